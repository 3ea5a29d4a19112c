"""Footsteps ahead: where and when the feet land, and how the body moves between.

    planner = Planner()
    plan = planner.plan(state, command, stones)  # exact, one robot after another
    plan = BatchPlanner(planner.program).plan(state, command, stones)  # all robots at once
    sample = plan.sample(time)  # body, feet, headings, contacts, forces

The model of a step is a linear pendulum in closed form (`pendulum`). A plan is the optimum of a
quadratic program (`program`) over footholds and the time of the next touchdown, with branch and
bound over stones (`planner`). All arithmetic but that of the solver takes NumPy arrays and tensors
of torch.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""Train without each part of the method, several seeds, and compare in one table and one picture.

    python recipes/ablate.py                                        # straight walks, three seeds
    python recipes/ablate.py --variants default no_delta --seeds 0 1 --total-steps 500000
    python recipes/ablate.py --variants default my_variants.py      # functions that edit the stack
    python recipes/ablate.py directions --list
    python recipes/ablate.py directions --variants default no_effort --seeds 0 1 2 3 4

Variants are trained one after the other with the same budget. Finished work is kept: the same
command resumes an interrupted training and adds new rows to the table. All policies are evaluated
on the same task (`aslip.envs.evaluation_stack`), and each gets the observation with which it was
trained.

Straight walks: 21 speeds, with the paper's reward on the true state and the motion of the actuated
spring-mass model.

Walks in all directions: 32 commands of the shipped library twice, on the nominal robot, and on
robots, floors and sensors drawn from `aslip.transforms.WIDE_RANGES`, which are the same for each
policy. Each has a table. Policies are compared by the reward of
`aslip.transforms.rewards.DIRECTION_WEIGHTS`, to the gaits of the shipped library; a walk whose
reward falls below the limit of trainings does not survive. These walks hold one command, and
nothing pushes them: what a variant does to sudden changes, pushes and standing shows in the
episodes of its training only, of which the picture has the lengths.
"""

from __future__ import annotations

from ablate_settings import DESCRIPTIONS, TASKS, Config

from aslip.base.command_line import preset_command_line, this_command
from aslip.errors import one_line_errors
from aslip.training.settings import say_loading

if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = preset_command_line(TASKS, DESCRIPTIONS)
    say_loading(CONFIG.out)

import ablate_directions
import ablate_straight
from ablation import Found, run


def main(config: Config, resume_command: str = "the same call") -> Found:
    """Train missing variants, then write table and picture; returns the walks.

    Args:
        config: the settings.
        resume_command: command that continues after an interruption, for messages.

    Raises:
        UnknownNameError: a variant is unknown.
        AssetError: there is no such file of variants.
        ConfigurationError: a file has no variants, a training in the folder had another budget or
            other gaits, or another process works in the folder.
        FileDamagedError: results in the folder cannot be read.
    """
    lists = {"straight": ablate_straight, "directions": ablate_directions}
    return run(config, lists[config.task].experiment(config, resume_command))


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, this_command())

"""Fault injection: number of faults injected and number survived, by kind of fault.

    python -m benchmarks.faults                        # all kinds, half an hour
    python -m benchmarks.faults --random-steps 0 --kills 0    # short kinds only
    python -m benchmarks.faults --kills 100            # a hundred killed trainings

The docstring of each fault defines survival. Trainings are tiny runs of `recipes/ppo_aslip.py` on
one thread. Each interrupted run is resumed and compared bit by bit with an uninterrupted one.
"""

"""Faults injected on purpose and many times, and faults survived.

    python -m benchmarks.faults                        # all of them: half an hour
    python -m benchmarks.faults --steps 0 --kills 0    # without the long ones
    python -m benchmarks.faults --kills 100            # a night of killed trainings

The docstring of each function says what counts as survived. Trainings are tiny ones of
`recipes/ppo_aslip.py` on one thread; each one that was stopped is resumed and compared bit by bit
with an undisturbed one.
"""

"""What goes wrong, on purpose and many times: faults injected, and faults survived.

    python -m benchmarks.faults                        # all of them: half an hour
    python -m benchmarks.faults --steps 0 --kills 0    # without the long ones
    python -m benchmarks.faults --kills 100            # a night of killed trainings

What counts as survived is in each function's docstring. Trainings are tiny ones of
`recipes/ppo_aslip.py`, on one thread, and every one that was stopped is resumed and compared bit by
bit with one that was not.
"""

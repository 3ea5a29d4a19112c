"""How well the state estimator knows the robot, and what it costs.

    python -m benchmarks.estimator

A policy walks at constant speeds and through changes of speed with noisy sensors. The first table
compares what the policy sees with the truth at the same instant, nothing removed: no bias, no
delay. NIS is the squared innovation of a foot at rest over its predicted variance, summed over the
three axes (3 where the filter is consistent; a single one is within its 95 % band from 0.22 to 9.35
if its noise is normal); NEES the same of the errors of velocity (3) and height (1). The second
table is about robots that fell and were reset. The third is time, side by side in one run.
"""

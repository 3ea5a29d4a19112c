"""What a policy survives: pushes by direction and phase of the stride, and robots unlike its own.

    python -m benchmarks.perturbation                                       # the shipped policy
    python -m benchmarks.perturbation --policy runs/seed0 runs/seed1 runs/seed2

A push is a horizontal force on the pelvis; its largest survivable impulse is found by bisection,
all directions and phases side by side, each from a state of the same steady walk. Survival need not
be monotonic in the impulse: what is found is one bound between walks and falls. Direction 0 is
forward, 90 degrees to the left; phase 0 is left lift-off. What happens on one side in one half of
the stride should happen on the other in the other half.

Then one parameter of the robot or of the floor is changed at a time, see `aslip.sim.DYNAMICS`, and
the share of walks without a fall is taken over commanded speeds. Wilson's interval takes these for
draws from all speeds, and walks of several policies for independent.
"""

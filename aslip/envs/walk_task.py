"""Walking at a constant speed, as a plain dm_control task.

No gait library here: the task rewards walking at a speed with the body upright, so that Cassie can
be used by any dm_control agent. Reference-guided learning adds its own terms as transforms.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from dm_control.rl import control
from dm_control.suite import base
from dm_control.utils import rewards
from dm_env import specs

from aslip.envs.physics import CassiePhysics
from aslip.errors import ConfigurationError
from aslip.robot import FALL_HEIGHT, PHYSICS_TIMESTEP, POLICY_PERIOD
from aslip.robot.model import DEFAULT_FLOOR_FRICTION

# the body height [m] from which standing is rewarded in full; gaits of the library bob above it
_STAND_HEIGHT = 0.75
# a speed error [m/s] at which the reward has fallen to a tenth
_SPEED_MARGIN = 0.5
# PD targets may lie this far [rad] outside the joint range to ask for torque at the limit
_TARGET_MARGIN = 1.0


class Walk(base.Task):
    """Walk along x at a given speed, upright.

    Args:
        speed: forward speed to keep [m/s].
        terminate_on_fall: end the episode, without bootstrap, when the robot has fallen.
        random: `numpy.random.RandomState` or seed; the pelvis' initial velocity is drawn from it.
    """

    def __init__(
        self,
        speed: float = 1.0,
        *,
        terminate_on_fall: bool = True,
        random: np.random.RandomState | int | None = None,
    ) -> None:
        if not np.isfinite(speed):
            raise ConfigurationError(f"speed must be a finite number of m/s, got {speed!r}")
        super().__init__(random=random)
        self._speed = speed
        self._terminate_on_fall = terminate_on_fall

    def action_spec(self, physics: CassiePhysics) -> specs.BoundedArray:
        """Ten joint angles [rad], within the joints' ranges and a margin."""
        low, high = physics.motor_range().T
        return specs.BoundedArray(
            low.shape, np.float64, low - _TARGET_MARGIN, high + _TARGET_MARGIN, "motor_target"
        )

    def initialize_episode(self, physics: CassiePhysics) -> None:
        """Stand, pushed a little in a random direction."""
        physics.stand()
        physics.data.qvel[:2] = self.random.uniform(-0.1, 0.1, size=2)
        super().initialize_episode(physics)

    def get_observation(self, physics: CassiePhysics) -> OrderedDict[str, np.ndarray]:
        """The robot's true state but for its place on the floor."""
        state = physics.true_state()
        observation = OrderedDict(height=state["pelvis_position"][2:])
        for name in (
            "pelvis_orientation",
            "pelvis_velocity",
            "pelvis_angular_velocity",
            "motor_position",
            "motor_velocity",
            "joint_position",
            "joint_velocity",
            "ground_force",
        ):
            observation[name] = state[name]
        return observation

    def get_reward(self, physics: CassiePhysics) -> float:
        """Product of upright, high enough, and at speed; in [0, 1]."""
        upright = (1 + physics.pelvis_upright()) / 2
        high = rewards.tolerance(
            physics.pelvis_height(), (_STAND_HEIGHT, float("inf")), margin=_STAND_HEIGHT / 2
        )
        at_speed = rewards.tolerance(
            physics.pelvis_velocity()[0], (self._speed, self._speed), margin=_SPEED_MARGIN
        )
        return float(upright * high * at_speed)

    def get_termination(self, physics: CassiePhysics) -> float | None:
        """Discount 0 after a fall."""
        fallen = self._terminate_on_fall and physics.pelvis_height() < FALL_HEIGHT
        return 0.0 if fallen else None


def walk_environment(
    speed: float = 1.0,
    *,
    time_limit: float = 12.0,
    terminate_on_fall: bool = True,
    floor_friction: float = DEFAULT_FLOOR_FRICTION,
    random: np.random.RandomState | int | None = None,
) -> control.Environment:
    """A dm_control environment of the `Walk` task at the policy rate of 33 Hz.

    Args:
        speed: forward speed to keep [m/s].
        time_limit: length of an episode [s]; 12 s are the paper's 400 policy steps.
        terminate_on_fall: end the episode when the robot has fallen.
        floor_friction: sliding friction of the floor.
        random: `numpy.random.RandomState` or seed.
    """
    physics = CassiePhysics.load(floor_friction)
    assert physics.timestep() == PHYSICS_TIMESTEP
    return control.Environment(
        physics,
        Walk(speed, terminate_on_fall=terminate_on_fall, random=random),
        time_limit=time_limit,
        control_timestep=POLICY_PERIOD,
    )

"""Path following: from an estimated pose to a command, for policies that walk in all directions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

_STEEPEST = 0.5  # largest angle a e towards the path [rad]

Pose = tuple[float, float, float]
"""Position x, y [m] and yaw [rad] in the world."""


class Path(Protocol):
    """Curve on the ground, as a function of its arc length."""

    def at(self, distance: float) -> tuple[Pose, float]:
        """Pose of a point, whose yaw is that of the tangent, and curvature there [1/m].

        Args:
            distance: arc length from the start [m].
        """
        ...


@dataclass(frozen=True)
class Eight:
    """Figure of eight: a circle to the left, then one to the right, from the origin along x."""

    radius: float = 3.0
    """Radius of the circles [m]."""

    def at(self, distance: float) -> tuple[Pose, float]:
        """Pose and curvature [1/m] at an arc length [m]; the path repeats after two circles."""
        turns, angle = divmod(distance / self.radius, 2 * math.pi)
        side = -1.0 if turns % 2 else 1.0
        x, y = self.radius * math.sin(angle), side * self.radius * (1 - math.cos(angle))
        return (x, y, side * angle), side / self.radius


@dataclass(frozen=True)
class PathFollower:
    r"""Law that keeps a robot on a path at a constant speed.

    With the distance e to the left of the path's nearest point, and the yaw error
    :math:`\theta` there:

    .. math:: v = R(-\psi)\,(u,\,-k e)^T, \quad \omega = \kappa u - k_\theta (\theta + a e)

    u is the speed along the path, :math:`\kappa` its curvature, and :math:`\psi` the yaw of the
    command's frame relative to the tangent; k, :math:`k_\theta` and a are `gain`, `turn_gain` and
    `aim`. k e is limited to `most`, and a e to half a radian. The law is feedforward with
    proportional feedback (Siciliano et al. 2009, Sec. 11.5), extended by a sideways speed.
    """

    path: Path
    """Path to follow."""
    speed: float = 0.8
    """Speed along the path [m/s]."""
    gain: float = 1.0
    """Sideways speed per distance from the path [1/s]."""
    turn_gain: float = 1.0
    """Yaw rate per yaw error [1/s]."""
    aim: float = 0.5
    """Angle towards the path per distance from it [rad/m]; it brings back robots that track
    sideways speeds badly, too."""
    most: float = 0.2
    """Largest sideways speed towards the path [m/s]."""

    def command(
        self, pose: Pose, heading: float, distance: float
    ) -> tuple[tuple[float, float, float], float]:
        """Command for the next policy step.

        Args:
            pose: estimated position and yaw of the pelvis.
            heading: yaw of the frame in which speeds are commanded [rad].
            distance: arc length of the nearest point, as the last step returned it [m]; 0 at first.

        Returns:
            Command: forward, sideways speed [m/s] and yaw rate [rad/s]; and arc length of the point
            of the path that is nearest now [m].
        """
        distance += self.errors(pose, distance)[0]
        _, left, turned = self.errors(pose, distance)
        (_, _, tangent), curvature = self.path.at(distance)
        towards = min(max(-self.gain * left, -self.most), self.most)
        yaw = heading - tangent
        cosine, sine = math.cos(yaw), math.sin(yaw)
        forward, sideways = (
            cosine * self.speed + sine * towards,
            cosine * towards - sine * self.speed,
        )
        aimed = turned + min(max(self.aim * left, -_STEEPEST), _STEEPEST)
        return (forward, sideways, curvature * self.speed - self.turn_gain * aimed), distance

    def errors(self, pose: Pose, distance: float) -> tuple[float, float, float]:
        """Distances ahead and to the left of a point of the path [m], and yaw error [rad].

        Args:
            pose: position and yaw of the robot.
            distance: arc length of the point [m].
        """
        (x, y, tangent), _ = self.path.at(distance)
        dx, dy = pose[0] - x, pose[1] - y
        cosine, sine = math.cos(tangent), math.sin(tangent)
        turned = math.remainder(pose[2] - tangent, math.tau)
        return cosine * dx + sine * dy, cosine * dy - sine * dx, turned

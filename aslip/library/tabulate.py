"""Tabulate motions: inverse kinematics and statics at every sample."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, TypedDict, Unpack

import numpy as np

from aslip.errors import ConfigurationError
from aslip.ik import Kinematics
from aslip.library.build import Progress, build_rows
from aslip.library.region import listed
from aslip.library.rows import FramedMotion
from aslip.library.table import ARRAYS, FEWEST_SAMPLES, GaitTable
from aslip.library.transitions import TRANSITION_ARRAYS, TransitionTable
from aslip.robot import CASSIE, STANDARD_GRAVITY, Robot
from aslip.rom import Gait, Transition
from aslip.rom.motion import COMMAND_SIZES, PHASE_SAMPLES, Motion

# limits of `warn_of_mistakes`
_RATE_GAP: Final = 0.05
_LEAST_RATE_GAP: Final = 0.01
_LOADED_SPEED: Final = 0.1
_WEIGHT_GAP: Final = 0.2
_ACCELERATION_GAP: Final = 0.5
_LEAST_ACCELERATION_GAP: Final = 0.3


class BuildOptions(TypedDict, total=False):
    """Options of `tabulate` that do not change what it returns."""

    workers: int | None
    """Number of processes; by default all cores for more than 128 motions."""
    progress: Progress | None
    """Function called with the numbers of finished motions and of all motions."""
    folder: Path | None
    """Folder that keeps finished rows, from which an interrupted build resumes."""


def tabulate(
    motions: Sequence[Motion],
    robot: Robot = CASSIE,
    *,
    samples: int = PHASE_SAMPLES,
    torque_jumps: bool = False,
    single_precision: bool = False,
    missing: bool = False,
    leg_dynamics: bool = False,
    **build: Unpack[BuildOptions],
) -> GaitTable:
    """Tabulate motions whose commands form a grid, with the robot's configurations and torques.

    Inverse kinematics maps the body of the reduced-order model to the pelvis origin and its point
    feet to the centres of the soles. Toes point along the foot heading and soles are level along
    the toes; a leg without a motor for the roll of its foot lets the sole lean with it (0.04 rad
    for Cassie). Public code keeps the legs in vertical planes and the foot motors still, so that
    its feet tilt and sink into the floor. Statics turns the model's ground forces into motor
    torques; inverse dynamics adds, if asked for, those that the legs need for themselves, which
    have no mass in the model.

    All rows are in the motion's moving frame, see `aslip.library.Reference`.

    Args:
        motions: one motion per point of the grid, in ascending order of commands; the last axis of
            the command varies fastest.
        robot: robot that the motions are mapped to.
        samples: samples of a stride.
        torque_jumps: forces may jump between samples, see `GaitTable`.
        single_precision: store numbers in single precision, half as large.
        missing: motions may be missing at points of the grid outside a convex region.
        leg_dynamics: add the torques that carry and accelerate the legs to those that balance the
            model's forces.
        build: processes, progress and resuming, see `BuildOptions`.

    Raises:
        ConfigurationError: the commands do not form a grid, a stride is not finite or does not end
            where the command leads, or there are fewer than four samples.
        UnreachablePoseError: the robot cannot take a pose of a motion.
    """
    _check_samples(samples)
    axes, present = grid_of(motions, missing=missing)
    phase = np.arange(samples) / samples
    rows = build_rows(motions, robot, phase, leg_dynamics=leg_dynamics, **build)
    columns = {}
    for name in ARRAYS:
        values = np.stack([row[name] for row in rows])
        single = single_precision and name != "strides"
        columns[name] = values.astype(np.float32 if single else float)
    return GaitTable(axes=axes, torque_jumps=torque_jumps, robot=robot, present=present, **columns)


def tabulate_transitions(
    gait: Gait,
    transitions: tuple[Transition, Transition],
    robot: Robot = CASSIE,
    *,
    samples: int = 48,
    leg_dynamics: bool = False,
) -> TransitionTable:
    """Tabulate stop and start with the robot's configurations and torques, after either foot.

    The model's legs meet in the point mass, so that even at rest they push the feet apart, Cassie's
    by 16 N. The robot's legs need not, and on soft contacts its feet would creep: the torques
    balance ground forces whose horizontal part the feet share in proportion to their loads.

    Args:
        gait: gait in place.
        transitions: stop and start after its left touchdown, from
            `aslip.rom.optimize_transitions`.
        robot: robot that they are mapped to.
        samples: samples of each motion, both ends included.
        leg_dynamics: as in `tabulate`.

    Raises:
        ConfigurationError: there are fewer than four samples.
        UnreachablePoseError: the robot cannot take a pose.
    """
    _check_samples(samples)
    kinematics, phase = Kinematics(robot), np.linspace(0.0, 1.0, samples)
    motions = [side for one in transitions for side in (one, one.mirrored())]
    framed = [FramedMotion.still(motion, phase).sharing_friction() for motion in motions]
    rows = [motion.rows(kinematics, leg_dynamics=leg_dynamics) for motion in framed]
    columns = {n: np.stack([row[n] for row in rows]) for n in TRANSITION_ARRAYS}
    return TransitionTable(
        touchdown=gait.single_stance / gait.stride,
        durations=np.array([motion.stride for motion in transitions]),
        **{name: v.reshape(2, 2, *v.shape[1:]) for name, v in columns.items()},
    )


def _check_samples(samples: int) -> None:
    """Check that a cubic can interpolate between the samples.

    Raises:
        ConfigurationError: there are fewer than four.
    """
    if samples < FEWEST_SAMPLES:
        raise ConfigurationError(f"samples must be {FEWEST_SAMPLES} or more, got {samples!r}")


def warn_of_mistakes(motions: Sequence[Motion], robot: Robot = CASSIE) -> None:
    """Warn of motions that no robot can follow, whatever the model: one line for each mistake.

    Velocities must be the change of positions, on average over a stride within 5 % and 0.01 m/s or
    rad/s; feet must rest while they carry load, on average below 0.1 m/s; ground forces must carry
    the robot's weight over a stride, within 20 %, and accelerate their share of it as the body is
    accelerated, on average within half of that and 0.3 m/s²; and one motion alone has no range of
    commands. Walks of the robot, whose pelvis is not all of its mass, differ by up to half, shipped
    gaits by 1 %, and by a quarter if sampled eight times a stride.
    """
    weight = robot.total_mass * STANDARD_GRAVITY
    found: dict[str, list[str]] = {}
    for motion in motions:
        for mistake, text in _mistakes(motion, weight):
            command = np.asarray(motion.command).tolist()
            found.setdefault(mistake, []).append(f"at command {command} {text}")
    if len(motions) == 1:
        command = np.asarray(motions[0].command).tolist()
        found["every command is walked as that of the only motion"] = [f"{command}"]
    for mistake, places in found.items():
        of = f"{len(places)} of {len(motions)} motions: " if len(motions) > 1 else ""
        warnings.warn(f"{of}{mistake}, {places[0]}", stacklevel=3)


def _mistakes(motion: Motion, weight: float) -> Iterator[tuple[str, str]]:
    """Mistakes of a motion, each with the numbers that show it."""
    s = motion.sample(np.arange(-1, PHASE_SAMPLES + 1) / PHASE_SAMPLES)
    tracks = {
        "body.velocity": (s.body.position, s.body.velocity),
        "feet.velocity": (s.feet.position, s.feet.velocity),
        "heading.rate": (s.heading.angle, s.heading.rate),
    }
    changes, span = {}, 2 * motion.stride / PHASE_SAMPLES
    for name, (position, velocity) in tracks.items():
        change = (position[2:] - position[:-2]) / span
        size, gap = (float(np.abs(x).mean()) for x in (change, change - velocity[1:-1]))
        if gap > _RATE_GAP * size + _LEAST_RATE_GAP:
            yield f"{name} is not the rate of the position or angle", f"by {gap:.2g} of {size:.2g}"
        changes[name] = change
    load = s.ground_force[1:-1, :, 2]
    carried = load.sum(axis=1).mean()
    if not abs(carried / weight - 1) < _WEIGHT_GAP:
        yield f"ground_force does not carry the robot's {weight:.0f} N", f"but {carried:.0f} N"
    else:
        velocity = changes["body.velocity"]
        acceleration = (velocity[2:] - velocity[:-2]) / span
        given = s.ground_force[2:-2].sum(axis=1) * (STANDARD_GRAVITY / carried)
        off = given - acceleration - [0.0, 0.0, STANDARD_GRAVITY]
        size, gap = (np.linalg.norm(x, axis=1).mean() for x in (acceleration, off))
        if gap > _ACCELERATION_GAP * size + _LEAST_ACCELERATION_GAP:
            text = f"by {gap:.2g} of {size:.2g} m/s²"
            yield "ground_force is not the body's mass x (acceleration + gravity)", text
    moved = np.abs(load) * np.linalg.norm(changes["feet.velocity"], axis=-1)
    if (speed := moved.sum() / max(np.abs(load).sum(), 1.0)) > _LOADED_SPEED:
        yield "feet move while they carry load", f"at {speed:.2g} m/s, averaged by load"


def grid_of(
    motions: Sequence[Motion], *, missing: bool = False
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Grid of the commands of motions.

    Args:
        motions: motions in ascending order of commands.
        missing: accept points of the grid without a motion.

    Returns:
        Values of the command along each axis, and the mask of points with a motion.

    Raises:
        ConfigurationError: the commands do not form a grid in ascending order.
    """
    commands = [np.asarray(motion.command, dtype=float) for motion in motions]
    alike = commands and all(c.ndim == 1 and c.shape == commands[0].shape for c in commands)
    if alike and len(commands[0]) in COMMAND_SIZES:
        axes = tuple(np.unique(column) for column in np.transpose(commands))
        pairs = zip(axes, np.transpose(commands), strict=True)
        place = tuple(np.searchsorted(axis, values) for axis, values in pairs)
        present = np.zeros(tuple(map(len, axes)), dtype=bool)
        present[place] = True
        order = np.ravel_multi_index(place, present.shape)
        if (np.diff(order) > 0).all() and (missing or present.all()):
            return axes, present
    raise ConfigurationError(
        "commands of motions must be ascending and form a grid, one motion per point, got"
        f" {listed([command.tolist() for command in commands])}"
    )

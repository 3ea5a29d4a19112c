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

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, cast

import matplotlib as mpl
import numpy as np
import torch
import tyro
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator
from scipy import stats
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp
from tqdm import tqdm

import aslip
from aslip.cassie import POLICY_PERIOD
from aslip.errors import ConfigurationError, one_line_errors
from aslip.ghost import heading
from aslip.stack import CassieTransformedEnv
from aslip.transforms import PhaseClock
from benchmarks.common import Common, Interval, environment, markdown, write_report

_CONFIDENCE = 0.95
# colours of phases, which come round
_CYCLIC = "hsv"
# directions of pushes [deg]
_SIDES = {0.0: "forward", 90.0: "left", 180.0: "back", 270.0: "right"}


@dataclass(frozen=True)
class Sweep:
    """How a parameter of `aslip.sim.DYNAMICS` is shown."""

    label: str
    flag: str
    """The field of `Config` that has its values."""
    shown: float = 1.0
    """Shown value over that in SI units."""
    nominal: float = 1.0
    """Shown value of the robot as it is."""


SWEEPS: Final = MappingProxyType(
    {
        "floor_friction": Sweep("floor friction", "floor_friction"),
        "payload": Sweep("payload [kg]", "payload", nominal=0.0),
        "slope": Sweep("slope [deg]", "slope_deg", 180 / math.pi, nominal=0.0),
        "torque_delay": Sweep("torque delay [ms]", "torque_delay_ms", 1e3, nominal=3.0),
        "motor_strength": Sweep("motor strength", "motor_strength"),
    }
)


@dataclass(frozen=True)
class Config(Common):
    """What to measure. A sweep without values is left out."""

    speed: float = 1.0
    """Commanded while pushed [m/s]."""
    directions: int = 8
    """Of pushes, all around."""
    phases: int = 8
    """Of the stride at which a push begins; 0 for no pushes at all."""
    repeats: int = 2
    """Trials of each, which differ in sensor noise."""
    bisections: int = 7
    """Halvings of the range of impulses."""
    largest: float = 96.0
    """End of that range [N s]."""
    duration: float = 0.2
    """Of a push, rounded up to policy steps [s]."""
    settle: float = 3.0
    """Walking before a push [s]."""
    after: float = 3.0
    """Walking after a push, without a fall, that counts as surviving it [s]."""
    floor_friction: tuple[float, ...] = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
    """Sliding friction of the floor."""
    payload: tuple[float, ...] = (0.0, 4.0, 8.0, 12.0, 16.0, 20.0)
    """At the pelvis [kg]."""
    slope_deg: tuple[float, ...] = (-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0)
    """Of the floor, rising forward."""
    torque_delay_ms: tuple[float, ...] = (0.0, 3.0, 5.0, 7.0, 9.0, 12.0)
    """From command to action."""
    motor_strength: tuple[float, ...] = (0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.4)
    """Delivered over commanded torque."""
    speeds: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
    """Commanded in sweeps [m/s]."""
    episodes: int = 1
    """Walks at each value and speed, which begin at other phases."""
    episode: float = 12.0
    """Length of one [s]."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        least = {"directions": 1, "phases": 0, "repeats": 1, "bisections": 1, "episodes": 1}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise ConfigurationError(f"{name} must be {low} or more, got {getattr(self, name)}")
        for name in ("largest", "duration", "settle", "after", "episode"):
            if not 0 < getattr(self, name) < math.inf:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")


def main(config: Config) -> dict[str, Any]:
    """Measure, print and draw; returns the numbers."""
    total = len(config.policy) * robot_steps(config)
    with (
        torch.no_grad(),
        set_exploration_type(ExplorationType.DETERMINISTIC),
        tqdm(total=total, unit="step", unit_scale=True, leave=False) as bar,
    ):
        pushes = [survived_pushes(config, policy, bar) for policy in config.policy]
        sweeps = [survived_sweeps(config, policy, bar) for policy in config.policy]
    numbers = {
        "speed": config.speed,
        "push_duration": push_steps(config) * POLICY_PERIOD,
        "resolution": config.largest * 0.5**config.bisections,
        "pushes": push_rows(config, pushes),
        "sweeps": sweep_rows(config, sweeps),
    }
    tables = [make(numbers) for make in (push_table, sweep_table)]
    text = "\n\n".join(table for table in tables if table)
    write_report(config, "perturbation", numbers, text, picture(config, numbers))
    return numbers


def robot_steps(config: Config) -> int:
    """Policy steps times robots that one policy takes at most."""
    pushed = config.directions * config.phases * config.repeats
    once = push_steps(config) + round(config.after / POLICY_PERIOD)
    each = round(config.settle / POLICY_PERIOD) + config.bisections * once
    return pushed * each + len(trials(config)) * round(config.episode / POLICY_PERIOD)


def walk(
    env: CassieTransformedEnv,
    actor: TensorDictModuleBase,
    td: TensorDictBase,
    steps: int,
    bar: tqdm,
    force: np.ndarray | None = None,
) -> tuple[TensorDictBase, np.ndarray]:
    """Walk on from a tensordict, which is left as it is, until all robots have fallen.

    Args:
        env: of n robots, in the state that the tensordict is of.
        actor: who acts.
        td: from where.
        steps: policy steps.
        bar: told of each robot's steps.
        force: (n, 3) on the pelvis all the while [N, world].

    Returns:
        The tensordict after the last step, and (n,) whether each robot has not fallen.
    """
    td = td.clone()
    alive = np.ones(env.num_envs, dtype=bool)
    for _ in range(steps):
        if force is not None:
            td["push"] = torch.from_numpy(force).float()
        td = env.step(actor(td))
        alive &= ~np.asarray(td["next", "terminated"][:, 0])
        td = step_mdp(td).exclude("push")
        bar.update(env.num_envs)
        if not alive.any():
            break
    return td, alive


def reset(env: CassieTransformedEnv, speed: np.ndarray, phase: np.ndarray) -> TensorDictBase:
    """Start on the reference at speeds (n,) [m/s] and phases (n,)."""
    values = {"command": speed, "phase": phase}
    request = {name: torch.tensor(value)[:, None].float() for name, value in values.items()}
    return env.reset(TensorDict(request, batch_size=len(phase)))


# ----------------------------------------------------------------------- pushes


def push_steps(config: Config) -> int:
    """Policy steps of a push."""
    return math.ceil(config.duration / POLICY_PERIOD - 1e-9)


def survived_pushes(config: Config, policy: str, bar: tqdm) -> np.ndarray:
    """(directions, phases, repeats) largest impulses that one policy was seen to survive [N s].

    Zero where it falls without a push.
    """
    shape = (config.directions, config.phases, config.repeats)
    if not config.phases:
        return np.zeros(shape)
    direction, phase, _ = (grid.ravel() for grid in np.indices(shape))
    actor, env = aslip.load_policy(policy), environment(config, policy, len(phase))
    try:
        td, standing = settled(config, env, actor, phase / config.phases, bar)
        states = env.base_env.states()
        orientation = np.asarray(td["truth", "pelvis_orientation"])
        toward = 2 * np.pi * direction / config.directions + heading(orientation)
        unit = np.stack([np.cos(toward), np.sin(toward), np.zeros(len(phase))], axis=1)
        survived, fatal = np.zeros(len(phase)), np.full(len(phase), config.largest)
        for _ in range(config.bisections):
            impulse = (survived + fatal) / 2
            env.base_env.set_states(states)
            alive = standing & survives(config, env, actor, td, impulse[:, None] * unit, bar)
            survived, fatal = np.where(alive, impulse, survived), np.where(alive, fatal, impulse)
    finally:
        env.close()
    return survived.reshape(shape)


def settled(
    config: Config,
    env: CassieTransformedEnv,
    actor: TensorDictModuleBase,
    phase: np.ndarray,
    bar: tqdm,
) -> tuple[TensorDictBase, np.ndarray]:
    """Walk until the start has been forgotten, all at the same time at phases (n,).

    Returns:
        The tensordict at that time, and (n,) who has not fallen.
    """
    steps = round(config.settle / POLICY_PERIOD)
    start = phase - steps * POLICY_PERIOD / stride(env, config.speed)
    td = reset(env, np.full(len(phase), config.speed), start % 1.0)
    return walk(env, actor, td, steps, bar)


def survives(
    config: Config,
    env: CassieTransformedEnv,
    actor: TensorDictModuleBase,
    td: TensorDictBase,
    impulse: np.ndarray,
    bar: tqdm,
) -> np.ndarray:
    """(n,) who has not fallen a while after a push of impulses (n, 3) [N s, world]."""
    steps = push_steps(config)
    td, during = walk(env, actor, td, steps, bar, impulse / (steps * POLICY_PERIOD))
    _, after = walk(env, actor, td, round(config.after / POLICY_PERIOD), bar)
    return during & after


def stride(env: CassieTransformedEnv, speed: float) -> float:
    """Duration of a stride of the environment's reference [s]."""
    clock = next(t for t in env.transforms if isinstance(t, PhaseClock))
    return float(clock.library.stride(torch.full((1, 1), speed)))


def push_rows(config: Config, pushes: list[np.ndarray]) -> list[dict[str, Any]]:
    """A row a direction: over all phases, and at each."""
    return [
        {
            "direction_deg": 360 * i / config.directions,
            **vars(Interval.of([found[i].ravel() for found in pushes])),
            "phases": [
                {"phase": j / config.phases, **vars(Interval.of([found[i, j] for found in pushes]))}
                for j in range(config.phases)
            ],
        }
        for i in range(config.directions if config.phases else 0)
    ]


def push_table(numbers: dict[str, Any]) -> str:
    """A row a direction."""
    rows = []
    for row in numbers["pushes"]:
        extremes = [pick(row["phases"], key=lambda cell: cell["mean"]) for pick in (min, max)]
        rows.append(
            [
                _SIDES.get(row["direction_deg"], f"{row['direction_deg']:.0f}°"),
                _interval(row).text(1),
                *(f"{_interval(cell).text(1)} at {cell['phase']:.3g}" for cell in extremes),
            ]
        )
    header = ["push", "impulse N s", "least, at phase", "greatest, at phase"]
    return markdown(header, rows) if rows else ""


def _interval(row: dict[str, Any]) -> Interval:
    return Interval(row["mean"], row["low"], row["high"])


# ----------------------------------------------------------------------- sweeps


@dataclass(frozen=True)
class Trial:
    """A walk of a robot unlike its own."""

    parameter: str
    shown: float
    """Value of the parameter, as it is shown."""
    speed: float
    """Commanded [m/s]."""
    phase: float
    """At which it begins."""


def trials(config: Config) -> list[Trial]:
    """All walks of all sweeps."""
    return [
        Trial(name, shown, speed, (i / len(config.speeds) + k / config.episodes) % 1.0)
        for name, sweep in SWEEPS.items()
        for shown in getattr(config, sweep.flag)
        for i, speed in enumerate(config.speeds)
        for k in range(config.episodes)
    ]


def survived_sweeps(config: Config, policy: str, bar: tqdm) -> np.ndarray:
    """(n,) whether one policy has walked through each of the `trials` without a fall."""
    all_trials = trials(config)
    if not all_trials:
        return np.zeros(0, dtype=bool)
    actor, env = aslip.load_policy(policy), environment(config, policy, len(all_trials))
    try:
        for i, trial in enumerate(all_trials):
            value = trial.shown / SWEEPS[trial.parameter].shown
            env.base_env.set_dynamics({trial.parameter: value}, np.array([i]))
        speed, phase = (
            np.array([getattr(t, name) for t in all_trials]) for name in ("speed", "phase")
        )
        steps = round(config.episode / POLICY_PERIOD)
        return walk(env, actor, reset(env, speed, phase), steps, bar)[1]
    finally:
        env.close()


def wilson(successes: int, trials: int) -> Interval:
    """Share of successes and Wilson's 95 % interval, which holds at 0 and 1, too."""
    found = stats.binomtest(successes, trials)
    interval = found.proportion_ci(_CONFIDENCE, method="wilson")
    return Interval(successes / trials, float(interval.low), float(interval.high))


def sweep_rows(config: Config, sweeps: Sequence[np.ndarray]) -> list[dict[str, Any]]:
    """A row a parameter and value, over all policies."""
    all_trials, survived = trials(config), np.array(sweeps)
    rows = []
    for name, shown in dict.fromkeys((t.parameter, t.shown) for t in all_trials):
        columns = [(t.parameter, t.shown) == (name, shown) for t in all_trials]
        found = survived[:, columns]
        at = np.array([t.speed for t in all_trials])[columns]
        rows.append(
            {
                "parameter": name,
                "value": shown,
                **vars(wilson(int(found.sum()), found.size)),
                "trials": found.size,
                "by_speed": {str(v): float(found[:, at == v].mean()) for v in config.speeds},
            }
        )
    return rows


def sweep_table(numbers: dict[str, Any]) -> str:
    """A row a parameter and value."""
    rows = [
        [
            SWEEPS[row["parameter"]].label,
            f"{row['value']:g}",
            _interval(row).text(0, 100),
            ", ".join(speed for speed, share in row["by_speed"].items() if share < 1),
        ]
        for row in numbers["sweeps"]
    ]
    header = ["changed", "value", "walks survived %", "falls when told to walk at m/s"]
    return markdown(header, rows) if rows else ""


# ---------------------------------------------------------------------- picture


def picture(config: Config, numbers: dict[str, Any]) -> Figure | None:
    """Impulses around the robot and over the stride, and survival over each parameter."""
    swept = [name for name in SWEEPS if any(r["parameter"] == name for r in numbers["sweeps"])]
    heights = [4.6] * bool(numbers["pushes"]) + [2.6] * bool(swept)
    if not heights:
        return None
    figure = Figure(figsize=(12, sum(heights)), layout="constrained")
    parts = list(figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0])
    if numbers["pushes"]:
        part = parts.pop(0)
        impulse = np.array([[cell["mean"] for cell in row["phases"]] for row in numbers["pushes"]])
        _draw_polar(cast("PolarAxes", part.add_subplot(1, 2, 1, projection="polar")), impulse)
        _draw_map(part.add_subplot(1, 2, 2), impulse)
        part.suptitle(
            f"largest survivable push at {config.speed:g} m/s: impulse [N s] within"
            f" {numbers['push_duration']:.2g} s"
        )
    if swept:
        panels = parts[0].subplots(1, len(swept), sharey=True, squeeze=False)[0]
        for axes, name in zip(panels, swept, strict=True):
            rows = [row for row in numbers["sweeps"] if row["parameter"] == name]
            _draw_sweep(axes, SWEEPS[name], rows)
    return figure


def _draw_polar(axes: PolarAxes, impulse: np.ndarray) -> None:
    """Impulse (directions, phases) over the direction of the push, forward up; a line a phase.

    What is survived at any phase is shaded.
    """
    directions, phases = impulse.shape
    angle = 2 * np.pi * np.arange(directions + 1) / directions
    closed = np.concatenate([impulse, impulse[:1]])
    axes.fill(angle, closed.min(axis=1), color="0.85", label="any")
    for j in range(phases):
        color = mpl.colormaps[_CYCLIC](j / phases)
        axes.plot(angle, closed[:, j], color=color, lw=1.2, label=f"{j / phases:.3g}")
    axes.plot(angle, closed.mean(axis=1), "k", lw=2.5, label="mean")
    axes.set_theta_zero_location("N")
    axes.set_thetagrids(list(_SIDES), list(_SIDES.values()))
    axes.set_ylim(0, None)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.set_rlabel_position(157.5)
    axes.grid(alpha=0.4)
    axes.legend(title="phase", fontsize=8, loc="center left", bbox_to_anchor=(1.12, 0.5))


def _draw_map(axes: Axes, impulse: np.ndarray) -> None:
    """The same in numbers."""
    directions, phases = impulse.shape
    image = axes.imshow(impulse, cmap="viridis", aspect="auto", norm=Normalize(0, impulse.max()))
    for (i, j), value in np.ndenumerate(impulse):
        color = "white" if value < 0.6 * impulse.max() else "black"
        axes.text(j, i, f"{value:.1f}", ha="center", va="center", color=color, fontsize=9)
    axes.set_xticks(range(phases), [f"{j / phases:.3g}" for j in range(phases)])
    degrees = [360 * i / directions for i in range(directions)]
    axes.set_yticks(range(directions), [_SIDES.get(d, f"{d:.0f}°") for d in degrees])
    axes.set(xlabel="phase at which the push begins (0: left lift-off)", ylabel="towards")
    axes.figure.colorbar(image, ax=axes, label="impulse [N s]")


def _draw_sweep(axes: Any, sweep: Sweep, rows: list[dict[str, Any]]) -> None:
    """Survival over a parameter, with intervals."""
    value = [row["value"] for row in rows]
    mean, low, high = (100 * np.array([row[k] for row in rows]) for k in ("mean", "low", "high"))
    axes.axvline(sweep.nominal, color="0.6", ls="--", lw=1)
    axes.errorbar(
        value, mean, [mean - low, high - mean], fmt="o-", color="tab:red", ms=4, capsize=3
    )
    axes.set(xlabel=sweep.label, ylim=(-4, 104))
    axes.grid(alpha=0.3)
    axes.label_outer()
    if axes.get_subplotspec().colspan.start == 0:
        axes.set_ylabel("walks survived [%]")


if __name__ == "__main__":
    with one_line_errors():
        main(tyro.cli(Config))

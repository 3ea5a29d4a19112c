"""Ship a policy: its file, and a card of training, interface and performance.

    python -m recipes.policy_card --name mine --run runs/ppo_aslip     # ship a run's policy
    python -m recipes.policy_card --name mine                          # write its card again
    python -m recipes.policy_card --name mine --library directions     # follow other gaits
    python -m recipes.policy_card --name mine --hub owner/mine         # to the Hugging Face hub

Copies the policy of a training run and its learning curve to `assets/policies/`, where
`aslip.load_policy` finds it by name, and writes the card beside them. The card combines the
policy's file, walks at all speeds and the other benchmarks. Walks and benchmarks take some minutes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the card."""

    name: str
    """Name by which `aslip.load_policy` finds the policy."""
    run: Path | None = None
    """Run folder of the training; without one, the card of the shipped policy is written again."""
    assets: Path = Path("assets/policies")
    """Folder of shipped policies."""
    out: Path = Path("runs/policy_card")
    """Folder for the benchmarks' results."""
    measure: bool = True
    """Walk, run the benchmarks, and add their tables to the card."""
    library: str | None = None
    """Library that the policy follows from now on, shipped or a file. Its file and its card still
    name the one of its training."""
    hub: str | None = None
    """Repository of the Hugging Face hub, `owner/name`, to which policy, curve and card are
    uploaded; a new one is private."""

    def __post_init__(self) -> None:
        """Check the name."""
        super().__post_init__()
        if not self.name.isidentifier():
            raise ConfigurationError(f"a policy's name must be an identifier, got {self.name!r}")


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import json
import re
from contextlib import closing
from functools import partial
from typing import Any

from tensordict.utils import unravel_key

import aslip.programs  # noqa: F401  for our own benchmarks
from aslip.base.archive import as_json
from aslip.base.provenance import provenance
from aslip.base.tables import markdown
from aslip.base.writing import replacing
from aslip.envs import make_env
from aslip.library import GaitLibrary
from aslip.policy import (
    CARD,
    POLICY_FILE,
    POLICY_FORMAT,
    find_policy,
    keep_library,
    load_policy,
    policy_environment,
    policy_library,
    read_card,
)
from aslip.policy.gaits import in_all_directions
from aslip.policy.hub import upload
from aslip.robot import CASSIE
from aslip.training.environments import make_evaluation_env
from aslip.training.run import write_text
from aslip.transforms import ActionDelta
from aslip.walking import evaluate, walk_table
from benchmarks.paper import foot_placement, step_frequency, velocity_tracking
from benchmarks.robustness import pushes, walking_quality
from benchmarks.robustness.parameters import SWEEPS
from benchmarks.scorecard import direction_targets
from benchmarks.scorecard.record import describe

_LEFT = "---"
# flags of the training command that do not affect the policy
_OWN = r" --out [^ ]+| --resume\b"
_MOTORS, _JOINTS = "; ".join(CASSIE.motor_names), "; ".join(CASSIE.joint_names)
_ENTRIES = {
    "estimate/height": "pelvis height above the ground [m]",
    "estimate/orientation": "quaternion from the pelvis to the heading frame, wxyz with w ≥ 0",
    "estimate/velocity": "pelvis velocity [m/s, heading frame: z up, x along the robot's heading]",
    "estimate/angular_velocity": "pelvis angular velocity [rad/s, pelvis]",
    "estimate/acceleration": "pelvis acceleration without gravity [m/s², pelvis]",
    "estimate/motor_position": f"motor angles [rad]: {_MOTORS}",
    "estimate/motor_velocity": "motor velocities [rad/s], same order",
    "estimate/joint_position": f"joint angles [rad]: {_JOINTS}",
    "estimate/joint_velocity": "joint velocities [rad/s], same order",
    "reference/body_position": "body of the model, relative to uniform motion [m]",
    "reference/body_velocity": "velocity of the model's body [m/s]",
    "reference/left_foot_position": "from the body [m]",
    "reference/left_foot_velocity": "over ground [m/s]",
    "reference/right_foot_position": "from the body [m]",
    "reference/right_foot_velocity": "over ground [m/s]",
    "clock/sin": "sine of the stride phase",
    "clock/cos": "cosine of the stride phase",
    "command": "commanded forward speed [m/s]",
    "reference/body_heading": "heading of the model's body, from the moving frame [rad]",
    "reference/left_foot_heading": "direction of the left toes, from the moving frame [rad]",
    "reference/right_foot_heading": "direction of the right toes, from the moving frame [rad]",
    "filtered_command": "forward, sideways speed [m/s] and yaw rate [rad/s], limited in rate",
    "plan/filtered_command": "forward, sideways speed [m/s] and yaw rate [rad/s] of the plan,"
    " or without stones of the command",
    "plan/step": "next foothold, from the body and above the foot in stance [m]; time until then"
    " [s]; foot in stance, 1 left, -1 right; zeros without stones",
    "odometry/path_error": "estimated distance from the moving frame's origin [m]",
    "last_action": "action of the last policy step [rad], same order as the motors",
}
"""Meaning of each entry of the observation."""

_BASELINES = {
    "reference/motor_target": "the reference's motor angles one policy step ahead, plus feedforward"
    " of the model's leg forces and of the PD loop's damping",
    "reference/motor_position": "the reference's motor angles one policy step ahead",
}


def main(config: Config) -> Path:
    """Copy the policy, run the benchmarks and write the card; returns the card's path."""
    shipped, curve = (config.assets / f"{config.name}.{kind}" for kind in ("zip", "png"))
    if config.run is not None:
        _ship(config, config.run, shipped, curve)
    if config.library is not None:
        _move(shipped, config.library)
    load_policy(shipped)  # raises if damaged
    about = read_card(shipped)
    parts = [f"# The policy `{config.name}`", training_section(about)]
    if curve.exists():
        parts.append(f"![Learning curve]({curve.name})")
    parts.append(interface_section(about))
    if config.measure:
        commit = provenance()["commit"] or "not recorded"
        parts += [f"The rest was measured with commit {commit}.", walks_section(shipped, about)]
        parts += benchmark_sections(config, str(shipped), about)
    card = config.assets / f"{config.name}.md"
    write_text(card, "\n\n".join(parts) + "\n")
    print(f"{shipped}, {card}")
    if config.hub is not None:
        pictures = {curve.name: curve.read_bytes()} if curve.exists() else {}
        files = {POLICY_FILE: shipped.read_bytes(), **pictures}
        print(upload(config.hub, card.read_text(encoding="utf-8"), files))
    return card


def training_section(about: dict[str, Any]) -> str:
    """Section on the training: command, commit, seed, cost and versions."""
    made = about.get("made_by", {})
    settings = made.get("settings", {})
    versions = ", ".join(f"{k} {v}" for k, v in made.get("versions", {}).items() if v)
    minutes = made.get("seconds", float("nan")) / 60
    rows = [
        ["command", f"`{made.get('command') or 'not recorded'}`"],
        ["commit", str(made.get("commit") or "not recorded")],
        ["seed", str(settings.get("seed", "not recorded"))],
        ["policy steps", f"{made.get('steps', 'not recorded')}"],
        ["time", "not recorded" if minutes != minutes else f"{minutes:.0f} minutes"],
        ["versions", versions or "not recorded"],
        ["settings", ", ".join(f"{k} {v}" for k, v in settings.items()) or "not recorded"],
    ]
    if about["network"] == "planned":
        kept = made.get("gaits", settings.get("start"))
        rows.append(["without stones", f"the network of `{kept}`, which did not learn"])
    if trained := made.get("trained_on"):
        now = about["library_sha256"][:12]
        rows.append(
            ["gaits", f"trained on those of SHA-256 {trained[:12]}, follows those of {now}"]
        )
    return f"## Training\n\n{markdown(['', ''], rows, _LEFT)}"


def interface_section(about: dict[str, Any]) -> str:
    """Section on observation, action and PD control."""
    with closing(make_env(stack=about["stack"])) as env:
        delta = next(t for t in env.transforms if isinstance(t, ActionDelta))
        spec = env.full_observation_spec
    baseline = "/".join(map(str, unravel_key(delta.baseline_key)))
    rows, index = [], 0
    for name in about["observation"]:
        size = spec[tuple(name.split("/"))].shape[-1]
        span = str(index) if size == 1 else f"{index}-{index + size - 1}"
        rows.append([span, name, _ENTRIES[name]])
        index += size
    gains = [
        [name, f"{stiffness:g}", f"{damping:g}", f"{limit:g}"]
        for name, stiffness, damping, limit in zip(
            CASSIE.motor_names,
            CASSIE.stiffness,
            CASSIE.damping,
            CASSIE.torque_limit * CASSIE.gear,
            strict=True,
        )
    ]
    header = ["motor", "stiffness [N m/rad]", "damping [N m s/rad]", "torque limit [N m]"]
    return "\n\n".join(
        [
            "## Interface",
            f"It observes {index} numbers, normalised by means and variances in the file and"
            " clipped at ten standard deviations:",
            markdown(["index", "entry", "meaning"], rows, _LEFT),
            f"It answers with {len(CASSIE.motor_names)} angles [rad],"
            f" {1 / CASSIE.policy_period:.1f} times a second, that are added to the baseline"
            f" {baseline}: {_BASELINES[baseline]}. The sums are the targets of PD loops that run"
            f" {CASSIE.substeps / CASSIE.policy_period:.0f} times a second, with velocity target"
            f" zero; torques reach the robot {1e3 * CASSIE.torque_delay:g} ms late."
            f' `aslip.make_env(stack="{about["stack"]}")` and `aslip.walking.Walker` do all this.',
            markdown(header, gains),
        ]
    )


def walks_section(policy: Path, about: dict[str, Any]) -> str:
    """Section on evaluation episodes at constant commands, with the noise of the training."""
    seed = about.get("made_by", {}).get("settings", {}).get("seed", 0)
    env, commands = make_evaluation_env(partial(make_env, **policy_environment(policy)), seed)
    with closing(env):
        env.set_seed(seed)
        rows, _, total = walk_table(evaluate(load_policy(policy), env, commands)).rpartition("\n\n")
    where = f"Twelve seconds each, on the nominal robot: {total}."
    return f"## Walks at constant command\n\n{where}\n\n{rows}"


def benchmark_sections(config: Config, policy: str, about: dict[str, Any]) -> list[str]:
    """Run the other benchmarks; returns sections with their tables and the limits."""
    common: dict[str, Any] = {"policy": (policy,), "out": config.out / config.name}
    parts = []
    if in_all_directions(about):
        return direction_sections(config, policy, about)
    if "reference/body_position" in about["observation"]:
        foot_placement.main(foot_placement.Config(**common))
        step_frequency.main(step_frequency.Config(**common))
        parts += [
            _section(config, "Foot placement", "paper.foot_placement"),
            _section(config, "Step frequency", "paper.step_frequency"),
        ]
    velocity_tracking.main(velocity_tracking.Config(**common))
    named = f"{config.name}={policy}"
    walking_quality.main(walking_quality.Config(**{**common, "policy": (named,)}))
    numbers = pushes.main(pushes.Config(**common))
    return [
        *parts,
        _section(config, "Velocity tracking", "paper.velocity_tracking"),
        _section(config, "Ground contact, impacts and power", "robustness.walking_quality"),
        f"## Limits\n\n{limits(numbers)}\n{training_conditions(about)}",
        (config.out / config.name / "pushes.md").read_text(encoding="utf-8").strip(),
    ]


def direction_sections(config: Config, policy: str, about: dict[str, Any]) -> list[str]:
    """Targets of walks in all directions, tables of their benchmarks, and the limits."""
    out = config.out / config.name
    direction_targets.main(direction_targets.Config(policy=(policy,), out=out))
    folder = out / describe(policy)["name"]
    titles = {
        "Velocity": "tracking",
        "Sudden changes of the command": "command_changes",
        "Stop, standing and start": "stops",
        "Figure of eight": "figure_of_eight",
        "Foot placement": "foot_placement",
        "Ground contact, impacts and power": "walking_quality",
    }
    numbers = json.loads((folder / "pushes.json").read_text(encoding="utf-8"))
    return [
        _section(config, "Targets", "scorecard.direction_targets"),
        "This command also made the tables below.",
        *(_table_section(title, folder / f"{name}.md") for title, name in titles.items()),
        f"## Limits\n\n{limits(numbers)}\n{training_conditions(about)}",
        (folder / "pushes.md").read_text(encoding="utf-8").strip(),
    ]


def limits(numbers: dict[str, Any]) -> str:
    """List of the weakest push direction and phase, and of parameters that cause falls."""
    cells = [(cell, row) for row in numbers["pushes"] for cell in row["phases"]]
    weakest, row = min(cells, key=lambda pair: pair[0]["mean"])
    lines = [
        f"- At {numbers['speed']:g} m/s, pushes of {numbers['push_duration']:.2g} s of more than"
        f" {weakest['mean']:.1f} N s, where it is weakest: at phase {weakest['phase']:g}, at"
        f" {row['direction_deg']:.0f}° from forward to the left."
    ]
    for name, sweep in SWEEPS.items():
        rows = [row for row in numbers["sweeps"] if row["parameter"] == name]
        bad = [f"{row['value']:g}" for row in rows if row["mean"] < 1]
        if bad:
            lines.append(f"- {sweep.label}: some walks fail at {', '.join(bad)}.")
        elif rows:
            values = [row["value"] for row in rows]
            lines.append(f"- {sweep.label}: none from {min(values):g} to {max(values):g}.")
    return "\n".join(lines)


def training_conditions(about: dict[str, Any]) -> str:
    """Line on the robots, floors and pushes of the training, as its policy's file has them."""
    made = about.get("made_by", {})
    settings, transforms = made.get("settings", {}), made.get("transforms", {})
    how = "to walk in all directions" if in_all_directions(about) else "to walk straight ahead"
    pushes = settings.get("push_impulse", 0)
    pushed = f", with pushes of up to {pushes:g} N s" if pushes else ""
    dynamics = transforms.get("training/dynamics", transforms.get("dynamics"))
    if dynamics is None:
        return f"- It was trained on level ground with friction 1, {how}{pushed}."
    ranges = [
        f"{name} {float(low):g} to {float(high):g}"
        for name, low, high in re.findall(r"'(\w+)': '\(([^,]+), ([^)]+)\)'", dynamics)
    ]
    if settings.get("encoder_offset"):
        ranges.append(f"encoder offsets of up to {settings['encoder_offset']:g} rad")
    share = settings.get("randomise_share", 1)
    each = f" (each nominal with a probability of {1 - share:g})" if share < 1 else ""
    grown = ", in ranges that grew from the nominal ones" if settings.get("ramp") else ""
    return (
        f"- It was trained {how} on robots and floors drawn for each episode{each}{grown}:"
        f" {', '.join(ranges)}; see `aslip.sim.DYNAMICS`{pushed}."
    )


def _section(config: Config, title: str, benchmark: str) -> str:
    """Section with a benchmark's table and its command."""
    command = f"`aslip measure {benchmark} --policy {config.name}`"
    table = config.out / config.name / f"{benchmark.split('.')[-1]}.md"
    return _table_section(title, table, f"{command}\n\n")


def _table_section(title: str, table: Path, before: str = "") -> str:
    """Section with a table."""
    return f"## {title}\n\n{before}{table.read_text(encoding='utf-8').strip()}"


def _ship(config: Config, run: Path, target: Path, curve: Path) -> None:
    """Copy policy and learning curve of a run, without the run folder in the recorded command."""
    source = find_policy(run)
    load_policy(source)  # raises if damaged
    policy_environment(source)  # raises if the stack has no name, or the gaits are missing
    config.assets.mkdir(parents=True, exist_ok=True)
    entries = POLICY_FORMAT.read(source)
    card = json.loads(entries[CARD])
    made = card["made_by"]
    if made.get("command"):
        made["command"] = re.sub(_OWN, "", made["command"])
    POLICY_FORMAT.write(target, {**entries, CARD: as_json(card)})
    keep_library(target, policy_library(source))
    curve.unlink(missing_ok=True)
    if (run / "learning_curve.png").exists():
        with replacing(curve) as file:
            file.write((run / "learning_curve.png").read_bytes())


def _move(policy: Path, library: str) -> None:
    """Name another library as the one that a policy follows, and keep the one of its training."""
    entries = POLICY_FORMAT.read(policy)
    card = json.loads(entries[CARD])
    if card["library_sha256"] is not None:
        card["made_by"].setdefault("trained_on", card["library_sha256"])
    gaits = GaitLibrary.load(library)
    card["library_sha256"] = gaits.sha256
    keep_library(policy, gaits)
    POLICY_FORMAT.write(policy, {**entries, CARD: as_json(card)})


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)

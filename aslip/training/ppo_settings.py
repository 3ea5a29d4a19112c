"""Settings of `recipes/ppo_aslip.py` and of the recipes that are built on it.

Apart from the recipe, because a command line is parsed before PyTorch is imported.
"""

from __future__ import annotations

import argparse
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from aslip.envs import RewardSource
from aslip.errors import AslipError, ConfigurationError
from aslip.robot import CASSIE
from aslip.training.command_line import command_line, program, usage_error
from aslip.training.settings import CollectorKind, check_shares, check_types, read_settings


@dataclass(frozen=True)
class Config:
    """Settings; "Table II" is the paper's table of PPO hyper-parameters, the preset "paper"."""

    preset: Literal["default", "paper"] = "default"
    """Defaults of all other settings: the recipe's own, or the paper's where it gives them."""

    out: Path = Path("runs/ppo_aslip")
    """Folder of the run."""
    resume: bool = False
    """Continue the run in the folder."""
    seed: int = 0
    """Reaches every random number."""
    total_steps: int = 1_500_000
    """Policy steps to train for, rounded up to whole updates; the paper trains for 175 million. As
    many again as one update has come first, to teach the normaliser what inputs look like."""
    schedule_steps: int = 0
    """Policy steps after which learning rate and standard deviation have fallen to their last
    values, which then stay; 0 for the total_steps that the run is started with."""
    num_envs: int = 256
    """Robots simulated side by side."""
    stack: Literal["aslip", "paper", "single_reference"] = "aslip"
    """Environment: motor targets with feedforward torque, without (paper), or the paper's baseline,
    one reference motion."""
    symmetric: bool = True
    """Make actor and critic treat left and right alike; not in the paper."""
    value_scale: float = 10.0
    """Factor on the output of the critic's network; 1 in the paper."""
    samples: int = 2048
    """Policy steps per update; Table II says 5096."""
    minibatch: int = 256
    """Samples of a gradient step; Table II says 64."""
    epochs: int = 5
    """Passes over the samples of an update; Table II says 3."""
    learning_rate: float = 3e-4
    """Initial learning rate of Adam; Table II says 1e-4."""
    last_learning_rate: float = 2e-5
    """Final learning rate of Adam; constant in the paper."""
    std: float = 0.15
    """Initial standard deviation of the policy [rad]; the paper gives none, its public code
    exp(-2)."""
    last_std: float = 0.05
    """Final standard deviation of the policy [rad]; constant in the paper."""
    fall_after: float = 0.6
    """Share of schedule_steps after which learning rate and standard deviation fall,
    exponentially; until then both keep their initial values."""
    adam_epsilon: float = 1e-5
    """Epsilon of Adam (Table II)."""
    gamma: float = 0.95
    """Discount; Table II says 0.99. Steps count for 0.6 s in place of 3: less noise in advantages,
    and what a step does shows within a stride."""
    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation; the paper gives none."""
    clip: float = 0.2
    """Clipping range of PPO's probability ratio (Table II)."""
    max_grad_norm: float = 0.5
    """Largest gradient norm, of actor and critic each; the paper gives none."""
    truth: bool = False
    """Show the policy the simulator's truth instead of what an estimator makes of noisy sensors."""
    reward_on: RewardSource = "truth"
    """Reward what the simulator knows of the robot, or what its estimator believes."""
    command_interval: float = 8.0
    """Mean time between changes of the commanded speed in training [s], for commands without an
    interval of their own; 0 for none, as in the paper."""
    randomise: bool = False
    """Train on robots that differ from episode to episode, in mass, friction, springs, motors,
    delay, slope and noise (`aslip.transforms.DYNAMICS_RANGES`); evaluated is the robot itself."""
    coarse: bool = False
    """Train with physics steps of 1 ms in place of 0.5; evaluated is always with the latter."""
    collector: CollectorKind = "single"
    """Processes that simulate: this one, others on this machine, or those of a Ray cluster
    (`aslip.training.collect`)."""
    num_collectors: int = 2
    """Processes or actors that robots are shared out to, unless there is but this process."""
    eval_interval: int = 250_000
    """Policy steps between evaluations over all speeds."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints; with none, there is one after every update."""

    def __post_init__(self) -> None:
        """Check ranges, so that a typing slip is reported at the start."""
        check_types(self)
        for name in (
            "total_steps", "num_envs", "samples", "minibatch", "epochs", "num_collectors",
            "eval_interval",
        ):  # fmt: skip
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name} must be 1 or more, got {getattr(self, name)}")
        for name in (
            "learning_rate", "last_learning_rate", "adam_epsilon", "clip", "max_grad_norm",
            "value_scale", "std", "last_std",
        ):  # fmt: skip
            if getattr(self, name) <= 0:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("gamma", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigurationError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        if not 0 <= self.fall_after < 1:
            raise ConfigurationError(f"fall_after must be in [0, 1), got {self.fall_after}")
        if not 0 <= self.seed < 2**63:
            raise ConfigurationError(f"seed must be from 0 to 2**63 - 1, got {self.seed}")
        for name in ("checkpoint_minutes", "schedule_steps"):
            if getattr(self, name) < 0:
                raise ConfigurationError(f"{name} must be 0 or more, got {getattr(self, name)}")
        if self.command_interval != 0 and self.command_interval < CASSIE.policy_period:
            raise ConfigurationError(
                f"command_interval must be 0, or a policy step, {CASSIE.policy_period} s, or more;"
                f" got {self.command_interval}"
            )
        collectors = 1 if self.collector == "single" else self.num_collectors
        check_shares(self.num_envs, self.samples, collectors)


PRESETS = {
    "default": Config(),
    "paper": Config(
        preset="paper", stack="paper", symmetric=False, value_scale=1.0, samples=5120,
        minibatch=64, epochs=3, learning_rate=1e-4, last_learning_rate=1e-4, gamma=0.99,
        command_interval=0.0, std=math.exp(-2), last_std=math.exp(-2),
    ),
}  # fmt: skip
"""Named settings to start from; 5120 is the multiple of 256 nearest to 5096."""


def training_settings(
    presets: Mapping[str, Config] = PRESETS, arguments: Sequence[str] | None = None
) -> Config:
    """Settings from the command line.

    What is not given is as in the preset that is named or, with `--resume`, as in the run.

    Args:
        presets: by name.
        arguments: words of the command line; those of this program by default.

    Raises:
        SystemExit: as `command_line`.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    # without a word after them: left to the parser that knows all flags
    parser.add_argument("--preset", nargs="?")
    parser.add_argument("--out", nargs="?")
    parser.add_argument("--resume", action=argparse.BooleanOptionalAction)
    given = parser.parse_known_args(arguments)[0]
    default = presets.get(given.preset, presets["default"])
    if given.resume:
        try:
            default = kept_settings(Path(given.out or default.out), presets)
        except AslipError as error:
            usage_error(str(error))
    return command_line(Config, default, arguments)


def kept_settings(folder: Path, presets: Mapping[str, Config] = PRESETS) -> Config:
    """Settings of the run in a folder, with the folder as it is called now.

    Raises:
        ConfigurationError: the folder holds no run, or one with settings that this recipe has not.
        FileDamagedError: the settings cannot be read.
    """
    kept = read_settings(folder)[0]
    unknown = sorted(kept.keys() - {field.name for field in fields(Config)})
    if unknown:
        raise ConfigurationError(
            f"the run in {str(folder)!r} is of another version or recipe: it has the settings"
            f" {unknown}; resume it with the version that started it"
        )
    preset = presets.get(str(kept.get("preset")), presets["default"])
    return with_schedule(replace(preset, **{**kept, "out": folder, "resume": False}), kept)


def with_schedule(config: Config, kept: Mapping[str, Any] | None = None) -> Config:
    """Fix how many policy steps the schedule has, however long the run will be trained on.

    Args:
        config: the settings.
        kept: settings of the run that is resumed; None for a new run.
    """
    if config.schedule_steps:
        return config
    kept = kept or {}
    # a run of before has no schedule of its own
    steps = kept.get("schedule_steps") or kept.get("total_steps") or config.total_steps
    return replace(config, schedule_steps=steps)


def whole_updates(config: Config) -> int:
    """Policy steps to train for, in whole updates."""
    return math.ceil(config.total_steps / config.samples) * config.samples


def resume_command(config: Config) -> str:
    """Command line that resumes the run of this program."""
    return f"{program()} --resume --out {shlex.quote(str(config.out))}"

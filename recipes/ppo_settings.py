"""Settings, presets and command line of `ppo_aslip.py`, without any import of PyTorch.

python recipes/ppo_aslip.py --help
python recipes/ppo_aslip.py paper --seed 1
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeVar

from aslip.base.assets import UserPaths
from aslip.base.command_line import preset_command_line, program, usage_error
from aslip.base.imports import extras
from aslip.errors import AslipError, ConfigurationError
from aslip.training.settings import (
    LoggerName,
    check_positive,
    check_range,
    check_shares,
    check_types,
    read_settings,
    say_loading,
)

with extras():
    import tyro

DESCRIPTIONS = {
    "default": "the stack `straight`, with feedforward torques; settings for fast learning",
    "paper": "paper's stack and settings, as far as given (5120 samples instead of 5096)",
    "single_reference": "paper's baseline: one reference motion in joint space (Xie et al. 2018)",
    "robust": "domain randomisation: robot, floor and sensor noise differ between episodes",
    "truth": "policy observes the true state instead of the estimate",
    "gpu": "all robots, networks and updates on a GPU, on MuJoCo Warp",
    "straight": "the default with physics of 2 kHz; the shipped policy `straight` is one of these",
}

TIMESTEPS = (0.0005, 0.001)
"""Physics timesteps of the low level at 2 kHz (`aslip.robot.model.physics_timesteps`) [s]."""


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of learning; "Table II" is the paper's table of PPO hyper-parameters."""

    preset: tyro.conf.Suppress[tyro.conf.Fixed[str]] = "default"
    """Name of the preset with the defaults of the other settings."""
    out: Path = Path("runs/ppo_aslip")
    """Folder of the run."""
    resume: bool = False
    """Continue the run in the folder, with its settings except for those given."""
    library: str | None = None
    """Library of gaits: a file or the name of a shipped one; by default that of the preset. The run
    keeps a copy."""
    start: str | None = None
    """Policy to start from: the name of a shipped one, a file or a run; by default a new one."""
    critic_steps: int = 100_000
    """Policy steps at the start in which only the critic of a given policy learns."""
    seed: int = 0
    """Seed of all random numbers."""
    device: str = "cpu"
    """PyTorch device of networks and updates, such as "cuda", and of robots on MuJoCo Warp."""
    backend: Literal["batch", "warp"] = "batch"
    """Simulator of training: "batch" on the CPU, or "warp", MuJoCo Warp on the device. Evaluations
    walk on the CPU."""
    total_steps: int = 1_500_000
    """Policy steps to train for, rounded up to whole updates, after one batch that only initialises
    the input normaliser; the paper trains for 175 million."""
    schedule_steps: int = 0
    """Policy steps after which learning rate and standard deviation have their final values; 0 for
    the initial total_steps of the run."""
    num_envs: int = 256
    """Robots simulated in parallel."""
    num_collectors: int = 0
    """Ray actors that simulate them, on this machine or on those of the cluster at RAY_ADDRESS; 0
    for robots in this process."""
    samples: int = 2048
    """Policy steps per update; Table II says 5096."""
    minibatch: int = 256
    """Samples per gradient step; Table II says 64."""
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
    """Share of schedule_steps with the initial learning rate and standard deviation; after it, both
    decay exponentially."""
    adam_epsilon: float = 1e-5
    """Epsilon of Adam (Table II)."""
    gamma: float = 0.95
    """Discount factor; Table II says 0.99, a horizon of 3 s instead of 0.6 s. Chosen on one seed; a
    guess at why it helps is that an action takes effect within a stride, 0.8 s."""
    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation; the paper gives none."""
    clip: float = 0.2
    """Clipping range of PPO's probability ratio (Table II)."""
    max_grad_norm: float = 0.5
    """Largest gradient norm, separately for actor and critic; the paper gives none."""
    symmetric: bool = True
    """Make actor and critic equivariant to left-right mirroring; not in the paper."""
    value_scale: float = 10.0
    """Factor on the output of the critic's network; 1 in the paper."""
    physics_timestep: float = 1e-3
    """Physics timestep in training, 0.0005 as walks have or the faster 0.001 [s]; the low level
    runs at 2 kHz."""
    eval_interval: int = 250_000
    """Policy steps between evaluations over all speeds."""
    eval_steps: int = 400
    """Policy steps of an evaluation's walks."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints; 0 for one after every update."""
    logger: LoggerName = "none"
    """Logger that gets settings, numbers and films of evaluations, besides CSV and TensorBoard,
    which have the numbers only."""

    def __post_init__(self) -> None:
        """Check types and ranges.

        Raises:
            ConfigurationError: a setting has the wrong type or is out of range.
        """
        super().__post_init__()
        check_types(self)
        if self.preset not in DESCRIPTIONS:
            raise ConfigurationError(
                f"preset must be one of {[*DESCRIPTIONS]}, got {self.preset!r}"
            )
        if not re.fullmatch(r"(cpu|cuda|mps|xpu)(:\d+)?", self.device):
            raise ConfigurationError(
                f"device must be a PyTorch device, such as 'cpu' or 'cuda', got {self.device!r}"
            )
        check_positive(
            self, "total_steps", "num_envs", "samples", "minibatch", "epochs", "eval_interval",
            "eval_steps", "learning_rate", "last_learning_rate", "adam_epsilon", "clip",
            "max_grad_norm", "value_scale", "std", "last_std",
        )  # fmt: skip
        check_range(self, 0, 1, "gamma", "gae_lambda")
        check_range(self, 0, 0.99, "fall_after")
        check_range(self, 0, 2**63 - 1, "seed")
        check_range(self, 0, math.inf, "checkpoint_minutes", "schedule_steps", "num_collectors")
        check_range(self, 0, math.inf, "critic_steps")
        if self.physics_timestep not in TIMESTEPS:
            raise ConfigurationError(
                f"physics_timestep must be one of {TIMESTEPS} s, got {self.physics_timestep}"
            )
        check_shares(self.num_envs, self.samples, self.num_collectors or 1)

    def learning_rate_after(self, step: int) -> float:
        """Learning rate after a number of policy steps."""
        return scheduled(self, step, self.learning_rate, self.last_learning_rate)

    def std_after(self, step: int) -> float:
        """Standard deviation of the policy after a number of policy steps [rad]."""
        return scheduled(self, step, self.std, self.last_std)


_PAPER = Config(
    preset="paper", out=Path("runs/paper"), symmetric=False, value_scale=1.0, samples=5120,
    minibatch=64, epochs=3, learning_rate=1e-4, last_learning_rate=1e-4, gamma=0.99,
    std=math.exp(-2), last_std=math.exp(-2), physics_timestep=5e-4,
)  # fmt: skip

ON_GPU: Mapping[str, Any] = MappingProxyType(
    {
        "backend": "warp", "device": "cuda", "num_envs": 16384, "samples": 4 * 16384,
        "minibatch": 4096, "learning_rate": 1e-3, "last_learning_rate": 1e-4,
        "eval_interval": 1_000_000,
    }
)  # fmt: skip
"""Settings of thousands of robots on a GPU."""

PRESETS = {
    config.preset: config
    for config in (
        Config(),
        _PAPER,
        replace(
            _PAPER, preset="single_reference", out=Path("runs/single_reference"),
            total_steps=6_250_000, fall_after=0.8, last_learning_rate=1e-5, last_std=0.05,
        ),
        Config(preset="robust", out=Path("runs/robust")),
        Config(preset="truth", out=Path("runs/truth")),
        Config(preset="gpu", out=Path("runs/gpu"), **ON_GPU, total_steps=5_000_000),
        Config(preset="straight", out=Path("runs/straight"), physics_timestep=5e-4),
    )
}  # fmt: skip
"""Settings to start from, by name; `ppo_presets.environments` makes the environments of each."""

AnyConfig = TypeVar("AnyConfig", bound=Config)


def training_settings(
    presets: Mapping[str, AnyConfig], arguments: Sequence[str] | None = None
) -> AnyConfig:
    """Read settings from the command line.

    Defaults come from the preset or, with `--resume`, from the run.

    Args:
        presets: settings by name; the first is the default.
        arguments: words of the command line; those of this program by default.

    Raises:
        SystemExit: after `--help`, or after a message about a mistake.
    """
    config = preset_command_line(presets, DESCRIPTIONS, arguments)
    if not config.resume:
        say_loading(config.out)
        return config
    try:
        kept = run_settings(config.out, presets[config.preset])
    except AslipError as error:
        usage_error(str(error))
    config = preset_command_line({**presets, config.preset: kept}, DESCRIPTIONS, arguments)
    say_loading(config.out)
    return config


def run_settings(folder: Path, preset: AnyConfig) -> AnyConfig:
    """Settings of the run in a folder, which may have been moved.

    Args:
        folder: folder of the run.
        preset: defaults of settings that the run does not have.

    Raises:
        ConfigurationError: the folder holds no run, or the run has another preset or unknown
            settings.
        FileDamagedError: the settings cannot be read.
    """
    kept = read_settings(folder)[0]
    unknown = sorted(kept.keys() - {field.name for field in fields(preset)})
    if unknown:
        raise ConfigurationError(
            f"the run in {str(folder)!r} comes from another version or recipe: it has the settings"
            f" {unknown}; resume it with the version that started it"
        )
    if kept.get("preset") != preset.preset:
        raise ConfigurationError(
            f"the run in {str(folder)!r} has the preset {kept.get('preset')!r}; to resume it:"
            f" {program()} {kept.get('preset')} --resume --out {shlex.quote(str(folder))}"
        )
    return with_schedule(replace(preset, **{**kept, "out": folder, "resume": False}), kept)


def with_schedule(config: AnyConfig, kept: Mapping[str, Any] | None = None) -> AnyConfig:
    """Set the length of the schedule, which resuming with more total_steps must not change.

    Args:
        config: the settings.
        kept: settings of the run that is resumed; None for a new run.
    """
    if config.schedule_steps:
        return config
    steps = (kept or {}).get("schedule_steps", config.total_steps)
    return replace(config, schedule_steps=steps)


def scheduled(config: Config, step: int, first: float, last: float) -> float:
    """Value that decays exponentially from `first` to `last` over the last part of the schedule."""
    steps = config.schedule_steps or config.total_steps
    share = (step / steps - config.fall_after) / (1 - config.fall_after)
    return first * (last / first) ** min(max(share, 0.0), 1.0)


def resume_command(config: Config) -> str:
    """Command line that resumes the run of this program."""
    preset = "" if config.preset == "default" else f" {config.preset}"
    return f"{program()}{preset} --resume --out {shlex.quote(str(config.out))}"

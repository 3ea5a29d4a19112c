"""Teach Cassie to walk at every speed from 0 to 2 m/s, guided by actuated-SLIP gaits.

    python recipes/ppo_aslip.py                         # train, evaluate, draw: runs/ppo_aslip/
    python recipes/ppo_aslip.py --resume                # go on after Ctrl-C, kill or a crash
    python recipes/ppo_aslip.py --seed 1 --out runs/seed1 --total-steps 5000000
    python recipes/ppo_aslip.py --truth --out runs/truth # without noise and estimator
    python recipes/ppo_aslip.py --preset paper --out runs/paper
    python recipes/ppo_aslip.py --randomise --out runs/robust # robots that differ
    python recipes/ppo_aslip.py --collector ray --num-collectors 8 # on a cluster: aslip/collect

This is Green et al. 2021 from top to bottom: settings, environment, policy, PPO, evaluation. An
ablation is a call of `main` in which `make_env` gets something else to `drop` or to `replace`.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

import torch
import tyro
from tensordict import TensorDict
from torchrl.checkpoint import GlobalRNGState
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from tqdm import tqdm

import aslip
from aslip.cassie import POLICY_PERIOD
from aslip.cassie.model import TIMESTEPS
from aslip.collect import CollectorKind, check_shares, make_collector
from aslip.errors import ConfigurationError, one_line_errors
from aslip.evaluation import WalkResult, evaluate, walk_table
from aslip.plots import learning_curve, save_figure
from aslip.policy import (
    PolicyShape,
    RunningNormalizer,
    make_actor,
    make_critic,
    save_policy,
    set_std,
)
from aslip.provenance import provenance
from aslip.run import TrainingRun, check_types, peak_memory, write_text
from aslip.stack import (
    ON_TRUTH,
    STACKS,
    CassieTransformedEnv,
    RewardSource,
    acts_on,
    commanded,
    described,
    observed,
    randomised,
)
from aslip.transforms import SpeedCommand


@dataclass(frozen=True)
class Config:
    """Settings; "Table II" is the paper's table of PPO hyper-parameters, the preset "paper"."""

    preset: Literal["default", "paper"] = "default"
    """What all other settings are by default: the recipe's own, or what the paper says."""

    out: Path = Path("runs/ppo_aslip")
    """Folder of the run."""
    resume: bool = False
    """Continue the run in the folder."""
    seed: int = 0
    """Reaches every random number."""
    total_steps: int = 1_500_000
    """Policy steps to train for; the paper trains for 175 million. As many again as one update has
    come first, to teach the normaliser what inputs look like."""
    num_envs: int = 256
    """Robots simulated side by side."""
    stack: Literal["aslip", "paper", "single_reference"] = "aslip"
    """What to learn on: with motor targets that make up for load and damping, or without, or the
    paper's baseline, one reference motion."""
    symmetric: bool = True
    """Make actor and critic treat left and right alike; not in the paper."""
    value_scale: float = 10.0
    """What an output of one of the critic's net is worth; one in the paper."""
    samples: int = 2048
    """Policy steps an update; Table II says 5096."""
    minibatch: int = 256
    """Samples of a gradient step; Table II says 64."""
    epochs: int = 5
    """Passes over the samples of an update; Table II says 3."""
    learning_rate: float = 3e-4
    """Of Adam, at first; Table II says 1e-4."""
    last_learning_rate: float = 2e-5
    """The same at the end. Constant in the paper."""
    std: float = 0.15
    """Standard deviation of actions, at first [rad]; the paper gives none, its public code
    exp(-2)."""
    last_std: float = 0.05
    """The same at the end. Constant in the paper."""
    fall_after: float = 0.6
    """Share of the training after which learning rate and standard deviation fall, exponentially;
    until then they are what they are at first."""
    adam_epsilon: float = 1e-5
    """Of Adam (Table II)."""
    gamma: float = 0.95
    """Discount; Table II says 0.99. Steps count for 0.6 s in place of 3: less noise in advantages,
    and what a step does shows within a stride."""
    gae_lambda: float = 0.95
    """Of the advantage estimate; the paper gives none."""
    clip: float = 0.2
    """Of PPO's probability ratio (Table II)."""
    max_grad_norm: float = 0.5
    """Gradient norm, of actor and critic each; the paper gives none."""
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
    """Where robots are: in this process, in others on this machine, or in Ray's, on a cluster, too
    (`aslip.collect`)."""
    num_collectors: int = 2
    """Processes or actors that robots are shared out to, unless there is but this process."""
    eval_interval: int = 250_000
    """Policy steps between evaluations over all speeds."""
    checkpoint_minutes: float = 3.0
    """Minutes between checkpoints; with none, there is one after every update."""

    def __post_init__(self) -> None:
        """Check what a typing slip would make a mystery of later."""
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
        if self.checkpoint_minutes < 0:
            raise ConfigurationError(
                f"checkpoint_minutes must be 0 or more, got {self.checkpoint_minutes}"
            )
        if self.command_interval != 0 and self.command_interval < POLICY_PERIOD:
            raise ConfigurationError(
                f"command_interval must be 0, or a policy step, {POLICY_PERIOD} s, or more; got"
                f" {self.command_interval}"
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
"""Settings that others are given on top of; 5120 is the multiple of 256 nearest to 5096."""


def main(config: Config, edits: Mapping[str, Any] | None = None) -> list[WalkResult]:
    """Train, then evaluate at all speeds; a table and pictures are in the folder.

    Args:
        config: the settings.
        edits: more settings of `aslip.make_env`, such as what to drop and to replace.
    """
    torch.manual_seed(config.seed)

    # ------------------------------------------------------------ environment
    edits = dict(edits or {})
    if config.truth:
        drop = edits.get("drop", ())
        edits["drop"] = [*([drop] if isinstance(drop, str) else drop), *ON_TRUTH["drop"]]
        edits["replace"] = {**(edits.get("replace") or {}), **ON_TRUTH["replace"]}
    task = {"stack": config.stack, "seed": config.seed, "reward_on": config.reward_on, **edits}
    probe = aslip.make_env(**copy.deepcopy(task))
    speeds, transforms = commanded(probe), described(probe)
    probe.close()
    run = TrainingRun(config.out, config, resume=config.resume, transforms=transforms)
    # a transform that was given as it is belongs to one environment only
    eval_env = aslip.make_env(num_envs=len(speeds), **copy.deepcopy(task))

    # ----------------------------------------------------------------- policy
    observation = observed(eval_env)
    size = eval_env.observation_spec["observation"].shape[-1]
    shape = PolicyShape(size, std=config.std, symmetric=config.symmetric)
    normalizer = RunningNormalizer(size)
    actor = make_actor(normalizer, shape, observation)
    critic = make_critic(normalizer, shape, observation, scale=config.value_scale)

    # -------------------------------------------------------------------- PPO
    advantage = GAE(
        gamma=config.gamma,
        lmbda=config.gae_lambda,
        value_network=critic,
        average_gae=True,
        deactivate_vmap=True,
    )
    loss = ClipPPOLoss(
        actor,
        critic,
        clip_epsilon=config.clip,
        entropy_bonus=False,
        loss_critic_type="l2",
        critic_coeff=0.5,
        functional=False,
        log_explained_variance=False,
    )
    nets = [list(actor.parameters()), list(critic.parameters())]
    optimizer = torch.optim.Adam(
        [*nets[0], *nets[1]], lr=config.learning_rate, eps=config.adam_epsilon, fused=True
    )

    # ------------------------------------------------------------------- loop
    collector = make_collector(
        partial(training_env, config.command_interval, **{**task, **variety(config, task)}),
        actor,
        kind=config.collector,
        num_envs=config.num_envs,
        samples=config.samples,
        num_collectors=config.num_collectors,
        seed=config.seed,
    )
    components = {
        "actor": actor,
        "critic": critic,
        "optimizer": optimizer,
        "rng": GlobalRNGState(),
        "collector": collector,
    }
    step, elapsed, divergences = 0, 0.0, 0
    episodes: deque[tuple[float, float]] = deque(maxlen=256)  # length, return
    if config.resume and (kept := run.restore(components)):
        step, elapsed, divergences = kept["step"], kept["elapsed_s"], kept["divergences"]
        episodes.extend(map(tuple, kept["episodes"]))
        shape = replace(shape, std=std(config, step))
    start = time.perf_counter() - elapsed
    results: list[WalkResult] = []
    bar = tqdm(total=config.total_steps, initial=step, unit="step", dynamic_ncols=True)
    batches = collector if step < config.total_steps else ()
    with bar, collector, run.saving(components, config.checkpoint_minutes) as keep:
        for data in batches:
            divergences += int(data["next", "truth", "diverged"].sum())
            if normalizer.count == 0:
                # the first samples only teach the normaliser what inputs look like
                normalizer.update(data["observation"])
                continue
            results = []
            check_rewards(data)
            with torch.no_grad():
                advantage(data)
            for group in optimizer.param_groups:
                group["lr"] = learning_rate(config, step)
            losses = update(data, loss, optimizer, nets, config)
            normalizer.update(data["observation"])
            step += data.numel()
            shape = replace(shape, std=std(config, step))
            set_std(actor, shape.std)  # of the next samples

            done = data["next", "done"][..., 0]
            lengths = data["next", "step_count"][..., 0][done].tolist()
            totals = data["next", "episode_reward"][..., 0][done].tolist()
            episodes.extend(zip(lengths, totals, strict=True))
            length, total = torch.tensor(episodes or [(0.0, 0.0)]).mean(0).tolist()
            terms = {
                f"term_{name}": float(term.mean())
                for name, term in data["next", "reward_terms"].items()
            }
            if step % config.eval_interval < data.numel() or step >= config.total_steps:
                results = evaluated(actor, eval_env, speeds, config.seed)
            run.log(
                step,
                {
                    "elapsed_s": time.perf_counter() - start,
                    "episode_length": length,
                    "episode_return": total,
                    **terms,
                    **losses,
                    "divergences": divergences,
                    **summary(results),
                },
            )
            keep(
                step,
                {
                    "elapsed_s": time.perf_counter() - start,
                    "episodes": list(episodes),
                    "divergences": divergences,
                },
            )
            bar.set_postfix_str(progress(length, total, terms), refresh=False)
            bar.update(data.numel())
            if step >= config.total_steps:
                break

    # ---------------------------------------------------------------- summary
    results = results or evaluated(actor, eval_env, speeds, config.seed)
    made_by = {
        "settings": {k: v for k, v in run.settings.items() if k not in ("out", "resume")},
        "transforms": run.transforms,
        "steps": step,
        "seconds": round(time.perf_counter() - start),
        **provenance(),
    }
    stack = acts_on(eval_env)
    save_policy(run.policy_file, actor, shape, made_by, stack=stack, observation=observation)
    table = walk_table(results)
    minutes = (time.perf_counter() - start) / 60
    footer = f"{step} policy steps in {minutes:.1f} minutes, peak memory {peak_memory():.2f} GiB"
    write_text(config.out / "summary.md", f"{table}\n\n{footer}\n")
    history = run.history()
    if history:
        save_figure(
            learning_curve(history, f"seed {config.seed}"), config.out / "learning_curve.png"
        )
    print(f"\n{table}\n\n{footer}\n{config.out}/: {', '.join(sorted(written(config.out)))}")
    run.close()
    return results


def variety(config: Config, task: Mapping[str, Any]) -> dict[str, Any]:
    """What training has and evaluation has not: coarse physics, other robots."""
    edits: dict[str, Any] = {"timestep": TIMESTEPS[config.coarse]}
    if config.randomise:
        stack = task["stack"]
        if isinstance(stack, str):
            stack = STACKS[stack](task.get("library"), config.reward_on)
        edits |= {"stack": randomised(stack), "library": None, "reward_on": "truth"}
    return edits


def training_env(command_interval: float, **settings: Any) -> CassieTransformedEnv:
    """An environment whose commands change within episodes; those that do so already stay."""
    env = aslip.make_env(**settings)
    for transform in env.transforms:
        held = isinstance(transform, SpeedCommand) and math.isinf(transform.interval)
        if held and command_interval:
            transform.interval = command_interval
    return env


def check_rewards(data: TensorDict) -> None:
    """Raise FloatingPointError if a term of the reward is no number, which all would learn from."""
    for name, term in data["next", "reward_terms"].items():
        if not term.isfinite().all():
            raise FloatingPointError(f"the reward term {name!r} is not finite for some robots")


def update(
    data: TensorDict,
    loss: ClipPPOLoss,
    optimizer: torch.optim.Optimizer,
    nets: list[list[torch.nn.Parameter]],
    config: Config,
) -> dict[str, float]:
    """Some epochs of PPO over the samples; returns means of what the loss reports."""
    keys = ("observation", "action", "action_log_prob", "advantage", "value_target")
    samples = data.select(*keys).reshape(-1)
    reports = []
    for _ in range(config.epochs):
        for index in torch.randperm(len(samples)).split(config.minibatch):
            terms = cast("TensorDict", loss(samples[index]))
            total = terms["loss_objective"] + terms["loss_critic"]
            optimizer.zero_grad()
            total.backward()
            for parameters in nets:
                torch.nn.utils.clip_grad_norm_(parameters, config.max_grad_norm)
            optimizer.step()
            reports.append(terms.detach())
    means = torch.stack(reports).mean(0)
    if not torch.isfinite(means.get("loss_objective")):
        raise FloatingPointError("the PPO loss is not finite; lower --learning-rate")
    return {key: float(means.get(key)) for key in ("loss_critic", "kl_approx", "clip_fraction")}


def learning_rate(config: Config, step: int) -> float:
    """Of an update after so many policy steps."""
    return _falling(config, step, config.learning_rate, config.last_learning_rate)


def std(config: Config, step: int) -> float:
    """Of actions after so many policy steps."""
    return _falling(config, step, config.std, config.last_std)


def _falling(config: Config, step: int, first: float, last: float) -> float:
    share = (step / config.total_steps - config.fall_after) / (1 - config.fall_after)
    return first * (last / first) ** min(max(share, 0.0), 1.0)


def evaluated(
    actor: ProbabilisticActor, env: CassieTransformedEnv, speeds: list[float], seed: int
) -> list[WalkResult]:
    """Walks at all speeds, with the same noise every time."""
    env.set_seed(seed)
    return evaluate(actor, env, speeds)


def written(folder: Path) -> list[str]:
    """Names of the files in a run's folder."""
    return [path.name for path in folder.iterdir() if path.is_file()]


def summary(results: list[WalkResult]) -> dict[str, float]:
    """Means of an evaluation, NaN where there was none."""
    count = len(results) or float("nan")
    return {
        "eval_return": sum(r.total for r in results) / count,
        "eval_length": sum(r.steps for r in results) / count,
        "eval_survived": sum(r.survived for r in results) / count,
    }


def progress(length: float, total: float, terms: dict[str, float]) -> str:
    """What the progress bar says beside rate and time left."""
    short = " ".join(f"{name.removeprefix('term_')} {value:.2f}" for name, value in terms.items())
    return f"length {length:.0f} return {total:.0f} | {short}"


def command_line(presets: Mapping[str, Config] = PRESETS) -> Config:
    """Settings from the command line, on top of those of the preset that it names."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--preset", choices=list(presets), default="default")
    preset = parser.parse_known_args()[0].preset
    return tyro.cli(type(presets[preset]), default=presets[preset])


if __name__ == "__main__":
    with one_line_errors():
        main(command_line())

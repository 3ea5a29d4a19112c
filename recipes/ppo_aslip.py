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

from aslip.errors import one_line_errors
from aslip.training.ppo_settings import (
    PRESETS,
    Config,
    resume_command,
    training_settings,
    whole_updates,
    with_schedule,
)

if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = training_settings(PRESETS)

import copy
import math
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDict
from torchrl.checkpoint import GlobalRNGState
from torchrl.envs.transforms import StepCounter
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from tqdm import tqdm

import aslip
from aslip.envs import (
    ON_TRUTH,
    STACKS,
    StackEnv,
    command_speeds,
    describe_transforms,
    observation_keys,
    policy_interface,
    randomise_stack,
)
from aslip.policy import (
    PolicyShape,
    RunningNormalizer,
    make_actor,
    make_critic,
    save_policy,
    set_std,
)
from aslip.robot.model import physics_timesteps
from aslip.show.plots import learning_curve, save_figure
from aslip.training.collect import make_collector
from aslip.training.provenance import provenance
from aslip.training.run import TrainingRun, peak_memory, write_text
from aslip.training.settings import read_settings
from aslip.transforms import SpeedCommand, StaggeredEnds
from aslip.walking import WalkResult, evaluate, walk_table


def main(
    config: Config, edits: Mapping[str, Any] | None = None, go_on: str = "resume=True"
) -> list[WalkResult]:
    """Train, then evaluate at all speeds; a table and pictures are in the folder.

    Args:
        config: the settings.
        edits: more settings of `aslip.make_env`, such as what to drop and to replace.
        go_on: how to resume the training, for messages.
    """
    torch.manual_seed(config.seed)
    config = with_schedule(config, read_settings(config.out)[0] if config.resume else None)

    # ------------------------------------------------------------ environment
    edits = dict(edits or {})
    if config.truth:
        drop = edits.get("drop", ())
        edits["drop"] = [*([drop] if isinstance(drop, str) else drop), *ON_TRUTH["drop"]]
        edits["replace"] = {**(edits.get("replace") or {}), **ON_TRUTH["replace"]}
    task = {"stack": config.stack, "seed": config.seed, "reward_on": config.reward_on, **edits}
    probe = aslip.make_env(**copy.deepcopy(task))
    speeds, transforms = command_speeds(probe), describe_transforms(probe)
    probe.close()
    run = TrainingRun(config.out, config, resume=config.resume, transforms=transforms, go_on=go_on)
    # a transform that was given as it is belongs to one environment only
    eval_env = aslip.make_env(num_envs=len(speeds), **copy.deepcopy(task))

    # ----------------------------------------------------------------- policy
    observation = observation_keys(eval_env)
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
    print(announcement(config, run, step), flush=True)
    start = time.perf_counter() - elapsed
    results: list[WalkResult] = []
    total_steps = whole_updates(config)
    bar = tqdm(total=total_steps, initial=step, unit="step", dynamic_ncols=True)
    bar.set_description("training" if normalizer.count else "first samples, for the normaliser")
    batches = collector if step < config.total_steps else ()
    with bar, collector, run.saving(components, config.checkpoint_minutes) as keep:
        for data in watched(batches, actor, bar, config.num_envs):
            divergences += int(data["next", "truth", "diverged"].sum())
            if normalizer.count == 0:
                # these samples only teach the normaliser what inputs look like
                normalizer.update(data["observation"])
                bar.reset()
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

            # episodes that were cut short to stagger robots say nothing of their length
            done = (data["next", "done"] & (data.get("stagger", 0) != 1))[..., 0]
            lengths = data["next", "step_count"][..., 0][done].tolist()
            totals = data["next", "episode_reward"][..., 0][done].tolist()
            episodes.extend(zip(lengths, totals, strict=True))
            length, total = torch.tensor(episodes or [(0.0, 0.0)]).mean(0).tolist()
            terms = {
                f"term_{name}": float(term.mean())
                for name, term in data["next", "reward_terms"].items()
            }
            if step % config.eval_interval < data.numel() or step >= config.total_steps:
                bar.set_description("evaluating")
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
            bar.update(step - bar.n)
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
    save_policy(run.policy_file, actor, shape, made_by, **policy_interface(eval_env))
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


def announcement(config: Config, run: TrainingRun, step: int) -> str:
    """Words at the start: where, what, and how to stop and to go on."""
    asked, total = config.total_steps, whole_updates(config)
    rounded = f" ({asked} asked for, in updates of {config.samples})" if total != asked else ""
    what = f"training for {total} policy steps{rounded}"
    if step >= asked:
        what = f"nothing left to train after {step} of {asked} policy steps, evaluating"
    elif config.resume:
        what = f"going on after {step} of {total} policy steps{rounded}"
    about = [f"preset {config.preset}", f"seed {config.seed}", f"{config.num_envs} robots"]
    told = "; ".join([f"{config.out}: {what}", ", ".join(about), *run.changes])
    return f"{told}\nCtrl-C saves and stops; to go on: {run.go_on}"


def watched(
    batches: Iterable[TensorDict], actor: ProbabilisticActor, bar: tqdm, robots: int
) -> Iterator[TensorDict]:
    """Batches, with a bar that moves at each policy step of robots in this process."""

    def move(*_: Any) -> None:
        bar.update(robots)

    iterator = iter(batches)
    while True:
        hook = actor.register_forward_hook(move)
        try:
            data = next(iterator, None)
        finally:
            hook.remove()
        if data is None:
            return
        yield data
        bar.set_description("training", refresh=False)


def variety(config: Config, task: Mapping[str, Any]) -> dict[str, Any]:
    """What training has and evaluation has not: coarse physics, other robots."""
    edits: dict[str, Any] = {"timestep": physics_timesteps()[config.coarse]}
    if config.randomise:
        stack = task["stack"]
        if isinstance(stack, str):
            stack = STACKS[stack](task.get("library"), config.reward_on)
        edits |= {"stack": randomise_stack(stack), "library": None, "reward_on": "truth"}
    return edits


def training_env(command_interval: float, **settings: Any) -> StackEnv:
    """An environment of staggered robots whose commands change; those that do so already stay."""
    env = aslip.make_env(**settings)
    limits = [t.max_steps for t in env.transforms if isinstance(t, StepCounter)]
    if limits and limits[0] is not None:
        env.append_transform(StaggeredEnds(limits[0]))
        env.set_seed(env.seed)
    for transform in env.transforms:
        if isinstance(transform, SpeedCommand) and math.isinf(transform.interval):
            transform.interval = command_interval or math.inf
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
    steps = config.schedule_steps or config.total_steps
    share = (step / steps - config.fall_after) / (1 - config.fall_after)
    return first * (last / first) ** min(max(share, 0.0), 1.0)


def evaluated(
    actor: ProbabilisticActor, env: StackEnv, speeds: list[float], seed: int
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


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, go_on=resume_command(CONFIG))

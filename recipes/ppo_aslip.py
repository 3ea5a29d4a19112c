"""Teach Cassie to walk at every speed from 0 to 2 m/s, guided by actuated-SLIP gaits.

    python recipes/ppo_aslip.py                  # train, evaluate, draw: runs/ppo_aslip/
    python recipes/ppo_aslip.py --resume         # continue after Ctrl-C, kill or a crash
    python recipes/ppo_aslip.py --seed 1 --out runs/seed1 --total-steps 5000000
    python recipes/ppo_aslip.py paper            # the paper's settings; presets: --help

This is Green et al. 2021 from top to bottom: environment, policy, PPO, evaluation. To swap a part,
call `main` with a function that makes another:

    main(Config(), make_env=partial(aslip.make_env, drop=["foot_orient"]))
    main(Config(symmetric=False), make_actor=make_recurrent_actor)

Robots in several processes or on a cluster: `ppo_cluster.py`.
"""

from __future__ import annotations

from ppo_settings import (
    PRESETS,
    Config,
    resume_command,
    scheduled,
    training_settings,
    with_schedule,
)

from aslip.errors import one_line_errors

if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = training_settings(PRESETS)

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, cast

import torch
from tensordict import TensorDict
from torchrl.checkpoint import GlobalRNGState
from torchrl.modules import ProbabilisticActor, ValueOperator, set_recurrent_mode
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from torchrl.record.loggers import Logger

import aslip
from aslip.envs import (
    ON_TRUTH,
    StackEnv,
    default_stack,
    observation_keys,
    policy_interface,
    randomise_stack,
)
from aslip.policy import (
    MakeActor,
    PolicyShape,
    RunningNormalizer,
    is_recurrent,
    make_actor,
    make_critic,
    save_policy,
    set_std,
)
from aslip.robot.model import physics_timesteps
from aslip.show.plots import learning_curve, save_figure
from aslip.training.collectors import LocalCollector
from aslip.training.environments import (
    MakeEnv,
    describe_environments,
    make_evaluation_env,
    make_training_env,
)
from aslip.training.progress import Progress, check_rewards
from aslip.training.provenance import provenance
from aslip.training.run import TrainingRun
from aslip.training.settings import read_settings
from aslip.walking import WalkResult, evaluate, walk_table


def main(
    config: Config,
    make_env: MakeEnv = aslip.make_env,
    make_actor: MakeActor = make_actor,
    make_critic: Callable[..., ValueOperator] = make_critic,
    *,
    make_train_env: MakeEnv | None = None,
    make_collector: Callable[..., Any] = LocalCollector,
    network: Mapping[str, Any] | None = None,
    logger: Logger | None = None,
    go_on: str = "resume=True",
) -> list[WalkResult]:
    """Train a policy and evaluate it at all speeds; files are in `config.out`.

    Args:
        config: settings of learning.
        make_env: makes the environment, of the keywords `num_envs` and `seed`.
        make_actor: makes the policy of a normaliser, a `PolicyShape` and the observation's keys.
        make_critic: makes the value function, of the keyword `scale`, too.
        make_train_env: makes the environment to train in; by default `make_env`'s with changing
            commands and staggered first episodes (`make_training_env`).
        make_collector: makes the collector, of the arguments of `LocalCollector`.
        network: more settings of the `PolicyShape`, such as `hidden` and `mirror_signs`.
        logger: logger of TorchRL's, besides CSV and TensorBoard.
        go_on: command that resumes the training, for messages.
    """
    torch.manual_seed(config.seed)
    config = with_schedule(config, read_settings(config.out)[0] if config.resume else None)
    make_train_env = make_train_env or partial(make_training_env, make_env)
    env, speeds = make_evaluation_env(make_env, config.seed)
    transforms = describe_environments(env, make_train_env)
    run = TrainingRun(
        config.out, config, resume=config.resume, transforms=transforms, go_on=go_on, logger=logger
    )

    # ---------------------------------------------------------------- networks
    observation, size = observation_keys(env), env.observation_spec["observation"].shape[-1]
    settings = {"std": config.std, "symmetric": config.symmetric, **(network or {})}
    shape = PolicyShape(size, env.action_spec.shape[-1], **settings)
    normalizer = RunningNormalizer(size)
    actor = make_actor(normalizer, shape, observation)
    critic = make_critic(normalizer, shape, observation, scale=config.value_scale)
    for net in (actor, critic):
        net.to(config.device)
    advantage, loss, optimizer = make_ppo(config, actor, critic)

    # -------------------------------------------------------------------- loop
    collector = make_collector(
        make_train_env, actor, num_envs=config.num_envs, samples=config.samples, seed=config.seed,
        device=config.device,
    )  # fmt: skip
    parts = {"actor": actor, "critic": critic, "optimizer": optimizer, "rng": GlobalRNGState()}
    parts["collector"] = collector
    progress = Progress(
        config.total_steps, config.samples, run.restore(parts) if config.resume else None
    )
    title = f"preset {config.preset}, seed {config.seed}, {config.num_envs} robots"
    print(run.announcement(title, progress), flush=True)
    results: list[WalkResult] = []
    batches = () if progress.finished else progress.watch(collector, actor, config.num_envs)
    with progress, collector, run.saving(parts, config.checkpoint_minutes) as keep:
        for data in batches:
            if normalizer.count == 0:
                # the first batch only initialises the normaliser
                normalizer.update(data["observation"])
                continue
            check_rewards(data)
            with torch.no_grad():
                advantage(data)
            set_learning_rate(optimizer, config, progress.step)
            losses = update(data, loss, optimizer, config)
            normalizer.update(data["observation"])
            progress.add(data)
            std = scheduled(config, progress.step, config.std, config.last_std)
            set_std(actor, std)
            shape = replace(shape, std=std)
            results = []
            if progress.step % config.eval_interval < data.numel() or progress.finished:
                results = evaluate_all(config, actor, env, speeds)
            run.log(progress.step, progress.row(data, losses) | eval_means(results))
            keep(progress.step, progress.state())
            if progress.finished:
                break

    # ----------------------------------------------------------------- results
    results = results or evaluate_all(config, actor, env, speeds)
    made_by = run.about(progress) | provenance()
    save_policy(run.policy_file, actor, shape, made_by, network=make_actor, **policy_interface(env))
    env.close()
    run.finish(walk_table(results), progress)
    if history := run.history():
        curve = learning_curve(history, f"seed {config.seed}")
        save_figure(curve, config.out / "learning_curve.png")
    return results


def make_ppo(
    config: Config, actor: ProbabilisticActor, critic: ValueOperator
) -> tuple[GAE, ClipPPOLoss, torch.optim.Optimizer]:
    """Advantage estimator, loss and optimizer."""
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
    parameters = [*actor.parameters(), *critic.parameters()]
    optimizer = torch.optim.Adam(
        parameters, lr=config.learning_rate, eps=config.adam_epsilon, fused=True
    )
    return advantage, loss, optimizer


def update(
    data: TensorDict, loss: ClipPPOLoss, optimizer: torch.optim.Optimizer, config: Config
) -> dict[str, float]:
    """Train for some epochs on a batch (num_envs, T); returns means of the loss's reports.

    Minibatches are of single policy steps, or of whole rows where the actor is recurrent.

    Raises:
        FloatingPointError: the loss is not finite.
    """
    actor, critic = loss.actor_network, loss.critic_network
    keys = {"action", "action_log_prob", "advantage", "value_target"}
    samples = data.select(*keys, *actor.in_keys, *critic.in_keys)
    recurrent = is_recurrent(actor)
    if not recurrent:
        samples = samples.reshape(-1)
    size = max(1, config.minibatch // samples[0].numel())
    reports = []
    for _ in range(config.epochs):
        for index in torch.randperm(len(samples)).split(size):
            with set_recurrent_mode(recurrent):
                terms = cast("TensorDict", loss(samples[index]))
            total = terms["loss_objective"] + terms["loss_critic"]
            optimizer.zero_grad()
            total.backward()
            for net in (actor, critic):
                torch.nn.utils.clip_grad_norm_(net.parameters(), config.max_grad_norm)
            optimizer.step()
            reports.append(terms.detach())
    means = torch.stack(reports).mean(0)
    if not torch.isfinite(means.get("loss_objective")):
        raise FloatingPointError("the PPO loss is not finite; lower --learning-rate")
    return {key: float(means.get(key)) for key in ("loss_critic", "kl_approx", "clip_fraction")}


def set_learning_rate(optimizer: torch.optim.Optimizer, config: Config, step: int) -> None:
    """Set the learning rate of an update after so many policy steps."""
    rate = scheduled(config, step, config.learning_rate, config.last_learning_rate)
    for group in optimizer.param_groups:
        group["lr"] = rate


def evaluate_all(
    config: Config, actor: ProbabilisticActor, env: StackEnv, speeds: list[float]
) -> list[WalkResult]:
    """Walk at all speeds, with the same noise in every evaluation."""
    env.set_seed(config.seed)
    policy = actor if config.device == "cpu" else copy.deepcopy(actor).cpu()
    return evaluate(policy, env, speeds, config.eval_steps)


def eval_means(results: list[WalkResult]) -> dict[str, float]:
    """Means of an evaluation, NaN where there was none."""
    count = len(results) or float("nan")
    return {
        "eval_return": sum(r.total for r in results) / count,
        "eval_length": sum(r.steps for r in results) / count,
        "eval_survived": sum(r.survived for r in results) / count,
    }


def environments(preset: str) -> dict[str, Any]:
    """Environments of a preset, as arguments of `main`."""
    one_speed = partial(make_training_env, command_interval=math.inf)
    if preset in ("paper", "single-reference"):
        make_env = partial(aslip.make_env, stack=preset.replace("-", "_"))
        return {"make_env": make_env, "make_train_env": partial(one_speed, make_env)}
    if preset == "robust":
        robots = partial(aslip.make_env, stack=randomise_stack(default_stack()))
        return {"make_train_env": partial(make_training_env, robots)}
    if preset == "truth":
        return {"make_env": partial(aslip.make_env, **ON_TRUTH)}
    if preset == "coarse":
        steps = partial(aslip.make_env, timestep=physics_timesteps()[1])
        return {"make_train_env": partial(make_training_env, steps)}
    return {}


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, **environments(CONFIG.preset), go_on=resume_command(CONFIG))

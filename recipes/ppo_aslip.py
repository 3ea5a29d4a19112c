"""Teach Cassie to walk at every speed from 0 to 2 m/s, guided by actuated-SLIP gaits.

    python recipes/ppo_aslip.py                  # train, evaluate, draw: runs/ppo_aslip/
    python recipes/ppo_aslip.py --resume         # continue after Ctrl-C, kill or a crash
    python recipes/ppo_aslip.py --seed 1 --out runs/seed1 --total-steps 5000000
    python recipes/ppo_aslip.py paper            # the paper's settings; presets: --help
    python recipes/ppo_aslip.py gpu              # 16384 robots on a GPU
    python recipes/ppo_aslip.py --library lip.npz                      # follow gaits of your own
    python recipes/ppo_aslip.py --num-collectors 8                     # robots in Ray actors
    python recipes/ppo_aslip.py --logger wandb                         # or tensorboard, mlflow

The recipe has all parts of Green et al. 2021: environment, policy, PPO, evaluation. To swap a part,
call `main` with a function that makes the new one:

    main(Config(), make_env=partial(aslip.make_env, drop=["foot_orient"]))
    main(Config(symmetric=False), make_actor=make_recurrent_actor)
"""

from __future__ import annotations

from ppo_settings import PRESETS, Config, resume_command, training_settings, with_schedule

from aslip.errors import one_line_errors

if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = training_settings(PRESETS)

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

import torch
from ppo_presets import environments, own_library
from tensordict import TensorDict
from tensordict.utils import NestedKey
from torchrl.modules import ProbabilisticActor, ValueOperator, set_recurrent_mode
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from torchrl.record.loggers import Logger

import aslip
from aslip.base.decorators import on_cpu_in_single
from aslip.envs import StackEnv, observation_keys
from aslip.errors import ConfigurationError
from aslip.policy import (
    MakeActor,
    PolicyShape,
    RunningNormalizer,
    check_policy_fits,
    is_recurrent,
    keep_library,
    load_policy,
    make_actor,
    make_critic,
    planned_weights,
    policy_interface,
    reference_library,
    save_policy,
    set_std,
    update_normalizers,
)
from aslip.robot import CASSIE
from aslip.show.film import film_evaluation
from aslip.show.plots import learning_curve, save_figure
from aslip.sim.warp import check_device
from aslip.training.collectors import LocalCollector
from aslip.training.environments import (
    MakeEnv,
    describe_environments,
    make_evaluation_env,
    make_training_env,
)
from aslip.training.loop import training_loop
from aslip.training.progress import Progress
from aslip.training.run import TrainingRun
from aslip.training.settings import read_settings
from aslip.walking import WalkResult, evaluate, evaluation_means, walk_table


@on_cpu_in_single
def main(
    config: Config,
    make_env: MakeEnv | None = None,
    make_actor: MakeActor = make_actor,
    make_critic: Callable[..., ValueOperator] = make_critic,
    *,
    make_train_env: MakeEnv | None = None,
    make_collector: Callable[..., Any] | None = None,
    network: Mapping[str, Any] | None = None,
    logger: Logger | None = None,
    resume_hint: str = "resume=True",
) -> list[WalkResult]:
    """Train a policy and evaluate it at all speeds; files are in `config.out`.

    Args:
        config: settings of learning.
        make_env: makes the environment from the keywords `num_envs` and `seed`; by default that of
            `aslip.make_env` on the library of the settings.
        make_actor: makes the policy from a normaliser, a `PolicyShape` and the observation's keys.
        make_critic: makes the value function from the same arguments and the keyword `scale`.
        make_train_env: makes the environment for training, with the physics of the keyword
            `timestep`; by default `make_training_env` does.
        make_collector: makes the collector from the arguments of `LocalCollector`, which is the
            default; with `config.num_collectors`, it is `RayCollectors`.
        network: more settings of the `PolicyShape`, such as `hidden` and `mirror_signs`.
        logger: TorchRL logger of the rows instead of the one named in `config`, in addition to CSV
            and TensorBoard.
        resume_hint: command that resumes the training, for messages.
    """
    torch.manual_seed(config.seed)
    config = with_schedule(config, read_settings(config.out)[0] if config.resume else None)
    make_env = make_env or partial(aslip.make_env, library=own_library(config))
    make_train_env = with_physics(config, make_train_env or partial(make_training_env, make_env))
    env, speeds = make_evaluation_env(make_env, config.seed)
    run = TrainingRun(
        config.out, config, resume=config.resume, resume_hint=resume_hint,
        logger=logger or config.logger, transforms=describe_environments(env, make_train_env),
    )  # fmt: skip
    keep_library(run.policy_file, reference_library(env))
    shape, normalizer, actor, critic = make_networks(config, env, make_actor, make_critic, network)
    advantage, loss, optimizer = make_ppo(config, actor, critic)
    collector = (make_collector or collector_class(config, critic.in_keys))(
        make_train_env, actor, num_envs=config.num_envs, samples=config.samples, seed=config.seed,
        device=config.device,
    )  # fmt: skip
    parts = {"actor": actor, "critic": critic, "optimizer": optimizer, "collector": collector}
    interface = {"network": make_actor, **policy_interface(env)}
    write_policy = partial(save_run_policy, config, run, actor, shape, interface)

    results: list[WalkResult] = []
    with training_loop(run, parts, config, write_policy) as training:
        if not normalizer.count.any():  # the first batch only initialises the normaliser
            update_normalizers([actor, critic], next(training))
        for data in training:
            advantage(data)
            learns = config.start is None or training.step >= config.critic_steps
            loss.actor_network.requires_grad_(learns)
            losses = update(data, loss, optimizer, config) | annealed(config, training.step)
            update_normalizers([actor, critic], data)
            training.count(data)
            anneal(config, training.step, actor, optimizer)
            with training.log(data, {**losses, **evaluation_means([])}) as row:
                results = evaluate_all(config, actor, env, speeds) if training.evaluates else []
                row.update(evaluation_means(results))
            training.film(partial(film_evaluation, on_cpu(actor), env, speeds))
    write_policy({"actor": actor.state_dict()}, training.progress.state())
    results = results or evaluate_all(config, actor, env, speeds)
    save_results(config, run, training.progress, results)
    env.close()
    return results


def with_physics(config: Config, make_train_env: MakeEnv) -> MakeEnv:
    """Function that makes the environment for training with the physics of the settings.

    Raises:
        ConfigurationError: there is no such device, or MuJoCo Warp is not installed.
    """
    physics: dict[str, Any] = {}
    if config.physics_timestep != CASSIE.physics_timestep:
        physics["timestep"] = config.physics_timestep
    if config.backend == "warp":
        check_device(config.device)
        physics |= {"backend": "warp", "device": config.device}
    return partial(make_train_env, **physics) if physics else make_train_env


def make_networks(
    config: Config,
    env: StackEnv,
    make_actor: MakeActor,
    make_critic: Callable[..., ValueOperator],
    network: Mapping[str, Any] | None = None,
) -> tuple[PolicyShape, RunningNormalizer, ProbabilisticActor, ValueOperator]:
    """Shape, normaliser, actor and critic for an environment."""
    keys, size = observation_keys(env), env.observation_spec["observation"].shape[-1]
    settings = {"std": config.std, "symmetric": config.symmetric, **(network or {})}
    shape = PolicyShape(size, env.action_spec.shape[-1], **settings)
    normalizer = RunningNormalizer(size)
    actor = make_actor(normalizer, shape, keys)
    if config.start is not None:
        start_from(config.start, actor, env)
    critic = make_critic(normalizer, shape, keys, scale=config.value_scale)
    for net in (actor, critic):
        net.to(config.device)
    return shape, normalizer, actor, critic


def start_from(policy: str, actor: ProbabilisticActor, env: StackEnv) -> None:
    """Give an actor the weights and statistics of a policy with the same observation.

    Both parts of an actor for plans (`make_planned_actor`) get those of a policy with one.

    Of a policy that observes less, whose observation is the beginning of the environment's, the
    action stays the same until the actor has learned: weights of the other inputs are zero.

    Raises:
        AssetError, FileDamagedError: the policy does not exist, or its file is damaged.
        ConfigurationError: the policy does not fit the environment, or has another network.
    """
    check_policy_fits(policy, env, begins=True)
    weights, own = load_policy(policy).state_dict(), actor.state_dict()
    if own.keys() == (both := planned_weights(weights)).keys():
        weights = both
    size = env.observation_spec["observation"].shape[-1]
    for name, value in weights.items():
        if value.ndim and own.get(name, value).shape[-1:] == (size,) != value.shape[-1:]:
            weights[name] = torch.nn.functional.pad(value, (0, size - value.shape[-1]))
    try:
        actor.load_state_dict(weights)
    except RuntimeError as error:
        raise ConfigurationError(f"the policy {policy!r} has another network: {error}") from None


def collector_class(config: Config, keys: Sequence[NestedKey]) -> Callable[..., Any]:
    """Class of the collector; `keys` are entries that the critic reads."""
    if not config.num_collectors:
        return LocalCollector
    from aslip.training.ray import RayCollectors  # few trainings need it

    return partial(RayCollectors, num_collectors=config.num_collectors, keys=keys)


def make_ppo(
    config: Config, actor: ProbabilisticActor, critic: ValueOperator
) -> tuple[GAE, ClipPPOLoss, torch.optim.Optimizer]:
    """Advantage estimator, loss and optimizer."""
    advantage = GAE(
        gamma=config.gamma, lmbda=config.gae_lambda, value_network=critic, average_gae=True,
        deactivate_vmap=True,
    )  # fmt: skip
    loss = ClipPPOLoss(
        actor, critic, clip_epsilon=config.clip, entropy_bonus=False, loss_critic_type="l2",
        critic_coeff=0.5, functional=False, log_explained_variance=False,
    )  # fmt: skip
    parameters = [*actor.parameters(), *critic.parameters()]
    optimizer = torch.optim.Adam(
        parameters, lr=config.learning_rate, eps=config.adam_epsilon, fused=True
    )
    return advantage, loss, optimizer


def update(
    data: TensorDict, loss: ClipPPOLoss, optimizer: torch.optim.Optimizer, config: Config
) -> dict[str, float]:
    """Train for some epochs on a batch (num_envs, T), and return mean losses and its numbers.

    Minibatches consist of single policy steps, or of whole rows if the actor is recurrent.

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
        for index in torch.randperm(len(samples), device=samples.device).split(size):
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
    if not all(torch.isfinite(means.get(key)) for key in ("loss_objective", "loss_critic")):
        raise FloatingPointError("the PPO loss is not finite; lower --learning-rate")
    names = ("loss_critic", "kl_approx", "clip_fraction")
    return {key: float(means.get(key)) for key in names} | batch_numbers(data)


def batch_numbers(data: TensorDict) -> dict[str, float]:
    """Entropy [nat], a mean over the batch's actions, and variance that the critic explains."""
    target = data["value_target"]
    rest = (target - data["state_value"]).var() / target.var()
    return {
        "entropy": -float(data["action_log_prob"].mean()),
        "explained_variance": 1 - float(rest),
    }


def annealed(config: Config, step: int) -> dict[str, float]:
    """Learning rate and standard deviation of the policy after a number of policy steps."""
    return {"learning_rate": config.learning_rate_after(step), "std": config.std_after(step)}


def anneal(
    config: Config, step: int, actor: ProbabilisticActor, optimizer: torch.optim.Optimizer
) -> None:
    """Set learning rate and standard deviation of the policy after a number of policy steps."""
    values = annealed(config, step)
    set_std(actor, values["std"])
    for group in optimizer.param_groups:
        group["lr"] = values["learning_rate"]


def evaluate_all(
    config: Config,
    actor: ProbabilisticActor,
    env: StackEnv,
    speeds: Sequence[float] | Sequence[Sequence[float]],
) -> list[WalkResult]:
    """Walk at all commands, with the same noise in every evaluation."""
    env.set_seed(config.seed)
    return evaluate(on_cpu(actor), env, speeds, config.eval_steps)


def on_cpu(actor: ProbabilisticActor) -> ProbabilisticActor:
    """Actor on the CPU, a copy if it is elsewhere."""
    return actor if next(actor.parameters()).is_cpu else copy.deepcopy(actor).cpu()


def save_run_policy(
    config: Config,
    run: TrainingRun,
    actor: ProbabilisticActor,
    shape: PolicyShape,
    interface: Mapping[str, Any],
    states: Mapping[str, Any],
    progress: Mapping[str, Any],
) -> None:
    """Write the policy of a state of the training, which may be an earlier one than the actor's."""
    saved = copy.deepcopy(actor)
    saved.load_state_dict(states["actor"])
    shape = replace(shape, std=config.std_after(progress["step"]))
    save_policy(run.policy_file, saved, shape, run.about(progress), **interface)


def save_results(
    config: Config, run: TrainingRun, progress: Progress, results: list[WalkResult]
) -> None:
    """Write and print the table of the walks, and draw the learning curve."""
    run.finish(walk_table(results), progress)
    if history := run.history():
        curve = learning_curve(history, f"seed {config.seed}")
        save_figure(curve, config.out / "learning_curve.png")


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, **environments(CONFIG), resume_hint=resume_command(CONFIG))

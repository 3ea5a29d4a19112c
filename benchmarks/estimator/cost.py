"""What sensors and estimator cost."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping
from contextlib import ExitStack, closing
from typing import Any, cast

import numpy as np
from tensordict import TensorDictBase

import aslip
from aslip.envs import ON_TRUTH, BatchEnv, StackEnv
from aslip.estimation import StateEstimator
from aslip.policy import policy_stack
from aslip.robot import Indices
from aslip.sim import Sensors
from aslip.walking import markdown
from benchmarks.estimator.arrays import packets
from benchmarks.estimator.config import Config


class _NoSensors:
    """In place of `Sensors`: the PD loop works on the truth, packets stay as they are."""

    def __init__(self, sensors: Sensors, indices: Indices) -> None:
        self._packets = sensors.packets()
        self._indices = indices
        self.motor_position, self.motor_velocity = sensors.motor_position, sensors.motor_velocity

    def read(self, substep: int, qpos: np.ndarray, qvel: np.ndarray) -> None:
        del substep
        np.take(qpos, self._indices.motor_qpos, axis=1, out=self.motor_position)
        np.take(qvel, self._indices.motor_qvel, axis=1, out=self.motor_velocity)

    def packets(self) -> dict[str, np.ndarray]:
        return self._packets

    def reset(self, *_: object) -> None:
        """Nothing to forget."""

    feel = reset

    def finish(self) -> None:
        """Nothing to compute."""


def throughput(config: Config) -> dict[str, float]:
    """Policy steps per second of whole environments, in turn, by what the robot senses."""
    variants: dict[str, Mapping[str, Any]] = {
        "truth, no sensors": ON_TRUTH,
        "truth, sensors": ON_TRUTH,
        "estimator": {"drop": ["noise"]},
        "estimator and noise": {},
    }
    with ExitStack() as stack:
        envs = {
            name: stack.enter_context(closing(aslip.make_env(**_settings(config), **edit)))
            for name, edit in variants.items()
        }
        seconds = _timed(config, envs)
    whole = [config.num_envs / s for s in seconds["truth, no sensors"][2:]]
    table = {"truth, no sensors": statistics.median(whole)}
    for name in list(variants)[1:]:
        pairs = zip(seconds["truth, no sensors"][2:], seconds[name][2:], strict=True)
        table[name] = table["truth, no sensors"] * statistics.median(a / b for a, b in pairs)
    return table


def _settings(config: Config) -> dict[str, Any]:
    stack = policy_stack(config.policy)
    return {"num_envs": config.num_envs, "seed": config.seed, "stack": stack}


def _timed(config: Config, envs: Mapping[str, StackEnv]) -> dict[str, list[float]]:
    """Seconds of each environment's policy steps."""
    base = envs["truth, no sensors"].base_env
    assert isinstance(base, BatchEnv)
    for part in base.simulations.parts:
        part.sensors = cast("Sensors", _NoSensors(part.sensors, part.indices))
    policy = aslip.load_policy(config.policy)
    states = {name: cast("TensorDictBase", env.reset()) for name, env in envs.items()}
    seconds: dict[str, list[float]] = {name: [] for name in envs}
    for _ in range(config.rounds + 2):
        for name, env in envs.items():
            policy(states[name])
            # torch's threads go on spinning for a while after their work
            time.sleep(0.01)
            start = time.perf_counter()
            _, states[name] = env.step_and_maybe_reset(states[name])
            seconds[name].append(time.perf_counter() - start)
    return seconds


def packet_time(config: Config) -> float:
    """Median seconds for one packet of one robot."""
    env = aslip.make_env(seed=config.seed, stack=policy_stack(config.policy))
    policy, sensed = aslip.load_policy(config.policy), []
    with closing(env):
        td = cast("TensorDictBase", env.reset())
        for _ in range(60):
            _, td = env.step_and_maybe_reset(policy(td))
            sensed.extend(packets(td)[0])
    estimator = StateEstimator()
    tracking, _ = estimator.start(sensed[0])
    seconds = []
    for packet in sensed[1:]:
        start = time.perf_counter()
        estimator.update(tracking, packet)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def cost_table(costs: dict[str, Any], config: Config) -> str:
    """A row a kind of sensing, and the time of a packet."""
    best = costs["throughput"]["truth, no sensors"]
    rows = [
        [name, f"{rate:.0f}", f"{100 * rate / best:.0f} %"]
        for name, rate in costs["throughput"].items()
    ]
    table = markdown([f"N = {config.num_envs}", "policy steps/s", "share"], rows)
    return f"{table}\n\nOne packet of one robot: {1e6 * costs['packet']:.0f} us"

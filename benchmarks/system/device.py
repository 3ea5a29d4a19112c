"""Throughput on a GPU, and where the time goes, over the number of robots.

    python -m benchmarks.system.device
    python -m benchmarks.system.device --device cpu --num-envs 16 64 --steps 5   # for a test

In every policy step each candidate advances the same N robots from the same states, in turn. The
bound is bare `mujoco_warp.step`, captured in one graph, with as many physics steps and constant
torques. Times are between waits for the device; a last table has a whole training, with PPO.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import check_numbers


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    device: str = "cuda"
    """Device of robots and policy."""
    num_envs: tuple[int, ...] = (1024, 4096, 16384)
    """Numbers N of robots."""
    timestep: float = 0.001
    """Physics timestep [s]."""
    steps: int = 30
    """Policy steps that are timed, after some of warm-up."""
    policy: str = "directions"
    """Policy that walks, in its stack."""
    training: bool = True
    """Also time training."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(self, "timestep", steps=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import itertools
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import mujoco_warp as mjw
import torch
import warp as wp

from aslip.base.tables import markdown
from aslip.envs import StackEnv, WarpEnv
from aslip.robot import CASSIE
from aslip.sim.warp import WarpSimulations, check_device
from benchmarks.common import Subject
from benchmarks.system.throughput import time_iterations
from recipes import ppo_aslip

_WARM_UP = 5
_BOUND = "captured `mujoco_warp.step` (bound)"
_ALL = "environment, all transforms"


class Bound:
    """Physics steps of a policy period in one graph, without drive and sensors.

    Args:
        robots: simulations whose model it steps, in data of its own.
    """

    def __init__(self, robots: WarpSimulations) -> None:
        self._robots, model = robots, robots.model
        steps = round(CASSIE.policy_period / model.opt.timestep)
        with wp.ScopedDevice(wp.device_from_torch(robots.place)):
            self.d = mjw.make_data(
                model, nworld=robots.num, nconmax=robots.contacts, njmax=robots.constraints
            )
            with wp.ScopedCapture() as capture:
                for _ in range(steps):
                    mjw.step(robots.m, self.d)
        self._graph: Any = capture.graph

    def advance(self) -> None:
        """Simulate a policy period from the robots' states."""
        for name in ("qpos", "qvel", "ctrl", "qacc_warmstart"):
            wp.copy(getattr(self.d, name), getattr(self._robots.d, name))
        wp.capture_launch(self._graph)


def main(config: Config) -> None:
    """Measure and print."""
    place = check_device(config.device)
    subject = Subject.load(config.policy)
    print(f"{_name(place)}; physics of {1e3 * config.timestep:g} ms; policy {config.policy}\n")
    for num in config.num_envs:
        env = subject.env(
            num, seed=0, backend="warp", device=config.device, timestep=config.timestep
        )
        seconds = _times(config, env, subject.policy.to(place))
        rows = []
        for name, taken in seconds.items():
            share = f"{100 * seconds[_BOUND] / taken:.0f} %"
            rows.append([str(num), name, f"{1e3 * taken:.2f}", f"{num / taken:.0f}", share])
        header = ["N", "part", "a policy step [ms]", "policy steps/s", "of bound"]
        print(markdown(header, rows, ["---:", "---", *["---:"] * 3]), "\n", flush=True)
        del env
    if config.training:
        print(_training_table(config))


def _times(config: Config, env: StackEnv, policy: Callable[..., object]) -> dict[str, float]:
    """Median time of a policy step [s], by what is done in it."""
    robots, place = env.base_env, env.place
    assert isinstance(robots, WarpEnv)
    sims = robots.simulations
    bound = Bound(sims)
    td = env.reset()
    target = torch.zeros(robots.num_envs, len(CASSIE.motor_names), device=place)
    seconds: dict[str, list[float]] = {}

    def timed(name: str, call: Callable[[], object]) -> object:
        _wait(place)
        start = time.perf_counter()
        result = call()
        _wait(place)
        seconds.setdefault(name, []).append(time.perf_counter() - start)
        return result

    with torch.no_grad():
        for _ in range(_WARM_UP + config.steps):
            timed(_BOUND, bound.advance)
            timed("policy", partial(policy, td))
            target.copy_(env.transform.inv(td.clone())["motor_target"])
            _, td = timed(_ALL, partial(env.step_and_maybe_reset, td))  # pyright: ignore
        for _ in range(_WARM_UP + config.steps):
            timed("simulations: drive, sensors, physics", partial(sims.advance, target))
            timed("look at the robots", lambda: robots._observation(sims._live["diverged"]))
    return {name: statistics.median(values[_WARM_UP:]) for name, values in seconds.items()}


def _training_table(config: Config) -> str:
    """Table of times that iterations of a training spend on collection and learning."""
    preset = ppo_aslip.PRESETS["gpu"]
    rows = []
    for num in config.num_envs:
        samples = num * (preset.samples // preset.num_envs)
        settings = replace(preset, device=config.device, num_envs=num, samples=samples)
        settings = replace(settings, minibatch=min(preset.minibatch, samples))
        spans = time_iterations(settings, 4)
        collecting = statistics.median(got - asked for asked, got in spans[2:])
        whole = statistics.median(b[0] - a[0] for a, b in itertools.pairwise(spans[2:]))
        cells = [str(num), str(samples), f"{collecting:.2f}", f"{whole - collecting:.2f}"]
        rows.append([*cells, f"{samples / whole:.0f}"])
    header = ["N", "samples", "collection [s]", "learning [s]", "policy steps/s"]
    return markdown(header, rows, ["---:"] * 5)


def _wait(place: torch.device) -> None:
    if place.type == "cuda":
        torch.cuda.synchronize(place)


def _name(place: torch.device) -> str:
    return torch.cuda.get_device_name(place) if place.type == "cuda" else "CPU"


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)

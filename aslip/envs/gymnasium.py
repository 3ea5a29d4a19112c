"""Environments for Gymnasium: one robot, or n robots in one batch.

Actions and observations are NumPy arrays, as Stable-Baselines3 and CleanRL expect. TorchRL's own
`register_gym` is no alternative: it takes unbatched environments only and returns tensors.

    env = aslip.GymEnv(render_mode="rgb_array", stack="paper")
    envs = aslip.GymVectorEnv(64, drop=["noise"])

or from Gymnasium's registry: `gymnasium.make("aslip.envs.gymnasium:aslip/Walk-v0")` and
`gymnasium.make_vec("aslip.envs.gymnasium:aslip/Walk-v0", 64)`.
"""

from __future__ import annotations

from typing import Any, ClassVar, cast

import mujoco
import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from aslip.base.imports import extras

with extras():
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

from aslip.base.checks import check_count
from aslip.base.decorators import check_types, on_cpu_in_single
from aslip.envs.make import make_env
from aslip.envs.stack_env import StackEnv, check_seed
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.robot import CASSIE
from aslip.robot.model import APPEARANCE_GROUP, load_model
from aslip.robot.opengl import make_renderer

_FRAME_RATE = round(1 / CASSIE.policy_period)
Info = dict[str, Any]


class GymEnv(gymnasium.Env):
    """One robot for Gymnasium.

    The observation is the entry `observation` of the stack. `info` has the entries `command` and
    `reward_terms`.

    Args:
        render_mode: "rgb_array" for pictures; needs OpenGL, see `aslip.robot.opengl`.
        settings: arguments of `make_env`; without `seed` each environment draws its own.

    Raises:
        ConfigurationError: `num_envs` is not 1, or `make_env` refuses a setting.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": ["rgb_array"],
        "render_fps": _FRAME_RATE,
    }

    @check_types
    def __init__(self, render_mode: str | None = None, **settings: Any) -> None:
        _check_render_mode(render_mode, self.metadata)
        if check_count("num_envs", settings.get("num_envs", 1)) != 1:
            raise ConfigurationError("GymEnv has one robot; GymVectorEnv(num_envs) has several")
        self.render_mode = render_mode
        self.env = _make(settings)
        self.observation_space, self.action_space = _spaces(self.env)
        self._camera: _Camera | None = None
        self._state = TensorDict(batch_size=1)

    def reset(
        self, *, seed: int | None = None, options: Info | None = None
    ) -> tuple[np.ndarray, Info]:
        """Start an episode.

        Args:
            seed: seed of all random numbers from now on.
            options: entries of the stack's reset request, such as `{"command": 1.0}`, or with a
                library over three commands `{"command": [0.5, 0.0, 0.3]}`.

        Raises:
            UnknownNameError: a reset of the stack does not take such an option.
        """
        super().reset(seed=seed)
        self._state = _reset(self.env, seed, options)
        return _observation(self._state)[0], _first(_info(self._state))

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Info]:
        """Run one policy step, 30 ms."""
        after = self.env.step(_act(self._state, np.asarray(action)[None]))
        self._state = self.env.step_mdp(after)
        reward, terminated, truncated = _outcome(after["next"])
        return (
            _observation(self._state)[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _first(_info(after["next"])),
        )

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Picture (480, 640, 3) of the robot; None without a `render_mode`.

        Raises:
            RenderingError: OpenGL does not work.
        """
        if self.render_mode is None:
            return None
        if self._camera is None:
            self._camera = _Camera()
        return self._camera.picture(_configuration(self._state))

    def close(self) -> None:
        """Free the simulation and the renderer."""
        if self._camera is not None:
            self._camera.close()
        if not self.env.is_closed:
            self.env.close()


class GymVectorEnv(VectorEnv):
    """N robots in one batch for Gymnasium.

    Args:
        num_envs: number of robots.
        autoreset_mode: when a robot whose episode ended is reset, a member or value of Gymnasium's
            `AutoresetMode`. "SameStep": in that step; observation and `info` are the first of the
            new episode, `info["final_obs"]` and `info["final_info"]` the last of the old one.
            "NextStep", which Gymnasium's `NormalizeObservation` needs: in the next step, which
            ignores the robot's action, with reward 0. "Disabled" is not supported.
        settings: arguments of `make_env`; without `seed` each environment draws its own.

    Raises:
        ConfigurationError: the mode is not supported, or `make_env` refuses a setting.
    """

    metadata: ClassVar[dict[str, Any]] = {  # pyright: ignore[reportIncompatibleVariableOverride]
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": [],
        "render_fps": _FRAME_RATE,
    }

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **settings: Any,
    ) -> None:
        _check_render_mode(settings.pop("render_mode", None), self.metadata)
        supported = (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP)
        modes = [mode.value for mode in supported]
        if autoreset_mode not in (*supported, *modes):
            raise ConfigurationError(
                f"autoreset_mode must be one of {modes}, got {autoreset_mode!r}"
            )
        self.metadata = {**self.metadata, "autoreset_mode": AutoresetMode(autoreset_mode)}
        self.env = _make({**settings, "num_envs": num_envs})
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _spaces(self.env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._state = TensorDict(batch_size=num_envs)
        self._ended = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | None = None,  # pyright: ignore[reportIncompatibleMethodOverride]
        options: Info | None = None,
    ) -> tuple[np.ndarray, Info]:
        """Start an episode of every robot; see `GymEnv.reset`.

        Args:
            seed: seed of all random numbers from now on.
            options: as in `GymEnv.reset`.
        """
        super().reset(seed=None if seed is None else check_seed(seed))
        self._state = _reset(self.env, seed, options)
        self._ended = np.zeros_like(self._ended)
        return _observation(self._state), _info(self._state)

    def _restarted(self, state: TensorDictBase, robots: np.ndarray) -> TensorDictBase:
        """State in which some robots (n,) begin a new episode."""
        return self.env.reset(state.set("_reset", torch.from_numpy(robots)[:, None]))

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Run one policy step, 30 ms, of every robot."""
        mode, due = self.metadata["autoreset_mode"], self._ended
        if due.any():
            # the batch steps all robots; what the ended ones do is lost
            actions = np.where(due[:, None], np.float32(0), actions)
        after = self.env.step(_act(self._state, actions))
        self._state = self.env.step_mdp(after)
        reward, terminated, truncated = _outcome(after["next"])
        if due.any():
            self._state = self._restarted(self._state, due)
            reward, terminated, truncated = (
                np.where(due, 0, x).astype(x.dtype) for x in (reward, terminated, truncated)
            )
        ended = terminated | truncated
        if mode == AutoresetMode.NEXT_STEP:
            self._ended = ended
        elif ended.any():
            self._state = self._restarted(self._state, ended)
        info = _info(self._state)
        if mode == AutoresetMode.SAME_STEP and ended.any():
            last, final = _observation(after["next"]), np.full(self.num_envs, None, dtype=object)
            for robot in np.flatnonzero(ended):
                final[robot] = last[robot]
            info |= {"final_obs": final, "_final_obs": ended}
            info |= {"final_info": _info(after["next"]), "_final_info": ended}
        return _observation(self._state), reward.astype(np.float64), terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Free the simulations."""
        del kwargs
        if not self.env.is_closed:
            self.env.close()


class _Camera:
    """Renderer that follows one robot."""

    def __init__(self) -> None:
        model = load_model()
        self._data, self._option = mujoco.MjData(model), mujoco.MjvOption()
        self._option.geomgroup[APPEARANCE_GROUP] = True
        self._option.sitegroup[:] = False
        self._renderer = make_renderer(model, 640, 480)

    def picture(self, qpos: np.ndarray) -> np.ndarray:
        """Picture (480, 640, 3) of a configuration (35,)."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._renderer.model, self._data)
        self._renderer.update_scene(self._data, "follow", self._option)
        return self._renderer.render()

    def close(self) -> None:
        self._renderer.close()


def _make(settings: Info) -> StackEnv:
    env = make_env(**settings)
    if "observation" not in env.observation_spec:
        raise ConfigurationError("Gymnasium needs an `observation`, but no transform writes it")
    return env


def _check_render_mode(mode: str | None, metadata: Info) -> None:
    if mode not in (None, *metadata["render_modes"]):
        modes = metadata["render_modes"]
        raise ConfigurationError(f"render_mode must be None or one of {modes}, got {mode!r}")


def _spaces(env: StackEnv) -> tuple[spaces.Box, spaces.Box]:
    """Observation space and action space of one robot."""
    size = env.observation_spec["observation"].shape[-1]
    action = cast("Any", env.action_spec_unbatched.space)
    low, high = (np.asarray(bound, dtype=np.float32) for bound in (action.low, action.high))
    return spaces.Box(-np.inf, np.inf, (size,), np.float32), spaces.Box(low, high, dtype=np.float32)


@on_cpu_in_single
def _reset(env: StackEnv, seed: int | None, options: Info | None) -> TensorDictBase:
    if seed is not None:
        env.set_seed(seed)
    known = [key for key in env.state_spec.keys(True, True) if isinstance(key, str)]
    request = TensorDict(batch_size=env.batch_size)
    for name, value in (options or {}).items():
        if name not in known:
            raise UnknownNameError.among("option of reset", name, known)
        size = env.state_spec[name].shape[-1]
        column = torch.as_tensor(value, dtype=torch.float32).reshape(-1, size)
        request[name] = column.expand(*env.batch_size, size).clone()
    return env.reset(request)


@on_cpu_in_single
def _act(state: TensorDictBase, action: np.ndarray) -> TensorDictBase:
    if state.is_empty():
        raise gymnasium.error.ResetNeeded("call reset before step")
    return state.set("action", torch.as_tensor(np.asarray(action, dtype=np.float32)))


def _column(state: TensorDictBase, key: str) -> np.ndarray:
    """(n,) numbers of an entry (n, 1)."""
    return cast("Tensor", state[key])[:, 0].detach().numpy().copy()


def _observation(state: TensorDictBase) -> np.ndarray:
    """(n, k) observations of all robots."""
    return cast("Tensor", state["observation"]).detach().numpy().copy()


def _outcome(state: TensorDictBase) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) rewards, terminated and truncated flags of a step."""
    terminated = _column(state, "terminated")
    truncated = _column(state, "truncated") if "truncated" in state else np.zeros_like(terminated)
    return _column(state, "reward"), terminated, truncated


def _info(state: TensorDictBase) -> Info:
    """Commands, (n,) speeds or (n, c), and reward terms (n,)."""
    info: Info = {}
    if "command" in state:
        command = cast("Tensor", state["command"]).detach().numpy().copy()
        info["command"] = command[:, 0] if command.shape[1] == 1 else command
    if "reward_terms" in state:
        terms = cast("TensorDictBase", state["reward_terms"])
        info["reward_terms"] = {str(name): _column(terms, str(name)) for name in terms.keys()}  # noqa: SIM118
    return info


def _first(info: Info) -> Info:
    """Numbers of the first robot."""
    return {
        name: _first(value) if isinstance(value, dict) else value[0].tolist()
        for name, value in info.items()
    }


def _configuration(state: TensorDictBase) -> np.ndarray:
    """(35,) configuration of the first robot.

    Raises:
        ConfigurationError: it is unknown before a reset, and of robots that are not simulated.
    """
    qpos = state.get(("truth", "qpos"), None)
    if qpos is None:
        raise ConfigurationError(
            'render needs a simulated robot, a reset before, and `keep` without or with "truth"'
        )
    return qpos[0].numpy()


gymnasium.register(
    id="aslip/Walk-v0",
    entry_point="aslip.envs.gymnasium:GymEnv",
    vector_entry_point="aslip.envs.gymnasium:GymVectorEnv",
)

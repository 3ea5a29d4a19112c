"""States of Warp simulations as rows of `aslip.sim.Simulations.states`, for logs and checkpoints.

A row is MuJoCo's integration state followed by the memory of the sensors. Torques that wait in the
ring are MuJoCo's history of commands there.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from aslip.sim.warp.structs import RING, TAPS

_BIT = mujoco.mjtState
_INTEGRATION = int(_BIT.mjSTATE_INTEGRATION)


def state_parts(model: mujoco.MjModel) -> dict[str, slice]:
    """Columns of MuJoCo's integration state by the name of `mujoco.mjtState`."""
    parts, start = {}, 0
    for k in range(int(_BIT.mjNSTATE)):
        if _INTEGRATION >> k & 1:
            size = mujoco.mj_stateSize(model, 1 << k)
            parts[_BIT(1 << k).name.removeprefix("mjSTATE_").lower()] = slice(start, start + size)
            start += size
    return parts


def history_of_ring(ring: np.ndarray, tick: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
    """History (n, k) of commands, from rings (n, RING, m) and counts (n,) of physics steps."""
    samples = int(model.actuator_history[0, 0])
    ago = np.arange(samples, 0, -1)
    slots = (tick[:, None] - ago) % RING
    values = np.take_along_axis(ring, slots[..., None], axis=1).swapaxes(1, 2)
    times = (tick[:, None] - ago) * model.opt.timestep
    rows = np.empty((len(tick), model.nu, 2 + 2 * samples))
    # user number, index of the newest sample, times, commands, oldest first
    rows[..., 0], rows[..., 1] = 0.0, samples - 1
    rows[..., 2 : 2 + samples], rows[..., 2 + samples :] = times[:, None], values
    return rows.reshape(len(tick), -1)


def ring_of_history(history: np.ndarray, tick: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
    """Rings (n, RING, m) of histories (n, k) at counts (n,) of physics steps."""
    samples = int(model.actuator_history[0, 0])
    rows = history.reshape(len(tick), model.nu, 2 + 2 * samples)
    newest = rows[..., 1:2].astype(int)
    order = (newest + 1 + np.arange(samples)) % samples  # oldest first
    values = np.take_along_axis(rows[..., 2 + samples :], order, axis=-1)
    ring = np.zeros((len(tick), RING, model.nu))
    slots = (tick[:, None] - np.arange(samples, 0, -1)) % RING
    np.put_along_axis(ring, slots[..., None], values.swapaxes(1, 2), axis=1)
    return ring


def read_states(model: mujoco.MjModel, d: Any, motors: Any, joints: Any) -> np.ndarray:
    """(n, k) states of Warp's data `d` and of the low level's structs."""
    parts, tick = state_parts(model), motors.tick.numpy()
    num = len(tick)
    start = np.empty(mujoco.mj_stateSize(model, _INTEGRATION))
    mujoco.mj_getState(model, mujoco.MjData(model), start, _INTEGRATION)
    physics = np.tile(start, (num, 1))
    physics[:, parts["time"]] = tick[:, None] * model.opt.timestep
    for name, array in _mirrored(d).items():
        physics[:, parts[name]] = array.numpy().reshape(num, -1)
    physics[:, parts["history"]] = history_of_ring(motors.waiting.numpy(), tick, model)
    memory = (
        motors.count.numpy()[:, 1:],
        joints.memory.numpy().swapaxes(1, 2),
        motors.position.numpy(),
        motors.velocity.numpy(),
    )
    return np.concatenate([physics, *(part.reshape(num, -1) for part in memory)], axis=1)


def write_states(
    states: np.ndarray, model: mujoco.MjModel, d: Any, motors: Any, joints: Any
) -> None:
    """Write (n, k) states into Warp's data `d` and the low level's structs."""
    parts, num = state_parts(model), len(states)
    tick = np.rint(states[:, parts["time"]][:, 0] / model.opt.timestep).astype(int)
    for name, array in _mirrored(d).items():
        array.assign(states[:, parts[name]].reshape(array.numpy().shape))
    motors.tick.assign(tick)
    motors.waiting.assign(ring_of_history(states[:, parts["history"]], tick, model))
    width, shape = motors.position.shape[1], joints.memory.shape
    sizes = [(TAPS - 1) * width, shape[1] * shape[2], width]
    memory = states[:, mujoco.mj_stateSize(model, _INTEGRATION) :]
    count, filters, position, velocity = np.split(memory, np.cumsum(sizes), axis=1)
    counts = motors.count.numpy().copy()
    counts[:, 1:] = count.reshape(num, TAPS - 1, width)
    motors.count.assign(counts)
    joints.memory.assign(filters.reshape(num, shape[2], -1).swapaxes(1, 2))
    motors.position.assign(position)
    motors.velocity.assign(velocity)


def _mirrored(d: Any) -> dict[str, Any]:
    """Arrays of Warp's data that MuJoCo's integration state has, too, by its names."""
    names = ("qpos", "qvel", "ctrl", "xfrc_applied")
    return {"warmstart": d.qacc_warmstart} | {name: getattr(d, name) for name in names}

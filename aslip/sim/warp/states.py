"""States of Warp simulations as rows of `aslip.sim.Simulations.states`, for logs and checkpoints.

A row is MuJoCo's integration state followed by the memory of the sensors. Torques that wait in the
ring are MuJoCo's history of commands there.
"""

from __future__ import annotations

import mujoco
import numpy as np

from aslip.sim.warp import low_level as low

_BIT = mujoco.mjtState


def state_parts(model: mujoco.MjModel) -> dict[str, slice]:
    """Columns of MuJoCo's integration state by the name of `mujoco.mjtState`."""
    parts, start = {}, 0
    whole = int(_BIT.mjSTATE_INTEGRATION)
    for k in range(int(_BIT.mjNSTATE)):
        if whole >> k & 1:
            size = mujoco.mj_stateSize(model, 1 << k)
            parts[_BIT(1 << k).name.removeprefix("mjSTATE_").lower()] = slice(start, start + size)
            start += size
    return parts


def history_of_ring(ring: np.ndarray, tick: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
    """History (n, k) of commands, from rings (n, RING, m) and counts (n,) of physics steps."""
    samples = int(model.actuator_history[0, 0])
    ago = np.arange(samples, 0, -1)
    slots = (tick[:, None] - ago) % low.RING
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
    ring = np.zeros((len(tick), low.RING, model.nu))
    slots = (tick[:, None] - np.arange(samples, 0, -1)) % low.RING
    np.put_along_axis(ring, slots[..., None], values.swapaxes(1, 2), axis=1)
    return ring

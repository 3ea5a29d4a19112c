"""Stones below simulated robots, which differ from robot to robot."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from aslip.envs import BatchEnv, DmControlEnv, SimulatedEnv
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import CASSIE
from aslip.robot.model import ground_geoms, load_model
from aslip.sim.course import Course, pattern, stairs
from aslip.sim.stones import FLOOR_DEPTH, course_model
from tests.helpers import BACKENDS, bare_env, differing, standing_targets

# a platform of a polygon, and a rectangle
POLYGON = [[-0.5, -0.6], [0.4, -0.7], [0.4, 0.6], [-0.5, 0.6]]
MIXED = Course(np.array([[0.0] * 6, [0.7, 0.1, 0.05, 0.3, 0.3, 0.3]]), {0: np.array(POLYGON)})


def _start(env: SimulatedEnv, *places: tuple[float, float], **groups: Any) -> None:
    """Reset robots to standing, displaced by x and z [m]."""
    qpos = torch.tensor(CASSIE.standing).repeat(env.num_envs, 1)
    for row, (x, z) in zip(qpos, places, strict=True):
        row[0] += x
        row[2] += z
    initial = TensorDict(qpos=qpos, qvel=torch.zeros(env.num_envs, 32), batch_size=env.num_envs)
    env.reset(TensorDict(initial=initial, batch_size=env.num_envs, **groups))


def _stand(env: SimulatedEnv, steps: int) -> Any:
    td, target = TensorDict(), standing_targets(env)
    for _ in range(steps):
        td = env.step(TensorDict(motor_target=target, batch_size=env.num_envs))["next"]
    return td["truth"]


def test_moved_stones_equal_stones_compiled_in_their_places() -> None:
    """Bit for bit, over a fall from one stone onto others."""
    course = pattern("mixed", count=6)
    moved = course_model(course, visual=False)
    spec = mujoco.MjSpec.from_file(str(CASSIE.mjcf))
    spec.compiler.discardvisual = True
    floor = spec.geom("floor")
    floor.pos[2] = course.stones[:, 2].min() - FLOOR_DEPTH
    for x, y, z, yaw, length, width in course.stones:
        half = [length / 2, width / 2, (z - floor.pos[2]) / 2]
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=[x, y, z - half[2]],
            quat=[np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)], condim=3, contype=0, conaffinity=15,
            friction=floor.friction, priority=1, solref=floor.solref,
        )  # fmt: skip
    states = []
    for model in (moved, spec.compile()):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qpos[0] += 1.3
        for _ in range(1200):
            mujoco.mj_step(model, data)
        assert data.ncon >= 4
        states.append(data.qpos.copy())
    np.testing.assert_array_equal(*states)


def test_each_robot_has_its_own_ground() -> None:
    """A robot without stones keeps its bits; the force on a stone is that on the floor."""
    plain, results = BatchEnv(1), []
    _start(plain, (0, 0))
    expected = _stand(plain, 12)
    for env in (BatchEnv(4, num_threads=2), DmControlEnv(4)):
        env.set_course([None, pattern("up", count=2), MIXED, None])
        env.set_course(pattern("down", count=6), np.array([3]))
        # the second robot on the goal, the last beside all stones
        _start(env, (0, 0), (2.25, 0.16), (0, 0), (-3, 0))
        results.append(_stand(env, 12))
    assert differing(*results) == []
    truth = results[0]
    assert torch.equal(truth["qpos"][:1], expected["qpos"])
    assert torch.equal(truth["ground_force"][:1], expected["ground_force"])
    for on_stones in (1, 2):
        force = truth["ground_force"][on_stones]
        torch.testing.assert_close(force, expected["ground_force"][0], rtol=0.02, atol=1.0)
    rise = truth["pelvis_position"][:, 2] - expected["pelvis_position"][0, 2]
    assert rise[:3].tolist() == pytest.approx([0.0, 0.16, 0.0], abs=1e-3)
    assert rise[3] < -0.3


@pytest.mark.parametrize("backend", BACKENDS)
def test_stones_are_chosen_at_resets(backend: str) -> None:
    """Resets place stones of their own robots; friction, delays and later courses leave them."""
    env = bare_env(backend)
    env.set_dynamics({"floor_friction": [0.3, 0.7]})
    stones = torch.full((2, 8, 6), torch.nan, dtype=torch.float64)
    stones[1] = torch.tensor(pattern("down", count=6).stones)
    group = TensorDict(stones=stones, batch_size=2)
    env.reset(TensorDict(course=group, batch_size=2))
    np.testing.assert_array_equal(env.stones, stones.numpy())
    mask = torch.tensor([[True], [False]])
    other = TensorDict(stones=torch.tensor(stairs(0.1).stones).expand(2, -1, -1), batch_size=2)
    env.reset(TensorDict(course=other, _reset=mask, batch_size=2))
    np.testing.assert_array_equal(env.stones[1], stones[1].numpy())
    env.set_dynamics({"torque_delay": 0.02}, np.array([0]))
    fields = _fields(env, "geom_friction", "geom_pos")
    ground = ground_geoms(env.model)
    assert len(ground) == 9
    np.testing.assert_allclose(fields["geom_friction"][:, ground, 0].T, [[0.3, 0.7]] * 9)
    np.testing.assert_allclose(fields["geom_pos"][:, ground[0], 2], [-1.0, -1.48])
    np.testing.assert_allclose(fields["geom_pos"][1, ground[1:], :2], stones[1, :, :2])
    env.set_course(None)
    assert np.isnan(env.stones).all()
    np.testing.assert_array_equal(_fields(env, "geom_pos")["geom_pos"][:, ground[0], 2], 0.0)


def _fields(env: SimulatedEnv, *names: str) -> dict[str, np.ndarray]:
    """Fields (n, ...) of the robots' models."""
    if isinstance(env, DmControlEnv):
        models = [physics.model for physics in env.physics]
        return {name: np.stack([getattr(m, name) for m in models]) for name in names}
    assert isinstance(env, BatchEnv)
    parts = env.simulations.parts
    return {name: np.concatenate([p.batch.expand(name) for p in parts]) for name in names}


def test_stones_of_another_shape_are_refused() -> None:
    env, bad = bare_env("batch"), torch.zeros(2, 3, 6)
    with pytest.raises(ShapeError, match=r"course must be one, or 2 courses, got 3"):
        env.set_course([None] * 3)
    for name, stones, message in (
        ("stones", bad[..., :5], r"must have shape \(2, up to 200, 6\), got \(2, 3, 5\)"),
        ("stones", bad, "stones must be NaN, or finite with length and width above 0"),
        ("rocks", bad, "did you mean 'stones'|there are"),
    ):
        course = TensorDict({name: stones}, batch_size=2)
        with pytest.raises((ShapeError, ConfigurationError, UnknownNameError), match=message):
            env.reset(TensorDict(course=course, batch_size=2))
    assert env.stones.shape == (2, 0, 6)
    assert len(ground_geoms(env.model)) == len(ground_geoms(load_model())) == 1

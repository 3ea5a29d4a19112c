"""Courses drawn at resets, and stones that robots see."""

from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs.utils import check_env_specs

import aslip
from aslip.envs import StackEnv, default_stack, insert_before
from aslip.envs.directions import course_stack, planned_stack
from aslip.errors import AslipError, ConfigurationError, ShapeError
from aslip.robot import NoiseLevel
from aslip.robot.rotation import yaw
from aslip.sim.course import Course, lay_stones, pattern, stairs
from aslip.transforms import RandomCourse, SeenStones

COURSES = [pattern("up", count=7), stairs(-0.15, steps=3)]
NONE = NoiseLevel(0.0, 0.0)
TRIANGLES = Course(
    np.array([[0.0, 0.0, 0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.05, 0.0, 1.0, 1.0]]),
    {
        0: np.array([[-0.6, -0.6], [0.3, -0.6], [0.3, 0.6], [-0.6, 0.6]]),
        1: np.array([[0.5, -0.3], [1.0, 0.0], [0.5, 0.3]]),
    },
)


def _env(num: int = 4, **settings: Any) -> StackEnv:
    stack = insert_before(default_stack(), "start", course=RandomCourse(COURSES))
    stack = insert_before(stack, "observation", stones=SeenStones(**settings))
    return aslip.make_env(num_envs=num, seed=1, num_threads=1, stack=stack)


def test_each_reset_draws_a_course_of_which_the_robot_sees_the_nearest_stones() -> None:
    """Robots start on its first stone; who is not reset keeps course and errors."""
    env = _env(count=8)
    first = env.reset()
    np.testing.assert_array_equal(env.base_env.stones, first["stones", "course"])
    lengths = torch.isfinite(first["stones", "course"][..., 0]).sum(1)
    assert {*lengths.tolist()} == {9, 4}
    assert torch.equal(torch.isfinite(first["stones", "height"]).sum(1), lengths.clip(max=8))
    assert (first["truth", "ground_height"] == 0).all()
    first["action"] = torch.zeros(4, 10)
    td = cast("TensorDictBase", env.step(first)["next"])
    for key in (("stones", "course"), ("stones", "error")):
        assert torch.equal(td[key].nan_to_num(), first[key].nan_to_num())
    td["_reset"] = torch.tensor([[True], [False], [False], [False]])
    seen = {key: td[key].clone() for key in (("stones", "course"), ("stones", "error"))}
    again = env.reset(td)
    for key, value in seen.items():
        assert torch.equal(again[key][1:].nan_to_num(), value[1:].nan_to_num())
    assert not torch.equal(again["stones", "error"][0], seen["stones", "error"][0])
    check_env_specs(env)


def test_robots_amid_stones_that_lie_close_see_those_at_their_feet() -> None:
    rows = lay_stones(np.resize([0.22, 0.0], 20))
    rows[:, 0] -= 2.0
    stack = insert_before(default_stack(), "start", course=RandomCourse(rows[None]))
    stack = insert_before(stack, "observation", stones=SeenStones(noise=NONE))
    td = aslip.make_env(num_envs=1, seed=1, num_threads=1, stack=stack).reset()
    pelvis = td["odometry", "pelvis_position"][0, :2]
    seen = (td["stones", "corners"][0].mean(-2) - pelvis).numpy()
    there = rows[:, :2] - td["truth", "pelvis_position"][0, :2].numpy()
    at_feet = there[np.abs(there[:, 0]) < 0.2]
    assert len(at_feet) >= 2
    away = np.linalg.norm(at_feet[:, None] - seen, axis=-1).min(1)
    np.testing.assert_allclose(away, 0.0, atol=1e-3)


def test_stones_that_are_shown_need_not_be_all_the_ground() -> None:
    """Robots walk on the course, see what is shown of it, and chosen stones are both."""
    ground = stairs(0.1, steps=3).stones[None]
    shown = ground * np.array([1, 1, 1, 1, 0.5, 0.5])
    course = RandomCourse(ground, shown)
    stack = insert_before(default_stack(), "start", course=course)
    stack = insert_before(stack, "observation", stones=SeenStones(noise=NONE))
    env = aslip.make_env(num_envs=2, seed=1, num_threads=1, stack=stack)
    td = env.reset()
    np.testing.assert_array_equal(env.base_env.stones[0], ground[0].astype(np.float32))
    td = cast("TensorDictBase", env.step(td.set("action", torch.zeros(2, 10)))["next"])
    corners = cast("Tensor", td["stones", "corners"])[0, : len(ground[0])]
    size = corners[:, 2] - corners[:, 0]
    np.testing.assert_allclose(size.norm(dim=1), np.hypot(*shown[0, :, 4:].T), atol=1e-5)
    chosen = torch.as_tensor(shown, dtype=torch.float32).expand(2, -1, -1)
    for key in (("course", "stones"), ("stones", "course")):
        chosen = chosen * torch.tensor([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
        td = env.reset(TensorDict({key: chosen}, batch_size=2))
        np.testing.assert_array_equal(env.base_env.stones, chosen)
        assert torch.equal(td["stones", "shown"], chosen)
    with pytest.raises(ShapeError, match=r"must be \(1, 4, 6\), got \(1, 3, 6\)"):
        RandomCourse(ground, shown[:, 1:])


def test_stones_are_seen_from_the_pelvis_wherever_the_estimate_is() -> None:
    """Without noise the place of each corner from pelvis and its yaw is the true one."""
    env = _env(2, count=3, noise=NONE)
    stones = torch.tensor(COURSES[0].stones, dtype=torch.float32).expand(2, 9, 6)
    course = TensorDict(stones=stones, batch_size=2)
    td = env.reset(TensorDict(course=course, heading=torch.tensor([[0.0], [0.7]]), batch_size=2))
    td["action"] = torch.zeros(2, 10)
    td = cast("TensorDictBase", env.step(td)["next"])
    truth, odometry = (cast("TensorDictBase", td[group]) for group in ("truth", "odometry"))
    seen = (
        cast("Tensor", td["stones", "corners"]).mean(2) - odometry["pelvis_position"][:, None, :2]
    )
    true = stones[:, :3, :2] - truth["pelvis_position"][:, None, :2]
    for places, group in ((seen, odometry), (true, truth)):
        turn = yaw(group["pelvis_orientation"].numpy())
        turned = torch.as_tensor(np.exp(-1j * turn))[:, None]
        along = turned * torch.view_as_complex(places.contiguous())
        places.copy_(torch.view_as_real(along))
    torch.testing.assert_close(seen, true, atol=1e-5, rtol=0)
    rise = td["stones", "height"] - odometry["pelvis_position"][:, 2:]
    torch.testing.assert_close(
        rise, stones[:, :3, 2] - truth["pelvis_position"][:, 2:], atol=1e-5, rtol=0
    )


def test_noise_of_sight_has_a_part_that_lasts() -> None:
    """Standard deviations within five of their own."""
    env = _env(32, noise=NoiseLevel(0.004, (0.02, 0.02, 0.01)))
    td, heights = env.reset(), []
    place = cast("Tensor", td["stones", "course"])[:, 1:4, 2]
    for _ in range(4):
        td = cast("TensorDictBase", env.step(td.set("action", torch.zeros(32, 10)))["next"])
        height = td["stones", "height"] - td["odometry", "pelvis_position"][:, 2:]
        heights.append(height[:, 1:4] + td["truth", "pelvis_position"][:, 2:] - place)
    error = torch.stack(heights)
    lasting = td["stones", "error"]
    assert lasting[..., 0].std().item() == pytest.approx(0.02, rel=0.15)
    white = error - lasting[:, 1:4, 2]
    assert white.std().item() == pytest.approx(0.004, rel=0.15)
    assert (white[1:] - white[:-1]).std().item() == pytest.approx(0.004 * 2**0.5, rel=0.15)


@pytest.mark.parametrize(
    ("courses", "error", "message"),
    [
        ([], ConfigurationError, r"one or more, got \(0, 0, 6\)"),
        (np.zeros((3, 6)), ShapeError, r"\(p, s, 6\), got \(3, 6\)"),
        ([TRIANGLES, COURSES[0]], ConfigurationError, "a single course, got 2 courses"),
    ],
)
def test_bad_courses_are_refused(courses: Any, error: type[AslipError], message: str) -> None:
    with pytest.raises(error, match=message):
        RandomCourse(courses)


def test_robots_see_and_stand_on_polygons() -> None:
    """They fall where a triangle is not, and are on the corners that they see."""
    stack = course_stack(planned_stack(), [TRIANGLES])
    env = aslip.make_env(num_envs=2, seed=3, stack=stack, num_threads=1)
    env.base_env.set_course(TRIANGLES)
    td = env.reset(TensorDict(stand=torch.ones(2, 1), batch_size=2))
    corners = td["stones", "corners"]
    assert corners.shape == (2, 16, 4, 2)
    seen = (corners[:, :2] - td["odometry", "pelvis_position"][:, None, None, :2]).double()
    there = torch.tensor(np.array([[*c, c[-1]][:4] for c in TRIANGLES.corners]))
    there = there - td["truth", "pelvis_position"][:, None, None, :2].double()
    assert (seen - there).abs().max() < 0.1  # noise of sight
    assert corners[:, 2:].isnan().all()
    course = TensorDict(stones=torch.ones(2, 2, 6), batch_size=2)
    with pytest.raises(ConfigurationError, match="rectangular stones, but this course has others"):
        env.reset(TensorDict(course=course, batch_size=2))
    policy = aslip.load_policy("stones")
    for _ in range(10):
        td = env.step(policy(td))["next"]
    assert td["truth", "ground_force"][..., 2].sum(1).min() > 200
    assert env.base_env.stones[:, :2, 2].tolist() == [[0.0, 0.05]] * 2


def test_a_robot_falls_below_its_stones_not_below_zero() -> None:
    """On high stones kneeling is a fall, deep below the start standing is none."""
    env = _env(2)
    td = env.reset()
    (fall,) = (t for t in env.transforms if type(t).__name__ == "Fall")
    after = TensorDict(
        truth=TensorDict(
            pelvis_position=torch.tensor([[0.0, 0.0, 1.3], [0.0, 0.0, -0.2]]),
            ground_height=torch.tensor([[1.0], [-1.1]]),
        ),
        terminated=torch.zeros(2, 1, dtype=torch.bool),
        done=torch.zeros(2, 1, dtype=torch.bool),
        batch_size=2,
    )
    assert fall._step(td, after)["terminated"][:, 0].tolist() == [True, False]


def test_commands_lead_robots_along_their_course() -> None:
    """Robots without stones keep the drawn commands, zero ones stay."""
    bend = pattern("zigzag", count=9).stones
    pool = np.stack([bend, np.full_like(bend, np.nan)])
    env = aslip.make_env(num_envs=16, seed=2, stack=course_stack(planned_stack(), pool))
    td = env.reset()
    on = torch.isfinite(td["stones", "course"][:, 0, 0])
    assert 0 < on.sum() < 16
    waits = on & (td["command"] == 0).all(1)
    assert 0 < waits.sum() < on.sum()
    on &= ~waits
    for _ in range(2):
        command = td["command"]
        assert (command[waits] == 0).all()
        assert (command[on, 0] >= 0.3 - 1e-6).all()
        assert (command[on, 0] <= 1.1 + 1e-6).all()
        # the course turns to the left first
        assert (command[on, 2] > 0).all()
        assert command[~on].std(0).min() > 0.05
        td = cast("TensorDictBase", env.step(td.set("action", torch.zeros(16, 10)))["next"])

"""Compiled model: masses, motors, loops, symmetry and contacts."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import copy
import itertools

import mujoco
import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.robot import CASSIE, SIDES, mirror_name
from aslip.robot.model import load_model

ROTOR_INERTIA = [6.1e-5, 6.1e-5, 3.65e-4, 3.65e-4, 4.9e-6] * 2


def test_total_mass(model: mujoco.MjModel) -> None:
    assert model.body_mass.sum() == pytest.approx(33.312, abs=1e-9)
    assert model.body_mass.sum() == pytest.approx(CASSIE.total_mass, abs=1e-9)
    assert model.body("pelvis").mass[0] == pytest.approx(10.33)


def test_armature_is_gear_squared_times_rotor_inertia(model: mujoco.MjModel) -> None:
    armature = [model.joint(name).armature[0] for name in CASSIE.motor_names]
    np.testing.assert_allclose(armature, CASSIE.gear**2 * ROTOR_INERTIA, rtol=1e-12)


def test_actuators_are_the_motors_in_order(model: mujoco.MjModel) -> None:
    names = [model.actuator(i).name for i in range(model.nu)]
    assert tuple(names) == CASSIE.motor_names
    joints = [model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nu)]
    assert tuple(joints) == CASSIE.motor_names
    np.testing.assert_array_equal(model.actuator_gear[:, 0], CASSIE.gear)
    np.testing.assert_array_equal(model.actuator_ctrlrange[:, 1], CASSIE.torque_limit)
    np.testing.assert_array_equal(model.actuator_ctrlrange[:, 0], -CASSIE.torque_limit)
    assert model.actuator_ctrllimited.all()


def test_timestep_and_torque_delay(model: mujoco.MjModel) -> None:
    assert model.opt.timestep == CASSIE.physics_timestep
    np.testing.assert_array_equal(model.actuator_delay, CASSIE.torque_delay)


def test_newton_solver_equals_the_public_simulators_solver(model: mujoco.MjModel) -> None:
    """Standing with bent springs and feet in the floor; PGS has many iterations."""
    accelerations = []
    for solver in (mujoco.mjtSolver.mjSOL_NEWTON, mujoco.mjtSolver.mjSOL_PGS):
        same = copy.copy(model)
        same.opt.solver, same.opt.iterations, same.opt.tolerance = solver, 20_000, 0.0
        data = mujoco.MjData(same)
        mujoco.mj_resetDataKeyframe(same, data, 0)
        data.qpos[2] -= 0.002
        data.qvel[:6] = 0.1
        mujoco.mj_forward(same, data)
        assert data.ncon >= 2
        accelerations.append(data.qacc.copy())
    np.testing.assert_allclose(*accelerations, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("side", SIDES)
def test_loops_close_at_the_published_points(model: mujoco.MjModel, side: str) -> None:
    """Rod ends meet the foot and the heel spring (second anchors as compiled)."""
    sign = 1 if side == "left" else -1
    expected = {
        f"{side}_plantar": [0.35012, 0, 0, 0.05512, 0.006, sign * 0.01484],
        f"{side}_achilles": [0.5012, 0, 0, 0.119434, -0.008663, -sign * 0.001568],
    }
    for name, anchors in expected.items():
        equality = model.equality(name)
        assert equality.type[0] == mujoco.mjtEq.mjEQ_CONNECT
        np.testing.assert_allclose(equality.data[:6], anchors, atol=1e-6)


def test_springs_have_the_published_stiffness(model: mujoco.MjModel) -> None:
    for side in SIDES:
        assert model.joint(f"{side}_shin").stiffness[0] == 1500
        assert model.joint(f"{side}_heel_spring").stiffness[0] == 1250


# ------------------------------------------------------------------- symmetry

_PER_JOINT = ("jnt_type", "jnt_stiffness", "jnt_margin", "jnt_solref", "jnt_solimp", "jnt_limited")
# roll and yaw have the opposite sign on the other leg
_REVERSED = ("hip_roll", "hip_yaw")


def _pairs(model: mujoco.MjModel, what: str) -> list[tuple[str, str]]:
    """(left, right) names of bodies, joints or actuators."""
    count = {"body": model.nbody, "joint": model.njnt, "actuator": model.nu}[what]
    names = [getattr(model, what)(i).name for i in range(count)]
    left = [name for name in names if name.startswith("left_")]
    assert {mirror_name(name) for name in left} == {n for n in names if n.startswith("right_")}
    return [(name, mirror_name(name)) for name in left]


def _is_reversed(name: str) -> bool:
    return name.removeprefix("left_").removeprefix("right_") in _REVERSED


def test_legs_have_mirrored_joints(model: mujoco.MjModel) -> None:
    for left, right in _pairs(model, "joint"):
        i, j = model.joint(left).id, model.joint(right).id
        for field in _PER_JOINT:
            values = getattr(model, field)
            np.testing.assert_array_equal(values[i], values[j], err_msg=f"{left} {field}")
        a, b = model.jnt_dofadr[i], model.jnt_dofadr[j]
        for field in ("dof_armature", "dof_damping", "dof_frictionloss"):
            assert getattr(model, field)[a] == getattr(model, field)[b], f"{left} {field}"
        low, high = model.jnt_range[i]
        expected = [-high, -low] if _is_reversed(left) else [low, high]
        np.testing.assert_array_equal(model.jnt_range[j], expected, err_msg=left)


def _mirror_qpos(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Configuration mirrored at the plane y = 0."""
    mirrored = qpos.copy()
    mirrored[1] *= -1
    mirrored[[4, 6]] *= -1
    for left, right in _pairs(model, "joint"):
        a, b = model.joint(left).qposadr[0], model.joint(right).qposadr[0]
        if model.joint(left).type[0] == mujoco.mjtJoint.mjJNT_BALL:
            # an axial vector reflected along z changes the signs of x and y
            signs = np.array([1, -1, -1, 1])
            mirrored[b : b + 4] = signs * qpos[a : a + 4]
            mirrored[a : a + 4] = signs * qpos[b : b + 4]
        else:
            sign = -1 if _is_reversed(left) else 1
            mirrored[b], mirrored[a] = sign * qpos[a], sign * qpos[b]
    return mirrored


def _mirror_qvel(model: mujoco.MjModel, qvel: np.ndarray) -> np.ndarray:
    mirrored = qvel.copy()
    mirrored[[1, 3, 5]] *= -1
    for left, right in _pairs(model, "joint"):
        a, b = model.joint(left).dofadr[0], model.joint(right).dofadr[0]
        if model.joint(left).type[0] == mujoco.mjtJoint.mjJNT_BALL:
            signs = np.array([-1, -1, 1])
            mirrored[b : b + 3], mirrored[a : a + 3] = (
                signs * qvel[a : a + 3],
                signs * qvel[b : b + 3],
            )
        else:
            sign = -1 if _is_reversed(left) else 1
            mirrored[b], mirrored[a] = sign * qvel[a], sign * qvel[b]
    return mirrored


def _random_qpos(model: mujoco.MjModel, rng: np.random.Generator) -> np.ndarray:
    qpos = rng.uniform(-1, 1, model.nq)
    for start in (3, 10, 24):
        qpos[start : start + 4] /= np.linalg.norm(qpos[start : start + 4])
    return qpos


def test_mirrored_states_have_mirrored_accelerations() -> None:
    """The dynamics of the legs, loops, springs and motors commute with the mirror."""
    model = load_model()
    # the pelvis' own inertia is slightly one-sided, as the real one's is
    pelvis = model.body("pelvis")
    pelvis.ipos[1] = 0.0
    pelvis.iquat[:] = [1, 0, 0, 0]
    # a converged solver, so that the order of constraints plays no part
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.iterations = 100
    model.opt.tolerance = 0
    rng = np.random.default_rng(1)
    data, twin = mujoco.MjData(model), mujoco.MjData(model)
    for _ in range(3):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qpos[2] = 2.0  # in the air
        data.qpos[7:] += rng.uniform(-0.01, 0.01, 28)
        data.qpos[3:7] = _random_qpos(model, rng)[3:7]
        for start in (10, 24):
            data.qpos[start : start + 4] /= np.linalg.norm(data.qpos[start : start + 4])
        data.qvel = rng.uniform(-1, 1, model.nv)
        torque = rng.uniform(-1, 1, model.nv)
        torque[:6] = 0
        data.qfrc_applied = torque
        twin.qpos = _mirror_qpos(model, data.qpos)
        twin.qvel = _mirror_qvel(model, data.qvel)
        twin.qfrc_applied = _mirror_qvel(model, torque)
        mujoco.mj_forward(model, data)
        mujoco.mj_forward(model, twin)
        scale = np.abs(data.qacc).max()
        assert scale > 1.0
        np.testing.assert_allclose(
            twin.qacc, _mirror_qvel(model, data.qacc), atol=1e-7 * scale, rtol=0
        )


# ------------------------------------------------------------------- contacts


def _touching_pairs(model: mujoco.MjModel) -> set[frozenset[str]]:
    """Pairs of named geoms whose masks let them collide."""
    geoms = [i for i in range(model.ngeom) if model.geom_contype[i] or model.geom_conaffinity[i]]
    assert all(model.geom(i).name for i in geoms), "a colliding geom has no name"
    return {
        frozenset((model.geom(i).name, model.geom(j).name))
        for i, j in itertools.combinations(geoms, 2)
        if (model.geom_contype[i] & model.geom_conaffinity[j])
        or (model.geom_contype[j] & model.geom_conaffinity[i])
    }


def test_everything_touches_the_floor_and_legs_touch_each_other(model: mujoco.MjModel) -> None:
    """Parts of one leg do not collide; pelvis and thighs collide with the floor only."""
    lower = ("shin", "tarsus", "foot")
    floor = {frozenset(("floor", f"{side}_{part}")) for side in SIDES for part in lower}
    floor |= {frozenset(("floor", name)) for name in ("pelvis", "left_thigh", "right_thigh")}
    crossing = {frozenset((f"left_{a}", f"right_{b}")) for a, b in itertools.product(lower, lower)}
    assert _touching_pairs(model) == floor | crossing


def test_crossed_legs_collide(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] = 2.0
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    data.joint("left_hip_roll").qpos[:] = -0.26
    data.joint("right_hip_roll").qpos[:] = 0.26
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    for contact in data.contact:
        sides = {model.geom(geom).name.split("_")[0] for geom in contact.geom}
        assert sides == {"left", "right"}


def test_floor_has_the_requested_friction() -> None:
    """The floor's coefficient has priority over the foot's."""
    model = load_model(floor_friction=0.6)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] -= 0.005
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    for contact in data.contact:
        assert contact.friction[0] == 0.6
        assert contact.dim == 3


@pytest.mark.parametrize("friction", [0.0, -0.1, float("nan"), float("inf"), 1e300])
def test_friction_must_be_a_positive_number(friction: float) -> None:
    with pytest.raises(ConfigurationError, match="floor_friction"):
        load_model(floor_friction=friction)

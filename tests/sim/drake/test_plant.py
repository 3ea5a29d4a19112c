"""Robot in Drake against the compiled MJCF: coordinates, inertia, springs, damping, loops."""

# Drake's stubs give arrays a wrong shape
# pyright: reportArgumentType=false

import mujoco
import numpy as np
import pytest

from aslip.robot import CASSIE

pytest.importorskip("pydrake", exc_type=ImportError)

from aslip.sim.drake import Mechanism
from aslip.sim.drake.coordinates import Coordinates

RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def mechanism() -> Mechanism:
    return Mechanism()


@pytest.fixture(scope="module")
def coordinates(mechanism: Mechanism) -> Coordinates:
    return Coordinates(mechanism.plant, CASSIE)


def random_state(speed: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """State in the air, with open loops and any attitude, within the joints' limits."""
    qpos = CASSIE.standing + 0.05 * RNG.normal(size=CASSIE.indices.num_qpos)
    qpos[2] = 3.0
    qpos[3:7] = RNG.normal(size=4)
    for at in CASSIE.indices.quaternions:
        qpos[at] /= np.linalg.norm(qpos[at])
    return qpos, speed * RNG.normal(size=CASSIE.indices.num_qvel)


def test_coordinates_return(coordinates: Coordinates) -> None:
    for _ in range(20):
        qpos, qvel = random_state()
        again = coordinates.from_drake(coordinates.to_drake(qpos, qvel))
        for at in CASSIE.indices.quaternions:
            again[0][at] *= np.sign(again[0][at] @ qpos[at])
        np.testing.assert_allclose(again[0], qpos, atol=1e-14)
        np.testing.assert_allclose(again[1], qvel, atol=1e-14)


def test_mass_centre_of_mass_and_inertia_matrix_are_mujoco_s(
    mechanism: Mechanism, coordinates: Coordinates
) -> None:
    """Inertia matrices are compared in MuJoCo's velocities, with the rotors' inertia."""
    model, plant = mechanism.model, mechanism.plant
    data, context = mujoco.MjData(model), plant.CreateDefaultContext()
    inertia = np.zeros((model.nv, model.nv))
    for _ in range(5):
        qpos, qvel = random_state()
        data.qpos, data.qvel = qpos, qvel
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        plant.SetPositionsAndVelocities(context, coordinates.to_drake(qpos, qvel))
        assert plant.CalcTotalMass(context) == pytest.approx(CASSIE.total_mass, rel=1e-12)
        centre = plant.CalcCenterOfMassPositionInWorld(context)
        np.testing.assert_allclose(centre, data.subtree_com[0], atol=1e-12)
        units = [coordinates.to_drake(qpos, unit)[model.nq - 2 :] for unit in np.eye(model.nv)]
        ours = np.array(units) @ plant.CalcMassMatrix(context) @ np.array(units).T
        np.testing.assert_allclose(ours, inertia, atol=1e-12)


@pytest.mark.parametrize(("speed", "tolerance"), [(0.0, 1e-9), (0.5, 2e-3)])
def test_a_step_in_the_air_with_open_loops_is_mujoco_s(
    mechanism: Mechanism, coordinates: Coordinates, speed: float, tolerance: float
) -> None:
    """Gravity, springs, damping, and at rest nothing else; engines turn bodies differently."""
    model, plant = mechanism.model, mechanism.plant
    diagram = mechanism.diagram
    context, after = diagram.CreateDefaultContext(), diagram.AllocateDiscreteVariables()
    state = plant.GetMyMutableContextFromRoot(context)
    plant.get_actuation_input_port().FixValue(state, np.zeros(model.nu))
    for loop in mechanism.loops:
        plant.SetConstraintActiveStatus(state, loop, False)
    data = mujoco.MjData(model)
    for _ in range(3):
        mujoco.mj_resetData(model, data)
        data.eq_active[:] = 0
        data.qpos, data.qvel = random_state(speed)
        plant.SetPositionsAndVelocities(state, coordinates.to_drake(data.qpos, data.qvel))
        before = data.qvel.copy()
        mujoco.mj_step(model, data)
        diagram.CalcForcedDiscreteVariableUpdate(context, after)
        context.SetDiscreteState(after)
        _, qvel = coordinates.from_drake(plant.GetPositionsAndVelocities(state))
        assert abs(data.qvel - before).max() > 0.05
        np.testing.assert_allclose(qvel, data.qvel, atol=tolerance)

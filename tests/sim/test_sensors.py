"""Encoders, velocity filters and IMU against closed form and against MuJoCo's own sensors."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from scipy.signal import lfilter

from aslip.base.assets import asset_path
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.sim import SimulationPool, Simulations
from aslip.sim.readings import MOTOR_VELOCITY_TAPS
from aslip.sim.sensors import JOINT_VELOCITY_FILTER, Sensors

RATE = 1 / CASSIE.physics_timestep
# radians of one count, at the joint: hip roll, hip yaw, hip pitch, knee, foot
MOTOR_STEPS = np.tile([3.07e-5, 3.07e-5, 4.79e-5, 4.79e-5, 4.8e-7], 2)
JOINT_STEPS = np.tile([2.40e-5, 2.40e-5, 7.67e-4], 2)


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return load_model(visual=False)


class Bench:
    """Sensors of one robot with prescribed joint angles."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.sensors = Sensors(1, model)
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("standing").id)
        self.qpos, self.qvel, self.qacc = data.qpos[None], data.qvel[None] * 0, data.qacc[None] * 0
        simulations = Simulations(1, model=model, num_threads=1)
        self.indices = simulations.indices

    def reset(self) -> None:
        self.sensors.reset(np.array([0]), self.qpos, self.qvel, self.qacc)

    def run(self, angle: Callable[[float], float], periods: int) -> dict[str, np.ndarray]:
        """Turn motors and joints by one function of time; readings at every substep."""
        records: dict[str, list[np.ndarray]] = {"motor_position": [], "motor_velocity": []}
        windows: dict[str, list[np.ndarray]] = {}
        for k in range(periods * CASSIE.substeps):
            now = angle(k * CASSIE.physics_timestep)
            self.qpos[0, self.indices.motor_qpos] = now
            self.qpos[0, self.indices.joint_qpos] = now
            self.sensors.read(k % CASSIE.substeps, self.qpos, self.qvel)
            self.sensors.record_acceleration(k % CASSIE.substeps, self.qacc)
            for name, record in records.items():
                record.append(getattr(self.sensors, name)[0].copy())
            if k % CASSIE.substeps == CASSIE.substeps - 1:
                self.sensors.finish()
                for name, window in self.sensors.packets().items():
                    windows.setdefault(name, []).append(window[0].copy())
        return {name: np.array(record) for name, record in records.items()} | {
            f"sent_{name}": np.concatenate(window) for name, window in windows.items()
        }


def _response(coefficients: tuple[np.ndarray, np.ndarray], hertz: float) -> complex:
    """Gain and phase of a velocity filter relative to a perfect derivative."""
    omega = 2 * np.pi * hertz
    numerator, denominator = (np.polyval(c[::-1], np.exp(-1j * omega / RATE)) for c in coefficients)
    return complex(numerator / denominator) / (1j * omega)


MOTOR_FILTER = (MOTOR_VELOCITY_TAPS / np.pi, np.array([1.0]))


# --------------------------------------------------------------------- encoders


@pytest.mark.parametrize("angle", [-1.0, -0.35007, 0.7003, 1.0])
def test_resolution_follows_from_the_bits(model: mujoco.MjModel, angle: float) -> None:
    seen = Bench(model).run(lambda t: angle, 1)
    for name, bits, gear in (
        ("motor_position", [13, 13, 13, 13, 18] * 2, CASSIE.gear),
        ("joint_position", [18, 18, 13] * 2, 1.0),
    ):
        step = 2 * np.pi / 2.0 ** np.array(bits) / gear
        expected = np.broadcast_to(np.trunc(angle / step) * step, seen[f"sent_{name}"].shape)
        np.testing.assert_allclose(seen[f"sent_{name}"], expected, rtol=1e-14)


# ---------------------------------------------------------------------- filters


def test_motor_filter_has_the_published_gain_and_delay() -> None:
    gain = abs(_response(MOTOR_FILTER, 1e-3))
    assert gain == pytest.approx(0.9997, abs=1e-4)
    delay = -np.angle(_response(MOTOR_FILTER, 1.0)) / (2 * np.pi)
    assert delay == pytest.approx(0.52e-3, abs=0.01e-3)
    assert abs(_response(MOTOR_FILTER, 200.0)) / gain == pytest.approx(0.96, abs=0.01)


def test_joint_filter_has_the_published_gain_and_delay() -> None:
    assert abs(_response(JOINT_VELOCITY_FILTER, 1e-3)) == pytest.approx(1.0019, abs=1e-4)
    delay = -np.angle(_response(JOINT_VELOCITY_FILTER, 1.0)) / (2 * np.pi)
    assert delay == pytest.approx(4.5e-3, abs=0.1e-3)
    assert abs(_response(JOINT_VELOCITY_FILTER, 50.0)) == pytest.approx(0.75, abs=0.01)
    assert abs(_response(JOINT_VELOCITY_FILTER, 100.0)) == pytest.approx(0.27, abs=0.01)


@pytest.mark.parametrize("hertz", [2.0, 20.0, 50.0])
def test_sine_response_equals_the_transfer_function(model: mujoco.MjModel, hertz: float) -> None:
    """The tolerance is one count times the filter's largest gain."""
    amplitude, periods = 0.4, 30
    omega = 2 * np.pi * hertz
    bench = Bench(model)
    seen = bench.run(lambda t: amplitude * np.sin(omega * t), periods)
    times = CASSIE.physics_timestep * np.arange(periods * CASSIE.substeps)
    packet_times = (
        CASSIE.packet_period * (np.arange(periods * CASSIE.sensor_window) + 1)
        - CASSIE.physics_timestep
    )
    cases = [
        (MOTOR_FILTER, times, seen["motor_velocity"], MOTOR_STEPS * abs(MOTOR_VELOCITY_TAPS).sum()),
        (JOINT_VELOCITY_FILTER, packet_times, seen["sent_joint_velocity"], JOINT_STEPS * 500),
    ]
    for coefficients, when, record, noise in cases:
        response = _response(coefficients, hertz) * amplitude * omega
        expected = (response * np.exp(1j * omega * when)).real
        late = when > 0.3
        worst = np.abs(record[late] - expected[late, None]).max(0)
        assert (worst < noise / (np.pi if coefficients is MOTOR_FILTER else 1.0)).all(), worst


def test_step_response_equals_the_difference_equations(model: mujoco.MjModel) -> None:
    """Responses are exact; packets have every sixth velocity of the motors."""
    bench = Bench(model)
    bench.qpos[0, bench.indices.motor_qpos] = bench.qpos[0, bench.indices.joint_qpos] = -0.2
    bench.reset()
    seen = bench.run(lambda t: -0.2 if t < 0.0101 else 0.1, 3)
    sent = slice(CASSIE.packet_substeps - 1, None, CASSIE.packet_substeps)

    padding = len(MOTOR_VELOCITY_TAPS)
    angle = np.repeat([-0.2, 0.1], [padding + 21, 3 * CASSIE.substeps - 21])[:, None]
    for bits, gear, coefficients, found in (
        ([13, 13, 13, 13, 18] * 2, CASSIE.gear, MOTOR_FILTER, seen["motor_velocity"]),
        ([18, 18, 13] * 2, 1.0, JOINT_VELOCITY_FILTER, seen["sent_joint_velocity"]),
    ):
        step = 2 * np.pi / 2.0 ** np.array(bits) / gear
        counted = np.trunc(angle / step) * step
        # a constant gives no velocity: the filters are settled where the difference is zero
        response = lfilter(*coefficients, counted - counted[0], axis=0)[padding:]
        response = response if coefficients is MOTOR_FILTER else response[sent]
        np.testing.assert_allclose(found, response, atol=1e-8)
    np.testing.assert_array_equal(seen["sent_motor_velocity"], seen["motor_velocity"][sent])


# ------------------------------------------------------------------------ resets


def test_filters_are_settled_after_a_reset_in_motion(model: mujoco.MjModel) -> None:
    """There is no transient, as if the joints had always moved at this velocity."""
    bench = Bench(model)
    bench.run(lambda t: 1.0 - 40.0 * t, 1)  # something to forget
    speed = 3.0
    bench.qpos[0, bench.indices.motor_qpos] = bench.qpos[0, bench.indices.joint_qpos] = 0.7
    bench.qvel[0, bench.indices.motor_qvel] = bench.qvel[0, bench.indices.joint_qvel] = speed
    bench.reset()
    first = {name: window[0].copy() for name, window in bench.sensors.packets().items()}
    for window in first.values():
        np.testing.assert_array_equal(window, np.broadcast_to(window[0], window.shape))
    before = 0.7 - CASSIE.physics_timestep * speed
    np.testing.assert_allclose(first["motor_position"][0], before, atol=5e-5)
    np.testing.assert_allclose(first["joint_position"][0], before, atol=8e-4)
    seen = bench.run(lambda t: 0.7 + speed * t, 1)
    velocity = np.vstack([first["motor_velocity"][:1], seen["motor_velocity"]])
    np.testing.assert_allclose(velocity, speed, atol=MOTOR_STEPS.max() * 2500)
    joint = np.vstack([first["joint_velocity"][:1], seen["sent_joint_velocity"]])
    np.testing.assert_allclose(joint[:, [0, 1, 3, 4]], 1.0019 * speed, atol=0.02)


@pytest.mark.parametrize("angle", [-0.3501, 0.7003, 1.2345])
def test_velocities_are_zero_after_a_reset_at_rest(model: mujoco.MjModel, angle: float) -> None:
    """The truncation of an angle causes no velocity."""
    bench = Bench(model)
    bench.run(lambda t: 1.0 - 40.0 * t, 1)  # something to forget
    bench.qpos[0, bench.indices.motor_qpos] = bench.qpos[0, bench.indices.joint_qpos] = angle
    bench.reset()
    seen = bench.run(lambda t: angle, 1)
    np.testing.assert_array_equal(seen["motor_velocity"], 0.0)
    np.testing.assert_allclose(seen["sent_joint_velocity"], 0.0, atol=1e-10)


# --------------------------------------------------------------------------- IMU


@pytest.fixture(scope="module")
def with_accelerometer() -> mujoco.MjModel:
    """Model with MuJoCo's accelerometer at the IMU."""
    spec = mujoco.MjSpec.from_file(str(asset_path("cassie.xml")))
    sensor = spec.add_sensor()
    sensor.name, sensor.type = "accelerometer", mujoco.mjtSensor.mjSENS_ACCELEROMETER
    sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, "imu"
    return spec.compile()


def test_imu_equals_mujocos_sensors(with_accelerometer: mujoco.MjModel) -> None:
    """All packets of a motion with random targets."""
    model = with_accelerometer
    simulations = Simulations(2, model=model, num_threads=1)
    states: list[dict[str, np.ndarray]] = []
    names = ("orientation", "gyro", "accelerometer")
    places = {
        name: model.sensor(name).adr[0] + np.arange(model.sensor(name).dim[0]) for name in names
    }
    original = simulations._step

    def step(failed: np.ndarray, stage: int) -> None:
        original(failed, 0)  # all sensors stay those of the state before the step
        data = simulations.snapshot().sensordata
        states.append({name: data[:, place].copy() for name, place in places.items()})

    simulations._step = step
    rng = np.random.default_rng(0)
    standing = simulations.qpos[:, simulations.indices.motor_qpos].copy()
    for _ in range(5):
        states.clear()
        simulations.advance(standing + rng.normal(0, 0.3, (2, 10)))
        packets = simulations.sensors.packets()
        seen = {name: np.stack([state[name] for state in states], axis=1) for name in names}
        sent = slice(CASSIE.packet_substeps - 1, None, CASSIE.packet_substeps)
        np.testing.assert_allclose(packets["gyro"], seen["gyro"][:, sent], atol=1e-12)
        turn = seen["orientation"][:, sent]
        turn = turn * np.where(turn[..., :1] < 0, -1, 1)
        np.testing.assert_allclose(packets["orientation"], turn, atol=1e-12)
        mean = (
            seen["accelerometer"]
            .reshape(2, CASSIE.sensor_window, CASSIE.packet_substeps, 3)
            .mean(2)
        )
        np.testing.assert_allclose(packets["accelerometer"], mean, atol=1e-10)
    assert np.abs(mean).max() > 10


def test_first_packets_have_the_force_at_the_reset(
    with_accelerometer: mujoco.MjModel,
) -> None:
    """The pelvis is tilted and has an angular velocity."""
    simulations = Simulations(2, model=with_accelerometer, num_threads=1)
    rng = np.random.default_rng(1)
    qpos = np.stack([with_accelerometer.key("standing").qpos] * 2)
    qpos[:, 3:7] += rng.normal(0, 0.1, (2, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    simulations.reset(np.arange(2), qpos, rng.uniform(-1, 1, (2, 32)))
    address = with_accelerometer.sensor("accelerometer").adr[0]
    expected = simulations.snapshot().sensordata[:, None, address : address + 3]
    assert np.abs(expected).max() > 1
    sent = simulations.sensors.packets()["accelerometer"]
    np.testing.assert_allclose(sent, np.repeat(expected, CASSIE.sensor_window, axis=1), atol=1e-9)


def test_reset_clears_the_packets() -> None:
    used, fresh = SimulationPool(2), SimulationPool(2)
    rng, standing = np.random.default_rng(8), CASSIE.standing[CASSIE.indices.motor_qpos]
    for _ in range(3):
        used.advance(standing + rng.normal(0, 0.3, (2, 10)))
    used.reset(np.arange(2))
    for _ in range(2):
        for name, window in used.packets().items():
            np.testing.assert_array_equal(window, fresh.packets()[name], err_msg=name)
        targets = standing + rng.normal(0, 0.3, (2, 10))
        used.advance(targets)
        fresh.advance(targets)

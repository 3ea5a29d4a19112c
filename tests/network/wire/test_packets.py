"""Packets byte by byte, against the tables of the protocol and Python's `struct`."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from aslip.errors import ShapeError
from aslip.network.wire import CASSIE_OUT, PACKETS, PD_IN, STATE_OUT, USER_IN, Packet
from tests.network.wire.packets import FORMATS, random_bytes

every_packet = pytest.mark.parametrize("packet", PACKETS, ids=lambda packet: packet.name)

# first byte of each field in the protocol's tables
OFFSETS = {
    PD_IN: {
        "left_leg.task_pd.torque": 0, "left_leg.motor_pd.torque": 120,
        "left_leg.motor_pd.p_target": 140, "left_leg.motor_pd.d_target": 160,
        "left_leg.motor_pd.p_gain": 180, "left_leg.motor_pd.d_gain": 200,
        "right_leg.task_pd.torque": 220, "right_leg.motor_pd.d_gain": 420, "telemetry": 440,
    },
    USER_IN: {"torque": 0, "telemetry": 40},
    STATE_OUT: {
        "pelvis.position": 0, "pelvis.orientation": 12, "pelvis.rotational_velocity": 28,
        "pelvis.translational_velocity": 40, "pelvis.translational_acceleration": 52,
        "pelvis.external_moment": 64, "pelvis.external_force": 76, "left_foot.position": 88,
        "left_foot.orientation": 100, "left_foot.rotational_velocity": 116,
        "left_foot.translational_velocity": 128, "left_foot.toe_force": 140,
        "left_foot.heel_force": 152, "right_foot.position": 164, "right_foot.heel_force": 228,
        "terrain.height": 240, "terrain.slope": 244, "motor.position": 252,
        "motor.velocity": 292, "motor.torque": 332, "joint.position": 372, "joint.velocity": 396,
        "radio.channel": 420, "radio.signal_good": 484, "battery.state_of_charge": 485,
        "battery.current": 489,
    },
    CASSIE_OUT: {
        "pelvis.target_pc.ethercat_status": 0, "pelvis.target_pc.ethercat_notifications": 24,
        "pelvis.target_pc.task_execution_time": 108, "pelvis.target_pc.overload_counter": 112,
        "pelvis.target_pc.cpu_temperature": 116, "pelvis.battery.data_good": 120,
        "pelvis.battery.state_of_charge": 121, "pelvis.battery.voltage": 125,
        "pelvis.battery.current": 173, "pelvis.battery.temperature": 177,
        "pelvis.radio.receiver_signal_good": 193, "pelvis.radio.medulla_signal_good": 194,
        "pelvis.radio.channel": 195, "pelvis.vector_nav.data_good": 259,
        "pelvis.vector_nav.status": 260, "pelvis.vector_nav.pressure": 262,
        "pelvis.vector_nav.temperature": 266, "pelvis.vector_nav.magnetic_field": 270,
        "pelvis.vector_nav.angular_velocity": 282, "pelvis.vector_nav.linear_acceleration": 294,
        "pelvis.vector_nav.orientation": 306, "pelvis.medulla_counter": 322,
        "pelvis.medulla_cpu_load": 323, "pelvis.bleeder_state": 325,
        "pelvis.vtm_temperature": 328, "left_leg.drives[0].status_word": 332,
        "left_leg.drives[0].position": 334, "left_leg.drives[1].status_word": 362,
        "left_leg.joints[0].position": 482, "left_leg.joints[2].velocity": 502,
        "left_leg.medulla_counter": 506, "left_leg.medulla_cpu_load": 507,
        "left_leg.reed_switch_state": 509, "right_leg.drives[0].status_word": 510,
        "is_calibrated": 688, "messages": 689,
    },
}  # fmt: skip


@pytest.mark.parametrize(
    ("packet", "size"), [(PD_IN, 476), (USER_IN, 58), (STATE_OUT, 493), (CASSIE_OUT, 697)]
)
def test_payloads_have_the_sizes_of_the_protocol(packet: Packet, size: int) -> None:
    assert packet.size == size == struct.calcsize(FORMATS[packet.name])


@every_packet
def test_fields_begin_where_the_protocol_says(packet: Packet) -> None:
    offsets = {place.path: place.offset for place in packet.places}
    assert OFFSETS[packet].items() <= offsets.items()


@every_packet
def test_fields_fill_the_payload_and_have_a_meaning(packet: Packet) -> None:
    end = 0
    for place in packet.places:
        assert place.offset == end
        assert place.meaning, place.path
        end += np.dtype(place.kind).itemsize * place.count
    assert end == packet.size


@every_packet
def test_every_number_has_the_value_that_struct_reads(packet: Packet) -> None:
    raw = random_bytes(packet, 50, np.random.default_rng(1))
    for payload, record in zip(raw, packet.decode(raw), strict=True):
        ours = _numbers(record)
        expected = struct.unpack(FORMATS[packet.name], payload.tobytes())
        np.testing.assert_array_equal(ours, np.array(expected))


@every_packet
def test_random_packets_return_to_the_same_bytes(packet: Packet) -> None:
    raw = random_bytes(packet, 3000, np.random.default_rng(2))
    assert packet.pack(packet.decode(raw)) == raw.tobytes()
    assert packet.pack(packet.unpack(raw[0].tobytes())) == raw[0].tobytes()


@every_packet
def test_random_bytes_make_packets_with_flags_of_zero_or_one(packet: Packet) -> None:
    raw = np.random.default_rng(3).integers(256, size=(3000, packet.size), dtype=np.uint8)
    packed = np.frombuffer(packet.pack(packet.decode(raw)), np.uint8).reshape(raw.shape)
    flags = [place.offset for place in packet.places if place.kind == "?"]
    np.testing.assert_array_equal(packed[:, flags], raw[:, flags] != 0)
    rest = np.setdiff1d(np.arange(packet.size), flags)
    np.testing.assert_array_equal(packed[:, rest], raw[:, rest])


def test_a_number_is_at_the_bytes_of_the_tables() -> None:
    """The right knee's position gain is the number 48 + 7 x 4 of `pd_in_t`, bytes 412 to 415."""
    record = PD_IN.zeros()
    record["right_leg"]["motor_pd"]["p_gain"][3] = 96.0
    payload = bytearray(476)
    payload[412:416] = struct.pack("<f", 96.0)
    assert PD_IN.pack(record) == bytes(payload)


def test_a_drive_is_at_the_bytes_of_the_tables() -> None:
    """The right foot's drive begins at 510 + 4 x 30; its velocity is six bytes behind."""
    record = CASSIE_OUT.zeros()
    record["right_leg"]["drives"]["velocity"][4] = -1.5
    payload = bytearray(697)
    payload[636:640] = struct.pack("<f", -1.5)
    assert CASSIE_OUT.pack(record) == bytes(payload)


@every_packet
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_number_anywhere_is_found(packet: Packet, bad: float) -> None:
    raw = np.zeros((1, packet.size), np.uint8)
    assert packet.is_finite(packet.decode(raw)).all()
    places = [place for place in packet.places if place.kind == "<f4"]
    raw = np.repeat(raw, len(places), axis=0)
    for row, place in zip(raw, places, strict=True):
        last = place.offset + 4 * (place.count - 1)
        row[last : last + 4] = np.frombuffer(struct.pack("<f", bad), np.uint8)
    assert not packet.is_finite(packet.decode(raw)).any()


@every_packet
@pytest.mark.parametrize("change", [-1, 1])
def test_payloads_of_another_size_are_refused(packet: Packet, change: int) -> None:
    with pytest.raises(ShapeError, match=f"{packet.size} bytes, got {packet.size + change}"):
        packet.unpack(bytes(packet.size + change))


def test_records_and_arrays_of_another_kind_are_refused() -> None:
    with pytest.raises(ShapeError, match="a record of pd_in_t"):
        PD_IN.pack(STATE_OUT.zeros())
    with pytest.raises(ShapeError, match="float64"):
        PD_IN.decode(np.zeros((2, PD_IN.size)))


def test_a_record_has_its_own_memory() -> None:
    payload = bytes(PD_IN.size)
    record = PD_IN.unpack(payload)
    record["telemetry"][:] = 1.0
    assert PD_IN.unpack(payload)["telemetry"][0] == 0.0


def _numbers(record: np.ndarray) -> list[float]:
    """All numbers of a record in the order of their bytes."""
    if record.dtype.names is None:
        return np.ravel(record).tolist()
    names = record.dtype.names
    if record.shape:
        return [number for row in record for number in _numbers(row)]
    return [number for name in names for number in _numbers(record[name])]

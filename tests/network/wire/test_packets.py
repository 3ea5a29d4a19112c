"""Packets byte by byte, against the tables of the protocol and Python's `struct`."""

import struct

import numpy as np
import pytest

from aslip.errors import ShapeError
from aslip.network.wire import CASSIE_OUT, PD_IN, STATE_OUT, USER_IN, Packet

_LEG = "H7f" * 5 + "6fBH?"
# payloads of the public C code in `struct`'s notation
FORMATS = {
    PD_IN: "<119f",
    USER_IN: "<10f9h",
    STATE_OUT: "<121f?2f",
    CASSIE_OUT: f"<6i21ifIf?f12ff4f??16f?Hff3f3f3f4fBH???f{_LEG}{_LEG}?4h",
}

every_packet = pytest.mark.parametrize("packet", FORMATS, ids=lambda packet: packet.name)

# first byte of fields in the protocol's tables
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
        "left_foot.position": 88, "left_foot.orientation": 100, "right_foot.position": 164,
        "right_foot.heel_force": 228, "terrain.height": 240, "motor.position": 252,
        "motor.velocity": 292, "motor.torque": 332, "joint.position": 372, "joint.velocity": 396,
        "radio.channel": 420, "radio.signal_good": 484, "battery.current": 489,
    },
    CASSIE_OUT: {
        "pelvis.target_pc.ethercat_status": 0, "pelvis.battery.data_good": 120,
        "pelvis.radio.receiver_signal_good": 193, "pelvis.radio.channel": 195,
        "pelvis.vector_nav.data_good": 259, "pelvis.vector_nav.angular_velocity": 282,
        "pelvis.vector_nav.linear_acceleration": 294, "pelvis.vector_nav.orientation": 306,
        "pelvis.vtm_temperature": 328, "left_leg.drives[0].position": 334,
        "left_leg.drives[1].status_word": 362, "left_leg.joints[0].position": 482,
        "left_leg.reed_switch_state": 509, "right_leg.drives[0].status_word": 510,
        "right_leg.drives[4].velocity": 636, "is_calibrated": 688, "messages": 689,
    },
}  # fmt: skip


def _random(packet: Packet, num: int, seed: int) -> np.ndarray:
    """Random payloads (num, size): any bits, NaN and infinities among them."""
    return np.random.default_rng(seed).integers(256, size=(num, packet.size), dtype=np.uint8)


@every_packet
def test_fields_fill_the_payload_where_the_protocol_says(packet: Packet) -> None:
    assert packet.size == struct.calcsize(FORMATS[packet])
    end = 0
    for place in packet.places:
        assert place.offset == end
        assert place.meaning, place.path
        end += np.dtype(place.kind).itemsize * place.count
    assert end == packet.size
    assert OFFSETS[packet].items() <= {p.path: p.offset for p in packet.places}.items()


@every_packet
def test_every_number_has_the_value_that_struct_reads(packet: Packet) -> None:
    for row in _random(packet, 50, seed=1):
        record = packet.unpack(row.tobytes())
        expected = struct.unpack(FORMATS[packet], row.tobytes())
        np.testing.assert_array_equal(_numbers(record), np.array(expected))


@every_packet
def test_random_bytes_return_with_flags_of_zero_or_one(packet: Packet) -> None:
    flags = [place.offset for place in packet.places if place.kind == "?"]
    for row in _random(packet, 300, seed=3):
        packed = np.frombuffer(packet.pack(packet.unpack(row.tobytes())), np.uint8)
        row[flags] = row[flags] != 0
        np.testing.assert_array_equal(packed, row)


@every_packet
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_number_anywhere_is_found(packet: Packet, bad: float) -> None:
    assert packet.is_finite(packet.zeros())
    for place in packet.places:
        if place.kind == "<f4":
            payload = bytearray(packet.size)
            last = place.offset + 4 * (place.count - 1)
            payload[last : last + 4] = struct.pack("<f", bad)
            assert not packet.is_finite(packet.unpack(payload)), place.path


@every_packet
@pytest.mark.parametrize("change", [-1, 1])
def test_payloads_of_another_size_are_refused(packet: Packet, change: int) -> None:
    with pytest.raises(ShapeError, match=f"{packet.size} bytes, got {packet.size + change}"):
        packet.unpack(bytes(packet.size + change))


def test_records_of_another_kind_are_refused() -> None:
    with pytest.raises(ShapeError, match="a record of pd_in_t"):
        PD_IN.pack(STATE_OUT.zeros())


def test_a_record_has_its_own_memory() -> None:
    payload = bytes(PD_IN.size)
    record = PD_IN.unpack(payload)
    record["telemetry"][:] = 1.0
    assert PD_IN.unpack(payload)["telemetry"][0] == 0.0


def _numbers(record: np.ndarray) -> list[float]:
    """All numbers of a record in the order of their bytes."""
    if record.dtype.names is None:
        return np.ravel(record).tolist()
    if record.shape:
        return [number for row in record for number in _numbers(row)]
    return [number for name in record.dtype.names for number in _numbers(record[name])]

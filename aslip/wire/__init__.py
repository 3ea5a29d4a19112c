"""Cassie's network protocol without a simulator: packets, datagrams, conversions, UDP sockets."""

from aslip.wire.convert import (
    ESTIMATE_ENTRIES,
    STOP_CHANNEL,
    MotorCommand,
    cassie_out_to_sensors,
    command_to_pd_in,
    estimate_to_state_out,
    pd_in_to_command,
    sensors_to_cassie_out,
    state_out_to_estimate,
    torque_to_user_in,
    user_in_to_torque,
)
from aslip.wire.endpoint import CLIENT, LOOPBACK, SIMULATOR, Address, Arrival, Endpoint
from aslip.wire.layout import Packet
from aslip.wire.link import Counters, Header, Link
from aslip.wire.packets import CASSIE_OUT, PACKETS, PD_IN, STATE_OUT, USER_IN

__all__ = [
    "CASSIE_OUT",
    "CLIENT",
    "ESTIMATE_ENTRIES",
    "LOOPBACK",
    "PACKETS",
    "PD_IN",
    "SIMULATOR",
    "STATE_OUT",
    "STOP_CHANNEL",
    "USER_IN",
    "Address",
    "Arrival",
    "Counters",
    "Endpoint",
    "Header",
    "Link",
    "MotorCommand",
    "Packet",
    "cassie_out_to_sensors",
    "command_to_pd_in",
    "estimate_to_state_out",
    "pd_in_to_command",
    "sensors_to_cassie_out",
    "state_out_to_estimate",
    "torque_to_user_in",
    "user_in_to_torque",
]

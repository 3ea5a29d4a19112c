"""Packets of Cassie's network protocol, by the names of its public C headers.

Left before right. Motors of a leg are hip roll, hip yaw, hip pitch, knee and foot; joints with an
encoder of their own are shin, tarsus and foot. Quaternions are wxyz. Numbers that are doubles in C
are sent in single precision. The headers give no units and frames. Those of `state_out_t` were
measured in the public simulator; temperatures, pressure and magnetic field are in the units of
their devices.

| mode | to the robot | from the robot |
|---|---|---|
| PD | `PD_IN` | `STATE_OUT` |
| torque | `USER_IN` | `CASSIE_OUT` |
"""

from __future__ import annotations

from typing import Final

from aslip.network.wire.layout import FLAG, FLOAT, Field, Packet

_INT, _UINT = "<i4", "<u4"
_SHORT, _USHORT, _BYTE = "<i2", "<u2", "u1"


def _pd_part(name: str, count: int, what: str, force: str, length: str) -> Field:
    """Five vectors of a PD law in task or motor space."""
    gain = f"{force}/({length})" if "," in length else f"{force}/{length}"
    return Field(
        name,
        (
            Field("torque", FLOAT, count, f"feedforward of {what} [{force}]"),
            Field("p_target", FLOAT, count, f"target position of {what} [{length}]"),
            Field("d_target", FLOAT, count, f"target velocity of {what} [{length} per s]"),
            Field("p_gain", FLOAT, count, f"position gains of {what} [{gain}]"),
            Field("d_gain", FLOAT, count, f"velocity gains of {what} [{gain} s]"),
        ),
    )


_PD_LEG = (
    _pd_part("task_pd", 6, "the foot in task space", "N, N m", "m, rad"),
    _pd_part("motor_pd", 5, "the leg's motors, at the joints", "N m", "rad"),
)

PD_IN: Final = Packet(
    "pd_in_t",
    (
        Field("left_leg", _PD_LEG),
        Field("right_leg", _PD_LEG),
        Field("telemetry", FLOAT, 9, "numbers for the operator"),
    ),
)
"""Targets and gains of PD loops that run on the robot, 476 bytes."""

USER_IN: Final = Packet(
    "cassie_user_in_t",
    (
        Field("torque", FLOAT, 10, "torques at the joints, left leg's motors, then right [N m]"),
        Field("telemetry", _SHORT, 9, "numbers for the operator"),
    ),
)
"""Torques of a controller that closes its own loops, 58 bytes."""

_PELVIS = (
    Field("position", FLOAT, 3, "position of the pelvis [m, world]"),
    Field("orientation", FLOAT, 4, "pelvis to world, wxyz"),
    Field("rotational_velocity", FLOAT, 3, "angular velocity [rad/s, pelvis]"),
    Field("translational_velocity", FLOAT, 3, "velocity [m/s, world]"),
    Field("translational_acceleration", FLOAT, 3, "acceleration, no gravity [m/s^2, pelvis]"),
    Field("external_moment", FLOAT, 3, "moment from outside [N m]"),
    Field("external_force", FLOAT, 3, "force from outside [N]"),
)
_FOOT = (
    Field("position", FLOAT, 3, "foot relative to the pelvis [m, pelvis]"),
    Field("orientation", FLOAT, 4, "orientation of the foot, wxyz"),
    Field("rotational_velocity", FLOAT, 3, "angular velocity [rad/s]"),
    Field("translational_velocity", FLOAT, 3, "velocity [m/s]"),
    Field("toe_force", FLOAT, 3, "force at the toes, z negative under load [N]"),
    Field("heel_force", FLOAT, 3, "force at the heel, z negative under load [N]"),
)

STATE_OUT: Final = Packet(
    "state_out_t",
    (
        Field("pelvis", _PELVIS),
        Field("left_foot", _FOOT),
        Field("right_foot", _FOOT),
        Field(
            "terrain",
            (
                Field("height", FLOAT, 1, "height of the ground [m, world]"),
                Field("slope", FLOAT, 2, "slope of the ground"),
            ),
        ),
        Field(
            "motor",
            (
                Field("position", FLOAT, 10, "angles of the driven joints [rad]"),
                Field("velocity", FLOAT, 10, "velocities of the driven joints [rad/s]"),
                Field("torque", FLOAT, 10, "torques at the driven joints [N m]"),
            ),
        ),
        Field(
            "joint",
            (
                Field("position", FLOAT, 6, "angles of the joints with encoders [rad]"),
                Field("velocity", FLOAT, 6, "velocities of the joints with encoders [rad/s]"),
            ),
        ),
        Field(
            "radio",
            (
                Field("channel", FLOAT, 16, "operator's channels, -1 to 1; 8 below 0 stops"),
                Field("signal_good", FLAG, 1, "radio is received"),
            ),
        ),
        Field(
            "battery",
            (
                Field("state_of_charge", FLOAT, 1, "charge, 0 to 1"),
                Field("current", FLOAT, 1, "current [A]"),
            ),
        ),
    ),
)
"""State that the robot's own estimator sends, 493 bytes."""

_DRIVE = (
    Field("status_word", _USHORT, 1, "status of the motor's amplifier"),
    Field("position", FLOAT, 1, "angle of the joint [rad]"),
    Field("velocity", FLOAT, 1, "velocity of the joint [rad/s]"),
    Field("torque", FLOAT, 1, "torque at the joint [N m]"),
    Field("drive_temperature", FLOAT, 1, "temperature of the amplifier"),
    Field("dc_link_voltage", FLOAT, 1, "supply [V]"),
    Field("torque_limit", FLOAT, 1, "largest torque at the joint [N m]"),
    Field("gear_ratio", FLOAT, 1, "turns of the motor per turn of the joint"),
)
_JOINT = (
    Field("position", FLOAT, 1, "angle [rad]"),
    Field("velocity", FLOAT, 1, "velocity [rad/s]"),
)
_LEG = (
    Field("drives", _DRIVE, 5),
    Field("joints", _JOINT, 3),
    Field("medulla_counter", _BYTE, 1, "counter of the leg's electronics"),
    Field("medulla_cpu_load", _USHORT, 1, "load of the leg's electronics"),
    Field("reed_switch_state", FLAG, 1, "switch of the leg"),
)
_TARGET_PC = (
    Field("ethercat_status", _INT, 6, "status of the bus"),
    Field("ethercat_notifications", _INT, 21, "messages of the bus"),
    Field("task_execution_time", FLOAT, 1, "duration of the control task"),
    Field("overload_counter", _UINT, 1, "late control tasks"),
    Field("cpu_temperature", FLOAT, 1, "temperature of the processor"),
)
_BATTERY = (
    Field("data_good", FLAG, 1, "battery's readings are valid"),
    Field("state_of_charge", FLOAT, 1, "charge, 0 to 1"),
    Field("voltage", FLOAT, 12, "cells [V]"),
    Field("current", FLOAT, 1, "current [A]"),
    Field("temperature", FLOAT, 4, "temperatures"),
)
_RADIO = (
    Field("receiver_signal_good", FLAG, 1, "receiver hears the operator's radio"),
    Field("medulla_signal_good", FLAG, 1, "robot hears the receiver"),
    Field("channel", FLOAT, 16, "operator's channels, -1 to 1; 8 below 0 stops"),
)
_VECTOR_NAV = (
    Field("data_good", FLAG, 1, "IMU's readings are valid"),
    Field("status", _USHORT, 1, "status of the IMU"),
    Field("pressure", FLOAT, 1, "air pressure"),
    Field("temperature", FLOAT, 1, "temperature of the IMU"),
    Field("magnetic_field", FLOAT, 3, "magnetic field [pelvis]"),
    Field("angular_velocity", FLOAT, 3, "angular velocity [rad/s, pelvis]"),
    Field("linear_acceleration", FLOAT, 3, "specific force at the IMU [m/s^2, pelvis]"),
    Field("orientation", FLOAT, 4, "pelvis to world, wxyz"),
)

CASSIE_OUT: Final = Packet(
    "cassie_out_t",
    (
        Field(
            "pelvis",
            (
                Field("target_pc", _TARGET_PC),
                Field("battery", _BATTERY),
                Field("radio", _RADIO),
                Field("vector_nav", _VECTOR_NAV),
                Field("medulla_counter", _BYTE, 1, "counter of the pelvis' electronics"),
                Field("medulla_cpu_load", _USHORT, 1, "load of the pelvis' electronics"),
                Field("bleeder_state", FLAG, 1, "brake resistor is on"),
                Field("left_reed_switch_state", FLAG, 1, "left switch of the pelvis"),
                Field("right_reed_switch_state", FLAG, 1, "right switch of the pelvis"),
                Field("vtm_temperature", FLOAT, 1, "temperature of the power module"),
            ),
        ),
        Field("left_leg", _LEG),
        Field("right_leg", _LEG),
        Field("is_calibrated", FLAG, 1, "encoders are calibrated"),
        Field("messages", _SHORT, 4, "diagnostic codes"),
    ),
)
"""Readings of all sensors, 697 bytes."""

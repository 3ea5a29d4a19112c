"""Log of a run over the network, and its replay through supervisor and controller.

| topic | content |
|---|---|
| `/received` | packets as they arrived, and the step of their sequence number |
| `/tick` | a policy step: request of the operator, stage, command of the motors, lateness |
| `/stones` | new stones of a policy step, as JSON of (m, e, 3) corners |
| `/estimate` | estimate on which the policy step acts |
| `/log` | beginnings of stages with their reasons |

Times begin with the run. A packet belongs to the first policy step that begins at its time or
later.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from aslip.control.base import ControllerBase
from aslip.errors import AslipError, FileDamagedError, machine_failed
from aslip.log import messages, read
from aslip.log.messages import MessageType
from aslip.log.template import FlatTopic
from aslip.log.writer import LogWriter
from aslip.network.runner.readings import Readings, SensorReadings, StateReadings
from aslip.network.runner.supervisor import (
    Limits,
    Reading,
    Request,
    Stage,
    Supervisor,
)
from aslip.network.wire import ESTIMATE_ENTRIES, MotorCommand, Packet

RAW: Final = "raw"
"""Metadata entry: "True" for logs of raw mode."""
POLICY: Final = "policy"
"""Metadata entry: name or path of the policy."""
FILES: Final = "files"
"""Metadata entry: names of the attached files that load the policy, joined by spaces."""

# names of the files of a controller
_LOADED = (["policy.onnx"], ["policy.zip", "library.npz"])
_STAGES = tuple(Stage)
_REQUEST = ("forward", "sideways", "yaw_rate", "walk", "stop", "damp", "stand")
_TIMING = ("lateness", "reply")
# little-endian CDR, then the numbers
_CDR = b"\x00\x01\x00\x00"
_SECOND = 10**9


def _command_names() -> list[str]:
    """Names of the numbers of a motor command."""
    return [name for part in MotorCommand._fields for name in messages.component_names(part, 10)]


class RunLog:
    """Writer of a run's log.

    Args:
        path: log to write.
        packet: kind of packets from the robot.
        files: files that load the policy, by name.
        metadata: further metadata of the run.

    Raises:
        ConfigurationError: a log of that name exists, or it cannot be written.
    """

    def __init__(
        self, path: Path, packet: Packet, files: Mapping[str, bytes], metadata: Mapping[str, str]
    ) -> None:
        self._writer = LogWriter(path)
        metadata = {FILES: " ".join(files), **metadata}
        self._writer.attach(files, metadata, ("numpy", "torch", "onnxruntime"))
        kind = MessageType("aslip_msgs/msg/Packet", f"int32 step\nuint8[{packet.size}] packet")
        self._received = self._writer.open_channel("/received", kind)
        self._notes = self._writer.open_channel("/log", messages.LOG)
        names = [*_REQUEST, "stage", *_command_names(), *_TIMING]
        self._tick = FlatTopic(self._writer, "/tick", names)
        self._stones = self._writer.open_channel("/stones", messages.STRING)
        self._estimate: FlatTopic | None = None
        self._flushed = 0

    def packet(self, time_ns: int, step: int, record: np.ndarray) -> None:
        """Write a packet, with the step of its sequence number, at its arrival [ns]."""
        data = _CDR + struct.pack("<i", step) + record.tobytes()
        self._writer.write(self._received, time_ns, data)

    def tick(
        self,
        time_ns: int,
        request: Request,
        stage: Stage,
        command: MotorCommand,
        reading: Reading | None,
        timing: Sequence[float],
    ) -> None:
        """Write a policy step.

        Args:
            time_ns: beginning of the policy step [ns].
            request: request of the operator.
            stage: stage after the policy step.
            command: command of the motors.
            reading: last reading.
            timing: lateness of the beginning, and time until the command was sent [s].
        """
        asked = [*map(float, request[:5]), float(bool(request.damp)), float(request.stand)]
        values = np.concatenate([asked, [_STAGES.index(stage)], *command, timing])
        self._tick.write(time_ns, values)
        if request.stones is not None:
            message = messages.STRING.encode({"data": json.dumps(request.stones.tolist())})
            self._writer.write(self._stones, time_ns, message)
        if reading is not None:
            self._write_estimate(time_ns, reading)
        if time_ns - self._flushed >= _SECOND:
            self._flushed = time_ns
            self._writer.flush()

    def note(self, time_ns: int, text: str) -> None:
        """Add a line to `/log` at a time [ns]."""
        message = messages.LOG.encode(messages.note(time_ns, text))
        self._writer.write(self._notes, time_ns, message)

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Finish the file with further metadata."""
        self._writer.finish(metadata)

    def _write_estimate(self, time_ns: int, reading: Reading) -> None:
        values = [reading.estimate[name] for name in ESTIMATE_ENTRIES]
        if self._estimate is None:
            names = [
                part
                for name, value in zip(ESTIMATE_ENTRIES, values, strict=True)
                for part in messages.component_names(name, value.size)
            ]
            self._estimate = FlatTopic(self._writer, "/estimate", names)
        self._estimate.write(time_ns, np.concatenate(values))


def run_metadata(policy: str, readings: Readings, limits: Limits) -> dict[str, str]:
    """Metadata that a replay needs."""
    raw = isinstance(readings, SensorReadings)
    return {
        POLICY: policy,
        RAW: str(raw),
        **{f"limits/{name}": repr(value) for name, value in asdict(limits).items()},
    }


class Replayed(NamedTuple):
    """Comparison of a replay with its log."""

    ticks: int
    """Number of policy steps."""
    walked: int
    """Number of policy steps with targets of the policy."""
    different: int
    """Number of policy steps whose stage, or any bit of the command, differs."""
    first: float
    """Time of the first different policy step [s]; NaN if none differs."""


def replay(path: Path, make: Callable[[list[Path]], ControllerBase[Any]], files: Path) -> Replayed:
    """Repeat a run from the packets and requests of its log.

    Args:
        path: log.
        make: function of the files of the policy that makes a controller.
        files: folder to which the files of the policy are written.

    Raises:
        AssetError: there is no such log.
        FileDamagedError: the log is damaged, or not of a run over the network.
    """
    recording = read(path)
    data = recording.metadata
    if FILES not in data or "/tick" not in recording.series:
        raise FileDamagedError(
            f"{str(path)!r} is no log of a run over the network, which has the topic /tick;"
            " replay logs of simulations with python -m aslip.log replay"
        )
    given = {n.removeprefix("limits/"): v for n, v in data.items() if n.startswith("limits/")}
    names = data[FILES].split()
    try:
        limits = Limits(**{name: float(value) for name, value in given.items()})
        # other names might lead out of the folder
        if names not in _LOADED:
            raise ValueError(f"its files are {names}, not one of {_LOADED}")
        for name in names:
            (files / name).write_bytes(recording.attachment(name))
        supervisor = Supervisor(make([files / name for name in names]), limits)
        return _compare(recording.series, supervisor, data[RAW] == "True")
    except Exception as error:  # a log of a stranger may fail in many ways
        if isinstance(error, AslipError) or machine_failed(error):
            raise
        reason = f"{type(error).__name__}: {error}"
        raise FileDamagedError(f"{str(path)!r} cannot be replayed: {reason}") from error


def _compare(series: Mapping[str, Any], supervisor: Supervisor, raw: bool) -> Replayed:
    """Run a supervisor over the ticks of a log."""
    readings = SensorReadings() if raw else StateReadings()
    ticks, received = series["/tick"], series.get("/received")
    names, waiting = _command_names(), 0
    stones = series.get("/stones")
    seen = {} if stones is None else dict(zip(stones.time.tolist(), stones["data"], strict=True))
    arrivals = [] if received is None else received.time
    walked, different, first = 0, 0, float("nan")
    for k, now in enumerate(ticks.time.tolist()):
        while waiting < len(arrivals) and arrivals[waiting] <= now:
            assert received is not None
            # NumPy drops the zeros at the end of bytes
            payload = bytes(received["packet"][waiting]).ljust(readings.receives.size, b"\0")
            record = readings.receives.unpack(payload)
            readings.take(float(arrivals[waiting]), int(received["step"][waiting]), record)
            waiting += 1
        numbers = [float(ticks[n][k]) for n in _REQUEST]
        damp = "operator" if numbers[5] else ""
        forward, sideways, yaw_rate = numbers[:3]
        walk, stop = map(bool, numbers[3:5])
        stand, text = bool(numbers[6]), seen.get(now)
        corners = None if text is None else np.array(json.loads(str(text)))
        request = Request(forward, sideways, yaw_rate, walk, stop, damp, stand, corners)
        command = np.concatenate(supervisor.tick(now, readings.newest(), request))
        logged = np.array([ticks[name][k] for name in names])
        stage = _STAGES[int(ticks["stage"][k])]
        walked += stage in (Stage.WALK, Stage.STOP)
        if stage is not supervisor.stage or command.tobytes() != logged.tobytes():
            first = now if not different else first
            different += 1
    return Replayed(len(ticks), walked, different, first)

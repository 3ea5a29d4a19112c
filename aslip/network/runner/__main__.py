"""Walk a robot, or its twin, with a policy over the network.

    python -m aslip.network.twin --real-time                     # in another terminal
    python -m aslip.network.runner --command 0.5 --duration 10

Without --command, --schedule and --listen, keys in the terminal steer. Ctrl-C damps the motors and
ends the run. The exit status is 0 after a stop by the operator, 1 after any other damping.
"""

from __future__ import annotations

import contextlib
import ipaddress
import math
import signal
import socket
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line, say
from aslip.base.processes import endings
from aslip.errors import ConfigurationError, NetworkError, one_line_errors
from aslip.library import Schedule
from aslip.network.runner.commands import KEYS, Datagrams, Keyboard, Scheduled, Source
from aslip.network.runner.load import Loaded, load
from aslip.network.runner.loop import Run, run_lockstep, run_real_time, take_priority
from aslip.network.runner.readings import Readings, SensorReadings, StateReadings
from aslip.network.runner.supervisor import Limits, Supervisor
from aslip.network.wire import CLIENT, LOOPBACK, SIMULATOR, Address, Endpoint, Link
from aslip.network.wire.endpoint import check_port

if TYPE_CHECKING:
    from aslip.network.runner.record import RunLog

# duration of the ramps of a robot that hangs from a gantry [s]
_GANTRY_RAMP = 2.0


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the runner."""

    policy: str = "directions"
    """Name of a shipped policy, policy file, or folder of a training run."""
    library: str | None = None
    """Gait library of the policy: file, or name of a shipped one; by default that of its stack."""
    command: str | None = None
    """Command from the start of the walk on: forward speed [m/s]; or forward speed, sideways speed
    and yaw rate [rad/s], separated by spaces."""
    schedule: str | None = None
    """Commands over the time of the walk [s], such as "0:0.0,4:1.0,8:0.5" or "0:0.5,6:stand"."""
    listen: int | None = None
    """Port on loopback that receives commands of another program as JSON."""
    duration: float = math.inf
    """Time after which a walk with --command or --schedule stops [s]."""
    host: str = SIMULATOR.host
    """IPv4 address of the robot; by default that of a twin on this machine."""
    port: int = SIMULATOR.port
    """Port of the robot: 25000 for a twin, 25010 for a robot."""
    local_port: int = CLIENT.port
    """Port of this program: 25001 for a twin, 25011 for a robot, 0 for any."""
    raw: bool = False
    """Use raw mode: the robot sends sensor readings, not estimates, and takes torques, not motor
    targets."""
    lockstep: bool = False
    """Advance a twin in lockstep, one command per tick, instead of real time."""
    ramp: float | None = None
    """Duration of the rise of the gains, and then of the motion of the joints to the first pose
    [s]; by default 0 for a twin, which stands on its feet, and 2 for a robot, which hangs from a
    gantry."""
    priority: int = 0
    """Real-time priority of this process, 1 to 99, where Linux permits it; 0 for none."""
    tilt: float = Limits.tilt
    """Angle between pelvis and vertical beyond which the motors are damped [rad]."""
    patience: float = 10.0
    """Longest wait for the first packet, and then for an estimate that a robot can have [s]."""
    log: Path | None = None
    """MCAP file to which the run is logged."""
    replay: Path | None = None
    """Log of a run to replay without a robot; all motor commands are compared with the log."""


def main(config: Config) -> None:
    """Run a controller over the network, or replay a log.

    Raises:
        SystemExit: status 1 after damping that the operator did not ask for, or after a replay
            with different commands.
    """
    if config.replay is not None:
        return replay_log(config.replay)
    source, limits = make_source(config), make_limits(config)
    readings: Readings = SensorReadings() if config.raw else StateReadings()
    link = Link(readings.sends, readings.receives, refuse_not_finite=False)
    peer = Address(config.host, config.port)
    local, beyond = local_address(peer, config.local_port)
    with source, Endpoint(link, local, peer, beyond_loopback=beyond) as endpoint:
        loaded = load(config.policy, config.library)
        controller = loaded.controller
        if isinstance(source, Scheduled) and source.sideways and controller.command_size == 1:
            raise ConfigurationError(f"the policy {config.policy!r} cannot walk sideways")
        if isinstance(source, Scheduled) and source.stands and not controller.stands:
            raise ConfigurationError(f"the policy {config.policy!r} cannot stand")
        if controller.plans and not config.raw:
            raise ConfigurationError(
                f"the policy {config.policy!r} follows a planner, which needs the sensors' packets"
                " of --raw"
            )
        supervisor = Supervisor(controller, limits)
        say(f"policy {config.policy!r} at {endpoint.local}, robot at {peer}")
        log = _open_log(config, loaded, readings, limits)
        run = Run(supervisor, readings, source, log=log, say=say)
        with damping_signals(run), contextlib.closing(run):
            take_priority(config.priority)
            drive = run_lockstep if config.lockstep else run_real_time
            drive(run, endpoint, patience=config.patience)
        counts = {name: number for name, number in asdict(link.counters).items() if number}
        say("\n".join([*run.tally.lines(), f"datagrams: {counts}"]))
    if not supervisor.by_operator:
        raise SystemExit(1)


def make_source(config: Config) -> Source:
    """Source of commands.

    Raises:
        ConfigurationError: several sources are given, or none and there is no terminal.
        NetworkError: the port for commands is in use.
    """
    given = [n for n in ("command", "schedule", "listen") if getattr(config, n) is not None]
    if len(given) > 1:
        raise ConfigurationError(f"give one of --command, --schedule and --listen, got {given}")
    if not config.duration > 0:
        raise ConfigurationError(f"duration must be positive, got {config.duration}")
    text = config.schedule if config.command is None else config.command
    if text is None and config.duration < math.inf:
        raise ConfigurationError(
            f"--duration needs --command or --schedule, got {config.duration:g} without one"
        )
    if config.listen is not None:
        source = Datagrams(config.listen, say)
        say(f"commands as JSON at 127.0.0.1:{source.port}")
        return source
    if text is None:
        source = Keyboard()
        say("\n".join(f"{key:6} {meaning}" for key, meaning in KEYS.items()))
        return source
    return Scheduled(Schedule.parse(text), config.duration)


def make_limits(config: Config) -> Limits:
    """Durations and limits of the supervisor."""
    ramp = config.ramp
    if ramp is None:
        ramp = 0.0 if _is_loopback(config.host) else _GANTRY_RAMP
    return Limits(ramp=ramp, tilt=config.tilt)


def local_address(robot: Address, port: int) -> tuple[Address, bool]:
    """Local address with a route to the robot, and True if it is beyond loopback.

    Args:
        robot: address of the robot.
        port: local port.

    Raises:
        ConfigurationError: there is no such port.
        NetworkError: there is no route to the robot.
    """
    check_port(robot.port)
    if _is_loopback(robot.host):
        return Address(LOOPBACK, port), False
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # sends nothing
            probe.connect(robot)
        except OSError as error:
            raise NetworkError(f"no route to the robot at {robot}: {error.strerror}") from error
        return Address(probe.getsockname()[0], port), True


def replay_log(path: Path) -> None:
    """Replay a log without a robot, and compare all motor commands with the log.

    Raises:
        SystemExit: status 1 if a command differs.
    """
    from aslip.network.runner.record import replay

    with tempfile.TemporaryDirectory() as folder:
        result = replay(path, lambda files: load(*files).controller, Path(folder))
    said = f"{path}: {result.ticks} policy steps, {result.walked} of them walked"
    if result.different:
        first = f"the first at {result.first:.2f} s"
        raise SystemExit(f"{said}; the commands of {result.different} differ, {first}")
    print(f"{said}; all commands are bit-equal")


@contextlib.contextmanager
def damping_signals(run: Run) -> Iterator[None]:
    """Damp the motors on Ctrl-C and `aslip.base.processes.ENDINGS`; a second Ctrl-C ends at once.

    So does a second SIGTERM. A closed terminal may send SIGHUP twice, and one is enough.
    """

    def damp(number: int, frame: object) -> None:
        if run.interrupted and number in (signal.SIGINT, signal.SIGTERM):
            raise KeyboardInterrupt
        run.interrupted = run.interrupted or f"operator: {signal.Signals(number).name}"

    before = {n: signal.signal(n, damp) for n in (signal.SIGINT, *endings())}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _open_log(config: Config, loaded: Loaded, readings: Readings, limits: Limits) -> RunLog | None:
    """Open the log of a run; None without --log."""
    if config.log is None:
        return None
    # imported late: a run without a log starts faster
    from aslip.network.runner.record import RunLog, run_metadata

    metadata = run_metadata(config.policy, readings, limits)
    return RunLog(config.log, readings.receives, loaded.files, metadata)


def _is_loopback(host: str) -> bool:
    """Check whether an IPv4 address is on loopback; False for any other text."""
    try:
        return ipaddress.IPv4Address(host).is_loopback
    except ValueError:
        return False


if __name__ == "__main__":
    with one_line_errors():
        main(command_line(Config))

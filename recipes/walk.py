r"""Walk with a policy through a schedule of commands; log, film, watch or steer the walk.

    python recipes/walk.py                                      # the shipped policy; prints a table
    python recipes/walk.py --command "0:0.0,4:1.0,8:0.5" --log walk.mcap
    python recipes/walk.py --policy runs/ppo_aslip --push "3:0,60,0" --video walk.mp4
    python recipes/walk.py --viewer                             # MuJoCo's window, in real time
    python recipes/walk.py --live                               # a page in your browser to steer it
    python recipes/walk.py --policy runs/ppo_directions \
        --command "0:0.5 0 0,4:0.5 0 0.5,8:0 -0.2 0"            # forward, sideways, yaw rate
    python recipes/walk.py ... --command "0:0.5 0 0,4:stand,9:0 0 0.3"    # policies that stand

A log replays with `python -m aslip.log replay --verify walk.mcap`, and opens in Foxglove, Rerun and
PlotJuggler.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths, asset_path
from aslip.base.command_line import command_line
from aslip.envs import Backend
from aslip.errors import ConfigurationError, one_line_errors
from aslip.log import JointRate
from aslip.show.model_place import RomPlace


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the walk."""

    policy: str = "directions"
    """Name of a shipped policy, its file, or the folder of a run."""
    library: str | None = None
    """Library of gaits: a file or the name of a shipped one; by default the copy beside the policy,
    or that of its stack."""
    command: str = "0:0.0,4:1.0,8:0.5"
    """Speeds over time, "seconds:m/s,..."; each holds until the next begins. In all directions
    three numbers: "seconds:m/s m/s rad/s,..." forward, sideways, yaw rate; "seconds:stand" to
    stand, with a policy that can."""
    course: str | None = None
    """Stones to walk over, with a policy that steps where a planner says: a JSON file, a pattern of
    `aslip.sim.course.PATTERNS`, or the seed of a random course. Speeds of the command count, from
    0.3 to 0.8 m/s; the robot is led along the stones."""
    push: tuple[str, ...] = ()
    """Pushes on the pelvis, "seconds:x,y,z" or "seconds:x,y,z:duration" [N]: x to the front of the
    robot, y to its left, z up. Durations are rounded up to policy steps of 0.03 s, 0.12 s by
    default."""
    duration: float | None = None
    """Duration of the walk [s]; by default until 4 s after the last change of speed. With --live,
    until Ctrl-C."""
    seed: int = 0
    """Seed of sensor noise."""
    truth: bool = False
    """Show the policy the true state instead of an estimate from noisy sensors."""
    backend: Backend = "batch"
    """Simulator; both give bit-equal states."""
    log: Path | None = None
    """MCAP log to write."""
    joint_rate: JointRate = "policy"
    """Rate at which joints are logged: of the policy, 33 Hz, or of the physics, 2 kHz."""
    video: Path | None = None
    """Film to write, such as walk.mp4 or walk.webp."""
    steps_per_frame: int = 2
    """Policy steps between frames of the film; 1 doubles the number of frames."""
    camera: str = "follow"
    """Camera of the film: side, follow or front."""
    width: int = 1280
    """Width of the film [pixels]."""
    height: int = 720
    """Height of the film [pixels]."""
    rom: RomPlace = "beside"
    """Place of the reduced-order model in film and viewer: beside the robot, through it, hidden."""
    viewer: bool = False
    """Show the walk in MuJoCo's viewer, in real time."""
    live: bool = False
    """Serve a page to watch and steer the robot; needs the extra aslip[live]."""
    policies: tuple[str, ...] = ()
    """More policies to choose from on the page."""
    host: str = "127.0.0.1"
    """Address of the page; 0.0.0.0 opens it to the network."""
    port: int = 8080
    """Port of the page."""

    def __post_init__(self) -> None:
        """Check settings that would otherwise fail late.

        Raises:
            ConfigurationError: a setting is invalid.
        """
        super().__post_init__()
        if self.duration is not None and not 0 < self.duration < math.inf:
            raise ConfigurationError(f"duration must be a positive time [s], got {self.duration}")
        if self.steps_per_frame < 1:
            raise ConfigurationError(
                f"steps per frame must be 1 or more, got {self.steps_per_frame}"
            )
        if self.live and (self.viewer or self.video or self.push):
            raise ConfigurationError("--live cannot be combined with --viewer, --video or --push")
        if self.live and self.command != Config.command and "," in self.command:
            raise ConfigurationError(
                "--live begins with one command, which the page changes, got the schedule"
                f" {self.command!r}"
            )


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import contextlib
from typing import Any, cast

import numpy as np
from tensordict import TensorDictBase
from tqdm import tqdm

import aslip
from aslip.base.processes import signals_exit
from aslip.base.tables import markdown
from aslip.envs import EPISODE_ENDS, ON_TRUTH, STACKS
from aslip.envs.directions import course_stack
from aslip.library import Schedule, numbers
from aslip.library.schedule import STAND
from aslip.log import Recorder
from aslip.policy import policy_environment, read_card
from aslip.robot import CASSIE
from aslip.robot.rotation import yaw
from aslip.show.film import Frame, Look, check_look, make_film
from aslip.sim.course import MOST_STONES, Course, find_course, stone_distances
from aslip.walking import Push, Walker, command_library, policy_steps

# duration of the last speed of a schedule [s]
_LAST_SPEED = 4.0
# stones to add on the page
_SPARE = 10


def main(config: Config) -> None:
    """Walk, and print a table."""
    schedule = Schedule.parse(config.command)
    pushes = [Push.parse(text) for text in config.push]
    check_pushes(pushes, duration(config, schedule))
    course = None if config.course is None else find_course(config.course)
    look = Look(config.camera, config.width, config.height, config.rom, course=course)
    if config.video is not None:
        check_look(look)
    walker = make_walker(config, schedule, course)
    for policy in dict.fromkeys([config.policy, *config.policies]):
        print(f"policy {policy}: {training_length(policy)}")
    schedule = schedule.of_size(walker.library.command_size)
    try:
        with signals_exit(), contextlib.closing(walker.env):
            if config.live:
                serve(config, walker)
                return
            rows, frames = walk(config, walker, schedule, pushes, look)
    finally:
        if walker.time:
            ending = "fell after" if walker.fallen else "walked for"
            arrived = ", to the end of the course" if has_arrived(walker) else ""
            print(f"the robot {ending} {walker.time:.2f} s{arrived}")
        if config.log is not None and config.log.exists():
            print(LOG_COMMANDS.format(config.log, asset_path("viewers/foxglove.json")))
    print(table(schedule, rows))
    if config.video is not None:
        make_film(config.video, frames, 1 / (config.steps_per_frame * CASSIE.policy_period), look)
        print(f"wrote {config.video}")


def has_arrived(walker: Walker) -> bool:
    """Whether the pelvis is above the last stone of the robot's course."""
    if walker.stones is None or walker.fallen:
        return False
    pelvis = walker.td["truth", "pelvis_position"][:, :2].double().numpy()
    last = walker.stones[np.isfinite(walker.stones[:, 0])][-1:]
    return bool(len(last)) and not stone_distances(last, pelvis).any()


LOG_COMMANDS = """wrote {0}
  python -m aslip.log info {0}             # list its topics
  python -m aslip.log replay --verify {0}  # simulate it again
  open it in Foxglove with the layout {1}"""


def serve(config: Config, walker: Walker) -> None:
    """Serve the page until Ctrl-C."""
    from aslip.show.live import LivePage

    policies = {name: name for name in (config.policy, *config.policies)}
    page = LivePage(walker, policies, host=config.host, port=config.port)
    print(f"page at {page.url}\nkeys there: {page.keys}\nCtrl-C ends", flush=True)
    page.serve()


def make_walker(config: Config, schedule: Schedule, course: Course | None = None) -> Walker:
    """Robot in its environment, with a recorder if there is a log to write.

    Raises:
        ConfigurationError: the policy cannot stand, and the schedule asks for it.
        SpeedOutOfRangeError: a command of the schedule is outside the library.
    """
    made = policy_environment(config.policy, config.library)
    stack = STACKS[made["stack"]](made["library"])
    library = command_library(config.policy, made["library"])
    schedule = schedule.of_size(library.command_size)
    if any(schedule.stands) and "stand" not in stack:
        raise ConfigurationError(
            f"the policy {config.policy!r} was not trained to stand, which --command asks for"
        )
    for command in schedule.commands:
        library.check_command(command)
    if course is not None:
        if made["stack"] != "planned":
            raise ConfigurationError(
                f"the policy {config.policy!r} does not step where a planner says, which --course"
                " needs; recipes/stepping_stones.py trains one that does"
            )
        courses: Any = [course]
        if config.live:
            if course.polygons:
                raise ConfigurationError("the page moves rectangular stones, no polygons")
            spare = min(_SPARE, MOST_STONES - len(course.stones))
            courses = np.pad(course.stones, ((0, spare), (0, 0)), constant_values=np.nan)[None]
        stack = course_stack(stack, courses)
    edits = ON_TRUTH if config.truth else {}
    if config.log is not None:
        stack["recorder"] = Recorder(
            config.log,
            joint_rate=config.joint_rate,
            policy=config.policy,
            config=config,
        )
    env = aslip.make_env(
        config.backend,
        seed=config.seed,
        stack=stack,
        drop=[*EPISODE_ENDS, *edits.get("drop", ())],
        replace=edits.get("replace"),
        num_threads=1,
    )
    if course is not None and course.polygons:
        # resets place rectangles only
        env.base_env.set_course(course)
    first = schedule.at(0.0), schedule.stand_at(0.0)
    return Walker(config.policy, env, library=library, speed=first[0], stand=first[1])


def training_length(policy: str) -> str:
    """Policy steps for which a policy, maybe of a running training, was trained, in words."""
    made_by = read_card(policy)["made_by"]
    steps, settings = made_by.get("steps"), made_by.get("settings")
    total = settings.get("total_steps") if isinstance(settings, dict) else None
    if not isinstance(steps, int) or not isinstance(total, int):
        return "its file does not say how long it was trained"
    return f"trained for {steps} policy steps" + (f" of {total}" if steps < total else "")


def duration(config: Config, schedule: Schedule) -> float:
    """Duration of the walk [s]."""
    return schedule.times[-1] + _LAST_SPEED if config.duration is None else config.duration


def check_pushes(pushes: list[Push], duration: float) -> None:
    """Check that each push is within the walk and does not overlap with another.

    Raises:
        ConfigurationError: a push is outside the walk, or begins during another.
    """
    end = 0
    for push in sorted(pushes, key=lambda push: push.time):
        first = policy_steps(push.time)
        if not 0 <= push.time < duration or first < end:
            raise ConfigurationError(
                f"a push at {push.time:g} s is outside the walk, from 0 to {duration:g} s, or"
                " begins before the previous one ends"
            )
        end = first + policy_steps(push.duration)


def walk(
    config: Config, walker: Walker, schedule: Schedule, pushes: list[Push], look: Look
) -> tuple[list[dict[str, float]], list[Frame]]:
    """Walk through the schedule or until a fall.

    Returns:
        A row per policy step, and the frames of the film if there is one.
    """
    waiting = sorted(pushes, key=lambda push: push.time, reverse=True)
    rows, frames = [], [Frame.of(walker.td, 0.0)]
    with contextlib.ExitStack() as stack:
        show = None
        if config.viewer:
            from aslip.show.viewer import open_viewer

            show = stack.enter_context(open_viewer(look.model(), rom=config.rom))
        for _ in tqdm(range(policy_steps(duration(config, schedule))), unit="step"):
            walker.command = schedule.at(walker.time)
            walker.stand = schedule.stand_at(walker.time)
            if waiting and waiting[-1].time <= walker.time + 1e-9:
                push = waiting.pop()
                walker.push(push.force, push.duration)
            td = walker.step()
            rows.append(row(walker, td))
            if config.video is not None and walker.steps % config.steps_per_frame == 0:
                frames.append(Frame.of(td["next"], walker.time, td.get("push")))
            if show is not None:
                show(Frame.of(td["next"], walker.time))
            if walker.fallen:
                break
    return rows, frames


def row(walker: Walker, td: TensorDictBase) -> dict[str, float]:
    """Numbers of a policy step."""
    after = cast("TensorDictBase", td["next"])
    forward, sideways, _ = after["true_odometry", "pelvis_velocity"][0].tolist()
    orientations: list[Any] = [t["truth", "pelvis_orientation"][0] for t in (td, after)]
    turn = np.diff(yaw(np.stack([orientation.double() for orientation in orientations])))[0]
    return {
        "time": walker.time,
        "speed": forward,
        "sideways": sideways,
        "yaw_rate": math.remainder(turn, math.tau) / CASSIE.policy_period,
        "reward": float(after["reward"]),
    }


def table(schedule: Schedule, rows: list[dict[str, float]]) -> str:
    """Commanded and mean speed of each part of the schedule, over its second half."""
    lines = []
    last = rows[-1]["time"]
    ends = [*schedule.times[1:], math.inf]
    names = ("speed", "sideways", "yaw_rate")[: len(numbers(schedule.commands[0]))]
    stands = schedule.stands or (False,) * len(ends)
    parts = zip(schedule.times, ends, schedule.commands, stands, strict=True)
    for start, end, command, stands_still in parts:
        middle = (start + min(end, last)) / 2
        part = [row for row in rows if middle < row["time"] <= end]
        if part:
            text = ", ".join(f"{number:.2f}" for number in numbers(command))
            mean = ", ".join(f"{np.mean([row[name] for row in part]):.3f}" for name in names)
            reward = np.mean([row["reward"] for row in part])
            lines.append([f"{start:g}", STAND if stands_still else text, mean, f"{reward:.3f}"])
    unit = "m/s" if len(names) == 1 else "m/s, m/s, rad/s"
    return markdown(["from s", f"command {unit}", f"speed {unit}", "mean reward"], lines)


if __name__ == "__main__":
    try:
        with one_line_errors():
            main(CONFIG)
    except KeyboardInterrupt:
        raise SystemExit(130) from None

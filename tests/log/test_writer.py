"""Logs are finished and renamed once, and never overwrite a file."""

import gc
import os
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest
from mcap.reader import make_reader
from torchrl.envs.transforms import StepCounter

import aslip
from aslip.envs import default_stack, insert_before
from aslip.errors import AssetError, ConfigurationError
from aslip.library import GaitLibrary
from aslip.log import Recorder, read, recover, replay
from aslip.robot import CASSIE
from tests.helpers import full_disk
from tests.log.helpers import MakeRecorded, run


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "walk.mcap"


def test_existing_log_is_not_overwritten(make_recorded: MakeRecorded, path: Path) -> None:
    env = make_recorded(path)
    path.write_bytes(b"precious")
    with pytest.raises(ConfigurationError, match=r"walk\.mcap' exists"):
        env.reset()
    with pytest.raises(ConfigurationError, match=r"walk\.mcap' exists.*overwrite=True"):
        make_recorded(path)
    assert [p.name for p in path.parent.iterdir()] == ["walk.mcap"]
    part = path.rename(path.with_name("walk.mcap.part"))
    with pytest.raises(ConfigurationError, match="recover"):
        make_recorded(path).reset()
    assert part.read_bytes() == b"precious"


def test_log_is_overwritten_on_request(make_recorded: MakeRecorded, path: Path) -> None:
    path.write_bytes(b"old")
    env = make_recorded(path, overwrite=True)
    run(env, 2)
    assert path.read_bytes() == b"old"
    env.close()
    assert len(read(path)["/step"]) == 2


def test_reset_after_closing_leaves_the_log_alone(make_recorded: MakeRecorded, path: Path) -> None:
    env = make_recorded(path)
    run(env, 5)
    env.transforms[-1].close()
    before = path.read_bytes()
    run(env, 3)
    env.close()
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["walk.mcap"]


def test_recorder_that_is_not_last_is_refused(library: GaitLibrary, path: Path) -> None:
    """Before the reward transform it would log a reward of 0."""
    stack = insert_before(default_stack(library), "reward", recorder=Recorder(path))
    with pytest.raises(ConfigurationError, match="'recorder' must be the last transform"):
        aslip.make_env(stack=stack, num_threads=1)


def test_transform_after_the_recorder_is_refused(make_recorded: MakeRecorded, path: Path) -> None:
    env = make_recorded(path)
    env.append_transform(StepCounter(step_count_key="steps"))
    with pytest.raises(ConfigurationError, match="last one is a StepCounter"):
        env.reset()
    assert not list(path.parent.iterdir())


def test_unclosed_environment_finishes_its_log(make_recorded: MakeRecorded, path: Path) -> None:
    env = make_recorded(path)
    run(env, 2)
    del env
    gc.collect()
    read(path)


_SCRIPT = """
import sys
import aslip
from aslip.log import Recorder
from aslip.envs import default_stack
env = aslip.make_env(stack={**default_stack(), "recorder": Recorder(sys.argv[1])})
env.rollout(3)
raise RuntimeError("a mistake in the script")
"""


def test_end_of_a_program_finishes_its_log(path: Path) -> None:
    """Also by an exception."""
    command = [sys.executable, "-c", _SCRIPT, str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1, ended.stderr
    assert [p.name for p in path.parent.iterdir()] == ["walk.mcap"]
    assert len(read(path)["/step"]) == 3


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_forked_process_leaves_the_log_to_its_parent(
    make_recorded: MakeRecorded, path: Path
) -> None:
    env = make_recorded(path)
    run(env, 2)
    child = os.fork()
    if child == 0:
        env.transforms[-1].close()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert [p.name for p in path.parent.iterdir()] == ["walk.mcap.part"]
    env.close()
    read(path)


def test_full_disk_ends_the_log_and_not_the_walk(make_recorded: MakeRecorded, path: Path) -> None:
    """There is one warning, and the written part can be recovered."""
    env = make_recorded(path)
    seen = run(env, 40)
    size = path.with_name("walk.mcap.part").stat().st_size
    with full_disk(size + 1000), pytest.warns(RuntimeWarning) as warned:
        more = run(env, 80)
        env.close()
    assert len(warned) == 1
    text = str(warned[0].message)
    assert "walk.mcap' ends here" in text
    assert f"recover {path}.part" in text
    assert len(more) == 80
    assert not path.exists()
    saved = recover(path.with_name("walk.mcap.part"), path)
    assert saved.until >= 0.99
    assert replay(path).equal
    rewards = [float(td["next", "reward"]) for td in seen]
    assert read(path)["/step"]["reward"].tolist() == rewards[: len(read(path)["/step"])]


def test_an_open_log_lacks_a_fraction_of_a_second(make_recorded: MakeRecorded, path: Path) -> None:
    """So does that of a killed process: the file has what was flushed."""
    env, steps = make_recorded(path), 40
    run(env, steps)
    saved = recover(path.with_name("walk.mcap.part"))
    env.close()
    # chunks alone, without the flush each second, end after 0.75 s
    assert 0.9 < saved.until < steps * CASSIE.policy_period
    assert replay(saved.path).equal


def test_full_disk_at_the_start_is_an_error(make_recorded: MakeRecorded, path: Path) -> None:
    env = make_recorded(path)
    with full_disk(1000), pytest.raises(ConfigurationError, match=r"cannot write.*walk"):
        env.reset()
    assert not list(path.parent.iterdir())


def test_unwritable_folder_is_an_error(make_recorded: MakeRecorded, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match=r"cannot write the log.*walk\.mcap"):
        make_recorded(tmp_path / "file" / "walk.mcap").reset()


def test_sequence_numbers_count_per_topic(walk: tuple[Path, list]) -> None:
    """Readers detect lost messages by gaps within a topic."""
    numbers = defaultdict(list)
    with walk[0].open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            numbers[channel.topic].append(message.sequence)
    for topic, found in numbers.items():
        assert found == list(range(1, len(found) + 1)), topic


def test_failed_start_leaves_no_file(make_recorded: MakeRecorded, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot record robot 7"):
        make_recorded(tmp_path / "walk.mcap", robot=7).reset()
    env = make_recorded(tmp_path / "walk.mcap")
    env.base_env.model.geom_size[0] += 1.0
    with pytest.raises(ConfigurationError, match=r"differs from cassie\.xml"):
        env.reset()
    assert not list(tmp_path.iterdir())


def test_invalid_settings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="joint_rate"):
        Recorder(tmp_path / "a.mcap", joint_rate="fast")  # pyright: ignore
    with pytest.raises(AssetError, match="nobody"):
        Recorder(tmp_path / "a.mcap", policy="nobody")

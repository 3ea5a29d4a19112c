"""Golden log: logs of earlier versions are still read and replayed."""

import hashlib
from pathlib import Path

import numpy as np

from aslip.log import read, replay
from aslip.log.messages import FORMAT
from aslip.robot import CASSIE
from tests.log.golden import GOLDEN, main

# messages, columns, and a hash of their names in order
TOPICS = {
    "/robot_description": (1, 1, "3a6eb0790f39ac87"),
    "/log": (2, 8, "92e00912ef8b0688"),
    "/truth": (19, 46, "8281001168502ad6"),
    "/estimate": (19, 52, "11148b4cb5a55f98"),
    "/odometry": (19, 24, "5eb5913fbd932ee6"),
    "/true_odometry": (19, 28, "a73c0e6c9675517a"),
    "/reference": (19, 40, "22f8a784ef07278d"),
    "/sensors": (19, 42, "5916cbec78d1850e"),
    "/observation": (19, 64, "11480c5f9d6cfb7b"),
    "/tf": (19, 11, "cdd16bd2555bcc85"),
    "/joint_states": (19, 7, "6b8d4a18cac006db"),
    "/state": (3, 4, "206dc2bb1550a17d"),
    "/dynamics": (3, 11, "d26a6c93c34b9ee6"),
    "/step": (17, 41, "45d843e552a171b4"),
    "/touchdown": (1, 6, "58628e6ffa250a27"),
}


def test_golden_log_is_read() -> None:
    """Topics, columns and numbers are those at the time of writing."""
    log = read(GOLDEN)
    assert log.metadata["format"] == FORMAT
    found = {
        topic: (len(series), len(series.columns), digest(" ".join(series.columns)))
        for topic, series in log.series.items()
    }
    assert found == TOPICS
    assert log["/truth"]["pelvis_position_x"][11] == 0.07125937938690186
    assert log["/sensors"]["gyro_x"][11, -1] == -0.22627057135105133
    assert log["/step"]["reward"][11] == 0.9439218044281006
    assert log["/dynamics"]["payload"].tolist() == [0.0, 3.0, 3.0]


# columns that came after the golden log, and that readers do without
ADDED = {
    "/dynamics": ["pd_stiffness", "pd_damping"],
    "/reference": ["body_heading", "left_foot_heading", "right_foot_heading"],
}


def digest(text: str) -> str:
    """Short hash of a text; one of column names changes with any name or order."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def test_golden_log_is_replayed() -> None:
    """Bit-equal with the same versions; close for a second with others."""
    result = replay(GOLDEN, model=CASSIE.mjcf)
    assert result.steps == 17
    assert result.compared == 1
    assert result.equal or result.doubts
    assert result.largest_difference < 1e-6


def test_new_log_has_the_messages_of_the_golden_log(tmp_path: Path) -> None:
    """A failure means that the format has changed: change `FORMAT` and the golden log, too."""
    main(tmp_path / "new.mcap")
    new, golden = read(tmp_path / "new.mcap"), read(GOLDEN)
    assert new.series.keys() == golden.series.keys()
    for topic, series in golden.series.items():
        added = ADDED.get(topic, [])
        kept = [name for name in new[topic].columns if name not in added]
        assert kept == list(series.columns), topic
        assert len(new[topic].columns) == len(kept) + len(added), topic
        np.testing.assert_array_equal(new[topic].time, series.time, err_msg=topic)
        for name, column in series.columns.items():
            assert new[topic][name].shape == column.shape, (topic, name)
            assert new[topic][name].dtype.kind == column.dtype.kind, (topic, name)
    assert new.metadata.keys() == golden.metadata.keys()
    assert new.attachments.keys() == golden.attachments.keys()

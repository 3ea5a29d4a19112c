"""Agreement of simulators."""

from pathlib import Path

from benchmarks.robustness import backends


def test_walks_of_two_simulators_agree(tmp_path: Path) -> None:
    config = backends.Config(policy=("straight",), steps=5, out=tmp_path)
    (row,) = backends.main(config)
    assert row["walks"] == 21
    assert abs(row["total"]["mean"]) < 0.05
    assert (tmp_path / "backends.md").exists()

"""Ground forces without a policy."""

from pathlib import Path

from benchmarks.paper import open_loop_force


def test_only_the_default_stack_feeds_forces_forward(tmp_path: Path) -> None:
    config = open_loop_force.Config(speeds=(1.0,), out=tmp_path)
    found = {row["stack"]: row["correlation"] for row in open_loop_force.main(config)}
    assert found["straight"] > 0.8
    assert abs(found["paper"]) < 0.4
    assert "| straight | 1 |" in (tmp_path / "open_loop_force.md").read_text()

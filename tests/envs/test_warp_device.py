"""No entry of a step on a device visits the host."""

import json
import subprocess
import sys


def test_no_entry_of_a_step_visits_the_host() -> None:
    """Only single numbers do, which decide whether a robot is reset or an entry is wrong."""
    run = subprocess.run(
        [sys.executable, "-m", "tests.envs.walk_elsewhere"], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    stacks = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("[")]
    assert len(stacks) == 2
    for visits in (visited for stack in stacks for visited in stack):
        assert {*visits} <= {"number", "wait"}
        assert len(visits) < 40

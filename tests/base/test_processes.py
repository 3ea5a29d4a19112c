"""Number of processors, and processes that end with their parent."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aslip.base import processes
from aslip.base.processes import processors

# without `if __name__ == "__main__":`
_SCRIPT = """
import os, time
from aslip.base.processes import worker_pool

with worker_pool(2) as pool:
    tasks = [pool.submit(os.getpid), pool.submit(os.getpid)]
    print(*{task.result() for task in tasks}, flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize(
    ("groups", "limits", "expected"),
    [
        ("0::/", {"cpu.max": "250000 100000"}, 3),
        ("0::/a/b", {"a/cpu.max": "200000 100000", "a/b/cpu.max": "max 100000"}, 2),
        ("0::/a\n1:cpu:/", {"a/cpu.max": "900000 100000", "cpu/cpu.cfs_quota_us": "-1"}, 5),
        ("0::/", {"cpu.max": "5000 100000"}, 1),
        # a container, whose group is elsewhere for the host
        (
            "3:cpuset:/\n2:cpu,cpuacct:/docker/1",
            {"cpu/cpu.cfs_quota_us": "400000", "cpu/cpu.cfs_period_us": "100000"},
            4,
        ),
        ("", {}, 5),
    ],
)
def test_the_quota_of_a_container_limits_the_processors(
    groups: str,
    limits: dict[str, str],
    expected: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(5)))
    monkeypatch.setattr(processes, "_GROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(processes, "_LIMITS", tmp_path)
    (tmp_path / "cgroup").write_text(groups)
    for name, text in limits.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n")
    assert processors() == expected


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_workers_of_any_script_end_when_it_is_killed(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(_SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        workers = [int(word) for word in parent.stdout.readline().split()]
        assert workers and all(map(_runs, workers))
        parent.send_signal(signal.SIGKILL)
    end = time.monotonic() + 60
    while any(map(_runs, workers)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(_runs, workers))


def _runs(pid: int) -> bool:
    """Whether a process runs; an ended one that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False

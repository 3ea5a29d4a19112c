"""Processes that end with their parent."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aslip.processes import worker_pool

# without `if __name__ == "__main__":`
_SCRIPT = """
import os, time
from aslip.processes import worker_pool

with worker_pool(2) as pool:
    tasks = [pool.submit(os.getpid), pool.submit(os.getpid)]
    print(*{task.result() for task in tasks}, flush=True)
    time.sleep(600)
"""


def test_one_worker_needs_no_pool() -> None:
    with worker_pool(1) as pool:
        assert pool is None


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

"""Exported policy against PyTorch: cold start, memory, and time per policy step.

    python -m benchmarks.system.export_speed                                    # a minute
    python -m benchmarks.system.export_speed --policy robust --starts 20

Each start is a new process that loads a controller and computes two motor targets. The time is that
from launch to second target, the memory the largest resident set (Linux). The policy is exported
before.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    policy: str = "straight"
    """Name of a shipped policy, or policy file."""
    starts: int = 5
    """Number of processes for each controller."""
    steps: int = 2000
    """Number of policy steps to time in each process."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from aslip.base.tables import markdown
from aslip.control.export import export_policy

_MAKE = {
    "ONNX": """
from aslip.control.exported import ExportedController
controller = ExportedController(sys.argv[1])
""",
    "PyTorch": """
import torch
torch.set_num_threads(1)
from aslip.control import Controller
controller = Controller(sys.argv[2])
""",
}
_RUN = """
import json, re, time
import numpy as np
from aslip.robot import CASSIE
estimate = {name: np.zeros((1, size)) for name, size in CASSIE.estimate_sizes.items()}
estimate["orientation"][:, 0], estimate["height"][:] = 1.0, 0.9
state, _ = controller.step(controller.start(estimate, 0.5), estimate)
ready = time.time()
# unlike `ru_maxrss`, without the memory of the process that launched this one
memory = int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1e3
start = time.perf_counter()
for _ in range(int(sys.argv[3])):
    state, _ = controller.step(state, estimate)
step = (time.perf_counter() - start) / int(sys.argv[3])
print(json.dumps([ready, memory, step * 1e6]))
"""


def main(config: Config) -> None:
    """Measure both controllers and print the table."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "policy.onnx"
        export_policy(config.policy, file)
        for kind, make in _MAKE.items():
            script = f"import sys\n{make}{_RUN}"
            found = np.array([_start(script, file, config) for _ in range(config.starts)])
            middle = np.median(found, axis=0)
            rows.append([kind, f"{middle[0]:.2f}", f"{middle[1]:.0f}", f"{middle[2]:.0f}"])
    print(markdown(["controller", "cold start s", "memory MB", "policy step us"], rows))
    print(f"\nmedians of {config.starts} processes; {config.policy}")


def _start(script: str, file: Path, config: Config) -> list[float]:
    """Time to the second motor target [s], memory [MB] and time per step [us] of a process."""
    command = [sys.executable, "-c", script, str(file), config.policy, str(config.steps)]
    start = time.time()
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    ready, memory, step = json.loads(run.stdout)
    return [ready - start, memory, step]


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)

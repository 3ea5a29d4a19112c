from typing import Any

from tqdm import tqdm

from benchmarks.common import Subject
from benchmarks.robustness.parameters import SWEEPS

NO_SWEEPS: dict[str, Any] = {sweep.flag: () for sweep in SWEEPS.values()}
BAR = tqdm(disable=True)
SHIPPED = Subject.load("straight")

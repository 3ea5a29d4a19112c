"""See the package."""

from __future__ import annotations

import tyro

from aslip.errors import one_line_errors
from benchmarks.estimator.config import Config
from benchmarks.estimator.suite import main

if __name__ == "__main__":
    with one_line_errors():
        main(tyro.cli(Config))

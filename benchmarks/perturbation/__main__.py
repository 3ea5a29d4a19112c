"""See the package."""

from __future__ import annotations

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line
from benchmarks.perturbation.config import Config

if __name__ == "__main__":
    # before the import below, which takes seconds
    CONFIG = command_line(Config)

    from benchmarks.perturbation.suite import main

    with one_line_errors():
        main(CONFIG)

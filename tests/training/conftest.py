"""Settings of a run in a temporary folder."""

from pathlib import Path

import pytest

from tests.training.run_folder import Settings


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(out=tmp_path / "run")

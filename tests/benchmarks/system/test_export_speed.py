"""Start of exported policies."""

import pytest

from benchmarks.system import export_speed


@pytest.mark.slow
def test_exported_policies_start_lighter_than_pytorch(capsys: pytest.CaptureFixture[str]) -> None:
    export_speed.main(export_speed.Config(starts=1, steps=10))
    rows = [line.split("|") for line in capsys.readouterr().out.splitlines() if "|" in line]
    memory = {row[1].strip(): float(row[3]) for row in rows[2:]}
    assert memory["ONNX"] < memory["PyTorch"] / 2

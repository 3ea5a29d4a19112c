"""What the README says one can type works."""

import os
import re
import subprocess
import sys
from pathlib import Path

from aslip.policy import policy_stack

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
# of the training it shows: too much for a test
_BUDGET = "total_steps=300_000"


def test_every_python_block_runs(tmp_path: Path) -> None:
    """One after the other in one process, as a reader would paste them."""
    code = "\n".join(re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL))
    assert code.count(_BUDGET) == 1
    code = code.replace(_BUDGET, "total_steps=64, num_envs=8, samples=64, minibatch=32")
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert policy_stack(tmp_path / "runs" / "upright") == "aslip"


def test_every_picture_and_linked_file_exists() -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert any(link.endswith(".png") for link in links)
    missing = [link for link in links if not (ROOT / link).exists()]
    assert not missing


def test_every_script_it_names_exists() -> None:
    scripts = re.findall(r"python ((?:recipes|benchmarks)/\w+\.py)", README)
    for module in re.findall(r"-m (benchmarks\.\w+)", README):
        path = module.replace(".", "/")
        scripts.append(f"{path}/__main__.py" if (ROOT / path).is_dir() else f"{path}.py")
    assert len(scripts) >= 4
    assert not [script for script in scripts if not (ROOT / script).is_file()]

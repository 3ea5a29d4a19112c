"""What the README says one can type works."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_every_python_block_runs(tmp_path: Path) -> None:
    """One after the other in one process, as a reader would paste them."""
    code = "\n".join(re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL))
    assert "make_env" in code
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr


def test_every_picture_and_linked_file_exists() -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert any(link.endswith(".png") for link in links)
    missing = [link for link in links if not (ROOT / link).exists()]
    assert not missing


def test_every_script_it_names_exists() -> None:
    scripts = re.findall(r"python ((?:recipes|benchmarks)/\w+\.py)", README)
    scripts += [f"{m.replace('.', '/')}.py" for m in re.findall(r"-m (benchmarks\.\w+)", README)]
    assert len(scripts) >= 4
    assert not [script for script in scripts if not (ROOT / script).is_file()]

"""What the README says one can type works."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

from packaging.specifiers import SpecifierSet

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


def _commands() -> list[list[str]]:
    """Words of each command in blocks of shell, comments left out."""
    blocks = re.findall(r"```bash\n(.*?)```", README, flags=re.DOTALL)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    words = [str(line).partition(" #")[0].split() for line in lines]
    return [found for found in words if found]


def test_every_policy_it_measures_ships_or_is_trained_before() -> None:
    """In the order of the commands; a benchmark of learning curves makes a folder a run."""
    made = {"runs/ppo_aslip"}
    measured = []
    for words in _commands():
        if "--out" in words:
            made.add(words[words.index("--out") + 1])
        if "benchmarks.learning_curves" in words and "--no-train" not in words:
            made.add("runs/learning_curves")
        for flag in {"--policy", "--baseline", "--run"} & set(words):
            first = words.index(flag) + 1
            last = next((i for i in range(first, len(words)) if words[i][:2] == "--"), len(words))
            for policy in words[first:last]:
                shipped = (ROOT / "assets" / "policies" / f"{policy}.zip").is_file()
                known = any(policy == folder or policy.startswith(f"{folder}/") for folder in made)
                measured.append(policy)
                assert shipped or known, f"{' '.join(words)}: {policy} is not there"
    assert len(measured) >= 5


def test_versions_of_python_are_those_that_can_be_installed() -> None:
    """Labmaze has no wheels from 3.13 on; the README names what is admitted."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    admitted = SpecifierSet(project["requires-python"])
    assert [minor for minor in range(8, 20) if f"3.{minor}" in admitted] == [11, 12]
    assert "With Python 3.11 or 3.12" in README
    assert "CI runs 3.11" in README
    assert "python3.11" in (ROOT / ".ci" / "run").read_text()

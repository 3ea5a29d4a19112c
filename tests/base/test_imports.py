"""Imports on first use, and of libraries that are not installed."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from aslip.base.imports import _EXTRAS

_ATTACHED = """
from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
"""
_STUB = "from .broken import THING as THING\nfrom .whole import OTHER as OTHER\n"


def test_an_attribute_error_in_a_module_is_not_hidden(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "attached"
    package.mkdir()
    (package / "__init__.py").write_text(_ATTACHED)
    (package / "__init__.pyi").write_text(_STUB)
    (package / "broken.py").write_text("import math\nTHING = math.no_such_function\n")
    (package / "whole.py").write_text("OTHER = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    cause = r"attached.THING cannot be imported: AttributeError: .*'no_such_function'"
    with pytest.raises(ImportError, match=cause):
        exec("from attached import THING")
    module = importlib.import_module("attached")
    with pytest.raises(ImportError, match=cause):
        hasattr(module, "THING")
    assert module.OTHER == 1
    assert module.__all__ == ["OTHER", "THING"]
    assert {"OTHER", "THING", "whole"} <= {*dir(module)}
    (package / "__init__.pyi").unlink()
    with pytest.raises(ValueError, match=r"non-existent stub '.*__init__\.pyi'"):
        importlib.reload(module)
    assert not hasattr(module, "NEITHER")
    with pytest.raises(AttributeError, match=r"'NEITHER'; there are \['OTHER', 'THING'\]"):
        _ = module.NEITHER


# what Windows lacks
_UNIX_MODULES = {"fcntl", "resource", "termios", "tty"}
_UNIX_NAMES = {
    "os": "O_DIRECTORY sched_getaffinity sched_setscheduler",
    "signal": "SIGHUP SIGUSR1 SIGUSR2 SIGXCPU",
}
_WITHOUT_EXTRAS = (
    f"""
import os, signal, sys

for module, names in {_UNIX_NAMES}.items():
    for name in names.split():
        delattr(globals()[module], name)
HIDDEN = {_UNIX_MODULES}
"""
    + """
from aslip.errors import ConfigurationError, MissingExtraError
from aslip.base.imports import _EXTRAS
HIDDEN.update(_EXTRAS)

class Finder:
    def __init__(self, plain):
        self.plain = plain

    def find_spec(self, name, *rest):
        hidden = name.partition(".")[0] in HIDDEN
        return None if hidden else self.plain.find_spec(name, *rest)

sys.meta_path[:] = map(Finder, sys.meta_path)
for line in sys.stdin:
    try:
        exec(line)
    except MissingExtraError as error:
        assert isinstance(error, (ConfigurationError, ImportError))
        print(error)
"""
)
_USES = {
    "from aslip.base.command_line import command_line; command_line(object)": "tyro train",
    "import recipes.ppo_settings": "tyro train",
    "import aslip.training.progress": "tensorboard train",
    "import aslip.show.plots": "matplotlib train",
    "import aslip.show.gait_paths": "matplotlib train",
    "import aslip.show.gait_region": "matplotlib train",
    "import aslip.show.film": "tqdm train",
    "import aslip.show.live": "viser live",
    "import aslip; aslip.GymEnv": "gymnasium gym",
    "import aslip.envs.gymnasium": "gymnasium gym",
    "import aslip.control.exported": "onnx control",
    "from aslip.network.runner.load import _of_export; _of_export('', None)": "onnx control",
    "from aslip.control.export import export_policy": "onnx control",
    "from aslip.network.twin import ENGINES; ENGINES['drake'](None, None)": "pydrake drake",
    "import aslip.training.ray as r; r.RayCollectors(None, None, num_envs=1, samples=1)": "ray ray",
    "import aslip; aslip.make_env('dm_control')": "dm_control",
    "import aslip.library as l; l.solve_directions": "pinocchio",
    "import aslip.walking as w; w.Walker(speed=0.5).step()": "",
    "import pathlib, aslip.log as l; l.Recorder(pathlib.Path(sys.argv[1]) / 'walk.mcap')": "",
    "from aslip.base import writing as w; w.claimed(w.Path(sys.argv[1])).__enter__()": "",
}


def test_without_an_extra_the_error_says_how_to_install_it(tmp_path: Path) -> None:
    """A robot walks without any, and without the calls and modules that other systems lack."""
    root = Path(__file__).parents[2]
    result = subprocess.run(
        [sys.executable, "-c", _WITHOUT_EXTRAS, str(tmp_path)],
        cwd=root, input="\n".join(_USES), capture_output=True, text=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    expected = []
    for name, _, how in (words.partition(" ") for words in _USES.values() if words):
        advice = f"pip install 'aslip[{how}]'" if how else _EXTRAS[name]
        expected.append(f"{name} is not installed: {advice}")
    assert result.stdout.splitlines() == expected


def test_a_program_that_lacks_an_extra_ends_with_one_line(tmp_path: Path) -> None:
    """Also if it imports the library before its main function."""
    (tmp_path / "program.py").write_text(
        "import sys\n"
        "from aslip.base.command_line import prepare_program\n"
        "prepare_program()\n"
        "if len(sys.argv) > 1: 1 / 0\n"
        "raise ModuleNotFoundError(name='matplotlib.figure')\n"
    )

    def end(*words: str) -> tuple[int, str]:
        command = [sys.executable, str(tmp_path / "program.py"), *words]
        result = subprocess.run(command, capture_output=True, text=True)
        return result.returncode, result.stderr

    assert end() == (1, "error: matplotlib is not installed: pip install 'aslip[train]'\n")
    assert end("other")[1].count("Traceback") == 1

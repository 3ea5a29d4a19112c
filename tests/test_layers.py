"""Imports between the rooms of the package, and imports of libraries.

Read from the source, so that an import inside a function counts, too. Libraries are followed
through files of the package; what they themselves import is not: TorchRL loads MuJoCo.
"""

from __future__ import annotations

import ast
import functools
import subprocess
import symtable
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "aslip"

# room -> rooms that it may import in addition to itself and the rooms that all may import
_BELOW_ALL = {"errors", "base"}
_MAY_IMPORT: dict[str, set[str]] = {
    "errors": set(),
    "base": set(),
    "programs": set(),
    "__main__": {"programs"},
    "robot": set(),
    "rom": set(),
    "ik": {"robot", "estimation"},
    "library": {"robot", "rom", "ik"},
    "estimation": {"robot"},
    "sim": {"robot"},
    "planning": {"robot", "rom"},
    "transforms": {"robot", "ik", "library", "estimation", "sim", "planning"},
    "envs": {"robot", "library", "estimation", "sim", "planning", "transforms"},
    "policy": {"robot", "library", "transforms", "envs"},
    "control": {"robot", "library", "estimation", "planning", "transforms", "policy"},
    "training": {"robot", "sim", "transforms", "policy", "envs"},
    "walking": {"robot", "library", "transforms", "policy", "envs"},
    "show": {"robot", "rom", "library", "sim", "transforms", "policy", "envs"}
    | {"training", "walking"},
    "log": {"robot", "library", "estimation", "sim", "transforms", "policy", "envs"}
    | {"training", "walking", "show"},
    "network": {"robot", "library", "estimation", "sim", "planning", "policy", "control", "show"}
    | {"log"},
}
# libraries with a long import time
_HEAVY = {
    "torch",
    "torchrl",
    "tensordict",
    "mujoco",
    "casadi",
    "pinocchio",
    "dm_control",
    "pydrake",
    "warp",
    "mujoco_warp",
}
# simulations on a device, whose states are tensors
_ON_DEVICE, _OF_DEVICES = PACKAGE / "sim" / "warp", {"torch", "warp", "mujoco_warp"}
# room -> libraries that it must not import
_FOREIGN = {
    "errors": _HEAVY,
    "programs": _HEAVY,
    "__main__": _HEAVY,
    "base": _HEAVY - {"torch", "tensordict"},
    "robot": _HEAVY - {"mujoco"},
    "rom": _HEAVY - {"casadi"},
    "ik": _HEAVY - {"pinocchio"},
    "library": {"mujoco", "dm_control", "torchrl"},
    "estimation": _HEAVY,
    "planning": _HEAVY,
    "sim": _HEAVY - {"mujoco", "pydrake"},
    "transforms": {"mujoco", "casadi", "pinocchio", "dm_control"},
    "envs": {"casadi", "pinocchio"},
    **dict.fromkeys(
        ("policy/file", "policy/networks", "policy/symmetry", "control/controller"),
        frozenset({"mujoco", "casadi", "pinocchio", "dm_control"}),
    ),
    "control/exported": _HEAVY,
    "network/wire": _HEAVY,
    **dict.fromkeys(
        ("network/twin/robot", "network/twin/real_time"), _HEAVY - {"mujoco", "pydrake"}
    ),
}


def _names(node: ast.AST) -> set[str]:
    """Full names of the modules and objects that a statement imports."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, ast.unparse(node)
        return {f"{node.module}.{alias.name}" for alias in node.names}
    return set()


def _for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


@functools.cache
def _imports(path: Path) -> frozenset[str]:
    """Full names of the modules and objects that a file imports anywhere."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return frozenset().union(*map(_names, ast.walk(tree)))


@functools.cache
def _run(path: Path, late: bool) -> frozenset[str]:
    """Names that a file imports when it is loaded; `late`: and when its functions are called."""
    waiting: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    found: set[str] = set()
    while waiting:
        node = waiting.pop()
        found |= _names(node)
        if late or not isinstance(node, ast.FunctionDef):
            waiting += [child for child in ast.iter_child_nodes(node) if not _for_types(child)]
    return frozenset(found)


@functools.cache
def _files_of(name: str) -> frozenset[Path]:
    """Files of the package that an import of a module or object loads."""
    found: set[Path] = set()
    parts = name.split(".")
    for end in range(1, len(parts) + 1):
        module = ROOT.joinpath(*parts[:end])
        found |= {p for p in (module / "__init__.py", module.with_suffix(".py")) if p.is_file()}
    # a package lists the modules of its lazy names for type checkers
    package = ROOT.joinpath(*parts[:-1]) / "__init__.py"
    for full in _imports(package) if package.is_file() and package not in found - {package} else ():
        if full.split(".")[-1] == parts[-1] and full != name:
            found |= _files_of(full)
    return frozenset(found)


@functools.cache
def _loads(path: Path, late: bool = False) -> dict[Path, frozenset[str]]:
    """Files of the package that a file loads in turn -> names that each of them imports."""
    names: dict[Path, frozenset[str]] = {}
    waiting = {path: late}
    while waiting:
        file, also = waiting.popitem()
        names[file] = _run(file, also)
        new = {
            other for name in names[file] if name.startswith("aslip") for other in _files_of(name)
        }
        waiting |= dict.fromkeys(new - names.keys(), False)
    return names


def _room(path: Path) -> str:
    """Room or module of the top level that a file belongs to."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def _rooms_imported(path: Path) -> set[str]:
    """Rooms that a file imports."""
    ours = {name.split(".")[1] for name in _imports(path) if name.startswith("aslip.")}
    return ours & set(ROOMS)


FILES = sorted(PACKAGE.rglob("*.py"))
ROOMS = sorted({_room(path) for path in FILES})


def test_every_room_is_known() -> None:
    """A new room needs a line in `_MAY_IMPORT`."""
    assert set(ROOMS) <= {*_MAY_IMPORT, "__init__"}


@pytest.mark.parametrize("room", [name for name in ROOMS if name in _MAY_IMPORT])
def test_a_room_imports_only_rooms_below_it(room: str) -> None:
    allowed = _MAY_IMPORT[room] | _BELOW_ALL | {room}
    wrong = {
        f"{path.relative_to(ROOT)} imports aslip.{other}"
        for path in FILES
        if _room(path) == room
        for other in _rooms_imported(path) - allowed
    }
    assert not wrong


@pytest.mark.parametrize("room", _FOREIGN)
def test_no_room_imports_forbidden_libraries(room: str) -> None:
    place = PACKAGE / room
    wrong = {
        f"{path.relative_to(ROOT)} imports {name}"
        + f" by way of {via.relative_to(ROOT)}" * (via != path)
        for path in FILES
        if path.is_relative_to(place) or path == place.with_suffix(".py")
        for via, names in _loads(path, True).items()
        for name in names
        if name.split(".")[0]
        in _FOREIGN[room] - (_OF_DEVICES if path.is_relative_to(_ON_DEVICE) else set())
    }
    assert not wrong


def test_the_rooms_have_no_cycle() -> None:
    graph = {
        room: {o for p in FILES if _room(p) == room for o in _rooms_imported(p)}
        - {room, "__init__"}
        for room in ROOMS
        if room != "__init__"
    }
    while free := {room for room, below in graph.items() if not below}:
        graph = {room: below - free for room, below in graph.items() if room not in free}
    assert not graph


def test_files_import_each_other_in_one_direction() -> None:
    """Late imports inside functions, too."""
    graph = {
        path: {
            other
            for name in _run(path, True)
            if name.startswith("aslip")
            for other in _files_of(name)
        }
        - {path, PACKAGE / "__init__.py", path.parent / "__init__.py"}
        for path in FILES
    }
    while free := {path for path, below in graph.items() if not below}:
        graph = {path: below - free for path, below in graph.items() if path not in free}
    assert not graph


def test_no_file_of_the_package_imports_recipes_benchmarks_or_tests() -> None:
    for path in FILES:
        top = {name.split(".")[0] for name in _imports(path)}
        assert not top & {"recipes", "benchmarks", "tests"}, path


def test_no_room_imports_private_names_of_another() -> None:
    for path in FILES:
        for name in _imports(path):
            parts = name.split(".")
            if parts[0] == "aslip" and any(p.startswith("_") and p != "__version__" for p in parts):
                assert parts[1] == _room(path), f"{path} imports {name}"


_ESTIMATION = """from aslip.estimation import StateEstimator
estimator = StateEstimator()
estimator.start(np.full((2, 1, estimator.robot.packet_size), np.nan))"""
_LOOK_UP = """import aslip, torch
aslip.GaitLibrary.load().lookup(torch.zeros(1, 1), torch.zeros(1, 1))"""
_CONTROL = {
    "import aslip; aslip.__version__": (),
    "import numpy as np, aslip.rom; aslip.rom.PendulumWalk().sample(np.zeros(1))": (),
    "from aslip.planning import Planner; Planner()": (),
    "from aslip.network.wire import Link": (),
    "from aslip.network.runner.__main__ import main": (),
    _ESTIMATION: ("numba", "scipy"),
    "from aslip.ik import LegTable; LegTable()": ("numba", "scipy"),
}


@pytest.mark.parametrize(
    "steps",
    [
        _CONTROL,
        {"from aslip.rom import optimize_gait": ("casadi", "scipy")},
        {"from aslip.ik import solve": ("pinocchio", "scipy")},
        {_LOOK_UP: ("torch", "tensordict")},
    ],
    ids=["control", "rom", "ik", "library"],
)
def test_parts_load_only_the_libraries_that_they_need(steps: dict[str, tuple[str, ...]]) -> None:
    """Statements of one program, and the slow libraries that each may load."""
    script = "import sys\n" + "".join(
        f"{code}\nprint(*sorted({{m.split('.')[0] for m in sys.modules}}))\n" for code in steps
    )
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    for (code, needed), loaded in zip(steps.items(), result.stdout.splitlines(), strict=True):
        assert set(loaded.split()) & (_HEAVY | {"numba", "scipy"}) <= {*needed}, code


def test_modules_have_the_names_that_stubs_take_from_them() -> None:
    stubs = sorted(PACKAGE.rglob("__init__.pyi"))
    assert len(stubs) > 10
    for stub in stubs:
        for node in ast.parse(stub.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                file = stub.with_name(f"{node.module}.py")
                if not file.is_file():
                    continue  # a package, whose own stub is checked
                table = symtable.symtable(file.read_text(encoding="utf-8"), str(file), "exec")
                for name in (alias.name for alias in node.names):
                    assert name in table.get_identifiers(), f"{stub} takes {name} from {file}"
                    found = table.lookup(name)
                    assert found.is_assigned() or found.is_imported(), f"{file} lacks {name}"


def test_an_unknown_public_name_lists_the_known_ones() -> None:
    import aslip

    with pytest.raises(AttributeError, match="make_env"):
        _ = aslip.make_enviroment
    for name in aslip.__all__:
        assert getattr(aslip, name) is not None

"""Who may import whom; read from the source, so that an import inside a function counts, too."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "aslip"

# each room may import those listed, itself, and those that stand below everything
_BELOW_ALL = {"errors", "files"}
_MAY_IMPORT: dict[str, set[str]] = {
    "errors": set(),
    "files": set(),
    "robot": set(),
    "rom": set(),
    "ik": {"robot"},
    "library": {"robot", "rom", "ik"},
    "estimation": {"robot"},
    "sim": {"robot"},
    "transforms": {"robot", "library", "estimation", "sim"},
    "policy": {"robot", "transforms"},
    "control": {"robot", "library", "estimation", "transforms", "policy"},
    "envs": {"robot", "library", "estimation", "sim", "transforms", "policy"},
    "training": {"robot", "sim", "policy", "envs"},
    "walking": {"robot", "library", "transforms", "policy", "envs", "control"},
    "show": {"robot", "rom", "library", "transforms", "policy", "envs", "walking"},
    "log": {"robot", "library", "estimation", "sim", "transforms", "policy", "envs", "control"}
    | {"training", "walking", "show"},
}
_HEAVY = {"torch", "torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"}
_FOREIGN = {
    "errors": _HEAVY,
    "files": _HEAVY,
    "robot": _HEAVY - {"mujoco"},
    "rom": _HEAVY - {"casadi"},
    "ik": _HEAVY - {"pinocchio"},
    "library": {"mujoco", "dm_control", "torchrl"},
    "sim": _HEAVY - {"mujoco"},
    "envs": {"casadi", "pinocchio"},
    "transforms": {"mujoco", "casadi", "pinocchio", "dm_control"},
}


def _imports(path: Path) -> set[str]:
    """Full names of all modules a file imports, and of what it imports from them."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in {path}"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def _layer(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def _own_layers(path: Path) -> set[str]:
    """Layers of this package that a file imports."""
    ours = {name.split(".")[1] for name in _imports(path) if name.startswith("aslip.")}
    known = {_layer(p) for p in PACKAGE.rglob("*.py")}
    return ours & known


FILES = sorted(PACKAGE.rglob("*.py"))
LAYERS = sorted({_layer(path) for path in FILES})


def test_every_room_is_known() -> None:
    """A new room must be given its place here."""
    assert set(LAYERS) <= {*_MAY_IMPORT, "__init__"}


@pytest.mark.parametrize("layer", [name for name in LAYERS if name in _MAY_IMPORT])
def test_a_layer_imports_only_what_lies_below_it(layer: str) -> None:
    allowed = _MAY_IMPORT[layer] | _BELOW_ALL | {layer}
    wrong = {
        f"{path.relative_to(ROOT)} imports aslip.{other}"
        for path in FILES
        if _layer(path) == layer
        for other in _own_layers(path) - allowed
    }
    assert not wrong


@pytest.mark.parametrize("layer", [name for name in LAYERS if name in _FOREIGN])
def test_a_layer_keeps_off_the_libraries_of_others(layer: str) -> None:
    wrong = {
        f"{path.relative_to(ROOT)} imports {name}"
        for path in FILES
        if _layer(path) == layer
        for name in _imports(path)
        if name.split(".")[0] in _FOREIGN[layer]
    }
    assert not wrong


def test_the_layers_have_no_cycle() -> None:
    graph = {
        layer: {o for p in FILES if _layer(p) == layer for o in _own_layers(p)}
        - {layer, "__init__"}
        for layer in LAYERS
        if layer != "__init__"
    }
    while free := {layer for layer, below in graph.items() if not below}:
        graph = {layer: below - free for layer, below in graph.items() if layer not in free}
    assert not graph


def test_no_file_of_the_package_imports_recipes_benchmarks_or_tests() -> None:
    for path in FILES:
        top = {name.split(".")[0] for name in _imports(path)}
        assert not top & {"recipes", "benchmarks", "tests"}, path


def test_nothing_is_imported_from_another_layers_private_names() -> None:
    for path in FILES:
        for name in _imports(path):
            parts = name.split(".")
            if parts[0] == "aslip" and any(p.startswith("_") and p != "__version__" for p in parts):
                assert parts[1] == _layer(path), f"{path} imports {name}"


def _loaded_after(code: str) -> set[str]:
    """Top-level modules in a new interpreter after some code."""
    script = f"{code}\nimport sys; print(*sorted({{m.split('.')[0] for m in sys.modules}}))"
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return set(result.stdout.split())


def test_the_package_alone_imports_nothing_heavy() -> None:
    loaded = _loaded_after("import aslip; aslip.__version__")
    assert "aslip" in loaded
    assert not loaded & {"torch", "torchrl", "mujoco", "casadi", "pinocchio", "dm_control"}


def test_the_reduced_order_model_needs_neither_torch_nor_mujoco() -> None:
    loaded = _loaded_after("import aslip.rom; import aslip; aslip.Gait")
    assert "casadi" in loaded
    assert not loaded & {"torch", "torchrl", "tensordict", "mujoco", "pinocchio", "dm_control"}


def test_the_inverse_kinematics_needs_pinocchio_only() -> None:
    loaded = _loaded_after("import aslip.ik")
    assert "pinocchio" in loaded
    assert not loaded & {"torch", "torchrl", "tensordict", "mujoco", "casadi", "dm_control"}


def test_an_unknown_public_name_lists_the_known_ones() -> None:
    import aslip

    with pytest.raises(AttributeError, match="make_env"):
        _ = aslip.make_enviroment
    for name in aslip.__all__:
        assert getattr(aslip, name) is not None

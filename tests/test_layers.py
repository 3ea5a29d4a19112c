"""Who may import whom; read from the source, so that an import inside a function counts, too."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "aslip"

# each layer may import those listed, itself, and those that stand below everything
_BELOW_ALL = {"errors", "assets", "files", "archive", "settings"}
_MAY_IMPORT = {
    "errors": set(),
    "assets": set(),
    "files": set(),
    "settings": set(),
    "cli": set(),
    "ppo_settings": {"cassie", "cli"},
    "archive": set(),
    "cassie": set(),
    "rom": set(),
    "ik": {"cassie"},
    "library": {"cassie", "rom", "ik"},
    "sim": {"cassie"},
    "task": {"cassie", "sim"},
    "envs": {"cassie", "sim", "task"},
    "palette": set(),
    "rewards": set(),
    "single_reference": {"cassie"},
    "metrics": {"cassie"},
    "estimation": {"cassie"},
    "transforms": {"cassie", "sim", "task", "library", "estimation", "rewards"},
}
_TOP = {"stack", "policy", "evaluation", "run", "tables", "plots", "render", "symmetry"}
_TOP |= {"checkpoint", "provenance", "collect", "ghost", "walker", "walks", "video", "log", "live"}
_TOP |= {"__init__", "pacing"}
_FOREIGN = {
    "errors": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"},
    "assets": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"},
    "files": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"},
    "settings": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"},
    "cli": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"},
    "ppo_settings": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "dm_control"},
    "archive": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"},
    "cassie": {"torch", "torchrl", "tensordict", "casadi", "pinocchio", "dm_control"},
    "rom": {"torch", "torchrl", "tensordict", "mujoco", "pinocchio", "dm_control"},
    "ik": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "dm_control"},
    "library": {"mujoco", "dm_control", "torchrl"},
    "sim": {"torch", "torchrl", "tensordict", "casadi", "pinocchio", "dm_control"},
    "task": {"torch", "torchrl", "tensordict", "casadi", "pinocchio"},
    "envs": {"casadi", "pinocchio"},
    "metrics": {"torch", "torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"},
    "single_reference": {"torchrl", "tensordict", "casadi", "pinocchio", "dm_control"},
    "rewards": {"torchrl", "tensordict", "mujoco", "casadi", "pinocchio", "dm_control"},
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


def test_every_layer_is_known() -> None:
    """A new folder or module must be given its place here."""
    assert set(LAYERS) <= set(_MAY_IMPORT) | _TOP


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


def test_only_transforms_and_what_uses_them_join_gaits_and_environments() -> None:
    joining = {_layer(p) for p in FILES if {"library", "envs"} <= _own_layers(p)}
    assert joining <= _TOP | {"transforms"}


def test_the_layers_have_no_cycle() -> None:
    """Between the modules at the top, too."""
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

"""Train, walk, measure and control from one command: `aslip` or `python -m aslip`."""

from __future__ import annotations

import ast
import runpy
import sys
from collections.abc import Mapping
from typing import Final

from aslip.base.command_line import prepare_program, set_program, usage_error
from aslip.programs import PROGRAMS

COMMANDS: Final = {
    "train": ("recipes.ppo_aslip", "train a policy to walk straight ahead"),
    "train directions": ("recipes.ppo_directions", "train a policy to walk in all directions"),
    "train stones": ("recipes.stepping_stones", "train a policy to step where a planner says"),
    "train sac": ("recipes.sac_aslip", "train a policy by SAC instead of PPO"),
    "walk": ("recipes.walk", "walk with a policy: film, log, numbers"),
    "live": ("recipes.walk", "watch and steer a robot in the browser: walk --live"),
    "measure": ("benchmarks", "run a benchmark; without a name, list them"),
    "ablate": ("recipes.ablate", "train and compare variants of a stack"),
    "card": ("recipes.policy_card", "make the card of a policy"),
    "gaits": ("recipes.gait_library", "optimise gaits straight ahead"),
    "gaits directions": ("recipes.direction_library", "optimise gaits in all directions"),
    "log": ("aslip.log", "list, check, export, recover and replay logs"),
    "export": ("aslip.control.export", "export a policy to ONNX"),
    "twin": ("aslip.network.twin", "simulate the robot behind its network protocol"),
    "control": ("aslip.network.runner", "run a policy over the robot's network protocol"),
}
"""Command -> program, and what it does."""


def main() -> None:
    """Run the program that the first words of the command line name."""
    prepare_program()
    set_program("aslip")
    words = sys.argv[1:]
    if words[:1] == ["live"]:
        words[:1] = ["walk", "--live"]
    name = next((n for n in (" ".join(words[:2]), *words[:1]) if n in COMMANDS), None)
    if name is None:
        if words and words[0] not in ("-h", "--help"):
            usage_error(f"no command {words[0]!r}; there are {', '.join(COMMANDS)}")
        print(_overview("COMMAND", {name: text for name, (_, text) in COMMANDS.items()}))
        return
    module, rest = COMMANDS[name][0], words[len(name.split()) :]
    if name == "measure":
        benchmarks = _benchmarks()
        if not rest or rest[0] in ("-h", "--help"):
            print(_overview("measure BENCHMARK", benchmarks))
            return
        if rest[0] not in benchmarks:
            usage_error(f"no benchmark {rest[0]!r}; there are {', '.join(benchmarks)}")
        module, name, rest = f"{module}.{rest[0]}", f"{name} {rest[0]}", rest[1:]
    set_program(f"aslip {name}")
    sys.argv[1:] = rest
    if module.startswith("recipes."):
        # recipes import one another by name, as scripts do
        sys.path.insert(0, str(PROGRAMS / "recipes"))
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _overview(what: str, lines: Mapping[str, str]) -> str:
    """Text for `--help`: a line for each command."""
    width = max(map(len, lines))
    listed = "\n".join(f"  {name.ljust(width)}  {text}" for name, text in lines.items())
    return f"usage: aslip {what} [options]\n\n{listed}\n\nfor all options: aslip {what} --help"


def _benchmarks() -> dict[str, str]:
    """Names of the programs in `benchmarks`, and the first line of their docstrings."""
    found = {}
    for path in sorted((PROGRAMS / "benchmarks").glob("*/*.py")):
        text = path.read_text(encoding="utf-8")
        if '__name__ == "__main__"' in text:
            name = f"{path.parent.name}.{path.stem}"
            found[name] = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
    return found


if __name__ == "__main__":
    main()

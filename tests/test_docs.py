"""Pages: snippets run, commands parse, links and names resolve."""

import contextlib
import importlib
import linecache
import re
import shlex
import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import aslip
from aslip.base.command_line import command_line, preset_command_line
from aslip.envs import directions_stack
from aslip.log import Recorder
from aslip.log.__main__ import main as log_main
from benchmarks.scorecard.learning_curves import report
from benchmarks.scorecard.learning_record import read_record
from docs import diagrams
from recipes.ppo_settings import PRESETS
from tests.library.standing import standing_library

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]

_FENCED = re.compile(r"^```.*?^```$", flags=re.DOTALL | re.MULTILINE)

# numbers on the pages -> smaller numbers for tests
_LITTLE = "total_steps=64, num_envs=8, samples=64, minibatch=32, eval_steps=5"
_SMALLER = {
    "total_steps=300_000": _LITTLE,
    "range(100)": "range(10)",
    "total_timesteps=2048": "total_timesteps=128",
    "speeds=(0.5, 1.0)": "speeds=(0.5, 1.0), settle=0.3, walk=1.2",
}
# programs outside this repository
_FOREIGN = {"pip", "ray", "rerun", "plotjuggler", "ruff", "pyright"} | {
    "tensorboard", "wandb", "mlflow",
}  # fmt: skip
# recipes that have presets
_PRESETS_OF = {
    "recipes.ppo_aslip": "PRESETS",
    "recipes.ppo_directions": "DIRECTION_PRESETS",
    "recipes.stepping_stones": "PRESETS",
    "recipes.ablate": "TASKS",
}


# ------------------------------------------------------------------------- pages


@dataclass(frozen=True)
class Section:
    """Part of a page from one heading to the next."""

    heading: str
    text: str
    """Text without the heading, blocks of code included."""

    @property
    def anchor(self) -> str:
        """Anchor of the heading, as GitHub makes it."""
        return re.sub(r"[^\w\- ]", "", self.heading.lower()).replace(" ", "-")


def page_name(page: Path) -> str:
    """Path from the root of the repository."""
    return str(page.relative_to(ROOT))


def prose(text: str) -> str:
    """Text without its blocks of code."""
    return _FENCED.sub("", text)


def blocks(text: str, language: str) -> list[tuple[int, str]]:
    """First line number and content of each block of code."""
    found = re.finditer(rf"^```{language}\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    return [(text[: match.start(1)].count("\n"), match[1]) for match in found]


def sections(text: str) -> list[Section]:
    """Sections in order; lines within blocks of code are not headings."""
    # blanked blocks of code keep their length, so that positions stay valid
    blank = _FENCED.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    found = [*re.finditer(r"^#+ +(.*)$", blank, flags=re.MULTILINE)]
    ends = [match.start() for match in found[1:]] + [len(text)]
    return [
        Section(match[1].strip(), text[match.end() : end])
        for match, end in zip(found, ends, strict=True)
    ]


def links(text: str) -> list[str]:
    """Targets of links and pictures, except for web addresses."""
    return re.findall(r"\]\((?!https?:)([^)\s]+)\)", prose(text))


def commands(text: str) -> list[list[str]]:
    """Words of each shell command, without comments and environment variables.

    Commands are lines of blocks of shell, and code of running text that starts with `python `.
    """
    lines = [
        line
        for _, block in blocks(text, "bash")
        for line in block.replace("\\\n", " ").splitlines()
    ]
    lines += re.findall(r"`((?:[A-Z_]+=\S+\s)*python\s[^`]+)`", prose(text))
    found = []
    for line in lines:
        for command in re.split(r"\s&&\s", _braces(line)):
            words = shlex.split(command, comments=True)
            while words and re.match(r"[A-Z_]+=", words[0]):
                words.pop(0)
            if words:
                found.append(words)
    return found


def _braces(line: str) -> str:
    """Expand the first `{a,b}` of a line, as a shell does."""
    return re.sub(
        r"(\S*)\{([\w,]+)\}",
        lambda match: " ".join(match[1] + item for item in match[2].split(",")),
        line,
    )


every_page = pytest.mark.parametrize("page", PAGES, ids=page_name)


# ------------------------------------------------------------------------ Python


def _program(page: Path) -> str:
    """All Python blocks of a page, on the lines that they have there."""
    lines: list[str] = []
    for start, code in blocks(page.read_text(), "python"):
        lines += [""] * (start - len(lines)) + code.splitlines()
    return "\n".join(lines) + "\n"


def _small(code: str) -> str:
    """Code with smaller trainings and fewer robots."""
    code = re.sub(r"\b64\b", "4", code)
    for large, small in _SMALLER.items():
        code = code.replace(large, small)
    return code


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Working folder of a page's programs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _record(path: Path) -> None:
    """Write a short log, as `recipes/walk.py --log` does."""
    stack = {**aslip.default_stack(), "recorder": Recorder(path, policy="straight")}
    with contextlib.closing(aslip.make_env(stack=stack, num_threads=1, seed=0)) as env:
        env.rollout(4, aslip.load_policy("straight"))


@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page.read_text(), "python")], ids=page_name
)
def test_the_python_blocks_of_a_page_run_in_order(page: Path, folder: Path) -> None:
    code = _program(page)
    if "walk.mcap" in code and "Recorder(" not in code:
        _record(folder / "walk.mcap")
    code = _small(code)
    linecache.cache[page_name(page)] = (
        len(code),
        None,
        code.splitlines(keepends=True),
        page_name(page),
    )
    exec(compile(code, page_name(page), "exec"), {"__name__": "__docs__"})


# ------------------------------------------------------------------------- shell


def _options(arguments: list[str]) -> list[str]:
    """Arguments without `--resume`, which needs a run in the folder."""
    return [word for word in arguments if word != "--resume"]


@pytest.mark.parametrize(
    "page", [page for page in PAGES if commands(page.read_text())], ids=page_name
)
def test_commands_of_a_page_have_valid_programs_and_options(page: Path) -> None:
    """Settings are parsed and checked; no program runs."""
    for words in commands(page.read_text()):
        if words[0] not in _FOREIGN and words[1:3] != ["-m", "pytest"]:
            assert words[0] == "python", words
            _check_arguments(words)


def _check_arguments(words: list[str]) -> None:
    """Parse the arguments of `python` as the named program would.

    Raises:
        SystemExit: an option or its value is wrong.
    """
    if words[1] == "-c":
        compile(words[2], "command", "exec")
    elif words[1:3] == ["-m", "aslip.log"]:
        with pytest.raises(SystemExit, match="0"):
            log_main([*words[3:], "--help"])
    else:
        assert words[1] == "-m" or (ROOT / words[1]).is_file(), words
        module, arguments = (words[2], words[3:]) if words[1] == "-m" else (words[1], words[2:])
        module = module.removesuffix(".py").replace("/", ".")
        if "--help" in arguments:
            return
        if module in _PRESETS_OF:
            presets = getattr(importlib.import_module(module), _PRESETS_OF[module])
            preset_command_line(presets, {}, _options(arguments))
        else:
            command_line(_settings(module), arguments=_options(arguments))


def _settings(module: str) -> Any:
    """Class of the settings of a recipe or benchmark."""
    for name in (module, f"{module}.__main__", f"{module}.config"):
        with contextlib.suppress(ModuleNotFoundError, AttributeError):
            return importlib.import_module(name).Config
    raise AssertionError(f"{module} has no settings")


def test_commands_of_logs_work_on_a_log(folder: Path) -> None:
    """All commands of the page, in order."""
    _record(folder / "walk.mcap")
    ran = 0
    for words in commands((DOCS / "logs.md").read_text()):
        if words[1:3] == ["-m", "aslip.log"]:
            if words[-1].endswith(".part"):
                shutil.copy("walk.mcap", words[-1])
            assert log_main(words[3:]) == 0, words
            ran += 1
    assert ran == 5


def test_every_named_policy_ships_or_is_trained_on_a_page() -> None:
    """A policy either ships or is made by another command of the pages."""
    made, named = {"runs/ppo_aslip", "runs/ppo_directions", "runs/learning_curves"}, set()
    for words in (words for page in PAGES for words in commands(page.read_text())):
        for i, word in enumerate(words):
            if word == "--out":
                made.add(words[i + 1])
            if word in {"--policy", "--policies", "--paper", "--baseline", "--run"}:
                for policy in words[i + 1 :]:
                    if policy.startswith("--"):
                        break
                    named.add(policy.rpartition("=")[2])  # or method=policy
    shipped = {path.stem for path in (ROOT / "assets" / "policies").glob("*.zip")}
    unknown = [
        policy
        for policy in named - shipped
        if policy not in made and str(Path(policy).parent) not in made
    ]
    assert len(named) >= 5
    assert unknown == []


# ------------------------------------------------------------------- links, names


def _anchors(page: Path) -> set[str]:
    return {section.anchor for section in sections(page.read_text())}


@every_page
def test_every_link_leads_somewhere(page: Path) -> None:
    wrong = []
    for link in links(page.read_text()):
        target, _, anchor = link.partition("#")
        file = (page.parent / target).resolve() if target else page
        if not file.exists() or (anchor and anchor not in _anchors(file)):
            wrong.append(link)
    assert wrong == []


@every_page
def test_every_named_path_exists(page: Path) -> None:
    """Paths of the repository in backticks, also those of a test or class in a file."""
    rooms = "aslip|recipes|benchmarks|tests|assets|docs"
    paths = re.findall(rf"`((?:{rooms})/[\w./-]*)", prose(page.read_text()))
    assert [path for path in paths if not (ROOT / path).exists()] == []


@every_page
def test_every_named_object_exists(page: Path) -> None:
    """Dotted names of the package in backticks."""
    for name in re.findall(r"`((?:aslip|benchmarks)(?:\.\w+)+)", prose(page.read_text())):
        found, parts = None, name.split(".")
        for i in range(len(parts), 0, -1):
            with contextlib.suppress(ModuleNotFoundError):
                found = importlib.import_module(".".join(parts[:i]))
                for attribute in parts[i:]:
                    found = getattr(found, attribute)
                break
        assert found is not None, name


def test_the_index_lists_every_page() -> None:
    listed = {link for link in links((DOCS / "index.md").read_text()) if link.endswith(".md")}
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    assert pages - listed == {"index.md"}


def test_every_picture_is_on_a_page_and_described() -> None:
    shown = {
        (page.parent / target).resolve(): text
        for page in PAGES
        for text, target in re.findall(r"!\[([^]]*)\]\(([^)]+)\)", page.read_text())
    }
    assert set((DOCS / "images").iterdir()) - shown.keys() == set()
    assert [path for path, text in shown.items() if len(text) < 10] == []


def test_the_picture_of_the_stack_names_every_transform() -> None:
    assert {*aslip.default_stack(), *directions_stack(standing_library())} == diagrams.NAMES


def test_settings_on_the_page_of_differences_are_those_of_the_presets() -> None:
    """Code such as `gamma=0.95` in the columns of the default and of the preset `paper`."""
    columns = {"What only the default changes": {1: "default", 2: "paper"}}
    columns["What the preset `paper` keeps"] = {3: "paper"}
    compared = 0
    for section in sections((DOCS / "differences.md").read_text()):
        for row in re.findall(r"^\|(.*)\|$", section.text, flags=re.MULTILINE):
            for column, preset in columns.get(section.heading, {}).items():
                for setting, value in re.findall(r"`(\w+)=([\d.e-]+)`", row.split("|")[column]):
                    assert getattr(PRESETS[preset], setting) == float(value), (preset, setting)
                    compared += 1
    assert compared >= 18


# ------------------------------------------------------------------------ README


def test_the_readme_names_the_versions_of_python_that_can_be_installed() -> None:
    """Also for uv, which ignores the upper bound of requires-python."""
    readme = (ROOT / "README.md").read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    classified = [c.rpartition(".")[2] for c in project["classifiers"] if " :: 3." in c]
    for minor in range(8, 20):
        version = f"3.{minor}"
        admitted = version in SpecifierSet(project["requires-python"])
        assert admitted == (11 <= minor <= 14) == (str(minor) in classified)
        found = [Requirement(text) for text in project["dependencies"]]
        needed = {
            requirement.name: requirement.specifier
            for requirement in found
            if not requirement.marker or requirement.marker.evaluate({"python_version": version})
        }
        assert ("dm-control" in needed) == (minor < 13)
        assert (needed["numpy"] == SpecifierSet("<0")) == (minor > 14)
    assert "Python 3.11 to 3.14" in readme
    assert "| 3.11 | all tests (CI) |" in readme
    assert "python3.11" in (ROOT / ".ci" / "run").read_text()


def test_the_map_names_every_room() -> None:
    rooms = {path.name for path in (ROOT / "aslip").iterdir() if (path / "__init__.py").is_file()}
    architecture = (DOCS / "architecture.md").read_text()
    assert {room for room in rooms if f"`aslip/{room}`" not in architecture} == set()


def test_the_table_of_learning_curves_is_that_of_the_record() -> None:
    runs, page = read_record(DOCS / "learning_curves.csv"), (DOCS / "learning.md").read_text()
    table = re.findall(r"^\| (\w+) \| (\d+) \|.*\n", page, re.MULTILINE)
    printed = report([runs[variant, int(seed)] for variant, seed in table]).splitlines()[2:]
    assert len(table) >= 10
    assert [row for row in printed if row not in page] == []

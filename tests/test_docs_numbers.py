"""Measured numbers of README, CONTRIBUTING and docs/ are next to a command that reproduces them.

A section, from one heading to the next, with a measured number must have one of

- a command: in a block of shell, or in running text as code that starts with `python`,
- a block of Python that prints (the tests run them),
- in the lab book only, the commit of an entry whose script was not kept,
- a link to a section that has one of these.

Measured numbers are decimals, numbers with a unit, counts such as "18 of 20", multiples such as
"twice", returns and lengths of episodes, and cells of tables. Numbers in code, numbers that the
sentence attributes to the paper, and the constants below do not count.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.learning_curves import report
from benchmarks.learning_record import read_record
from tests.pages import DOCS, PAGES, blocks, commands, links, page_name, prose, sections

LAB_BOOK = DOCS / "lab"

CONSTANTS = (
    r"33 Hz", r"[12] kHz", r"(30|0\.5|1) ms", r"12 s\b", r"3 s of an episode",
    r"95 % (confidence|of commands)", r"from 0 to 2 m/s", r"steps of 0\.1 m/s",
    r"(Python|CPython|torch|torchrl)( \d\.\d+(\.\d+)?( or \d\.\d+)?)?", r"\b3\.1[123]\b",
    r"1\.5 million policy steps", r"6\.25 million policy steps",
)  # fmt: skip
"""Rates, durations and ranges that were chosen, not measured; versions."""

_UNIT = (
    r"(%|°|µs|ms|s|min|minutes?|seconds?|hours?|h|m/s|mm|cm|m|rad|N|kg|Hz|k|M|million|thousand|"
    r"[kM]B|[MG]iB|times)(?![\w/])"
)
_WORD = r"(two|three|four|five|six|seven|eight|nine|ten)"
_MEASURED = re.compile(
    rf"(?<![\w.])[-+]?\d+\.\d+(?![\w.]*\w)|(?<![\w.])\d[\d,.]*\s?{_UNIT}"
    r"|\d+ of (the )?\d+|\[[-\d.]+, [-\d.]+\]|\b\d+e-\d+"
    rf"|\b{_WORD} (times|seconds|minutes|hours)\b|\btwice\b|\bof {_WORD} seeds\b|\bevery seed\b"
    r"|\b([Rr]eturn(s|ed)?|[Ee]pisodes (of|last)|length)( is| of)? \d{2,}"
)
_CELL = re.compile(r"[-+±]?\d[\d.,]*( ?(%|\[.*\]|±.*|/.*|[a-zµ°].*))?")
_LITERATURE = re.compile(r"(in )?(the |its )?(paper|public code|released|authors)", re.IGNORECASE)
_ASIDE = re.compile(r"\((?:the )?(?:paper|Table II)\b[^()]*\)")
_PROGRAM = re.compile(r"recipes/|(-m )?(benchmarks|aslip\.(control|log|twin)|pytest)\b")
_ENTRY = re.compile(r"\bCommits? [0-9a-f]{7}\b")


def _statements(text: str) -> list[str]:
    """Sentences, list items and rows of tables, without code, comments and link targets."""
    text = re.sub(r"<!--.*?-->", "", prose(text), flags=re.DOTALL)
    text = re.sub(r"`[^`]*`|(?<=\])\([^)\s]*\)", "", text)
    found: list[str] = []
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", text):
        rows = [line for line in block.splitlines() if line.startswith("|")]
        running = " ".join(line for line in block.splitlines() if not line.startswith("|"))
        found += re.split(r"(?<=[.:;?!])\s+(?=[A-Z*\[])", running.strip())
        found += [row for row in rows if not re.fullmatch(r"[|:\- ]+", row)]
    return found


def measured(text: str) -> list[str]:
    """Measured numbers of a section, each with the statement that holds it."""
    found = []
    for statement in _statements(text):
        told = _ASIDE.sub("", statement)
        if _LITERATURE.match(told.lstrip("-* ")):
            continue
        for constant in CONSTANTS:
            told = re.sub(constant, "", told)
        cells = told.strip("|").split("|")[1:] if told.startswith("|") else []
        numbers = [cell for cell in map(str.strip, cells) if _CELL.fullmatch(cell)]
        numbers += [match[0] for match in _MEASURED.finditer(told)]
        found += [f"{number}: {statement}" for number in numbers[:1]]
    return found


def has_command(text: str) -> bool:
    """True for a section with a command that measures, or a block of Python that prints."""
    programs = (" ".join(words[1:3]) for words in commands(text) if words[0] == "python")
    prints = any("print(" in code for _, code in blocks(text, "python"))
    return prints or any(_PROGRAM.match(program) for program in programs)


def _supports(page: Path, text: str) -> bool:
    """True for a section with a command, or with an entry of the lab book."""
    return has_command(text) or bool(page.parent == LAB_BOOK and _ENTRY.search(text))


def _links_to_support(page: Path, link: str) -> bool:
    """True for a link to a section, by default the first of a page, that supports its numbers."""
    target, _, anchor = link.partition("#")
    file = (page.parent / target).resolve() if target else page
    if file.suffix != ".md" or not file.is_file():
        return False
    found = sections(file.read_text())
    section = next((section for section in found if section.anchor == anchor), found[0])
    return _supports(file, section.text)


def unsupported(page: Path, text: str) -> list[str]:
    """Measured numbers of a page's text without a command."""
    found = []
    for section in sections(text):
        linked = any(_links_to_support(page, link) for link in links(section.text))
        if not linked and not _supports(page, section.text):
            found += [f"{section.heading}: {number}" for number in measured(section.text)]
    return found


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_measured_number_is_beside_a_command(page: Path) -> None:
    text = page.read_text()
    assert text.startswith("# ")
    assert unsupported(page, text) == []


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_a_number_added_to_a_page_is_found(page: Path) -> None:
    added = "It walks at 0.97 m/s."
    for section in sections(page.read_text()):
        own = section.text
        if not any(["```" in own, commands(own), links(own), _ENTRY.search(own)]):
            text = f"# {section.heading}\n{own}\n\n{added}\n"
            assert f"{section.heading}: 0.97: {added}" in unsupported(page, text)
    text = f"{page.read_text()}\n## More\n\n{added}\n"
    assert unsupported(page, text)[-1] == f"More: 0.97: {added}"


@pytest.mark.parametrize(
    "statement",
    [
        "Walks last 3 s longer.", "It costs 4 %.", "The error is 1.3.", "18 of 20 hold.",
        "Returns are 375 [374, 376].", "It takes 21 minutes.", "- Memory: 5 MB.",
        "Evaluations return 369 after that.", "It learns three times as fast.",
        "Noise costs twice as much.", "The gap is 1e-13.", "Eight of ten seeds walk.",
        "| default | 0 | 396 |", "| feet | 2.3 [1.8, 2.8] cm |", "| noise | 95 % |",
        "![Feet within 3 cm](images/feet.png)", "It needs 300 k (paper: 25 million).",
        "Two seeds walk. The paper says 25 million. Ours walk after 0.3 million.",
    ],
)  # fmt: skip
def test_a_measured_number_needs_a_command(statement: str) -> None:
    page = f"# Title\n\n`python -m benchmarks.claims`\n\n## Section\n\n{statement}\n"
    assert len(unsupported(PAGES[0], page)) == 1
    for support in (
        "`MUJOCO_GL=egl python -m benchmarks.claims --policy\nmine`",
        "```bash\npython recipes/ppo_aslip.py\n```",
        "```python\nprint(0.97)\n```",
        "([there](docs/learning.md))",
    ):
        assert unsupported(PAGES[0], f"{page}\n{support}\n") == []
    for no_support in (
        "`python -c 1`", "```bash\npip install aslip\n```", "```python\nx = 1\n```",
        "Commit 58d4e3a.", "([there](LICENSE))",
    ):  # fmt: skip
        assert len(unsupported(PAGES[0], f"{page}\n{no_support}\n")) == 1


@pytest.mark.parametrize(
    "statement",
    [
        "The policy runs at 33 Hz, the loop at 2 kHz.", "It walks at any speed from 0 to 2 m/s.",
        "Python 3.11 or 3.12", "It needs `torchrl` 0.14.1.", "Set `std` to `0.15`.",
        "The paper trains for 175 million policy steps.", "Updates are larger (Table II: 5.1 k).",
        "| [Training](training.md) | several machines |", "Seeds 10 to 14, commit d79dbd9.",
        "See equation 3 and [1](docs/gaits.md).", "An episode has at most 400 policy steps, 12 s.",
    ],
)  # fmt: skip
def test_a_constant_needs_no_command(statement: str) -> None:
    assert unsupported(DOCS / "index.md", f"# Section\n\n{statement}\n") == []


def test_a_lab_book_entry_names_its_commit_in_the_lab_book_only() -> None:
    text = "# Try\n\nEpisodes last 350.\n\nCommit 58d4e3a.\n"
    page = LAB_BOOK / "straight.md"
    assert unsupported(page, text) == []
    assert len(unsupported(DOCS / "learning.md", text)) == 1
    assert len(unsupported(page, text.replace("58d4e3a", "somewhere"))) == 1


def test_each_page_of_the_lab_book_says_once_what_a_commit_alone_means() -> None:
    pages = {page: " ".join(page.read_text().split()) for page in LAB_BOOK.glob("*.md")}
    assert {page.name for page, text in pages.items() if text.count("not kept.") != 1} == set()


def test_no_page_places_the_default_above_the_paper() -> None:
    """This needs a run of six million policy steps with the paper's settings on record."""
    runs = read_record(DOCS / "learning_curves.csv")
    long_runs = [v for (v, _), run in runs.items() if v == "paper" and run.steps >= 6_000_000]
    for page in PAGES:
        text = " ".join(page.read_text().split())
        assert "to the letter" not in text, page
        assert long_runs or not re.search("(better|faster) than (in )?the paper", text), page


def test_table_of_learning_curves_is_that_of_the_record() -> None:
    runs = read_record(DOCS / "learning_curves.csv")
    table = re.findall(
        r"^\| (\w+) \| (\d+) \|.*\n", (DOCS / "learning.md").read_text(), re.MULTILINE
    )
    printed = report([runs[variant, int(seed)] for variant, seed in table]).splitlines()[2:]
    assert len(table) >= 10
    assert [row for row in printed if row not in (DOCS / "learning.md").read_text()] == []

"""Numbers of the pages that a record holds are those of the record."""

from __future__ import annotations

import re

from benchmarks.scorecard.learning_curves import report
from benchmarks.scorecard.learning_record import read_record
from tests.pages import DOCS, PAGES


def test_each_page_of_the_lab_book_says_once_what_a_commit_alone_means() -> None:
    pages = {page: " ".join(page.read_text().split()) for page in (DOCS / "lab").glob("*.md")}
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

"""README, CONTRIBUTING and pages of docs/: sections, blocks of code, commands and links."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]

_FENCED = re.compile(r"^```.*?^```$", flags=re.DOTALL | re.MULTILINE)


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

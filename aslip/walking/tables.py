"""Tables for people."""

from __future__ import annotations

from collections.abc import Sequence


def markdown(
    header: Sequence[str], rows: Sequence[Sequence[str]], align: str | Sequence[str] = "---:"
) -> str:
    """A Markdown table.

    Args:
        header: a name a column; may be empty.
        rows: as many cells each.
        align: Markdown's `"---"` (left) or `"---:"` (right), of all columns or of each.
    """
    marks = [align] * len(header) if isinstance(align, str) else align
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, marks, *rows])

"""Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence


def markdown(
    header: Sequence[str], rows: Sequence[Sequence[str]], align: str | Sequence[str] = "---:"
) -> str:
    """Write a Markdown table.

    Args:
        header: name of each column; may be empty.
        rows: cells of each row, as many as columns.
        align: `"---"` (left) or `"---:"` (right), for all columns or for each.
    """
    marks = [align] * len(header) if isinstance(align, str) else align
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, marks, *rows])

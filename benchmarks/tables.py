"""Tables as text, for a terminal and for Markdown: what every benchmark prints."""

from collections.abc import Sequence

import msgspec
import numpy as np


class Table(msgspec.Struct, frozen=True):
    """Columns and rows as text."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]

    def markdown(self) -> str:
        """Aligned, so that it reads in a terminal too."""
        lines = [self.columns, *(self.rows or [("none", *[""] * (len(self.columns) - 1))])]
        widths = [max(len(line[k]) for line in lines) for k in range(len(self.columns))]
        text = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)) + " |" for line in lines]
        text.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
        return f"### {self.title}\n" + "\n".join(text) + "\n"


def number(value: float | None) -> str:
    """Three significant digits, "-" for nothing."""
    if value is None or np.isnan(value):
        return "-"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"

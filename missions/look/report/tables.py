"""Tables for a person at a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping

from rich.table import Table
from rich.text import Text


def plain_table(*titles: str, left: Collection[str] = ("",)) -> Table:
    """A table without lines. Numbers are on the right; ``left`` are the titles of columns that hold
    words.
    """
    table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="dim")
    for title in titles:
        table.add_column(title, justify="left" if title in left else "right")
    return table


def figures_grid(rows: Iterable[tuple[str, str]]) -> Table:
    """The table of names and values."""
    figures = Table.grid(padding=(0, 3))
    for name, value in rows:
        figures.add_row(Text(name, "dim"), value)
    return figures


def counts_text(counts: Mapping[str, object], none: str = "none") -> str:
    """Counts by name in words; ``none`` where there are none."""
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or none


def sum_of(counts: Iterable[Mapping[str, int]]) -> Counter[str]:
    """Counts by name, added up."""
    return sum((Counter(each) for each in counts), Counter[str]())

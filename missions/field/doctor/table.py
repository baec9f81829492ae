"""The display of ``doctor``'s findings: one table, and what is measured now below it."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import TextIO

from rich.console import Console, Group
from rich.live import Live
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from drivers.rig.part_check import Finding, State

STYLE: dict[State, str] = {"ok": "green", "note": "yellow", "fault": "bold red"}
URGENCY: tuple[State, ...] = ("fault", "note", "ok")
WIDTH = 120  # where it is not a terminal


class FindingsTable:
    """Takes findings in. ``found`` are all of them."""

    def __init__(self) -> None:
        self.found: list[Finding] = []
        self._doing = ""

    def add(self, finding: Finding) -> None:
        self.found.append(finding)

    def doing(self, what: str) -> None:
        """Names what is measured from now on."""
        self._doing = what

    def render(self) -> Group:
        """The table, and a line that moves while something is measured."""
        return (
            Group(table(self.found), Spinner("dots", Text(self._doing, "dim")))
            if self._doing
            else Group(table(self.found))
        )


class Lines(FindingsTable):
    """The display in a file or a pipe: what is measured as a line at once, the table at the end."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream = stream

    def doing(self, what: str) -> None:
        self._stream.write(f"{what} ...\n")
        self._stream.flush()


@contextmanager
def open_findings(stream: TextIO) -> Generator[FindingsTable, None, None]:
    """A table on a stream: it grows when that is a terminal, and comes at the end, also after
    Ctrl-C, when not.
    """
    if stream.isatty():
        live = FindingsTable()
        with Live(
            get_renderable=live.render,
            console=Console(file=stream),
            refresh_per_second=8,
        ) as shown:
            try:
                yield live
            finally:
                live.doing("")
                shown.refresh()
        return
    lines = Lines(stream)
    try:
        yield lines
    finally:
        Console(file=stream, width=WIDTH).print(table(lines.found))


def table(found: list[Finding]) -> Table:
    """One row for each finding, its fix below what was found: faults first, then notes."""
    made = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    made.add_column("", no_wrap=True)
    made.add_column("what", no_wrap=True)
    made.add_column("found", overflow="fold")
    for finding in sorted(found, key=lambda each: URGENCY.index(each.state)):
        said = Text(finding.detail)
        if finding.fix:
            said.append(f"\nfix: {finding.fix}", "cyan" if finding.state != "ok" else "dim")
        made.add_row(Text(finding.state, STYLE[finding.state]), finding.name, said)
    return made

"""The display of a flight under way: a live table in a terminal, plain lines elsewhere."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import TextIO

from rich.console import Console as Terminal
from rich.console import Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from drivers.clock import stopwatch_ns
from flight.harness.flights import Progress
from flight.phases import words_of
from missions.ground.shown import Said
from missions.look.report.tables import counts_text
from path.messages import Role

LINE_PERIOD_S = 5.0
BAR_WIDTH = 14
REFRESH_HZ = 8
NOTES = 5  # that are kept in sight
ALARM = "ALARM"  # what a note begins with that must not be missed
SHORT = {Role.SENDER: "D1", Role.RECEIVER: "D2"}
COLORS = {Role.SENDER: "bright_blue", Role.RECEIVER: "yellow"}


@contextmanager
def open_console(stream: TextIO) -> Generator[LineConsole | LiveTable]:
    """A console on a stream: live when it is a terminal, lines when it is not."""
    if not stream.isatty():
        with Said(stream) as say:
            yield LineConsole(say)
        return
    table = LiveTable()
    with Live(
        get_renderable=table.render,
        console=Terminal(file=stream),
        refresh_per_second=REFRESH_HZ,
    ) as live:
        yield table
        live.refresh()


class Elapsed:
    """Seconds since each role's clock was first heard of; before it has one its stamps are 0, and
    the wall's count.

    ``wall_ns`` is the computer's own clock.
    """

    def __init__(self, wall_ns: Callable[[], int] = stopwatch_ns) -> None:
        self._started_ns: dict[Role, int] = {}
        self._wall_ns, self._opened_ns = wall_ns, wall_ns()

    def seconds(self, progress: Progress) -> float:
        if not progress.stamp_ns:
            return (self._wall_ns() - self._opened_ns) * 1e-9
        return (
            progress.stamp_ns - self._started_ns.setdefault(progress.role, progress.stamp_ns)
        ) * 1e-9


class LineConsole:
    """One line whenever a role's phase or note changes, and every few seconds of its clock."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._elapsed = Elapsed()
        self._last: dict[Role, Progress] = {}
        self._shown_s: dict[Role, float] = {}

    def show(self, progress: Progress) -> None:
        elapsed_s = self._elapsed.seconds(progress)
        last = self._last.get(progress.role)
        news = last is None or (progress.phase, progress.note) != (last.phase, last.note)
        if (
            last is not None
            and not news
            and elapsed_s - self._shown_s[progress.role] < LINE_PERIOD_S
        ):
            return
        self._last[progress.role], self._shown_s[progress.role] = progress, elapsed_s
        parts = [
            f"{elapsed_s:7.1f} s  {progress.role.value:<8}  {progress.phase:<10}",
            *_figures(progress),
        ]
        if progress.note and (news or not progress.stamp_ns):
            parts.append(progress.note)
        self._say("  ".join(parts).rstrip())


def _figures(progress: Progress) -> list[str]:
    figures: list[str] = []
    if progress.count:
        figures.append(_advance(progress))
    if progress.iou is not None:
        figures.append(_iou(progress))
    if progress.separation_m is not None:
        figures.append(f"{progress.separation_m:.2f} m apart")
    if progress.link_bytes_per_s:
        figures.append(f"link {progress.link_bytes_per_s / 1000:.1f} kB/s")
    return figures


def _advance(progress: Progress) -> str:
    """Return how far the agreement is: pairs, or evidence where it counts."""
    if progress.evidence is None:
        return f"{min(progress.count, progress.needed)}/{progress.needed}"
    reached, needed = progress.evidence
    return f"evidence {reached:.1f}/{needed:.1f}"


def _iou(progress: Progress) -> str:
    needed = "" if progress.tau is None else f" of {progress.tau:.2f}"
    return f"IoU {progress.iou:.2f}{needed}"


class LiveTable:
    """D1 left and D2 right, what they know together, and what was said last: in 60 columns or
    more.
    """

    def __init__(self) -> None:
        self._last: dict[Role, Progress] = {}
        self._elapsed = Elapsed()
        self._notes: deque[str] = deque(maxlen=NOTES)
        self._alarms: deque[str] = deque(maxlen=NOTES)

    def show(self, progress: Progress) -> None:
        elapsed_s = self._elapsed.seconds(progress)
        before = self._last.get(progress.role)
        if progress.note and (before is None or before.note != progress.note):
            kept = self._alarms if progress.note.startswith(ALARM) else self._notes
            kept.append(f"{elapsed_s:4.0f} s {SHORT[progress.role]} {progress.note}")
        self._last[progress.role] = progress

    def render(self) -> Group:
        shown = [self._last[role] for role in Role if role in self._last]
        drones = Table.grid(padding=(0, 1), expand=True)
        for _ in shown:
            drones.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
        drones.add_row(*map(_heading, shown))
        drones.add_row(*map(self._figures, shown))
        together = Table.grid(padding=(0, 2))
        together.add_row(*_together(shown))
        notes = [Text(note, style="dim") for note in self._notes]
        alarms = [Text(alarm, style="bold red") for alarm in self._alarms]
        return Group(drones, together, *notes, *alarms)

    def _figures(self, progress: Progress) -> str:
        figures = [f"{self._elapsed.seconds(progress):.0f} s"]
        if progress.iou is not None:
            figures.append(_iou(progress).replace(" of ", "/"))
        figures.append(f"{progress.link_bytes_per_s / 1000:.1f} kB/s")
        return "  ".join(figures)


def _heading(progress: Progress) -> Text:
    """A drone's name, whether it has the target, and its phase in words."""
    holds = " ●" if progress.responsible else ""
    name = (f"{SHORT[progress.role]}{holds} ", "bold")
    return Text.assemble(name, (words_of(progress.phase), COLORS[progress.role]))


def _together(shown: Sequence[Progress]) -> Iterator[ProgressBar | Text | str]:
    """How far the agreement is, and how far the drones are apart, by whoever knows."""
    agreeing = next((each for each in shown if each.count > 0 or each.iou is not None), None)
    if agreeing is not None:
        reached, needed = agreeing.evidence or (agreeing.count, agreeing.needed)
        yield ProgressBar(total=needed, completed=min(reached, needed), width=BAR_WIDTH)
        yield Text(_advance(agreeing), style="bold")
    apart_m = next((each.separation_m for each in shown if each.separation_m is not None), None)
    yield "" if apart_m is None else f"{apart_m:.2f} m apart"


@contextmanager
def open_tally(stream: TextIO, total: int) -> Generator[LineTally | LiveTally]:
    """A tally of runs on a stream: live when it is a terminal, a line at each tenth when it is
    not.
    """
    if not stream.isatty():
        yield LineTally(stream, total)
        return
    tally = LiveTally(total)
    with Live(
        get_renderable=tally.render,
        console=Terminal(file=stream),
        refresh_per_second=REFRESH_HZ,
    ) as live:
        yield tally
        live.refresh()


class LineTally:
    def __init__(self, stream: TextIO, total: int) -> None:
        self._stream = stream
        self._total = total
        self._outcomes: Counter[str] = Counter()

    def add(self, outcome: str) -> None:
        before = self._outcomes.total()
        self._outcomes[outcome] = self._outcomes[outcome] + 1
        done = before + 1
        if done == self._total or done * 10 // self._total > before * 10 // self._total:
            self._stream.write(
                f"{done}/{self._total} runs: {counts_text(dict(self._outcomes.most_common()))}\n"
            )
            self._stream.flush()


class LiveTally:
    def __init__(self, total: int) -> None:
        self._total = total
        self._outcomes: Counter[str] = Counter()

    def add(self, outcome: str) -> None:
        self._outcomes[outcome] += 1

    def render(self) -> Table:
        done = self._outcomes.total()
        table = Table.grid(padding=(0, 2))
        bar = ProgressBar(total=self._total, completed=done, width=3 * BAR_WIDTH)
        table.add_row(
            bar,
            f"{done}/{self._total} runs",
            counts_text(dict(self._outcomes.most_common())),
        )
        return table

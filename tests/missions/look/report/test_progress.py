"""Progress: who reads a file or a pipe gets lines, who sits at a terminal a table."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console as Terminal

from flight.harness.flights import Progress
from flight.phases import Phase, words_of
from missions.ground.shown import Said
from missions.look.report.progress import (
    Elapsed,
    LineConsole,
    LineTally,
    LiveTable,
    LiveTally,
    open_console,
    open_tally,
)
from path.messages import Role

START = Progress(
    role=Role.SENDER,
    stamp_ns=5_000_000_000,
    phase="take-off",
    count=0,
    needed=350,
    iou=None,
    tau=None,
    separation_m=None,
    link_bytes_per_s=0.0,
    responsible=False,
    note="",
)


def at(seconds: float, **changes: object) -> Progress:
    return replace(START, stamp_ns=START.stamp_ns + round(seconds * 1e9), **changes)  # type: ignore[arg-type]


def text_of(table: LiveTable | LiveTally, columns: int = 160) -> str:
    terminal = Terminal(file=io.StringIO(), width=columns, record=True)
    terminal.print(table.render())
    return terminal.export_text()


def lines(*shown: Progress) -> list[str]:
    stream = io.StringIO()
    console = LineConsole(Said(stream))
    for progress in shown:
        console.show(progress)
    return stream.getvalue().splitlines()


def test_lines_come_on_news_and_every_few_seconds() -> None:
    written = lines(
        START, at(0.2), at(0.4, phase="verify"), at(4.0, phase="verify"), at(5.5, phase="verify")
    )
    assert [line.split()[0] for line in written] == ["0.0", "0.4", "5.5"]


def test_time_begins_with_the_roles_clock() -> None:
    written = lines(replace(START, stamp_ns=0, note="compiling"), START, at(6.0))
    assert [line.split()[0] for line in written] == ["0.0", "0.0", "6.0"]


def test_the_agreement_is_shown_in_what_the_gate_goes_by() -> None:
    pairs = at(1, phase="verify", count=42)
    evidence = replace(pairs, needed=30, evidence=(3.69897, 4.30103))
    assert "  42/350" in lines(pairs)[0]
    assert "  evidence 3.7/4.3" in lines(evidence)[0]
    for progress, expected in (
        (pairs, "42/350"),
        (evidence, "3.7/4.3"),
        (replace(evidence, evidence=(9.0, 4.3)), "9.0/"),
    ):
        table = LiveTable()
        table.show(progress)
        assert expected in text_of(table)


def test_a_note_is_written_once() -> None:
    written = lines(START, at(1, note="the peer is late"), at(9, note="the peer is late"))
    assert [line.endswith("the peer is late") for line in written] == [False, True, False]


def test_a_line_has_the_figures_of_the_handshake() -> None:
    (line,) = lines(
        at(
            0,
            phase="verify",
            count=17,
            iou=0.7,
            tau=0.3,
            separation_m=1.25,
            link_bytes_per_s=9100.0,
        )
    )
    assert line.split(maxsplit=4)[4] == "17/350  IoU 0.70 of 0.30  1.25 m apart  link 9.1 kB/s"


def test_a_reader_that_went_away_stops_nothing() -> None:
    stream = io.StringIO()
    console = LineConsole(Said(stream))
    stream.close()
    console.show(START)


@pytest.mark.parametrize("columns", [60, 140])
def test_a_terminal_has_d1_left_and_d2_right_and_what_was_said_below(columns: int) -> None:
    table = LiveTable()
    table.show(at(0))
    table.show(at(12, phase="verify", count=100, iou=0.66, tau=0.35, evidence=(2.9, 3.3)))
    alone = text_of(table, columns)
    assert "D2" not in alone
    other = {"link_bytes_per_s": 10_100.0, "separation_m": 1.25}
    table.show(replace(at(1, phase="verify", **other), role=Role.RECEIVER))
    first, figures, together, *_ = text_of(table, columns).splitlines()
    assert first.index("D1 Compares both views") < first.index("D2 Compares both views")
    assert "12 s  IoU 0.66/0.35  0.0 kB/s" in figures
    assert "10.1 kB/s" in figures
    assert "evidence 2.9/3.3" in together and "1.25 m apart" in together
    assert max(map(len, text_of(table, columns).splitlines())) <= columns


def test_every_phase_of_both_drones_is_in_words_and_whole_in_sixty_columns() -> None:
    for phase in Phase:
        table = LiveTable()
        for role in Role:
            table.show(replace(START, role=role, phase=phase.title, responsible=True))
        first = text_of(table, 60).splitlines()[0]
        assert first.count(words_of(phase.title)) == 2
        assert words_of(phase.title) != phase.title


def test_what_was_said_stays_in_sight_and_is_whole_though_it_is_long() -> None:
    table = LiveTable()
    warning = "the link loses a third of what is sent: " + "come nearer, or land " * 4
    table.show(at(0))
    table.show(at(1, note=warning))
    table.show(at(2, note=warning))
    for second in range(3, 7):
        table.show(at(second, note=f"note {second}"))
    text = text_of(table, 60)
    words = " ".join(text.split())
    assert words.count(warning.strip()) == 1
    assert "1 s D1 the link" in words
    table.show(at(9, note="note 9"))
    assert "the link loses" not in text_of(table, 60)


def test_an_alarm_stays_below_all_notes_to_the_end() -> None:
    table = LiveTable()
    table.show(at(0))
    table.show(at(1, note="ALARM: the other drone's estimator stepped"))
    for second in range(2, 12):
        table.show(at(second, note=f"note {second}"))
    assert text_of(table, 60).splitlines()[-1] == (
        "   1 s D1 ALARM: the other drone's estimator stepped"
    )


def test_what_is_no_terminal_gets_lines() -> None:
    stream = io.StringIO()
    with open_console(stream) as console:
        console.show(START)
    with open_tally(stream, 2) as tally:
        tally.add("committed")
    assert "\x1b" not in stream.getvalue()
    assert stream.getvalue().count("\n") == 2


def test_a_terminal_gets_the_table_until_the_last_state() -> None:
    class FakeTerminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = FakeTerminal()
    with open_console(stream) as console:
        console.show(at(0, phase="done"))
    assert words_of("done") in stream.getvalue()


def test_a_tally_counts_outcomes_and_speaks_at_each_tenth() -> None:
    stream = io.StringIO()
    tally, live = LineTally(stream, 30), LiveTally(30)
    for k in range(30):
        for each in (tally, live):
            each.add("marker_lost" if k == 4 else "committed")
    written = stream.getvalue().splitlines()
    assert len(written) == 10
    assert written[-1] == "30/30 runs: committed 29, marker_lost 1"
    assert "30/30 runs" in text_of(live)


def test_preparation_shows_how_long_it_takes_before_any_clock_runs() -> None:
    wall_s = 0.0
    elapsed = Elapsed(lambda: round(wall_s * 1e9))
    preparing = replace(START, stamp_ns=0, phase="starting", note="preparing the renderer")
    assert elapsed.seconds(preparing) == 0.0
    wall_s = 47.0
    assert elapsed.seconds(preparing) == 47.0
    assert elapsed.seconds(START) == 0.0  # from here on it is the role's clock
    assert elapsed.seconds(at(3.0)) == 3.0

"""The suite's use of its figures: whom a vehicle is like, records, the page, and the figures
themselves.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.interfaces import FlightMode, PartError
from drivers.mavlink.bench import HeartbeatShown, Instant
from missions import cli
from missions.proofs.conformance import track
from missions.proofs.conformance.page import page
from missions.proofs.conformance.record import Record, joined, read_all, write
from missions.proofs.conformance.rows import SECTIONS, Row, likeness, said

RISE = Row("rise_s", "rises after", "s", (0.2, 0.3))
ANSWER = Row("answer", "answers")


def record(vehicle: str, **values: float | str | None) -> Record:
    return Record(vehicle, "a rig", "2026-01-02 03:04", 2, 0.5, 1.5, 0, values, {})


@pytest.mark.parametrize(
    ("own", "px4", "copter", "expected"),
    [
        (1.0, 1.1, 5.0, "PX4"),
        (1.0, 0.9, 1.2, "both"),
        (3.0, 1.0, 9.0, "between"),
        (9.0, 1.0, 3.0, "**neither**"),
        (None, 1.0, None, "ArduCopter"),
        (1.0, None, None, "**neither**"),
    ],
)
def test_whom_a_figure_is_like(
    own: float | None, px4: float | None, copter: float | None, expected: str
) -> None:
    real = {"PX4": {"rise_s": px4}, "ArduCopter": {"rise_s": copter}}
    assert likeness(RISE, {"rise_s": own}, real) == expected


def test_answers_are_alike_word_by_word_and_own_words_are_not_compared() -> None:
    assert likeness(ANSWER, {"answer": "denied"}, {"PX4": {"answer": "denied"}}) == "PX4"
    assert likeness(ANSWER, {"answer": "denied"}, {"PX4": {"answer": "failed"}}) == "**neither**"
    assert likeness(replace(ANSWER, alike=None), {"answer": "a"}, {"PX4": {"answer": "a"}}) == ""
    assert likeness(ANSWER, {}, {"PX4": {"answer": "a"}}) == ""


def test_figures_as_they_are_shown() -> None:
    assert [said(RISE, values) for values in ({"rise_s": 1.234}, {"rise_s": None}, {})] == [
        "1.23 s",
        "never",
        "not measured",
    ]


def test_every_row_has_a_name_of_its_own() -> None:
    names = [row.name for rows in SECTIONS.values() for row in rows]
    assert len(names) == len(set(names))


def test_the_page_is_made_of_the_records_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, record("embedded", heartbeat_s=1.0, early_arm_text="no | bar", arm_s=1.0))
    px4 = record("px4", heartbeat_s=9.5, arm_s=1.0)
    write(tmp_path, replace(px4, failed={"course": "it fell"}, restarts=2))
    with pytest.raises(SystemExit) as ended:
        cli.main(
            ["conformance", "--no-fly", "--out", str(tmp_path), "--page", str(tmp_path / "page.md")]
        )
    assert ended.value.code == 0
    assert "first heartbeat after" in capsys.readouterr().out
    text = (tmp_path / "page.md").read_text("utf-8")
    assert text == page(read_all(tmp_path), 7)
    assert "| first heartbeat after | 1.0 s | 9.5 s |" in text
    assert "`arm()` takes" not in text  # as a PX4
    assert "| ... and says | no · bar | not measured |" in text
    assert "- PX4, course: it fell" in text
    assert "switched off and on 2 times" in text


def test_flights_flown_again_replace_only_their_own(tmp_path: Path) -> None:
    before = replace(
        record("px4", a=1.0, b=2.0),
        failed={"course": "it fell", "cut": "too"},
        flown=("course", "cut"),
    )
    now = replace(record("px4", b=3.0), flown=("cut",))
    both = joined(before, now)
    assert (both.values, both.failed, both.flown) == (
        {"a": 1.0, "b": 3.0},
        {"course": "it fell"},
        ("course", "cut"),
    )
    (tmp_path / "px4.json").write_text('{"vehicle": "px4"}')
    with pytest.raises(PartError, match="no record of this suite"):
        read_all(tmp_path)


# --- the figures ---


def test_a_response_to_a_step_of_a_lag_of_half_a_second() -> None:
    t = np.arange(0.0, 4.0, 0.02)
    speed = 1.0 - np.exp(-t / 0.5)
    answer = track.response(t, speed, 0.0, 1.0)
    assert answer.rise_s == pytest.approx(0.5, abs=0.03)
    assert (answer.overshoot_percent, answer.error_mps) == (0.0, pytest.approx(0.0, abs=0.01))
    assert track.response(t, 0.1 * speed, 0.0, 1.0).rise_s is None


def instant(time_s: float, north_m: float = 0.0, speed_mps: float = 0.0) -> Instant:
    return Instant(time_s, 0.0, (north_m, 0.0, 0.0), (speed_mps, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


def test_when_and_where_it_stands() -> None:
    times = np.arange(0.0, 3.0, 0.1)
    flown = [
        instant(t, t - 0.25 * t * t if t < 2.0 else 1.0, max(0.0, 1.0 - 0.5 * t)) for t in times
    ]
    seconds, metres = track.standing(track.FlightTrack.of(flown, 0.0), 0.0)
    assert seconds == pytest.approx(1.7, abs=0.11)
    assert metres == pytest.approx(0.98, abs=0.05)
    moving = track.FlightTrack.of([instant(t, t, 1.0) for t in times], 0.0)
    assert track.standing(moving, 0.0) == (None, None)


def test_the_steepest_half_second() -> None:
    t = np.arange(0.0, 4.0, 0.1)
    assert track.fastest_mps(t, np.minimum(t, 2.0)) == pytest.approx(1.0)
    assert track.fastest_mps(t[:3], t[:3]) is None


def test_changes_of_mode_as_heartbeats_show_them() -> None:
    beats = [(0.0, FlightMode.OFFBOARD, True), (1.0, FlightMode.OFFBOARD, True), (2.0, FlightMode.LAND, True),
             (3.0, FlightMode.OTHER, True), (4.0, FlightMode.HOLD, False)]  # fmt: skip
    shown = [HeartbeatShown(t, mode, 5, armed) for t, mode, armed in beats]
    changes = track.modes_since(shown, 0.5)
    assert changes == [(1.5, "land"), (2.5, "mode 0x5"), (3.5, "disarmed")]
    assert track.in_words(changes) == "land → mode 0x5 → disarmed"
    assert (track.when(changes, "land"), track.when(changes, "hold")) == (1.5, None)
    assert track.in_words(track.modes_since(shown, 9.0)) == "no change"


def test_landed_states_begin_with_the_one_before() -> None:
    landed = [(0.0, 1), (0.8, 1), (2.0, 3), (3.0, 2), (9.0, 1)]
    expected = [(0.0, "on ground"), (1.0, "take-off"), (2.0, "in air")]
    assert track.landed_since(landed, 1.0, 5.0) == [(t, name) for t, name in expected]


def test_the_tilt_between_two_attitudes() -> None:
    half = math.radians(3.0) / 2.0
    assert track._tilt((math.cos(half), math.sin(half), 0.0, 0.0)) == pytest.approx(
        math.radians(3.0)
    )
    assert track._tilt((math.cos(half), 0.0, 0.0, math.sin(half))) == pytest.approx(0.0, abs=1e-6)

"""A computer that is too slow for a run in real time is named, with what was late."""

from __future__ import annotations

import os
from pathlib import Path

from hil.harness.realtime.pace import StolenTime, overload_of

NAMES = "sender", "receiver"
QUICK = {name: [0.03] * 500 for name in NAMES}
MADE = {name: {"rendered": 500, "left_out": 20} for name in NAMES}


def test_a_computer_that_keeps_up_is_not_blamed() -> None:
    assert overload_of(QUICK, MADE) == ""
    assert overload_of({}, {}) == ""


def test_a_hiccup_or_a_program_that_was_stalled_for_a_moment_is_none() -> None:
    assert overload_of({**QUICK, "sender": [0.03] * 420 + [2.0] * 80}, MADE) == ""


def test_pictures_that_come_too_late_are_named() -> None:
    said = overload_of(QUICK, {**MADE, "receiver": {"rendered": 100, "left_out": 300}}, "the {}'s")
    assert said == "the receiver's pictures: 300 of 400 were not rendered in time"


def test_a_program_that_takes_its_frames_up_late_is_named() -> None:
    said = overload_of({**QUICK, "sender": [0.1] * 300 + [0.6] * 200}, MADE, "the {}'s")
    assert said == "the sender's program: 200 of 500 frames were late, a tenth by 0.60 s"


def test_a_world_that_stood_still_is_named() -> None:
    assert overload_of(QUICK, MADE, stood_s=0.3) == ""
    assert overload_of(QUICK, MADE, stood_s=2.16) == "the world stood still for 2.2 s"


def test_a_core_that_the_host_took_is_named_where_programs_have_a_share_of_one() -> None:
    """The kernel takes it for used: a fifth of a core is stopped five times as long."""
    assert overload_of(QUICK, MADE, stolen_s=0.16) == ""
    assert overload_of(QUICK, MADE, stolen_s=0.05, share=0.2) == ""
    said = overload_of(QUICK, MADE, stolen_s=0.16, share=0.2)
    assert said == "this computer's host took a core for 0.16 s, 0.8 s of a share"


def test_what_the_host_takes_is_the_most_of_one_core_at_once(tmp_path: Path) -> None:
    tick_s = 1.0 / os.sysconf("SC_CLK_TCK")
    stolen = StolenTime(tmp_path / "stat")
    seen: list[float] = []
    # on the ground 50, unwatched; then 3 and 4 together on one core, 5 on the other, 2 much later
    for now_s, one, two in (
        (0.0, 7, 9),
        (2.0, 57, 9),
        (2.1, 60, 9),
        (2.15, 99, 9),
        (2.2, 64, 14),
        (3.0, 66, 14),
    ):
        line = "cpu{} 5 5 5 5 5 5 5 {} 0 0\n"
        (tmp_path / "stat").write_text(
            line.format("", one + two) + line.format(0, one) + line.format(1, two)
        )
        stolen.watch(now_s)
        seen.append(round(stolen.longest_s / tick_s))
    assert seen == [0, 0, 3, 3, 7, 7]


def test_a_computer_that_does_not_say_what_its_host_took_has_none_taken(tmp_path: Path) -> None:
    stolen = StolenTime(tmp_path / "stat")
    for now_s in (0.0, 0.1, 0.2):
        stolen.watch(now_s)
    assert stolen.longest_s == 0.0


def test_a_few_frames_prove_nothing() -> None:
    assert overload_of({"sender": [3.0] * 10}, {"sender": {"rendered": 1, "left_out": 20}}) == ""

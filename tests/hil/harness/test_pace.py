"""A computer that is too slow for a run in real time is named, with what was late."""

from __future__ import annotations

from hil.harness.realtime.pace import overload_of

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


def test_a_few_frames_prove_nothing() -> None:
    assert overload_of({"sender": [3.0] * 10}, {"sender": {"rendered": 1, "left_out": 20}}) == ""

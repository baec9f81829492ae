from __future__ import annotations

import pytest

from flight.outcome import MissionEnd, Outcome, abort_reason
from path.messages import AbortReason


def test_exit_codes_and_labels_are_unique_and_only_the_good_ends_are_zero() -> None:
    bad = [outcome for outcome in Outcome if outcome.exit_code != 0]
    assert len({outcome.exit_code for outcome in bad}) == len(bad)
    assert len({outcome.label for outcome in Outcome}) == len(Outcome)
    assert [outcome for outcome in Outcome if outcome.exit_code == 0] == [
        Outcome.COMMITTED,
        Outcome.FLOWN,
    ]
    # from there on they are the shell's
    assert all(0 <= outcome.exit_code < 126 for outcome in Outcome)
    # tracebacks, wrong command lines
    assert all(outcome.exit_code not in (1, 2) for outcome in Outcome)


@pytest.mark.parametrize("outcome", Outcome)
def test_a_label_names_its_outcome(outcome: Outcome) -> None:
    assert Outcome.from_label(outcome.label) is outcome
    assert outcome.meaning


def test_an_unknown_label_is_an_error() -> None:
    with pytest.raises(KeyError):
        Outcome.from_label("fine")


@pytest.mark.parametrize(
    ("outcome", "reason"),
    [
        (Outcome.NO_AGREEMENT, AbortReason.TIMEOUT),
        (Outcome.TARGET_LOST, AbortReason.TARGET_LOST),
        (Outcome.TARGET_NOT_FOUND, AbortReason.TARGET_LOST),
        (Outcome.MARKER_LOST, AbortReason.MARKER_LOST),
        (Outcome.CAMERA_LOST, AbortReason.CAMERA),
        (Outcome.VEHICLE_LOST, AbortReason.VEHICLE),
        (Outcome.PILOT_OVERRIDE, AbortReason.PILOT),
        (Outcome.GUARD, AbortReason.GUARD),
        (Outcome.INTERRUPTED, AbortReason.SHUTDOWN),
    ],
)
def test_the_other_drone_is_told_why(outcome: Outcome, reason: AbortReason) -> None:
    assert abort_reason(outcome) is reason


@pytest.mark.parametrize("outcome", Outcome)
def test_every_outcome_has_a_word_for_the_other_drone(outcome: Outcome) -> None:
    assert isinstance(abort_reason(outcome), AbortReason)


def test_an_end_says_what_was_seen() -> None:
    end = MissionEnd(Outcome.GUARD, "battery at 15 %")
    assert str(end) == "guard: battery at 15 %"

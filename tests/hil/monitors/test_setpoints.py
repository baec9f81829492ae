"""A gap between setpoints is the script's, unless its own program was given no core for so long,
and just then.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from hil.monitors.setpoints import (
    Late,
    SetpointGap,
    all_explained,
    excuse_of,
    judged,
    late_of,
    told_with,
)

GAP = SetpointGap("sender", 12.0, 12.244)
LATE = Late(12.02, 12.24, 0.21, 0.19)


def test_a_gap_without_lateness_stays_a_violation() -> None:
    judgement = judged(GAP, [])
    assert not judgement.explained
    assert excuse_of([judgement]) == ""
    assert judgement.lateness == "its program was not late then"


def test_a_gap_in_which_the_program_had_no_core_is_explained() -> None:
    judgement = judged(GAP, [LATE])
    assert judgement.explained
    assert excuse_of([judgement]) == (
        "sender's program had no core for 0.19 s of the 0.24 s without a setpoint at 12.00 s"
    )


@pytest.mark.parametrize(("unserved_s", "explained"), [(0.043, False), (0.045, True)])
def test_what_the_computer_did_not_take_must_be_within_the_bound(
    unserved_s: float, explained: bool
) -> None:
    assert judged(GAP, [replace(LATE, unserved_s=unserved_s)]).explained is explained


def test_a_loop_that_was_late_by_its_own_doing_explains_nothing() -> None:
    """It computed, or slept: it had its core all the time."""
    judgement = judged(GAP, [replace(LATE, unserved_s=0.0)])
    assert not judgement.explained
    assert (
        judgement.lateness == "then its program's loop was 0.21 s late and had no core for 0.00 s"
    )


def test_a_gap_in_which_the_program_stood_for_a_disk_is_explained_and_says_so() -> None:
    """No core was taken from it, and it did nothing by itself."""
    gap = SetpointGap("receiver", 41.0, 42.63)
    judgement = judged(gap, [Late(41.0, 42.65, 1.61, 0.0, 1.58)])
    assert judgement.explained
    assert excuse_of([judgement]) == (
        "receiver's program had no core for 0.00 s and stood for a disk for 1.58 s of the 1.63 s "
        "without a setpoint at 41.00 s"
    )
    assert not judged(gap, [Late(41.0, 42.65, 1.61, 0.0, 0.7)]).explained


@pytest.mark.parametrize(
    "late", [replace(LATE, from_s=11.7, to_s=11.99), replace(LATE, from_s=12.4, to_s=12.6)]
)
def test_lateness_at_another_time_explains_nothing(late: Late) -> None:
    assert not judged(GAP, [late]).explained


def test_waits_in_the_same_gap_add_up() -> None:
    waits = [
        replace(LATE, from_s=12.0 + k * 0.05, to_s=12.05 + k * 0.05, unserved_s=0.02)
        for k in range(4)
    ]
    assert judged(GAP, waits).unserved_s == pytest.approx(0.08)
    assert judged(GAP, waits).explained


def test_one_gap_that_nothing_explains_is_enough_to_blame_the_script() -> None:
    other = SetpointGap("receiver", 30.0, 30.25)
    gaps = [judged(GAP, [LATE]), judged(other, [LATE])]
    assert not all_explained({"S8": 2}, gaps)
    assert all_explained({"S8": 1}, gaps[:1])
    # a failsafe that did not come is no gap of the program's
    assert not all_explained({"S8": 2}, gaps[:1])
    assert not all_explained({}, [])


def test_a_world_that_stood_still_is_told_and_explains_nothing() -> None:
    """What is sent to it counts from its arrival."""
    judgement = judged(GAP, [], [(3.0, 3.2), (12.1, 12.5)])
    assert not judgement.explained
    assert judgement.lateness == "its program was not late then, the world stood still for 0.40 s"


def test_a_record_says_how_long_all_that_sends_had_no_core() -> None:
    record = {
        "since_ns": 250_000_000,
        "loop_ns": 210_000_000,
        "waited_ns": 120_000_000,
        "beside_ns": 30_000_000,
    }
    late = late_of({**record, "stolen_ns": 10_000_000, "disk_ns": 20_000_000}, 12.25)
    assert (late.from_s, late.to_s, late.loop_s) == pytest.approx((12.0, 12.25, 0.21))
    assert (late.unserved_s, late.disk_s) == pytest.approx((0.16, 0.02))


def test_the_report_has_the_lateness_beside_the_gap_and_leaves_the_rest_as_it_is() -> None:
    details = [
        "S8 at 12.00 s: sender: 0.244 s between setpoints, until 12.24 s",
        "S9 at 3.00 s: too close",
    ]
    assert told_with(details, [judged(GAP, [LATE])]) == [
        f"{details[0]}; then its program's loop was 0.21 s late and had no core for 0.19 s",
        details[1],
    ]

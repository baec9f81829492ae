"""S2, S3, S4, L1 and L2 from scripted records: silent about what goes well, and each sees what it
is there for.
"""

from __future__ import annotations

from typing import Any

from hil.monitors.monitors import Monitors
from path.config import MethodConfig
from path.messages import Role

LEASE_S = 1.5
D1, D2 = Role.SENDER, Role.RECEIVER


class Story:
    """Records of both roles, in the order of time. The agreement is left out: S5 is held
    elsewhere.
    """

    def __init__(self) -> None:
        self.monitors = Monitors.of_pair(MethodConfig())

    def write(self, role: Role, topic: str, at_s: float, **record: Any) -> None:
        self.monitors.on_record(role, topic, round(at_s * 1e9), record)

    def epoch(self, role: Role, at_s: float, epoch: int, duty: str) -> None:
        self.write(role, "/epoch", at_s, epoch=epoch, duty=duty)

    def holds(
        self, role: Role, at_s: float, responsible: bool, until_s: float | None = None
    ) -> None:
        until_ns = None if until_s is None else round(until_s * 1e9)
        self.write(role, "/responsibility", at_s, responsible=responsible, until_ns=until_ns)

    def begin(self) -> None:
        self.holds(D1, 0.0, True)
        self.epoch(D1, 0.0, 1, "mine")
        self.epoch(D2, 0.1, 1, "observing")

    def commit(self, at_s: float = 1.0, epoch: int = 1) -> None:
        self.epoch(D1, at_s, epoch, "released")
        self.holds(D1, at_s, False)
        self.said(at_s, epoch)

    def said(self, at_s: float, epoch: int = 1, end_s: float | None = None) -> None:
        end_ns = round((at_s + LEASE_S if end_s is None else end_s) * 1e9)
        self.write(D1, "/commit", at_s, target_id=1, epoch=epoch, nonce=7, lease_end_ns=end_ns)

    def take(self, at_s: float, epoch: int = 1, until_s: float | None = None) -> None:
        self.epoch(D2, at_s, epoch, "provisional")
        self.holds(D2, at_s, True, at_s + 1.0 if until_s is None else until_s)

    def take_back(self, at_s: float, epoch: int = 2) -> None:
        self.epoch(D1, at_s, epoch, "mine")
        self.holds(D1, at_s, True)
        self.write(D1, "/decision", at_s, outcome="taken_back", reason=None)

    @property
    def found(self) -> dict[str, int]:
        return {name: count for name, count in self.monitors.violations.items() if name != "S5"}


def begun() -> Story:
    story = Story()
    story.begin()
    return story


def test_a_hand_over_that_goes_well_violates_nothing_and_is_timed() -> None:
    story = begun()
    story.commit()
    story.take(1.02)
    story.epoch(D1, 1.04, 1, "handed_over")
    story.write(D1, "/decision", 1.04, outcome="handed_over", reason=None)
    story.epoch(D2, 1.06, 1, "holding")
    story.holds(D2, 1.06, True)
    assert story.found == {}
    leases = story.monitors.legs[0].leases
    assert (round(leases.gap_s or 0.0, 6), round(leases.decision_s or 0.0, 6)) == (0.02, 0.04)


def test_taking_back_after_the_lease_and_trying_again_violates_nothing() -> None:
    story = begun()
    story.commit()
    story.take_back(2.52)
    story.epoch(D2, 2.6, 2, "observing")
    story.commit(5.0, epoch=2)
    story.take(5.1, epoch=2)
    assert story.found == {}
    assert round(story.monitors.legs[0].leases.gap_s or 0.0, 6) == 1.52


def test_s2_an_epoch_that_falls_across_a_restart() -> None:
    story = begun()
    story.epoch(D1, 1.0, 2, "mine")
    story.monitors.on_death(D1)
    story.epoch(D1, 5.0, 1, "mine")
    assert story.found == {"S2": 1}


def test_s2_a_lower_epoch_is_acted_on() -> None:
    story = begun()
    story.commit()
    story.take_back(2.52)
    story.take(2.6)
    assert "S2" in story.found


def test_s3_a_lease_that_is_over() -> None:
    story = begun()
    story.commit()
    story.take(2.51)
    assert story.found == {"S3": 1}


def test_s3_no_commit_at_all() -> None:
    story = begun()
    story.take(1.0)
    assert "S3" in story.found


def test_s4_commit_before_the_release() -> None:
    story = begun()
    story.said(1.0)
    assert story.found == {"S4": 1}


def test_s4_taken_back_too_soon() -> None:
    story = begun()
    story.commit()
    story.take_back(2.4)
    assert story.found == {"S4": 1}


def test_s4_taken_back_after_an_accept() -> None:
    story = begun()
    story.commit()
    story.epoch(D1, 1.1, 1, "handed_over")
    story.holds(D1, 4.0, True)
    assert "S4" in story.found


def test_l1_and_l2_a_decision_that_takes_too_long() -> None:
    story = begun()
    story.commit()
    story.take_back(3.5)
    assert story.found == {"L1": 1, "L2": 1}


def test_a_program_that_died_is_not_waited_for() -> None:
    story = begun()
    story.commit()
    story.monitors.on_death(D1)
    story.take_back(9.0)
    assert story.found == {}


def test_a_program_that_begins_again_before_it_tracks_anything_leaves_no_gap() -> None:
    story = Story()
    story.monitors.on_death(D1)
    story.holds(D1, 1.0, False)
    story.holds(D1, 9.8, True)
    assert story.found == {}


def test_a_claim_that_outlasts_the_lease_is_seen_and_one_that_ran_out_is_none() -> None:
    story = begun()
    story.commit()
    story.take(1.02, until_s=2.51)
    assert story.found == {"S3": 1}
    story = begun()
    story.commit()
    story.take(1.02, until_s=2.4)
    story.take_back(2.6)  # D2's program sleeps, and says nothing
    assert story.found == {}
    story.holds(D2, 2.7, True)
    assert story.found["S1"] == 1


def test_what_was_written_down_in_time_and_told_after_a_stall_is_not_taken() -> None:
    """A program that slept over its lease says what it wrote down when it goes on, and takes
    nothing.
    """
    story = begun()
    story.commit()
    story.take_back(2.6)
    story.epoch(D2, 3.1, 1, "provisional")
    story.holds(D2, 3.1, False)
    assert story.found == {}
    story.holds(D2, 3.1, True, 3.2)
    assert set(story.found) >= {"S2", "S3"}

"""Each monitor sees what it is there for, and is silent about a good run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.interfaces import FlightMode
from hil.autopilot.values import OffboardSession
from hil.monitors.monitors import Monitors
from hil.monitors.watched_log import WatchedLog
from hil.world.distances import Nearness, nearness
from path.config import EvidenceConfig, MethodConfig
from path.gate.evidence import EvidenceGate, evidence_needed, evidence_of, make_gate
from path.gate.identity import nearest_rival
from path.gate.window import FramePair, Gate, Offset, Offsets
from path.messages import Role
from path.observations import MissReason

METHOD = MethodConfig(gate="count", hold_frames=5, hold_s=0.4, max_gap_s=0.2)
PERIOD_NS = 100_000_000


@pytest.fixture
def monitors() -> Monitors:
    return Monitors.of_pair(METHOD)


def pairs(number: int, first: int = 1, **changes: Any) -> Iterator[dict[str, Any]]:
    """Agreeing pairs as the sender logs them."""
    for k in range(number):
        capture_ns = (first + k) * PERIOD_NS
        record = {
            "agreed": True,
            "counted": True,
            "iou": 0.7,
            "tau": 0.3,
            "count": k + 1,
            "target_id": 1,
            "epoch": 1,
        }
        yield {**record, "evidence": None, "capture_ns": capture_ns, **changes}


def near(apart_m: float) -> Nearness:
    """Return the truth of two bodies in the air that are so far from each other."""
    places_m = np.array([[0.0, 0.0, -1.0], [apart_m, 0.0, -1.0]])
    return nearness(("sender", "receiver"), places_m, 0.7)


def judge(monitors: Monitors, *records: dict[str, Any]) -> None:
    for record in records:
        monitors.on_record(Role.SENDER, "/agreement", record["capture_ns"] + 1, record)


def commit(monitors: Monitors, target_id: int = 1) -> None:
    give(monitors, 10 * PERIOD_NS, target_id=target_id)


def give(
    monitors: Monitors, stamp_ns: int, epoch: int = 1, target_id: int = 1, **changes: Any
) -> None:
    """Release and COMMIT, as the sender logs them."""
    monitors.on_record(Role.SENDER, "/epoch", stamp_ns, {"epoch": epoch, "duty": "released"})
    record = {
        "target_id": target_id,
        "epoch": epoch,
        "nonce": 7,
        "lease_end_ns": stamp_ns + 1_500_000_000,
    }
    monitors.on_record(Role.SENDER, "/commit", stamp_ns, {**record, **changes})


def responsible(monitors: Monitors, role: Role, is_so: bool) -> None:
    monitors.on_record(role, "/responsibility", 5, {"responsible": is_so, "until_ns": None})


def test_a_good_run_violates_nothing(monitors: Monitors) -> None:
    responsible(monitors, Role.SENDER, True)
    judge(monitors, *pairs(5))
    responsible(monitors, Role.SENDER, False)
    commit(monitors)
    responsible(monitors, Role.RECEIVER, True)
    responsible(monitors, Role.RECEIVER, True)  # provisionally, then for good
    for k in range(100):
        monitors.on_near(k * 0.02, near(1.2 + 0.1 * math.sin(k)))
    for role in Role:
        monitors.on_offboard(role, [OffboardSession(3.0, 0.06, 50.0, FlightMode.LAND)])
    monitors.on_record(Role.SENDER, "/phase", 5, {"phase": "land"})
    assert dict(monitors.violations) == {}
    assert monitors.details == []
    assert monitors.closest_m == pytest.approx(1.1, abs=0.01)


# --- S1


def test_s1_two_responsible_drones(monitors: Monitors) -> None:
    responsible(monitors, Role.SENDER, True)
    assert not monitors.violations
    responsible(monitors, Role.RECEIVER, True)
    assert dict(monitors.violations) == {"S1": 1}
    assert monitors.details[0].endswith("responsible at once: receiver, sender")


def test_s1_nobody_is_no_violation(monitors: Monitors) -> None:
    for role in (Role.SENDER, Role.RECEIVER):
        responsible(monitors, role, True)
        responsible(monitors, role, False)
    assert not monitors.violations


# --- S5


def test_s5_a_commit_without_enough_pairs(monitors: Monitors) -> None:
    judge(monitors, *pairs(4))
    commit(monitors)
    assert dict(monitors.violations) == {"S5": 1}
    assert "after 4 pairs" in monitors.details[0]


def test_s5_a_commit_too_soon(monitors: Monitors) -> None:
    quick = [{**record, "capture_ns": record["capture_ns"] // 2} for record in pairs(8)]
    judge(monitors, *quick)
    commit(monitors)
    assert dict(monitors.violations) == {"S5": 1}
    assert "0.35 s" in monitors.details[0]


def test_s5_a_commit_to_another_target(monitors: Monitors) -> None:
    judge(monitors, *pairs(5))
    commit(monitors, target_id=2)
    assert dict(monitors.violations) == {"S5": 1}


def test_s5_a_commit_out_of_nothing(monitors: Monitors) -> None:
    commit(monitors)
    assert dict(monitors.violations) == {"S5": 1}


@pytest.mark.parametrize(
    "changes", [{"agreed": False, "reason": "low_iou", "iou": 0.1, "tau": None, "count": 0}]
)
def test_s5_a_miss_in_between_restarts_the_count(
    monitors: Monitors, changes: dict[str, Any]
) -> None:
    first, missed, rest = pairs(3), next(pairs(1, 4, **changes)), pairs(4, 5)
    judge(monitors, *first, missed, *rest)
    assert not monitors.violations
    commit(monitors)
    assert dict(monitors.violations) == {"S5": 1}


def test_s5_what_is_no_evidence_does_not_restart_it(monitors: Monitors) -> None:
    ignored = next(pairs(1, 2, agreed=False, counted=False, reason="duplicate", tau=None))
    first, rest = list(pairs(5))[:3], list(pairs(5))[3:]
    judge(monitors, *first, ignored, *rest)
    commit(monitors)
    assert not monitors.violations


# --- S6


@pytest.mark.parametrize(
    "changes",
    [
        {"capture_ns": 3 * PERIOD_NS},  # the same frame again
        {"capture_ns": 2 * PERIOD_NS},  # an older one
        {"iou": 0.29},
        {"iou": None},
        {"tau": None},
        {"iou": math.nan},
    ],
)
def test_s6_a_pair_that_must_not_count(monitors: Monitors, changes: dict[str, Any]) -> None:
    judge(monitors, *pairs(3))
    judge(monitors, *pairs(1, 4, **{"count": 4, **changes}))
    assert dict(monitors.violations) == {"S6": 1}


def test_s6_an_old_frame_stays_old_across_a_miss(monitors: Monitors) -> None:
    judge(monitors, *pairs(3), *pairs(1, 4, agreed=False, iou=0.0, tau=None, count=0))
    judge(monitors, *pairs(1, 3))
    assert dict(monitors.violations) == {"S6": 1}


def test_s6_a_role_that_counts_more_than_there_was(monitors: Monitors) -> None:
    judge(monitors, *pairs(3), *pairs(1, 4, count=5))
    assert dict(monitors.violations) == {"S6": 1}
    assert "counts 5, the monitor 4" in monitors.details[0]


@pytest.mark.parametrize(
    ("later", "first"),
    [({"count": 4}, 7), ({"count": 4, "target_id": 2}, 4)],
    ids=["a gap", "another target"],
)
def test_s6_a_count_that_should_have_begun_again(
    monitors: Monitors, later: dict[str, Any], first: int
) -> None:
    judge(monitors, *pairs(3), *pairs(1, first, **later))
    assert dict(monitors.violations) == {"S6": 1}
    assert "the monitor 1" in monitors.details[0]


def test_a_count_that_begins_again_after_a_gap_is_right(monitors: Monitors) -> None:
    judge(monitors, *pairs(3), *pairs(5, 10))
    commit(monitors)
    assert not monitors.violations


# --- the gate "evidence"

EVIDENCE = MethodConfig(gate="evidence")
PATIENT = MethodConfig(
    gate="evidence", evidence=EvidenceConfig(patient_block_s=1.0, patient_strength=0.1)
)
BLOCK = 20  # pairs at 50 Hz


@dataclass
class Stream:
    """An evidence gate and what its sender logs of it, read by monitors."""

    monitors: Monitors = field(default_factory=lambda: Monitors.of_pair(EVIDENCE))
    gate: Gate = field(default_factory=lambda: EvidenceGate(EVIDENCE))
    epoch: int = 1
    offsets: Offsets = field(default_factory=lambda: Offsets((0.01, -0.005)))
    oversize: float = 0.0
    placed_iou: float | None = None

    def pair(self, index: int, iou: float = 0.8, **changes: Any) -> None:
        capture_ns = index * 20_000_000
        own = (index, capture_ns), (index + 1, capture_ns + 20_000_000)
        pair = FramePair(index, capture_ns, own, self.offsets, self.oversize, self.placed_iou)
        refusal = self.gate.agree(pair, iou, 0.4)
        evidence = self.gate.evidence.reached if self.gate.evidence else None
        counted = refusal in (None, MissReason.AMBIGUOUS_TARGET)
        record = {
            "agreed": refusal is None and iou >= 0.4,
            "counted": counted,
            "iou": iou,
            "tau": 0.4,
            "target_id": 1,
        }
        record |= {
            "count": self.gate.count,
            "evidence": evidence,
            "epoch": self.epoch,
            "capture_ns": capture_ns,
        }
        record |= {"offset_m": self.offsets.target_m, "rival_offset_m": nearest_rival(self.offsets)}
        record |= {"oversize": self.oversize, "placed_iou": self.placed_iou}
        judge(self.monitors, {**record, **changes})

    def pairs(self, first: int, number: int, iou: float = 0.8) -> None:
        for index in range(first, first + number):
            self.pair(index, iou)

    def commit(self, **changes: Any) -> dict[str, int]:
        give(self.monitors, 10, **{"epoch": self.epoch, **changes})
        return dict(self.monitors.violations)


def test_evidence_enough_for_a_commit_is_enough_for_the_monitors() -> None:
    stream = Stream()
    stream.pairs(0, 4 * BLOCK + 1)
    assert stream.gate.complete
    assert stream.commit() == {}


@pytest.mark.parametrize(
    ("iou", "placed_iou", "passes"), [(0.5, 0.8, True), (0.8, 0.5, False), (0.8, 0.3, False)]
)
def test_blocks_are_as_strong_as_the_overlap_of_placed_boxes_for_gate_and_monitors(
    iou: float, placed_iou: float, passes: bool
) -> None:
    stream = Stream(placed_iou=placed_iou)
    stream.pairs(0, 4 * BLOCK + 1, iou)
    assert stream.gate.complete == passes
    assert stream.commit() == ({} if passes else {"S5": 1})


@pytest.mark.parametrize(
    "offsets",
    [
        Offsets((0.10, 0.0)),
        Offsets((0.08, 0.0), ((0.09, 0.0),)),
        Offsets((0.03, 0.0), ((0.5, 0.0), (0.05, 0.0))),
    ],
)
def test_s5_a_box_that_may_be_of_another_object(offsets: Offsets) -> None:
    stream = Stream(offsets=offsets)
    stream.pairs(0, 20 * BLOCK + 1)
    assert not stream.gate.complete
    assert stream.commit() == {"S5": 1}


def test_s6_a_role_that_does_not_see_what_is_beside_the_target() -> None:
    stream = Stream()
    stream.pairs(0, 2 * BLOCK)
    stream.offsets = Offsets((0.01, 0.0), ((0.02, 0.0),))
    stream.pair(2 * BLOCK, evidence=2.44)
    assert dict(stream.monitors.violations) == {"S6": 1}


def test_boxes_too_large_for_the_target_take_a_run_down_for_the_monitors_as_for_the_gate() -> None:
    stream = Stream()
    stream.pairs(0, 4 * BLOCK + 1)
    stream.oversize = EVIDENCE.evidence.size_sigmas + 0.1
    stream.pairs(4 * BLOCK + 1, BLOCK)
    stream.oversize = 0.0
    stream.pair(5 * BLOCK + 1)
    assert not stream.gate.complete
    assert stream.commit() == {"S5": 1}


def test_s6_a_box_too_large_for_the_target_that_counts() -> None:
    stream = Stream()
    stream.pairs(0, BLOCK)
    stream.pair(BLOCK, oversize=EVIDENCE.evidence.size_sigmas + 0.1)
    assert dict(stream.monitors.violations) == {"S6": 1}


@pytest.mark.parametrize(("more", "violated"), [(1, {}), (0, {"S5": 1})])
def test_s5_is_as_patient_as_the_gate(more: int, violated: dict[str, int]) -> None:
    """Weak blocks all the time: nothing by the short ones, enough by the long ones, and not a pair
    sooner.
    """
    stream, (_, patient) = (
        Stream(Monitors.of_pair(PATIENT), make_gate(PATIENT)),
        PATIENT.evidence.paces,
    )
    blocks = next(
        n for n in range(1, 100) if evidence_of(n, patient) >= evidence_needed(1, patient)
    )
    stream.pairs(0, 50 * blocks + more, 0.5)
    assert stream.gate.complete == (not violated)
    assert stream.commit() == violated


def test_s5_a_commit_a_pair_too_soon() -> None:
    stream = Stream()
    stream.pairs(0, 4 * BLOCK)
    assert stream.commit() == {"S5": 1}
    assert "80 pairs, 1.58 s, evidence 2.88 in run 1" in stream.monitors.details[0]


def test_s5_a_later_run_needs_more_and_the_monitors_know() -> None:
    stream = Stream()
    stream.pairs(0, 2 * BLOCK + 1)
    stream.pairs(2 * BLOCK + 1, BLOCK, 0.41)  # weak: agreeing pairs all of them
    stream.pairs(3 * BLOCK + 1, 4 * BLOCK + 1)
    assert not stream.gate.complete
    assert stream.commit() == {"S5": 1}


def test_s5_is_silent_about_a_run_that_began_again_for_a_reason_of_the_senders_own() -> None:
    stream = Stream()
    stream.pairs(0, 30)
    stream.gate.restart(29 * 20_000_000)
    stream.pairs(30, 6 * BLOCK + 1)
    assert stream.gate.complete
    assert stream.commit() == {}


def test_s5_what_was_agreed_in_another_epoch_is_nothing() -> None:
    stream = Stream()
    stream.pairs(0, 4 * BLOCK + 1)
    assert stream.commit(epoch=2) == {"S5": 1}


def test_s5_a_new_epoch_begins_with_all_of_alpha_and_without_any_pair() -> None:
    stream = Stream()
    for first in range(0, 600, 30):  # many short runs
        stream.pairs(first, 20)
        stream.gate.restart((first + 20) * 20_000_000)
    stream.gate, stream.epoch = EvidenceGate(EVIDENCE), 2
    stream.pairs(601, 4 * BLOCK + 1)
    assert stream.commit() == {}


def test_a_commit_said_again_is_not_judged_again() -> None:
    stream = Stream()
    stream.pairs(0, 4 * BLOCK + 1)
    stream.commit()
    judge(stream.monitors, next(pairs(1, 700, agreed=False, tau=None)))
    assert stream.commit() == {}


def test_s6_a_role_that_claims_more_evidence_than_there_is() -> None:
    stream = Stream()
    stream.pairs(0, 2 * BLOCK)
    stream.pair(2 * BLOCK, evidence=4.4)
    assert dict(stream.monitors.violations) == {"S6": 1}
    assert "the role has evidence 4.40, the monitor 2.44" in stream.monitors.details[0]


@given(
    st.lists(
        st.tuples(st.sampled_from("aaaaaaaaawmsg"), st.integers(1, 50), st.floats(0.4, 1.0)),
        max_size=12,
    )
)
@settings(max_examples=100)
@pytest.mark.parametrize("method", [EVIDENCE, PATIENT])
def test_gate_and_monitors_never_differ(
    method: MethodConfig, script: list[tuple[str, int, float]]
) -> None:
    """Whatever comes in, in whatever order: what the gate completes is full for the monitors, and
    nothing else.
    """
    stream, index = Stream(Monitors.of_pair(method), make_gate(method)), 0
    for kind, length, iou in script:
        if kind in "aw":
            for _ in range(length):
                index += 1
                stream.pair(index, iou if kind == "a" else 0.42)
                stream.pair(max(0, index - 3), 1.0)  # an old one
                assert stream.gate.complete == stream.monitors.legs[0]._agreed.full  # pyright: ignore[reportPrivateUsage]
        elif kind == "m":
            index += 1
            stream.gate.disagree(index, index * 20_000_000)
            judge(
                stream.monitors,
                next(pairs(1, agreed=False, tau=None, capture_ns=index * 20_000_000)),
            )
        elif kind == "s":
            index += 1
            stream.gate.restart(index * 20_000_000)
        else:
            index += length
    assert not stream.monitors.violations


# --- S8


@pytest.mark.parametrize(
    ("gap_s", "ended_by", "cut_off", "violated"),
    [
        (0.19, FlightMode.LAND, False, False),
        (0.21, FlightMode.LAND, False, True),
        (0.21, None, False, True),
        (0.51, FlightMode.HOLD, True, False),  # the vehicle's own failsafe
        (1.10, FlightMode.HOLD, True, True),  # it came too late
        (0.90, None, True, True),  # it never came: still in offboard control, without setpoints
        (0.04, None, True, False),  # cut off when nothing was flown any more
    ],
)
def test_s8_setpoint_gaps(
    monitors: Monitors, gap_s: float, ended_by: FlightMode | None, cut_off: bool, violated: bool
) -> None:
    end_s = None if ended_by is None else 9.0
    sessions = [
        OffboardSession(1.0, 0.05, 2.0, FlightMode.LAND),
        OffboardSession(3.0, 0.0, end_s, ended_by),
    ]
    sessions[1].note_gap(4.0, 4.0 + gap_s)
    monitors.on_offboard(Role.RECEIVER, sessions, [8.0] if cut_off else [])
    assert dict(monitors.violations) == ({"S8": 1} if violated else {})
    assert all("receiver" in detail for detail in monitors.details)


def test_s8_is_told_with_the_gaps_own_time_and_each_gap_counts(monitors: Monitors) -> None:
    """A session begins long before: its time said nothing of what else happened then."""
    session = OffboardSession(3.0)
    for from_s, to_s in ((4.0, 4.1), (12.0, 12.15), (12.0, 12.244), (20.0, 20.2), (31.5, 31.957)):
        session.note_gap(from_s, to_s)
    monitors.on_offboard(Role.SENDER, [session])
    assert monitors.details == [
        "S8 at 12.00 s: sender: 0.244 s between setpoints, until 12.24 s",
        "S8 at 31.50 s: sender: 0.457 s between setpoints, until 31.96 s",
    ]
    assert [(gap.who, gap.from_s) for gap in monitors.gaps] == [("sender", 12.0), ("sender", 31.5)]


# --- S9


def test_s9_each_excursion_counts_once(monitors: Monitors) -> None:
    for k, separation_m in enumerate([1.0, 0.69, 0.60, 0.65, 0.71, 0.69, 0.8]):
        monitors.on_near(k * 0.02, near(separation_m))
    assert dict(monitors.violations) == {"S9": 2}
    assert monitors.closest_m == 0.60
    assert monitors.details[0] == "S9 at 0.02 s: sender and receiver are 0.69 m apart"


def test_s9_is_about_a_target_that_can_be_hit_as_well(monitors: Monitors) -> None:
    for k, nearest_m in enumerate([math.inf, 0.6, 0.39, 0.2, 0.5, 0.3]):
        monitors.on_target(k * 0.02, nearest_m)
    assert dict(monitors.violations) == {"S9": 2}
    assert monitors.details[0] == "S9 at 0.04 s: 0.39 m from the target, below 0.40 m"


# --- S11


def test_s11_counts_each_touch_of_each_body_once(monitors: Monitors) -> None:
    for k, away_m in enumerate([0.4, 0.1, -0.01, -0.05, 0.02, 0.0]):
        monitors.on_obstacles(k * 0.04, {"sender": 1.0, "receiver": away_m})
    monitors.on_obstacles(0.3, {})  # both have landed
    assert dict(monitors.violations) == {"S11": 2}
    assert monitors.details[0] == "S11 at 0.08 s: receiver touches an obstacle"
    assert monitors.obstacle_m == -0.05


# --- the watched log


@dataclass
class ListLog:
    records: list[tuple[str, int, Any]] = field(default_factory=list[tuple[str, int, Any]])

    def write(self, topic: str, stamp_ns: int, record: Any) -> None:
        self.records.append((topic, stamp_ns, record))

    def image(self, topic: str, stamp_ns: int, image: Any) -> None:
        self.records.append((topic, stamp_ns, image))


def test_a_watched_log_passes_everything_on_and_tells_the_monitors_world_time(
    monitors: Monitors,
) -> None:
    log = ListLog()
    responsible(monitors, Role.RECEIVER, True)
    watched = WatchedLog(log, Role.SENDER, monitors.on_record, offset_ns=4_000_000_000)
    record = {"responsible": True, "until_ns": None}
    watched.write("/responsibility", 6_500_000_000, record)
    watched.image("/image", 7, None)  # type: ignore[arg-type]
    assert log.records == [("/responsibility", 6_500_000_000, record), ("/image", 7, None)]
    assert monitors.details == ["S1 at 2.50 s: responsible at once: receiver, sender"]


def test_bounds_in_time_of_programs_that_run_do_not_bind_one_that_is_made_to_stand_still(
    monitors: Monitors,
) -> None:
    """Whoever is responsible, and until when, is not excused."""
    monitors.stalls = True
    for name in ("S7", "L1", "L2", "S1"):
        monitors.violated(name, 1.0, "so it is")
    assert dict(monitors.violations) == {"S1": 1}
    assert [told[:2] for told in monitors.beyond] == ["S7", "L1", "L2"]
    assert monitors.details == ["S1 at 1.00 s: so it is"]
    assert monitors.broken == ("stall",)


def test_what_was_promised_of_records_is_not_after_a_disk_has_lost_one(monitors: Monitors) -> None:
    """Vehicles, distances and agreements are not excused, and nothing is from before."""
    monitors.violated("S4", 0.5, "so it is")
    monitors.on_forgotten(1.0, Role.SENDER)
    for name in ("S1", "S4", "S6", "S8", "S9"):
        monitors.violated(name, 2.0, "so it is")
    assert dict(monitors.violations) == {"S4": 1, "S6": 1, "S8": 1, "S9": 1}
    assert [told[:2] for told in monitors.beyond] == ["S1", "S4"]
    assert monitors.broken == ("disk",)


# --- the gate "likelihood"

LIKELIHOOD = MethodConfig(gate="likelihood")


def by_likelihood(**changes: Any) -> Stream:
    return Stream(Monitors.of_pair(LIKELIHOOD), make_gate(LIKELIHOOD), **changes)


@pytest.mark.parametrize("rivals_m", [(), ((0.4, 0.1),), ((0.4, 0.1), (-0.35, 0.2))])
def test_a_likelihood_enough_for_a_commit_is_enough_for_the_monitors(
    rivals_m: tuple[Offset, ...],
) -> None:
    stream, rng = by_likelihood(), np.random.default_rng(3)
    for index in range(500):
        wavers = float(rng.normal(0.0, 0.01))
        stream.offsets = Offsets(
            (0.02 + wavers, -0.005), tuple((x + wavers, y) for x, y in rivals_m)
        )
        stream.pair(index, 0.1 if index % 17 == 5 else 0.8)
        if stream.gate.complete:
            break
    assert stream.gate.complete
    assert stream.commit() == {}


@pytest.mark.parametrize("offsets", [Offsets((0.15, 0.0)), Offsets((0.3, 0.0), ((0.01, 0.0),))])
def test_s5_a_box_that_errors_do_not_explain_by_likelihood(offsets: Offsets) -> None:
    stream = by_likelihood(offsets=offsets)
    stream.pairs(0, 300)
    assert not stream.gate.complete
    assert stream.commit() == {"S5": 1}


def test_s5_a_commit_by_likelihood_that_came_too_soon() -> None:
    stream = by_likelihood()
    stream.pairs(0, 40)
    assert stream.commit() == {"S5": 1}


def test_s6_a_role_that_claims_a_likelihood_that_its_pairs_do_not_have() -> None:
    stream = by_likelihood()
    stream.pairs(0, 60)
    stream.pair(60, evidence=9.9)
    assert dict(stream.monitors.violations) == {"S6": 1}

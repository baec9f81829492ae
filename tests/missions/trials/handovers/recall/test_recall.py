"""Detectors laid over hand-overs, and what the trial makes of both gates' commits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from flight.harness.montecarlo import MISS, PAIR, Series, StatedIdentity, Telling, tell
from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.handovers.judging import GATES, Verdict, judge_all
from missions.trials.handovers.recall import trial
from missions.trials.handovers.recall.attempts import (
    ALL_GATES,
    FRAMES,
    LOCKED_M,
    RecallAttempt,
    can_complete,
    faults_of,
    judge,
    orders,
    shortest_s,
    stays_far,
)
from missions.trials.handovers.recall.detectors import (
    REASONS,
    DetectorFaults,
    FaultyFrames,
    faulty_frames,
    spells,
    unwrapped,
    with_detector,
)
from missions.trials.handovers.recall.identity import counted, reliability
from missions.trials.shared.trial import TrialRequest, trial_part
from path.config import GateKind, MethodConfig
from path.gate.evidence import make_gate
from path.gate.window import Offsets
from path.observations import MissReason

METHOD = MethodConfig()
PERIOD_NS = 20_000_000
BY_ENTRY = ("offsets", "oversize", "placed_iou")


def series_of(count: int) -> Series:
    """Pairs that all agree, at 50 Hz; the sequence wraps on the way."""
    k = np.arange(count)
    own = np.stack((k, k * PERIOD_NS, k + 1, (k + 1) * PERIOD_NS), axis=1)
    capture = k * PERIOD_NS + 7_000_000
    yes = np.ones(count, bool)
    return Series(
        np.full(count, PAIR), np.full(count, -1), capture + PERIOD_NS, (65_500 + k) % 65_536, capture, own,
        np.full((count, 2), 0.8), np.full(count, 2.0), np.full(count, 0.01), yes, yes,
    )  # fmt: skip


def seen_by(series: Series, detector: DetectorFaults) -> Series:
    return with_detector(
        series, faulty_frames(detector, len(series) + 2, np.random.default_rng(1)), METHOD
    )


def test_the_longest_clear_stretch_is_of_both_drones_and_of_inventions_too() -> None:
    none = np.zeros(20, bool)
    at_5, at_12 = none.copy(), none.copy()
    at_5[5], at_12[12] = True, True
    assert FaultyFrames((none, none), (none, none)).longest_clear() == 20
    assert FaultyFrames((at_5, none), (none, none)).longest_clear() == 14
    assert FaultyFrames((at_5, none), (none, at_12)).longest_clear() == 7
    assert FaultyFrames((at_5, none), (none, none)).longest_clear(10) == 10


def told(series: Series, faults: FaultyFrames) -> tuple[bool, bool]:
    """Whether either gate may be complete after it was told a series."""
    seen, may = with_detector(series, faults, METHOD), list[bool]()
    for kind in GATES:
        own = replace(METHOD, gate=kind)
        telling = Telling(make_gate(own), own)
        telling.on(seen)
        may.append(can_complete(telling.gate, own, seen, faults))
    return may[0], may[1]


def test_a_gate_is_given_up_when_no_run_can_be_long_enough() -> None:
    none = np.zeros(FRAMES, bool)
    at_200, at_400 = none.copy(), none.copy()
    at_200[200], at_400[400] = True, True

    def missed(flags: NDArray[np.bool_]) -> FaultyFrames:
        return FaultyFrames((flags, none), (none, none))

    assert told(series_of(300), missed(none)) == (True, True)  # a run of 6 s goes on
    assert told(series_of(300), missed(at_200)) == (False, True)  # another cannot begin in time
    assert told(series_of(20), missed(at_400)) == (True, True)
    assert told(series_of(100), missed(at_400)) == (True, True)
    assert told(series_of(500), missed(none))[0]
    # no stretch of frames is long enough
    assert told(series_of(20), missed(at_200 | at_400)) == (False, True)
    assert not told(series_of(490), missed(at_400))[0]


@pytest.mark.parametrize(("share", "frames"), [(0.1, 5.0), (0.3, 15.0), (0.3, 1.0), (0.01, 1.0)])
def test_spells_have_their_share_and_their_length(share: float, frames: float) -> None:
    on = spells(share, frames, 400_000, np.random.default_rng(2))
    assert np.mean(on) == pytest.approx(share, rel=0.1)
    begins = np.sum(on[1:] & ~on[:-1])
    assert np.sum(on) / begins == pytest.approx(frames, rel=0.1)


def test_no_share_is_no_spell() -> None:
    assert not spells(0.0, 5.0, 100, np.random.default_rng(2)).any()


def test_numbers_of_frames_are_unwrapped_also_out_of_order() -> None:
    assert unwrapped(np.array([65_534, 65_535, 1, 0, 2])).tolist() == [0, 1, 3, 2, 4]


def test_perfect_detectors_change_nothing() -> None:
    series = series_of(300)
    seen = seen_by(series, DetectorFaults())
    assert np.array_equal(seen.kind, series.kind)
    assert np.array_equal(seen.iou, series.iou)


def test_misses_of_both_drones_take_pairs_and_say_why() -> None:
    seen = seen_by(series_of(50_000), DetectorFaults(0.9, 5.0))
    names = [REASONS[reason] for reason in seen.reason[seen.kind == MISS].tolist()]
    shares = {name: names.count(name) / len(seen) for name in set(names)}
    assert shares[MissReason.NO_CANDIDATE] == pytest.approx(0.1, rel=0.15)
    assert shares[MissReason.NO_TRACK] == pytest.approx(
        0.9 * (0.1 + 0.9 * 0.1 / 0.9 / 5.0), rel=0.2
    )
    assert shares.get(MissReason.LINK_SILENT, 0.0) < 0.01


def test_long_misses_of_d1_leave_d2_without_a_target() -> None:
    seen = seen_by(series_of(50_000), DetectorFaults(0.7, 15.0))
    assert np.sum(seen.kind == PAIR) / len(seen) == pytest.approx(0.7 * 0.68, rel=0.1)


def test_invented_boxes_overlap_with_nothing() -> None:
    seen = seen_by(series_of(50_000), DetectorFaults(1.0, 5.0, 0.05))
    assert np.all(seen.kind == PAIR)
    assert np.mean(seen.iou[:, 0] == 0.0) == pytest.approx(0.11, rel=0.2)


def test_a_growing_series_is_told_as_the_whole_one() -> None:
    seen = seen_by(series_of(500), DetectorFaults(0.99, 1.0))
    for kind in GATES:
        own = replace(METHOD, gate=kind, hold_frames=40, hold_s=0.5)
        telling = Telling(make_gate(own), own)
        for end in range(25, 501, 25):
            telling.on(first(seen, end))
        assert telling.done == tell(seen, make_gate(own), own)
        # offsets were not told: the gate "evidence" knows nothing of the object
        assert (telling.done is None) == (kind == "evidence")


@pytest.mark.parametrize("kind", GATES)
def test_an_entry_that_says_nothing_does_not_decide_because_it_is_judged_with_the_pair_that_does(
    kind: GateKind,
) -> None:
    """One frame of D1 lets it judge both. A miss costs no evidence, and the count ignores a frame
    that comes again.
    """
    own = replace(METHOD, gate=kind, hold_frames=40, hold_s=0.5)
    series = replace(
        series_of(200),
        right=np.ones(200, bool),
        offsets={k: Offsets((0.01, 0.0)) for k in range(200)},
    )
    done = tell(series, make_gate(own), own)
    assert done is not None
    series.kind[done + 1], series.right[done + 1], series.now_ns[done] = (
        MISS,
        False,
        series.now_ns[done + 1],
    )
    if kind == "count":
        series.sequence[done + 1] = series.sequence[done]
    assert tell(series, make_gate(own), own) == done


def first(series: Series, count: int) -> Series:
    arrays = {
        name: getattr(series, name)[:count]
        for name in series.__dataclass_fields__
        if name not in BY_ENTRY
    }
    return replace(series, **arrays)


def test_an_object_far_from_the_target_is_given_up_and_one_near_it_is_not() -> None:
    def far(offset_m: float, seconds: float) -> bool:
        series = series_of(round(50 * seconds))
        return stays_far(
            replace(series, offsets={7: Offsets((0.3, 0.0)), 9: Offsets((0.0, offset_m))})
        )

    assert far(0.2, 1.2)
    assert not far(0.2, 0.6)  # too soon to say
    assert not far(0.1, 1.2)


def test_the_shortest_runs_of_both_gates() -> None:
    assert shortest_s(replace(METHOD, gate="count")) == METHOD.hold_s
    assert shortest_s(replace(METHOD, gate="evidence")) == pytest.approx(1.6)


def test_every_cell_has_every_kind_of_attempt_and_no_hand_over_comes_twice() -> None:
    made = orders(3, [DetectorFaults()] * 5, 32)
    assert len({order.attempt.index for order in made}) == len(made) == 160
    for cell in range(5):
        own = [order for order in made if order.cell == cell]
        groups = [order.group for order in own]
        assert (groups.count("true"), groups.count("look-alike"), groups.count("wrong object")) == (
            16,
            8,
            8,
        )
        assert {o.attempt.wrong.distance_m for o in own if o.attempt.wrong is not None} == set(
            LOCKED_M
        )
        assert all(order.attempt.whole for order in own)


def judged(
    cell: int, group: str, count: Verdict, evidence: Verdict, likelihood: Verdict | None = None
) -> trial.Pair:
    template = next(o for o in orders(0, [DetectorFaults()], 4) if o.group == group)
    return replace(template, cell=cell), RecallAttempt(0, count, evidence, likelihood or Verdict())


@pytest.mark.parametrize("stated", [False, True])
def test_one_box_around_two_objects_is_handed_over_only_where_no_size_is_stated(
    stated: bool,
) -> None:
    """A look-alike 0.32 m beside the target: both detectors take the two for one object, from the
    first frame on.
    """
    order = next(
        each for each in orders(9107, trial.DETECTORS, trial.OF_EACH) if each.attempt.index == 1188
    )
    rig = rig_library.load("sim-rendered")
    if not stated:
        rig = replace(
            rig, method=replace(rig.method, evidence=replace(rig.method.evidence, span_m=0.0))
        )
    (told,) = judge_all(rig, judge, [order])
    assert told.count is not None and not told.count.committed
    assert told.evidence.wrong == (not stated)
    assert told.evidence.committed == (not stated)


def test_a_cell_counts_true_commits_and_all_wrong_ones() -> None:
    none, good, late = Verdict(), Verdict(2.0, 2.0, True, True), Verdict(4.0, 4.0, True, True)
    wrong = Verdict(1.0, 1.0, False, False)
    told = [
        judged(1, "true", none, good),
        judged(1, "true", none, late),
        judged(1, "true", good, none),
        judged(1, "look-alike", none, wrong),
        judged(1, "wrong object", wrong, wrong),
        judged(2, "true", wrong, wrong, wrong),
    ]
    evidence = trial.cell_of(told, 1, "evidence")
    assert (evidence.true_attempts, evidence.attempts, evidence.wrong) == (3, 5, 2)
    assert evidence.commit_rate == pytest.approx(2 / 3)
    assert evidence.t_median_s == 4.0
    assert evidence.t_p90_s == np.inf
    assert trial.cell_of(told, 1, "count").wrong == 1
    assert [trial.cell_of(told, cell, "likelihood").wrong for cell in (1, 2)] == [0, 1]


def test_what_d1_stated_is_held_against_what_it_followed() -> None:
    stated = (
        [StatedIdentity(0.9995, True)] * 90
        + [StatedIdentity(0.97, True)] * 6
        + [StatedIdentity(0.97, False)] * 4
    )
    rows = {row[0]: row[1:] for row in reliability([counted(stated), counted(stated[:90])]).rows}
    assert rows["0 to 0.001"][:4] == ("180", "0", "2", "0")
    assert rows["0.02 to 0.05"][:4] == ("10", "0.4", "1", "1")
    assert rows["0.5 to 1"] == ("0", "-", "0", "0", "-")


@pytest.mark.parametrize("short", [True, False])
def test_a_result_says_whether_it_is_short(short: bool) -> None:
    good = Verdict(2.0, 2.0, True, True)
    told = [
        judged(cell, "true", good, good) for cell in range(len(trial.DETECTORS)) for _ in range(4)
    ]
    found = trial.result(told, short)
    assert [finding.verdict for finding in found.findings[:3]] == ["met"] * 3
    assert found.findings[3].verdict == "short"  # so few attempts bound nothing
    assert found.summary["short"] is short
    assert len(found.summary["cells"]) == 3 * 45


def test_its_short_form(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "DETECTORS", (trial.EASY, trial.HARD))
    monkeypatch.setattr(trial, "QUICK", 4)
    with open_work(1) as work:
        request = TrialRequest(rig_library.load("sim-rendered"), tmp_path, 5, True, work)
        found = trial.run(request)
        kept = tmp_path / trial.KEPT
        whole = kept.read_text()
        kept.write_text("".join(whole.splitlines(keepends=True)[:-2]))
        # what an interrupt left out is run again, and nothing else
        assert trial.run(request).summary == found.summary
        assert kept.read_text() == whole
    assert found.summary["attempts"] == 8
    assert [cell["gate"] for cell in found.summary["cells"]] == [*ALL_GATES, *ALL_GATES]
    assert [cell["commit_rate"] for cell in found.summary["cells"][1:3]] == [1.0, 1.0]
    assert found.summary["cells"][0]["commit_rate"] == 0.0


@pytest.mark.parametrize(
    ("seed", "index"), [(70001, 50), (70002, 5840), (370011, 2237), (370014, 1505)]
)
def test_a_sender_that_may_have_gone_over_to_another_object_hands_nothing_over(
    seed: int, index: int
) -> None:
    """Its boxes began around both; later both drones' boxes were of the other one, which no gate
    can see.
    """
    rig = rig_library.load("sim-rendered")
    order = orders(seed, trial.DETECTORS, index // len(trial.DETECTORS) + 1)[index]
    for gate in ("evidence", "likelihood"):
        method = replace(rig.method, gate=gate)
        runner = trial_part(rig, "montecarlo")(rig)
        series = runner.run(order.attempt).series
        faults = faults_of(order)
        seen = with_detector(series, faults, method)
        done = tell(seen, make_gate(method), method) if len(seen) else None
        assert done is None or seen.right[done], gate

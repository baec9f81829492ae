"""Monte-Carlo hand-overs: repeatability, forced wrong associations, and what each fault does."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import get_args

import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from flight.harness.montecarlo import (
    OWN_MISS,
    PAIR,
    Attempt,
    FaultName,
    Series,
    WrongAssociation,
    agreeing,
    tell,
)
from hil.montecarlo.run import MonteCarloHandovers
from missions.ground import rig_library
from path.config import MethodConfig
from path.gate.window import AgreementWindow
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout
from tests.path.gate.side_by_side import SideBySide

SHORT = replace(MethodConfig(), hold_frames=40, hold_s=0.8)


def rig() -> Rig:
    return rig_library.load("sim")


@cache
def runner() -> MonteCarloHandovers:
    return MonteCarloHandovers(rig(), SHORT).warmed()


def same(a: Series, b: Series) -> None:
    """Equal in every number, to the last bit."""
    assert len(a) == len(b)
    for field in fields(Series):
        assert np.all(getattr(a, field.name) == getattr(b, field.name)), field.name


@pytest.mark.parametrize("kind", ["shift", "turn"])
@pytest.mark.parametrize("roll_deg", [0.0, 40.0])
def test_overlaps_are_those_of_both_mappings_whichever_the_method_uses(
    kind: str, roll_deg: float
) -> None:
    attempt = Attempt(
        4,
        1,
        wrong=WrongAssociation(kind, 0.5),  # type: ignore[arg-type]
        roll_deg=roll_deg,
        limit_s=1.5,
        whole=True,
    )
    by_corner = MonteCarloHandovers(rig(), replace(SHORT, box_mapping="corner"))
    same(runner().run(attempt).series, by_corner.run(attempt).series)


@pytest.mark.parametrize("fault", get_args(FaultName))
def test_every_fault_goes_through_the_method(fault: FaultName) -> None:
    series = runner().run(Attempt(3, 5, fault, limit_s=2.5, whole=True)).series
    assert len(series) > 90
    assert (series.kind == PAIR).any()
    assert np.isfinite(series.iou).all()


def test_an_attempt_depends_on_seed_and_index_alone() -> None:
    attempt = Attempt(1, 2, "mixed", limit_s=1.5, whole=True)
    first = runner().run(attempt).series
    runner().run(Attempt(8, 8, limit_s=0.5))
    same(first, MonteCarloHandovers(rig(), SHORT).run(attempt).series)
    other = runner().run(replace(attempt, index=3)).series
    assert len(other) != len(first) or (other.iou != first.iou).any()


def test_an_undisturbed_hand_over_ends_in_a_commit_of_the_right_object() -> None:
    found = runner().run(Attempt(0, 0, limit_s=4.0))
    assert found.outcome == "commit"
    assert found.right is True
    assert found.start_s is not None
    assert found.commit_s is not None
    assert 0.8 <= found.commit_s - found.start_s < 1.5
    assert found.series.right[found.series.kind == PAIR].all()
    assert found.circumstances.look_alike_m >= 1.0


def test_an_attempt_that_can_no_longer_commit_is_given_up_and_no_other() -> None:
    for index in range(12):
        attempt = Attempt(6, index, "mixed", limit_s=3.0)
        found, whole = runner().run(attempt), runner().run(replace(attempt, whole=True))
        assert (found.outcome, found.commit_s, found.right) == (
            whole.outcome,
            whole.commit_s,
            whole.right,
        )
    never = runner().run(Attempt(6, 0, wrong=WrongAssociation("lock", 0.8), limit_s=4.2))
    assert never.outcome == "timeout"
    assert 3.4 < never.simulated_s < 4.2  # the window needs 0.8 s


def test_the_closest_look_alike_is_the_one_that_drives_past() -> None:
    past = runner().run(Attempt(0, 0, "look_alike_crossing", limit_s=12.0)).circumstances
    assert 0.3 < past.closest_m < 0.45 < past.look_alike_m
    near = runner().run(Attempt(0, 0, "look_alike_near", limit_s=1.0)).circumstances
    assert near.closest_m == pytest.approx(near.look_alike_m, abs=1e-6)


def test_a_pose_that_is_off_makes_the_boxes_of_a_look_alike_agree() -> None:
    """The mapping goes back by the same wrong pose: decision 0209 says so."""
    found = [
        runner().run(Attempt(0, k, wrong=WrongAssociation("shift", 0.8, 0.0), limit_s=4.0))
        for k in range(6)
    ]
    assert sum(each.right is False for each in found) >= 4


def test_a_look_alike_where_nobody_looks_is_no_candidate() -> None:
    found = runner().run(Attempt(0, 1, wrong=WrongAssociation("lock", 0.8), limit_s=2.0))
    assert found.outcome == "timeout"
    assert found.reason == "no_candidate"
    assert not found.series.right.any()


def test_telling_a_gate_is_what_the_cycle_did() -> None:
    found = runner().run(Attempt(2, 7, "marker_occlusion", limit_s=6.0))
    done = tell(found.series, AgreementWindow(SHORT), SHORT)
    assert done is not None
    assert done == len(found.series) - 1  # the cycles stopped there
    looking_on = AgreementWindow(SHORT)
    tell(found.series, SideBySide(AgreementWindow(SHORT), looking_on), SHORT)
    assert looking_on.complete


def test_an_own_miss_restarts_and_a_higher_threshold_agrees_less() -> None:
    series = runner().run(Attempt(1, 0, "depth_holes", limit_s=9.0, whole=True)).series
    assert (series.kind == OWN_MISS).any()
    strict = replace(SHORT, tau_min=0.85, tau_max=0.95)
    assert agreeing(series, strict).sum() < agreeing(series, SHORT).sum()


def test_from_farther_away_the_target_is_farther_and_nothing_else_is_drawn_anew() -> None:
    near, far = (
        runner().run(Attempt(0, 3, reach=reach, limit_s=0.5)).circumstances for reach in (1.0, 1.4)
    )
    assert far.range_1_m == pytest.approx(1.4 * near.range_1_m, rel=0.02)
    assert (far.look_alike_m, far.target_mps) == (near.look_alike_m, near.target_mps)


def test_conditions_and_every_fault_are_put_into_words() -> None:
    assert set(runner().meanings()) == set(get_args(FaultName))
    assert len(runner().conditions()) > 10
    assert all(what and how for what, how in runner().conditions())


def test_one_marker_is_needed() -> None:
    one = rig()
    still = Pose(np.eye(3), np.zeros(3))
    two = MarkerLayout(
        (
            Marker(0, 0.04, 0.0, still),
            Marker(1, 0.04, 0.0, Pose(np.eye(3), np.array([0.1, 0.0, 0.0]))),
        )
    )
    with pytest.raises(PartError, match="one marker"):
        MonteCarloHandovers(replace(one, layout=two))


def test_what_d1_followed_itself_is_told_apart_from_what_both_did_not_agree_on() -> None:
    """Right boxes are of what D1 follows as long as it follows the target; a look-alike for D2
    alone is neither.
    """
    good = runner().run(Attempt(0, 0, limit_s=2.0)).series
    assert good.same[good.right].all()
    misled = (
        runner()
        .run(Attempt(0, 0, wrong=WrongAssociation("shift", 0.8, 0.0), limit_s=2.0, whole=True))
        .series
    )
    assert (misled.kind == PAIR).sum() > 50
    assert not misled.same.any() and not misled.right.any()

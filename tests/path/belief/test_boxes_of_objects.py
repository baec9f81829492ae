"""What a box says of an object whose size it has not, how surely an object exists, and what doubts
cost: by hand.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from path.belief import boxes as file
from path.belief.boxes import Measured
from path.belief.frame import Frame
from path.belief.motion import Motion
from path.belief.objects import Belief
from path.belief.track import ObjectTrack
from tests.path.belief.test_objects import AXES, EVERYWHERE, FRAME_NS, begun, box

S = 1_000_000_000
TURNED = np.array([[0.0, -0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])


def track(sides_m: tuple[float, float] = (0.3, 0.4), variance: float = 0.01) -> ObjectTrack:
    motion = Motion.at(np.array([2.0, 0.0, 0.0]), 0.01 * np.eye(3), 0.6, 0)
    return ObjectTrack(0, motion, np.log(sides_m), np.full(2, variance), log_odds=5.0, seen_ns=0)


def measured(sides_m: tuple[float, float], **changes: object) -> Measured:
    usual = Measured(
        np.array([2.0, 0.0, 0.0]), 1e-4 * np.eye(3), np.zeros(3), TURNED, sides_m, 0.05,
        (math.inf, math.inf), 1e-3, 5e-3,
    )  # fmt: skip
    return replace(usual, **changes)


def test_a_middle_within_half_of_what_is_too_much_along_each_side_of_the_box() -> None:
    beyond = np.array([0.2, 0.4])
    spread = np.diag([0.01, 0.04, 0.04])  # and ahead as far as the larger one
    np.testing.assert_allclose(file._halves(beyond), np.diag(spread))
    np.testing.assert_allclose(file.within(beyond, TURNED), TURNED @ spread @ TURNED.T, atol=1e-15)


def test_a_place_is_never_known_better_by_it_than_that_however_many_frames_say_it() -> None:
    beyond = np.array([0.2, 0.4])
    motion = Motion.at(np.zeros(3), np.eye(3), 0.6, 0)
    for _ in range(200):
        motion.update(np.zeros(3), file._bounded(motion, beyond, AXES))
    known = np.diag(AXES.T @ motion.place_covariance_m2 @ AXES)
    np.testing.assert_allclose(known, (0.01, 0.04, 0.04), rtol=0.05)
    better = Motion.at(np.zeros(3), np.diag([1e-6, 1e-6, 1e-6]), 0.6, 0)
    better.update(np.array([0.05, 0.05, 0.05]), file._bounded(better, beyond, AXES))
    np.testing.assert_allclose(better.place_m, 0.0, atol=1e-4)  # it is told nothing


FACTOR = math.exp(2.0 * math.sqrt(0.01 + 0.05**2))


def test_a_box_of_the_object_s_size_has_its_own_noise_alone() -> None:
    for times in (1.0, 0.99 * FACTOR, 1.01 / FACTOR):
        fit = file.fit_of(track(), measured((0.3 * times, 0.4 * times)))
        np.testing.assert_array_equal(fit.within_m2, np.zeros((3, 3)))
        np.testing.assert_array_equal(fit.noise_m2, 1e-4 * np.eye(3))
        assert not fit.larger


def test_in_a_larger_box_there_is_something_else_and_the_object_anywhere_in_it() -> None:
    own = track()
    seen = measured((0.9, 0.4))
    fit = file.fit_of(own, seen)
    beyond = np.array([0.9 - 0.3 / FACTOR, 0.4 - 0.4 / FACTOR])
    assert fit.larger
    np.testing.assert_allclose(fit.within_m2, file.within(beyond, TURNED))
    bounded = file._bounded(own.motion, beyond, TURNED)
    np.testing.assert_allclose(fit.noise_m2, 1e-4 * np.eye(3) + bounded)


def test_in_a_smaller_box_a_part_of_the_object_is_hidden() -> None:
    fit = file.fit_of(track(), measured((0.1, 0.4)))
    beyond = np.array([0.3 - 0.1, 0.0])
    assert not fit.larger
    np.testing.assert_allclose(fit.within_m2, file.within(beyond, TURNED))


def test_no_object_is_larger_than_the_target_can_be() -> None:
    own = track((0.9, 0.4))
    most = measured((0.5, 0.4), most_m=(0.5, 0.6))
    assert not file.fit_of(own, most).larger
    fit = file.fit_of(own, measured((0.6, 0.4), most_m=(0.5, 0.6)))
    assert fit.larger
    beyond = np.array([0.6 - 0.5 / FACTOR, 0.4 - 0.4 / FACTOR])
    np.testing.assert_allclose(fit.within_m2, file.within(beyond, TURNED))
    np.testing.assert_allclose(own.sides_m((0.5, 0.6)), (0.5, 0.4))


def test_sides_are_as_likely_as_a_distribution_with_tails_has_them_against_any() -> None:
    """Student's, of three degrees of freedom, for either side."""
    own = track()
    found = file.size_fits(own, measured((0.3 * math.exp(0.2), 0.4 * math.exp(-0.1))))
    variance = 0.01 + 0.05**2
    densities = [
        2.0 / (math.pi * math.sqrt(3.0 * variance)) * (1.0 + off**2 / (3.0 * variance)) ** -2
        for off in (0.2, 0.1)
    ]
    assert found == pytest.approx(math.prod(densities) / 0.25, rel=1e-3)


@pytest.mark.parametrize(
    ("sides_m", "right_m", "part"),
    [
        ((0.1, 0.1), 0.0, True),
        ((0.1, 0.1), 0.15, True),
        ((0.1, 0.1), 0.25, False),  # both together are wider than the object
        ((0.3 * 0.99 * FACTOR, 0.1), 0.0, True),
        ((0.3 * 1.01 * FACTOR, 0.1), 0.0, False),
    ],
)
def test_a_box_that_is_no_more_than_the_object_together_with_its_own_is_of_it_too(
    sides_m: tuple[float, float], right_m: float, part: bool
) -> None:
    own = track()
    seen = measured(sides_m, place_m=np.array([2.0, 0.0, 0.0]) + right_m * TURNED[:, 0])
    assert file.is_part(seen, own, None) is part
    there = measured((0.3, 0.4), place_m=own.motion.place_m.copy())
    own.motion.mean[:3] += 9.0  # it is where its box is
    assert file.is_part(seen, own, there) is part
    own.log_odds = 1.0
    assert not file.is_part(seen, own, there)  # it may be nothing itself


# --- existence, and what is doubted


def test_a_new_object_exists_by_one_in_ten_and_surely_after_half_a_second() -> None:
    belief, stamp_ns = begun()
    belief.update([box(0.0), box(0.6)], EVERYWHERE, stamp_ns + FRAME_NS)
    new = belief.tracks[1]
    assert new.existence == pytest.approx(0.1) and not new.confirmed
    for k in range(2, 60):
        belief.update([box(0.0), box(0.6)], EVERYWHERE, stamp_ns + k * FRAME_NS)
        odds = math.log(1.0 / 9.0) + (k - 1) * 0.02 / 0.1
        if not new.confirmed:
            assert new.log_odds == pytest.approx(odds)
        assert new.confirmed is (odds + 1e-9 >= math.log(19.0))
    kept = new.log_odds
    belief.update([box(0.0)], EVERYWHERE, stamp_ns + 60 * FRAME_NS)
    assert new.log_odds == kept  # once it exists it is only out of sight


@pytest.mark.parametrize("sees", [True, False])
def test_what_is_not_shown_where_it_can_be_seen_exists_less(sees: bool) -> None:
    belief, stamp_ns = begun()
    belief.update([box(0.0), box(0.6)], EVERYWHERE, stamp_ns + FRAME_NS)
    new = belief.tracks[1]
    belief.update([box(0.0)], lambda place: sees or place[1] < 0.3, stamp_ns + 2 * FRAME_NS)
    lost = math.log(10.0) * 0.02 / 0.1 if sees else 0.0
    assert new.log_odds == pytest.approx(math.log(1.0 / 9.0) - lost)
    assert new.shown is not sees


def test_doubts_add_up_to_no_more_than_all_and_some_of_them_are_hidden() -> None:
    own = track()
    own.doubted(0.4)
    assert (own.replaced, own.hidden) == (pytest.approx(0.38), pytest.approx(0.02))
    own.doubted(0.5)
    assert own.doubt == pytest.approx(0.4 + 0.6 * 0.5)
    assert own.hidden == pytest.approx(0.05 * own.doubt)
    own.doubted(1.0)
    assert own.doubt == pytest.approx(1.0)
    own.replaced = 2.0
    assert own.doubt == 1.0


def test_what_was_not_seen_for_longer_than_misses_last_is_hidden() -> None:
    own = track()
    own.doubted(0.4, unseen_s=0.3)
    hidden = 0.05 / (0.05 + 0.95 * math.exp(-3.0))
    assert (own.replaced, own.hidden) == (
        pytest.approx(0.4 * (1.0 - hidden)), pytest.approx(0.4 * hidden),
    )  # fmt: skip


def test_a_doubt_that_a_new_object_has_taken_is_none_any_more() -> None:
    belief, stamp_ns = begun()
    (own,) = belief.tracks
    own.hidden = 0.3
    for k in range(1, 60):
        belief.update([box(0.0), box(0.6)], EVERYWHERE, stamp_ns + k * FRAME_NS)
    assert own.doubt < 1e-3
    assert belief.probability(own.number) == pytest.approx(0.7, abs=0.01)
    assert belief.identity_of(1) == pytest.approx(0.3, abs=0.01)


def far_off(east_m: float, sigma_m: float = 0.1) -> ObjectTrack:
    """One twice as far off as a box, and so twice as far beside the middle as one at its range."""
    own = track((0.3, 0.3))
    own.motion = Motion.at(np.array([4.0, east_m, 0.0]), sigma_m**2 * np.eye(3), 0.6, 0)
    return own


def test_one_is_seen_in_the_box_of_a_nearer_one_by_its_direction_as_likely_as_it_is_known() -> None:
    around = box(0.0, wide_m=0.6)
    for east_m, half in ((0.5, 1.0), (0.6, 0.5), (0.7, 0.1587)):
        high = math.erf(3.0 / math.sqrt(2.0))  # within its height
        sides = 0.5 * (1.0 + math.erf((0.6 - east_m) / 0.1 / math.sqrt(2.0)))
        assert file.inside(far_off(east_m).motion, around) == pytest.approx(high * sides)
        assert sides == pytest.approx(half, abs=0.16)
    behind = Motion.at(np.array([-1.0, 0.0, 0.0]), np.eye(3), 0.6, 0)
    assert file.inside(behind, around) == 0.0


def test_one_is_held_in_the_box_of_a_nearer_one_by_its_direction_at_its_own_range() -> None:
    around = box(0.0, wide_m=0.6)
    far = far_off(0.0)
    far.motion.covariance[1, 1] = 4.0
    fit = file.held(far, around, [], np.asarray(around.sides_m))
    far.motion.update(fit.place_m, fit.noise_m2)
    np.testing.assert_allclose(far.motion.mean[:3], (4.0, 0.0, 0.0), atol=1e-9)
    assert far.motion.covariance[1, 1] == pytest.approx(0.6**2, rel=0.05)
    assert far.motion.covariance[0, 0] == pytest.approx(0.01, rel=0.01)  # of how far off, nothing


def beside(east_m: float, sigma_m: float = 0.02, north_m: float = 2.0) -> ObjectTrack:
    own = track((0.3, 0.3), variance=1e-4)
    own.motion = Motion.at(np.array([north_m, east_m, 0.0]), sigma_m**2 * np.eye(3), 0.6, 0)
    return own


def test_an_edge_of_a_box_of_two_is_of_the_one_that_surely_reaches_farther_there() -> None:
    """0.7 m wide, from -0.2: the left one's middle is at -0.05, and the right one's at 0.35."""
    around = box(0.15, wide_m=0.7)
    left, right = beside(-0.1), beside(0.3)
    for own, other, east_m in ((left, right, -0.05), (right, left, 0.35)):
        fit = file.held(own, around, [other], np.array([0.4, 0.0]))
        assert fit.larger
        assert fit.place_m[1] == pytest.approx(east_m)
        assert math.sqrt(fit.within_m2[1, 1]) == pytest.approx(0.5 * 0.3 * 0.01)


@pytest.mark.parametrize("why", ["it may be the other one's", "the border cuts the box"])
def test_where_an_edge_is_surely_nobody_s_one_is_anywhere_in_the_box(why: str) -> None:
    cut = why == "the border cuts the box"
    around = replace(box(0.15, wide_m=0.7), cut_edges=((cut, False), (False, False)))
    sigma_m = 0.02 if cut else 0.2
    fit = file.held(beside(-0.1, sigma_m), around, [beside(0.3, sigma_m)], np.array([0.4, 0.0]))
    assert fit.place_m[1] == pytest.approx(0.15)
    assert math.sqrt(fit.within_m2[1, 1]) == pytest.approx(0.2)


def test_a_border_that_cuts_one_edge_leaves_the_other_to_whom_it_is_of() -> None:
    around = replace(box(0.15, wide_m=0.7), cut_edges=((True, False), (False, False)))
    fit = file.held(beside(0.3), around, [beside(-0.1)], np.array([0.4, 0.0]))
    assert fit.place_m[1] == pytest.approx(0.35)
    assert around.cut == (True, False)


def test_how_far_off_a_box_is_it_says_of_the_nearest_in_it() -> None:
    around = box(0.15, wide_m=0.7, north_m=2.1)
    near, far = beside(0.0), beside(0.3, north_m=4.0)
    beyond = np.array([0.4, 0.0])
    assert file.held(near, around, [far], beyond).place_m[0] == pytest.approx(2.1)
    for its_own in (False, True):
        held = file.held(far, around, [near], beyond, its_own=its_own)
        assert held.place_m[0] == pytest.approx(4.0)
    # where it is not known who is, of the one to whom the box was given
    near.motion.covariance[0, 0] = 1.0
    assert file.held(far, around, [near], beyond).place_m[0] == pytest.approx(4.0)
    assert file.held(far, around, [near], beyond, its_own=True).place_m[0] == pytest.approx(2.1)


@pytest.mark.parametrize(("sigma_m", "moved"), [(0.1, True), (2.0, False)])
def test_a_box_that_may_as_well_be_the_other_one_s_moves_neither_to_its_range(
    sigma_m: float, moved: bool
) -> None:
    """A box twice as high as one is; of the farther one it is hardly less likely, or surely not."""
    around = box(0.0, high_m=0.7, north_m=2.5)
    near, far = beside(0.0, north_m=2.9), beside(0.0, north_m=5.0)
    near.motion.covariance[0, 0] = 0.4**2
    far.motion.covariance[0, 0] = sigma_m**2
    frame = Frame([near, far], [around], lambda _: True, 0.02)
    assert frame.together == {0}
    own = [pair[1] for k in range(2) if (pair := frame.fit(k)) is not None]
    held = [fit for fit in frame.held if fit is not None]
    assert len(own) == len(held) == 1
    assert own[0].place_m[0] == pytest.approx(2.5 if moved else 2.9)
    assert held[0].place_m[0] == pytest.approx(5.0)


def test_a_cut_side_is_as_likely_as_the_object_is_so_large_at_least() -> None:
    own = track()
    whole = file.size_fits(own, measured((0.3, 0.4)))
    for cut_m, likely in ((0.3, 0.5), (0.03, 1.0), (3.0, 0.0)):
        cut = file.size_fits(own, measured((cut_m, 0.4), cut_edges=((True, False), (False, False))))
        density = math.sqrt(whole)  # of the other side
        assert cut / density == pytest.approx(likely, abs=2e-3)


def test_a_doubt_goes_by_nine_tenths_with_each_spell_in_which_nothing_else_comes_up() -> None:
    belief, stamp_ns = begun()
    (own,) = belief.tracks
    own.replaced, own.hidden = 0.5, 0.02
    for k in range(1, 6):
        belief.update([box(0.0)], EVERYWHERE, stamp_ns + k * FRAME_NS)
    assert own.replaced == pytest.approx(0.5 * 0.1, abs=1e-4)
    assert own.hidden == pytest.approx(0.02 * math.exp(-0.1 / 5.0), abs=1e-4)


def test_the_size_of_an_object_is_learnt_from_boxes_of_its_own() -> None:
    belief, stamp_ns = begun()
    (own,) = belief.tracks
    before, variances = own.log_sides.copy(), own.size_variances.copy()
    belief.update([box(0.0, wide_m=0.31)], EVERYWHERE, stamp_ns + FRAME_NS)
    grown = variances + 0.1**2 * 0.02
    gain = grown / (grown + 0.03**2)
    off = np.log((0.31, 0.3)) - before
    np.testing.assert_allclose(own.log_sides, before + gain * off)
    np.testing.assert_allclose(own.size_variances, (1.0 - gain) * grown)


def test_nothing_is_learnt_of_size_from_a_box_that_cannot_be_its_own() -> None:
    belief, stamp_ns = begun()
    (own,) = belief.tracks
    before = own.log_sides.copy()
    belief.update([box(0.0, wide_m=0.15)], EVERYWHERE, stamp_ns + FRAME_NS)
    np.testing.assert_array_equal(own.log_sides, before)
    assert own.seen_ns == stamp_ns + FRAME_NS


@pytest.mark.parametrize("another", [False, True])
def test_a_box_with_another_one_in_it_tells_less_of_its_object_than_one_that_turned(
    another: bool,
) -> None:
    """Size was not seen for a while, so that an object may have turned: not if somebody else, whom
    nothing else shows, is where the box is larger.
    """
    belief, stamp_ns = begun(others_m=[0.5] if another else [])
    own = belief.tracks[0]
    if another:
        belief.tracks[1].motion.mean[:3] = own.motion.place_m + np.array([0.5, 0.0, -0.05])
        belief.tracks[1].motion.mean[3:] = own.motion.mean[3:]
    stamp_ns += S
    for _ in range(10):
        stamp_ns += FRAME_NS
        belief.update([box(0.0, high_m=0.36)], EVERYWHERE, stamp_ns)
    high_m = math.exp(float(own.log_sides[1]))
    known_m2 = float(AXES[:, 1] @ own.motion.place_covariance_m2 @ AXES[:, 1])
    assert own.shown is not another
    assert high_m == pytest.approx(0.3 if another else 0.36, abs=0.02)
    assert (math.sqrt(known_m2) > 0.03) is another


def test_depth_alone_keeps_a_track_within_its_body_in_a_frame_without_a_box() -> None:
    belief, stamp_ns = begun()
    (own,) = belief.tracks
    belief.carry(np.array([2.1, 0.1, 0.0]), stamp_ns)  # this frame has a box of it
    assert own.motion.place_m[1] == pytest.approx(0.0, abs=1e-3)
    later_ns = stamp_ns + 40 * FRAME_NS
    belief.update([], EVERYWHERE, later_ns)
    expected = Motion(own.motion.mean.copy(), own.motion.covariance.copy(), later_ns)
    expected.update(np.array([2.1, 0.1, 0.0]), 0.15**2 * np.eye(3))
    belief.carry(np.array([2.1, 0.1, 0.0]), later_ns)
    np.testing.assert_allclose(own.motion.mean, expected.mean, rtol=0.05, atol=1e-4)
    assert own.motion.place_m[1] > 0.01
    assert Belief(0.6).carry(np.zeros(3), 5) is None  # there is nothing to keep


def test_one_that_was_designated_is_known_half_as_well_as_its_box() -> None:
    belief = Belief(0.6)
    place = np.array([2.0, 0.1, 0.0])
    belief.designate(place, box(0.0), 5)
    (own,) = belief.tracks
    np.testing.assert_array_equal(own.motion.place_m, place)
    np.testing.assert_allclose(own.motion.place_covariance_m2, 4.0 * box(0.0).covariance_m2)
    assert own.confirmed and own.identity == 1.0 and belief.likeliest is own
    assert belief.probability(own.number) == 1.0 and belief.probability(99) == 0.0


def test_what_a_new_one_is_owed_counts_as_far_as_it_exists() -> None:
    belief, stamp_ns = begun()
    (own,) = belief.tracks
    belief.update([box(0.0), box(0.6)], EVERYWHERE, stamp_ns + FRAME_NS)
    new = belief.tracks[1]
    new.owed = {own.number: 0.4}
    own.replaced = own.hidden = 0.0
    assert belief.probability(new.number) == pytest.approx(own.identity * 0.4 * 0.1)
    assert belief.probability(own.number) == pytest.approx(own.identity * (1.0 - 0.1 * 0.4))
    own.replaced = 0.25
    assert belief.probability(own.number) == pytest.approx(own.identity * 0.96 * 0.75)

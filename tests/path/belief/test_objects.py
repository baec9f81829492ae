"""Tracks of all objects, and which of them was designated: on paper, and at every scale."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from path.belief.boxes import Measured
from path.belief.frame import SHOWN
from path.belief.mixing import others_m3
from path.belief.motion import MANOEUVRE_S, Array, density
from path.belief.objects import Belief
from path.belief.track import SPELL_S

# level, to the north: right is east
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
FRAME_NS = 20_000_000
FRAME_S = 0.02
SIGMA_M = 0.012
SIDE_M = 0.3
ACCEL = 0.6
EVERYWHERE: Callable[[Array], bool] = lambda _: True  # noqa: E731
UNKNOWN = (math.inf, math.inf)


def box(
    east_m: float,
    *,
    north_m: float = 2.0,
    wide_m: float = SIDE_M,
    high_m: float = SIDE_M,
    scale: float = 1.0,
    most_m: tuple[float, float] = UNKNOWN,
) -> Measured:
    """A box at a place; everything that is a length is ``scale`` times as long."""
    return Measured(
        scale * np.array([north_m, east_m, 0.0]),
        (scale * SIGMA_M) ** 2 * np.eye(3),
        np.zeros(3),
        AXES,
        (scale * wide_m, scale * high_m),
        0.03,
        (scale * most_m[0], scale * most_m[1]),
        1e-3 / scale**3,
        5e-3 / scale**3,
    )


def begun(
    east_m: float = 0.0, scale: float = 1.0, others_m: Sequence[float] = ()
) -> tuple[Belief, int]:
    """A target, and others, that have been followed for a second; and the newest stamp."""
    belief = Belief(scale * ACCEL)
    belief.designate(box(east_m, scale=scale).place_m, box(east_m, scale=scale), 0)
    stamp_ns = 0
    for _ in range(50):
        stamp_ns += FRAME_NS
        belief.update(
            [box(each, scale=scale) for each in (east_m, *others_m)], EVERYWHERE, stamp_ns
        )
    return belief, stamp_ns


def test_an_object_that_is_alone_stays_the_one() -> None:
    belief, _ = begun()
    assert belief.identity_of(0) > 1.0 - 1e-6
    assert len(belief.tracks) == 1


def test_one_beside_it_has_a_track_of_its_own_and_nothing_of_its_identity() -> None:
    belief, _ = begun(others_m=[0.35])
    assert len(belief.tracks) == 2
    assert belief.identity_of(0) > 1.0 - 1e-5
    assert belief.identity_of(1) < 1e-6


def test_two_that_were_out_of_sight_are_told_apart_as_far_as_their_places_were_known() -> None:
    """Both hidden for T; two boxes come back where both were. By hand: a swap against none, in
    normal errors.
    """
    apart_m, hidden_s = 0.35, 0.8
    belief, stamp_ns = begun(others_m=[apart_m])
    first, second = belief.tracks
    seen_ns = stamp_ns + round(hidden_s * 1e9)
    grown = first.motion.covariance.copy()
    variance = (
        grown[1, 1] + 2.0 * hidden_s * grown[1, 4] + hidden_s**2 * grown[4, 4]
        + ACCEL**2 * MANOEUVRE_S * hidden_s**3 / 3.0
    )  # fmt: skip
    known, noise = variance * np.eye(3), SIGMA_M**2 * np.eye(3)
    speed = second.motion.mean[4] - first.motion.mean[4]
    off = np.array([0.0, apart_m + hidden_s * speed, 0.0])
    swapped, kept = (
        density(off, known, noise) ** 2,
        density(off - (0.0, apart_m, 0.0), known, noise) ** 2,
    )
    by_hand = swapped / (swapped + kept)
    belief.update([box(0.0), box(apart_m)], EVERYWHERE, seen_ns)
    assert 0.001 < by_hand < 0.3
    assert belief.probability(second.number) == pytest.approx(by_hand, rel=0.3)
    assert belief.probability(first.number) == pytest.approx(1.0 - by_hand, abs=0.02)


def test_two_that_nobody_saw_for_long_might_be_either_and_no_wait_tells() -> None:
    belief, stamp_ns = begun(others_m=[0.35])
    stamp_ns += 3_000_000_000
    for k in range(100):
        belief.update([box(0.0), box(0.35)], EVERYWHERE, stamp_ns + k * FRAME_NS)
        assert belief.identity_of(0) < 0.75
    assert belief.identity_of(0) + belief.identity_of(1) > 0.9


def test_one_box_around_two_for_a_moment_mixes_nothing_up() -> None:
    belief, stamp_ns = begun(others_m=[0.35])
    for _ in range(10):
        stamp_ns += FRAME_NS
        belief.update([box(0.175, wide_m=0.65)], EVERYWHERE, stamp_ns)
    stamp_ns += FRAME_NS
    belief.update([box(0.0), box(0.35)], EVERYWHERE, stamp_ns)
    assert belief.identity_of(0) > 1.0 - 1e-3
    assert belief.identity_of(1) < 1e-3


def test_one_box_around_two_for_long_says_no_more_which_is_which() -> None:
    belief, stamp_ns = begun(others_m=[0.35])
    for _ in range(150):
        stamp_ns += FRAME_NS
        belief.update([box(0.175, wide_m=0.65)], EVERYWHERE, stamp_ns)
    stamp_ns += FRAME_NS
    belief.update([box(0.0), box(0.35)], EVERYWHERE, stamp_ns)
    assert belief.identity_of(0) < 0.99


def test_two_in_a_box_that_stays_as_wide_as_both_stay_on_their_own_sides() -> None:
    """An edge of the box is of the one that reaches farthest there: to change places they would
    have to be one behind the other, in a narrower box.
    """
    belief, stamp_ns = begun(others_m=[0.35])
    first, second = belief.tracks
    for k in range(150):
        stamp_ns += FRAME_NS
        belief.update([box(0.175 + 0.005 * k, wide_m=0.65)], EVERYWHERE, stamp_ns)
    assert first.motion.place_m[1] == pytest.approx(0.745, abs=0.05)
    assert second.motion.place_m[1] == pytest.approx(1.095, abs=0.05)
    stamp_ns += FRAME_NS
    belief.update([box(0.75), box(1.1)], EVERYWHERE, stamp_ns)
    assert belief.identity_of(0) > 0.98


def test_one_that_is_seen_in_the_box_of_a_nearer_one_stays_where_it_is() -> None:
    """Twice as far off, it is seen half as far from the middle: in the box, however far beside
    it.
    """
    belief, stamp_ns = begun()
    for _ in range(50):
        stamp_ns += FRAME_NS
        belief.update([box(0.0), box(0.7, north_m=4.0)], EVERYWHERE, stamp_ns)
    far = belief.tracks[1]
    for _ in range(100):
        stamp_ns += FRAME_NS
        belief.update([box(0.175, wide_m=0.5)], EVERYWHERE, stamp_ns)
    assert math.dist(far.motion.place_m, (4.0, 0.7, 0.0)) < 0.2
    assert belief.identity_of(0) > 1.0 - 1e-3


def test_a_box_that_the_border_cuts_teaches_no_smaller_size() -> None:
    belief, stamp_ns = begun()
    for _ in range(100):
        stamp_ns += FRAME_NS
        cut = replace(box(0.0, high_m=0.2), cut_edges=((False, True), (False, False)))
        belief.update([cut], EVERYWHERE, stamp_ns)
    whole = belief.tracks[0]
    np.testing.assert_allclose(np.exp(whole.log_sides), SIDE_M, rtol=0.05)
    belief.update([box(0.0)], EVERYWHERE, stamp_ns + FRAME_NS)
    assert len(belief.tracks) == 1
    assert belief.identity_of(0) > 1.0 - 1e-4


def test_one_that_comes_in_over_the_border_is_as_large_as_it_turns_out() -> None:
    belief, stamp_ns = begun()
    for k in range(50):
        stamp_ns += FRAME_NS
        high_m = 0.05 + 0.25 * min(1.0, k / 30.0)
        coming = replace(box(1.0, high_m=high_m), cut_edges=((False, k < 30), (False, False)))
        belief.update([box(0.0), coming], EVERYWHERE, stamp_ns)
    assert len(belief.tracks) == 2
    np.testing.assert_allclose(np.exp(belief.tracks[1].log_sides), SIDE_M, rtol=0.05)


def test_a_box_too_large_for_the_target_that_comes_apart_leaves_it_open_which_half_it_was() -> None:
    belief, most = Belief(ACCEL), (0.36, 0.36)
    belief.designate(box(0.0).place_m, box(0.0, wide_m=0.65, most_m=most), 0)
    for k in range(1, 5):
        belief.update([box(0.0, wide_m=0.65, most_m=most)], EVERYWHERE, k * FRAME_NS)
    for k in range(5, 50):
        belief.update([box(-0.17, most_m=most), box(0.17, most_m=most)], EVERYWHERE, k * FRAME_NS)
        assert max(belief.identity_of(0), belief.identity_of(1)) < 1.0 - 1e-3 / 3.0


@pytest.mark.parametrize("poor", [1.0, 10.0])
def test_either_half_of_such_a_box_is_as_likely_however_poorly_one_of_them_is_shown(
    poor: float,
) -> None:
    """What else was in it was an object too: that a detector is not sure of one says nothing of
    which is which.
    """
    belief, most = Belief(ACCEL), (0.36, 0.36)
    belief.designate(box(0.0).place_m, box(0.0, wide_m=0.65, most_m=most), 0)
    for k in range(1, 5):
        belief.update([box(0.0, wide_m=0.65, most_m=most)], EVERYWHERE, k * FRAME_NS)
    for k in range(5, 50):
        doubtful = replace(box(0.17, most_m=most), elsewhere_m3=poor * box(0.0).elsewhere_m3)
        belief.update([box(-0.17, most_m=most), doubtful], EVERYWHERE, k * FRAME_NS)
        assert max(belief.identity_of(0), belief.identity_of(1)) < 0.75


def test_a_box_that_was_too_large_for_a_moment_costs_a_moment() -> None:
    belief, most = Belief(ACCEL), (0.36, 0.36)
    belief.designate(box(0.0).place_m, box(0.0, wide_m=0.5, most_m=most), 0)
    for k in range(1, 50):
        belief.update([box(0.0, most_m=most)], EVERYWHERE, k * FRAME_NS)
    assert belief.identity_of(0) > 1.0 - 1e-2


def test_an_object_in_two_pieces_for_a_frame_stays_one() -> None:
    belief, stamp_ns = begun()
    stamp_ns += FRAME_NS
    belief.update([box(-0.08, wide_m=0.14), box(0.08, wide_m=0.14)], EVERYWHERE, stamp_ns)
    assert len(belief.tracks) == 1
    belief.update([box(0.0)], EVERYWHERE, stamp_ns + FRAME_NS)
    assert belief.identity_of(0) > 1.0 - 1e-3 / 3.0


def test_a_box_of_nothing_beside_the_target_is_forgotten() -> None:
    belief, stamp_ns = begun()
    stamp_ns += FRAME_NS
    belief.update([box(0.0), box(0.4)], EVERYWHERE, stamp_ns)
    assert len(belief.tracks) == 2
    for _ in range(round(2.0 * SPELL_S / FRAME_S)):
        stamp_ns += FRAME_NS
        belief.update([box(0.0)], EVERYWHERE, stamp_ns)
    assert len(belief.tracks) == 1
    assert belief.identity_of(0) > 1.0 - 1e-5


def test_one_that_comes_where_the_target_was_lost_is_no_target_for_sure() -> None:
    belief, stamp_ns = begun()
    belief.update([box(0.9)], EVERYWHERE, stamp_ns + 12_000_000_000)
    assert belief.identity_of(0) < 1.0 - 1e-3 / 3.0


MOST = (0.36, 0.36)


def out_of_one_box(together_s: float, *boxes_after: Measured) -> Belief:
    """Return what is believed a second after the target was so long in one box with somebody whom
    nobody had seen before, and these boxes came out of it.
    """
    belief = Belief(ACCEL)
    belief.designate(box(0.0).place_m, box(0.0, most_m=MOST), 0)
    first = round(together_s / FRAME_S)
    for k in range(1, 100 + first):
        boxes = [box(0.0, most_m=MOST)]
        if k >= 50:
            boxes = [box(0.175, wide_m=0.65, most_m=MOST)]
        if k >= 50 + first:
            boxes = [*boxes_after]
        belief.update(boxes, EVERYWHERE, k * FRAME_NS)
    return belief


TARGET = box(0.0, most_m=MOST)
BEHIND = box(0.5, north_m=2.8, most_m=MOST)


def test_who_comes_out_of_a_box_of_two_alone_may_be_the_one_whom_nobody_had_seen() -> None:
    """And no wait tells: where the other one is, neither is shown."""
    for together_s in (0.5, 1.0, 2.0, 4.0):
        assert out_of_one_box(together_s, BEHIND).identity_of(0) < 0.9


def test_two_that_come_out_of_one_box_are_told_apart_as_far_as_their_places_were_known() -> None:
    both = out_of_one_box(0.4, TARGET, BEHIND)
    assert both.identity_of(0) > 0.95
    longer = out_of_one_box(2.0, TARGET, BEHIND)
    assert longer.identity_of(0) < both.identity_of(0)
    assert longer.identity_of(0) + longer.identity_of(1) > 0.95


def test_one_large_box_in_between_makes_no_second_object() -> None:
    belief = out_of_one_box(2.0 * FRAME_S, TARGET)
    assert len(belief.tracks) == 1
    assert belief.identity_of(0) > 1.0 - 1e-3


def test_who_was_in_its_box_and_never_seen_since_is_believed_in_for_as_long_as_it_takes() -> None:
    most_m = (0.33, 0.33)
    belief, stamp_ns = begun()
    for _ in range(100):
        stamp_ns += FRAME_NS
        belief.update([box(0.0, wide_m=0.62, most_m=most_m)], EVERYWHERE, stamp_ns)
    for _ in range(600):
        stamp_ns += 10 * FRAME_NS
        belief.update([box(-0.16, most_m=most_m)], EVERYWHERE, stamp_ns)
    assert len(belief.tracks) == 2
    assert belief.identity_of(0) > 0.8


def test_one_that_is_known_and_goes_behind_the_target_is_the_other_one_in_its_box() -> None:
    belief, stamp_ns = begun(others_m=[0.5])
    for _ in range(100):
        stamp_ns += FRAME_NS
        belief.update([box(0.2, wide_m=0.7, most_m=MOST)], EVERYWHERE, stamp_ns)
    assert len(belief.tracks) == 2


def found_again(others: int, gone_s: float) -> float:
    """Return how sure it is of one that comes up near where the target was lost so long ago among
    so many others, one second later.
    """
    turns = 2.0 * math.pi * np.arange(others) / 8.0 + 0.2
    rest = [
        box(2.5 * math.sin(turn), north_m=2.0 + 2.5 * math.cos(turn)) for turn in turns.tolist()
    ]
    belief = Belief(ACCEL)
    belief.designate(box(0.0).place_m, box(0.0), 0)
    lost = 50 + round(gone_s / FRAME_S)
    for k in range(1, lost + 50):
        own = [] if 50 < k < lost else [box(0.0 if k <= 50 else 0.3)]
        belief.update([*own, *rest], EVERYWHERE, k * FRAME_NS)
    return belief.probability(0)


def test_in_a_crowd_somebody_else_may_come_up_where_the_target_was_lost_seconds_ago() -> None:
    """As many are hidden for each that is seen: alone there is nobody else."""
    assert found_again(0, 3.0) > 0.99
    assert found_again(8, 1.0) > 0.9
    assert found_again(8, 3.0) < 0.9
    assert found_again(8, 5.0) < found_again(4, 5.0) < found_again(2, 5.0) < 0.9


def test_others_are_as_dense_as_those_that_are_seen_spread_about_there() -> None:
    belief, _ = begun(others_m=[1.0, -2.0])
    own = belief.tracks[0]
    for other, place_m in zip(belief.tracks[1:], ([2.0, 1.0, 0.3], [4.0, 0.0, -0.1]), strict=True):
        other.motion.mean[:3] = place_m
    level_m2 = (1.0 + 4.0) / 4.0
    high_m2 = (0.09 + 0.01) / 2.0 + own.motion.covariance[2, 2] + SIGMA_M**2
    by_hand = 0.05 * 2.0 / ((2.0 * math.pi) ** 1.5 * level_m2 * math.sqrt(high_m2))
    assert others_m3(belief.tracks, own, box(0.0)) == pytest.approx(by_hand)
    belief.tracks[1].motion.mean[:3] = own.motion.place_m  # no nearer than a body is wide
    belief.tracks[2].log_odds = 0.0  # it may be nothing
    by_hand *= 0.5 * level_m2 / SIDE_M**2 * math.sqrt(high_m2 / (high_m2 - 0.05))
    assert others_m3(belief.tracks, own, box(0.0)) == pytest.approx(by_hand, rel=0.01)
    belief.tracks[1].log_odds = 0.0
    assert others_m3(belief.tracks, own, box(0.0)) == 0.0


def test_a_missed_frame_costs_nothing() -> None:
    belief, stamp_ns = begun()
    for _ in range(round(SHOWN * 10)):
        stamp_ns += FRAME_NS
        belief.update([], EVERYWHERE, stamp_ns)
    belief.update([box(0.0)], EVERYWHERE, stamp_ns + FRAME_NS)
    assert belief.identity_of(0) > 1.0 - 1e-4


@pytest.mark.parametrize("scale", [0.2, 5.0, 20.0])
def test_a_world_so_many_times_as_large_is_believed_the_same(scale: float) -> None:
    """Two that cross, in one box for a while, one of them out of sight: the same tracks and
    probabilities.
    """
    beliefs = []
    for factor in (1.0, scale):
        belief, stamp_ns = begun(scale=factor, others_m=[0.6])
        history: list[list[tuple[int, float]]] = []
        for k in range(120):
            stamp_ns += FRAME_NS
            other = 0.6 - 0.01 * k
            boxes = [box(0.0, scale=factor), box(other, north_m=2.1, scale=factor)]
            if abs(other) < 0.32:
                low, high = min(0.0, other) - 0.15, max(0.0, other) + 0.15
                middle, wide_m = 0.5 * (low + high), high - low
                boxes = [box(middle, north_m=2.05, wide_m=wide_m, scale=factor, most_m=MOST)]
            if 100 < k < 115:
                boxes = [box(0.1, wide_m=0.6, scale=factor, most_m=MOST), *boxes[1:]]
            if 90 < k < 100:
                boxes = []
            belief.update(boxes, EVERYWHERE, stamp_ns)
            history.append(
                [(track.number, belief.probability(track.number)) for track in belief.tracks]
            )
        beliefs.append(history)
    for one, other in zip(*beliefs, strict=True):
        assert [number for number, _ in one] == [number for number, _ in other]
        np.testing.assert_allclose(
            [q for _, q in one], [q for _, q in other], rtol=1e-6, atol=1e-12
        )


def test_one_of_two_that_were_in_one_box_may_be_hidden_when_the_other_comes_out_of_it() -> None:
    """They were shown together, so that neither must be shown alone in the frame after."""
    belief, stamp_ns = begun(others_m=[0.35])
    first, second = belief.tracks
    for k in range(50):
        stamp_ns += FRAME_NS
        belief.update([box(0.175 + 0.0035 * k, wide_m=0.65 + 0.007 * k)], EVERYWHERE, stamp_ns)
    stamp_ns += FRAME_NS
    belief.update([box(0.7)], EVERYWHERE, stamp_ns)
    assert belief.probability(second.number) < 0.04
    assert belief.probability(first.number) > 0.9


def test_who_is_gone_for_long_and_hardly_the_one_is_forgotten() -> None:
    """Else it would be as likely anywhere, and a rival to whoever stands there."""
    belief, stamp_ns = begun(others_m=[0.35])
    second = belief.tracks[1]
    second.identity = 1e-4
    for _ in range(300):
        stamp_ns += FRAME_NS
        belief.update([box(0.0)], EVERYWHERE, stamp_ns)
    assert second not in belief.tracks
    assert belief.identity_of(0) > 0.99

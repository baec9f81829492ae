"""All ranges of a target, each with its standard deviation, and what they say together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from path.camera.model import CameraModel
from path.observations import Box, Depth, RangeSource
from path.target.cylinder import AT_THE_CAMERA, box_middle_v, reach_m
from path.target.range import USUAL_SPAN, Body, Sight, by_ground, by_size, together

CAMERA = CameraModel(640, 480, 615.0, 615.0, 320.0, 240.0)
PERSON, CAR = Body(0.78, 1.75), Body(0.39, 0.16)
SCALES = (0.2, 1.0, 5.0, 20.0)
DEPTH, SIZE, GROUND, VIEWS = (
    RangeSource.DEPTH,
    RangeSource.SIZE,
    RangeSource.GROUND,
    RangeSource.VIEWS,
)


def looking(down_deg: float, right: float = 0.0) -> Sight:
    """Through a point of the middle row of a camera that looks so far down."""
    angle = math.radians(down_deg)
    return Sight((right, 0.0, 1.0), (0.0, math.cos(angle), math.sin(angle)))


def box_of(body: Body, sight: Sight, z_m: float) -> Box:
    """The box of a body that is as wide as one usually is, around its line of sight."""
    wide, _ = reach_m(
        AT_THE_CAMERA, sight.ray_c, sight.gravity_c, USUAL_SPAN * body.span_m, body.height_m
    )
    _, high = reach_m(
        AT_THE_CAMERA, sight.ray_c, sight.gravity_c, USUAL_SPAN * body.span_m, body.height_m
    )
    w, h = CAMERA.fx * wide / z_m, CAMERA.fy * high / z_m
    x, y, _ = sight.ray_c
    return Box(CAMERA.cx + CAMERA.fx * x - w / 2.0, CAMERA.cy + CAMERA.fy * y - h / 2.0, w, h)


def ranges(*said: tuple[float, float, RangeSource]) -> list[Depth]:
    return [Depth(z_m, sigma_m, source) for z_m, sigma_m, source in said]


# --- one by one ---


@pytest.mark.parametrize("k", SCALES)
@pytest.mark.parametrize("body", [PERSON, CAR])
def test_a_body_of_known_size_is_as_far_away_as_its_box_is_small(body: Body, k: float) -> None:
    scaled, sight = Body(k * body.span_m, k * body.height_m), looking(45.0)
    found = by_size(box_of(scaled, sight, 8.0 * k), CAMERA, sight, scaled, 1.5)
    assert found is not None and found.source is SIZE
    # to its surface, which is up to a quarter of its span and a line of sight's slant before its
    # middle
    assert 8.0 * k - 0.36 * scaled.span_m < found.z_m < 8.0 * k
    assert 0.02 * found.z_m < found.sigma_m < 0.2 * found.z_m


def test_a_tall_body_is_known_better_than_a_flat_one_from_the_side_and_few_pixels_know_less() -> (
    None
):
    side = looking(10.0)
    tall, flat = (
        by_size(box_of(body, side, 6.0), CAMERA, side, body, 1.5) for body in (PERSON, CAR)
    )
    far = by_size(box_of(PERSON, side, 40.0), CAMERA, side, PERSON, 1.5)
    assert tall is not None and flat is not None and far is not None
    assert tall.sigma_m / tall.z_m < 0.7 * flat.sigma_m / flat.z_m
    assert tall.sigma_m / tall.z_m < far.sigma_m / far.z_m


def test_a_size_is_off_by_as_much_as_it_says_whichever_way_the_body_heads() -> None:
    """Upright boxes of 1.6 to 1, seen from 45 degrees above, at every heading: off by what is
    stated, not by more.
    """
    sight, off = looking(45.0), []
    length, width, height = 0.34, 0.21, 0.16
    body = Body(math.hypot(length, width), height)
    for heading in np.linspace(0.0, math.pi, 37):
        c, s = abs(math.cos(heading)), abs(math.sin(heading))
        wide, deep = length * s + width * c, length * c + width * s
        high = height * math.cos(math.radians(45.0)) + deep * math.sin(math.radians(45.0))
        w, h = CAMERA.fx * wide / 3.0, CAMERA.fy * high / 3.0
        found = by_size(Box(320.0 - w / 2, 240.0 - h / 2, w, h), CAMERA, sight, body, 0.0)
        assert found is not None
        off.append((found.z_m + 0.14 - 3.0) / found.sigma_m)  # 0.14: from its surface to its middle
    assert float(np.sqrt(np.mean(np.square(off)))) < 1.2


@pytest.mark.parametrize(
    "box", [Box(-1.0, 9.0, 60.0, 60.0), Box(9.0, 420.0, 60.0, 70.0), Box(9.0, 9.0, 2.0, 60.0)]
)
def test_a_box_that_is_cut_or_a_speck_tells_no_range_and_no_more_does_an_unknown_body(
    box: Box,
) -> None:
    assert by_size(box, CAMERA, looking(45.0), PERSON, 1.5) is None
    assert by_size(Box(99.0, 99.0, 60.0, 60.0), CAMERA, looking(45.0), Body(), 1.5) is None


@pytest.mark.parametrize("k", SCALES)
@pytest.mark.parametrize("down_deg", [25.0, 45.0, 70.0])
def test_a_line_of_sight_ends_where_it_comes_down_to_the_middle_of_the_body(
    down_deg: float, k: float
) -> None:
    body = Body(k * PERSON.span_m, k * PERSON.height_m)
    angle = math.radians(down_deg)
    gravity = (0.0, math.cos(angle), math.sin(angle))
    middle = (0.4 * k, 0.2 * k, 8.0 * k)
    x, y, z = box_middle_v(AT_THE_CAMERA, middle, gravity, body.span_m, body.height_m)
    sight = Sight((x / z, y / z, 1.0), gravity)
    above_m = sum(a * b for a, b in zip(middle, gravity, strict=True))
    found = by_ground(above_m, 0.05 * k, 0.01, sight, body, GROUND)
    assert found is not None
    surface_m = found.z_m
    # the surface that faces the camera is before the middle, by a quarter of the span as the ray
    # slants
    assert 7.4 * k < surface_m < 8.0 * k
    plain = by_ground(above_m, 0.05 * k, 0.01, sight, Body(), GROUND)
    assert plain is not None
    # what is reckoned with where the size is known
    assert plain.z_m != pytest.approx(8.0 * k, rel=1e-4)
    behind_m = 8.0 * k - surface_m
    assert behind_m == pytest.approx(
        0.25 * body.span_m / math.hypot(*sight.ray_c) / level_of(sight), rel=0.02
    )


def level_of(sight: Sight) -> float:
    return sight.level / math.hypot(*sight.ray_c)


def test_what_the_ground_says_is_off_by_no_more_than_is_stated() -> None:
    rng = np.random.default_rng(3)
    for down_deg in (20.0, 45.0, 70.0):
        off: list[float] = []
        for _ in range(400):
            tilt, height = 0.015 * rng.standard_normal(), 0.06 * rng.standard_normal()
            true = looking(down_deg)
            seen = looking(down_deg + math.degrees(tilt))
            found = by_ground(3.0 * true.sinking + height, 0.06, 0.015, seen, Body(), GROUND)
            assert found is not None
            off.append((found.z_m - 3.0) / found.sigma_m)
        assert 0.85 < float(np.sqrt(np.mean(np.square(off)))) < 1.15


def test_a_line_of_sight_that_hardly_comes_down_or_from_below_tells_nothing() -> None:
    assert by_ground(3.0, 0.1, 0.01, looking(5.0), PERSON, GROUND) is None
    assert by_ground(-1.0, 0.1, 0.01, looking(45.0), PERSON, GROUND) is None


# --- together ---


def test_one_alone_is_left_as_it_is_and_none_is_none() -> None:
    (one,) = ranges((2.0, 0.02, DEPTH))
    found = together([one])
    assert found is not None
    assert found.depth is one and found.by == (DEPTH,) and found.against == ()
    assert together([]) is None
    assert (
        together(ranges((math.nan, 0.1, SIZE), (-1.0, 0.1, GROUND), (2.0, math.inf, VIEWS))) is None
    )


@pytest.mark.parametrize("k", SCALES)
def test_ranges_that_agree_count_by_their_variance_and_the_surest_is_named_first(k: float) -> None:
    found = together(
        ranges((8.2 * k, 0.4 * k, SIZE), (8.0 * k, 0.1 * k, GROUND), (7.9 * k, 0.2 * k, VIEWS))
    )
    assert found is not None
    assert found.depth.z_m == pytest.approx(7.99 * k, rel=2e-3)
    assert found.depth.sigma_m == pytest.approx(k / math.sqrt(100.0 + 25.0 + 6.25))
    assert (found.by, found.against, found.depth.source) == ((GROUND, VIEWS, SIZE), (), GROUND)


@pytest.mark.parametrize("k", SCALES)
@pytest.mark.parametrize("wrong", [DEPTH, SIZE, GROUND])
def test_one_that_contradicts_two_is_not_believed_however_sure_it_is(
    wrong: RangeSource, k: float
) -> None:
    """A depth of the wall behind, half a person, a step in the ground."""
    said = {DEPTH: (8.0, 0.1), SIZE: (8.1, 0.3), GROUND: (7.9, 0.15)}
    said[wrong] = (10.5, 0.05)
    found = together(
        [Depth(k * z_m, k * sigma_m, source) for source, (z_m, sigma_m) in said.items()]
    )
    assert found is not None
    assert found.against == (wrong,)
    assert found.chi2 > 10.0
    assert 7.8 * k < found.depth.z_m < 8.2 * k
    assert found.depth.sigma_m < 0.2 * k


@pytest.mark.parametrize("k", SCALES)
def test_where_two_contradict_each_other_nobody_knows_which_is_right_and_the_variance_holds_both(
    k: float,
) -> None:
    found = together(ranges((6.0 * k, 0.05 * k, DEPTH), (9.0 * k, 0.3 * k, GROUND)))
    assert found is not None
    assert (found.by, found.against) == ((DEPTH,), (GROUND,))
    assert found.depth.z_m == pytest.approx(6.0 * k)
    assert abs(found.depth.z_m - 9.0 * k) < 2.0 * found.depth.sigma_m


def test_whatever_contradicts_whatever_there_is_a_range() -> None:
    """A range alone is off its own mean by rounding, which is no contradiction."""
    rng = np.random.default_rng(9)
    for _ in range(500):
        said = [Depth(float(z), 0.01 * float(z), GROUND) for z in rng.uniform(0.5, 50.0, 3)]
        for count in (2, 3):
            found = together(said[:count])
            assert found is not None and len(found.by) + len(found.against) == count


@pytest.mark.parametrize("k", SCALES)
def test_a_size_that_is_too_far_is_of_a_body_that_is_half_hidden_and_makes_nothing_less_sure(
    k: float,
) -> None:
    """Its box is half as large; one that is too near is larger than such a body can be."""
    ground = Depth(7.9 * k, 0.12 * k, RangeSource.RANGEFINDER)
    half = together([ground, Depth(11.0 * k, 0.6 * k, SIZE)])
    assert half is not None
    assert (half.by, half.against) == ((RangeSource.RANGEFINDER,), (SIZE,))
    assert half.depth.z_m == pytest.approx(7.9 * k)
    assert half.depth.sigma_m == pytest.approx(0.12 * k)
    near = together([ground, Depth(5.0 * k, 0.4 * k, SIZE)])
    assert near is not None
    assert near.depth.z_m == pytest.approx(7.9 * k)  # the surer one
    assert near.depth.sigma_m > 1.5 * k


def test_a_depth_that_is_off_by_its_scale_contradicts_nothing() -> None:
    found = together(ranges((8.08, 0.005, DEPTH), (8.0, 0.02, VIEWS)))
    assert found is not None
    assert found.against == ()
    assert 8.0 < found.depth.z_m < 8.04


def test_what_is_stated_holds_what_comes_out() -> None:
    """Ranges drawn as they say: the fused one is off by as much as it says, and one in a thousand
    is doubted.
    """
    rng = np.random.default_rng(5)
    sigmas: Sequence[tuple[float, RangeSource]] = ((0.4, SIZE), (0.1, GROUND), (0.15, VIEWS))
    off: list[float] = []
    doubted = 0
    for _ in range(3000):
        found = together(
            [Depth(8.0 + s * rng.standard_normal(), s, source) for s, source in sigmas]
        )
        assert found is not None
        off.append((found.depth.z_m - 8.0) / found.depth.sigma_m)
        doubted += bool(found.against)
    assert 0.93 < float(np.std(off)) < 1.07
    assert doubted <= 15


def test_a_body_is_never_before_half_of_its_range() -> None:
    """From nearer than it is long, what it has before its middle is no rule any more."""
    found = by_size(
        box_of(Body(4.0, 4.0), looking(45.0), 9.0), CAMERA, looking(45.0), Body(4.0, 4.0), 1.5
    )
    assert found is not None and found.z_m > 0.0

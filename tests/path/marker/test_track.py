"""Markers that are recognised where they are expected, in exact images."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker import detect
from path.marker.detect import detect_markers
from path.marker.layout import Marker, MarkerLayout, single_marker
from path.marker.photometric import corners, passes
from path.marker.track import recognise
from path.observations import Region
from tests.path.marker.scene import (
    VGA,
    Optics,
    background,
    random_view,
    region_around,
    render,
    true_corners,
)

LAYOUT = single_marker()
GROUND = background(VGA, np.random.default_rng(0))
OFF_M, OFF_RAD = 0.0015, 0.005  # per axis, what the motion between two frames leaves unknown


def facing(distance_m: float, x_m: float = 0.0) -> Pose:
    return Pose(rotation.exp(np.array([math.pi - 0.4, 0.0, 0.3])), np.array([x_m, 0.0, distance_m]))


def image_of(
    pose: Pose, layout: MarkerLayout = LAYOUT, optics: Optics | None = None
) -> NDArray[np.uint8]:
    return render(VGA, pose, layout, np.random.default_rng(4), optics or Optics(), GROUND)


def off(pose: Pose, rng: np.random.Generator) -> Pose:
    return Pose(
        rotation.exp(rng.normal(0.0, OFF_RAD, 3)) @ pose.R, pose.t + rng.normal(0.0, OFF_M, 3)
    )


@pytest.fixture
def unsearched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing may be searched for."""

    def refuse(*_: object) -> None:
        raise AssertionError("searched")

    monkeypatch.setattr(detect, "search", refuse)


@pytest.mark.parametrize(
    ("dictionary", "far_m"), [("DICT_4X4_50", 1.2), ("DICT_APRILTAG_36h11", 0.7)]
)
@pytest.mark.usefixtures("unsearched")
def test_corners_are_as_good_as_those_of_a_marker_that_was_searched_for(
    dictionary: str, far_m: float
):
    layout = single_marker(dictionary=dictionary)
    rng, errors = np.random.default_rng(6), list[float]()
    for _ in range(25):
        view = random_view(rng, VGA, 0.35, far_m, 50.0)
        truth = true_corners(VGA, view.T_c_v, layout)
        found = detect_markers(
            render(VGA, view.T_c_v, layout, rng, ground=GROUND), region_around(truth, 60.0), layout, VGA,
            expected=off(view.T_c_v, rng),
        )  # fmt: skip
        errors.append(float(np.abs(found[0].corners_px - truth).max()))
    assert np.median(errors) < 0.04
    assert max(errors) < 0.15


def test_the_start_is_good_to_a_third_of_a_pixel():
    rng, errors = np.random.default_rng(7), list[float]()
    for _ in range(25):
        view = random_view(rng, VGA, 0.4, 1.2, 50.0)
        seen = recognise(
            render(VGA, view.T_c_v, LAYOUT, rng, ground=GROUND), off(view.T_c_v, rng), LAYOUT, VGA
        )
        assert seen is not None
        (one,) = seen
        errors.append(
            float(np.abs(one.quad + one.offset - true_corners(VGA, view.T_c_v, LAYOUT)).mean())
        )
    assert np.mean(errors) < 0.33


@pytest.mark.parametrize("printed", range(1, 12))
def test_another_marker_is_not_taken_for_the_expected_one(printed: int):
    pose = facing(0.6)
    assert recognise(image_of(pose), pose, LAYOUT, VGA)
    assert recognise(image_of(pose, single_marker(marker_id=printed)), pose, LAYOUT, VGA) is None


def test_no_marker_is_recognised_where_there_is_none():
    image = image_of(facing(0.6, 0.2))
    assert recognise(image, facing(0.6, -0.1), LAYOUT, VGA) is None
    assert recognise(np.full_like(image, 120), facing(0.6), LAYOUT, VGA) is None


def test_what_is_not_where_it_was_expected_is_decoded():
    pose = facing(0.6)
    region = region_around(true_corners(VGA, pose, LAYOUT), 80.0)
    decoded = detect_markers(image_of(pose), region, LAYOUT, VGA)
    (found,) = detect_markers(image_of(pose), region, LAYOUT, VGA, expected=facing(0.6, 0.03))
    assert (found.corners_px == decoded[0].corners_px).all()


@pytest.mark.parametrize(
    "pose", [facing(0.6, 0.33), facing(2.4), Pose(np.eye(3), np.array([0.0, 0.0, 0.6]))]
)
def test_none_is_expected_at_the_edge_of_the_image_too_small_or_from_behind(pose: Pose):
    assert recognise(image_of(facing(0.6)), pose, LAYOUT, VGA) is None


def test_of_several_markers_all_are_recognised_or_all_are_decoded():
    far = Marker(5, 0.08, 0.0, Pose(np.eye(3), np.array([0.12, 0.0, 0.0])))
    both = MarkerLayout((Marker(0, 0.04, 0.0, Pose(np.eye(3), np.zeros(3))), far))
    pose = facing(1.0, -0.06)
    seen = recognise(image_of(pose, both), pose, both, VGA)
    assert seen is not None
    assert [one.marker_id for one in seen] == [0, 5]
    hidden = image_of(pose, both)
    u, v = true_corners(VGA, pose, both, 5).mean(axis=0).astype(int)
    hidden[v - 12 : v + 12, u - 12 : u + 12] = 120
    assert recognise(hidden, pose, both, VGA) is None
    found = detect_markers(hidden, Region(0.0, 0.0, 640.0, 480.0), both, VGA, expected=pose)
    assert [one.marker_id for one in found] == [0]


def test_corners_of_opencv_are_always_decoded():
    pose = facing(0.6)
    region = region_around(true_corners(VGA, pose, LAYOUT), 80.0)
    plain = detect_markers(image_of(pose), region, LAYOUT, VGA, refine="subpix")
    (found,) = detect_markers(image_of(pose), region, LAYOUT, VGA, refine="subpix", expected=pose)
    assert (found.corners_px == plain[0].corners_px).all()


def test_what_the_last_step_may_explain_is_asked_again_before_anything_wrong_is_looked_for(
    monkeypatch: pytest.MonkeyPatch,
):
    """The share of pixels that count is low after the first pass with all of them, and well after
    the next.
    """

    def refuse(_: object) -> None:
        raise AssertionError("looked for")

    few_then_enough = property(lambda state: 0.8 if state.passes < 3 else 0.88)
    monkeypatch.setattr(passes.FitState, "share_used", few_then_enough)
    monkeypatch.setattr(corners, "_fit_misfit", refuse)
    truth = true_corners(VGA, facing(0.6), LAYOUT)
    found = detect_markers(
        image_of(facing(0.6)), region_around(truth, 60.0), LAYOUT, VGA, expected=facing(0.6)
    )
    assert np.abs(found[0].corners_px - truth).max() < 0.04

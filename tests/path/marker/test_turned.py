"""A marker whose corners fit, and gravity that says it cannot be so."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout, single_marker
from path.marker.locate import Gravity, LocatedMarker, locate_marker
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from path.messages import Vec3
from path.observations import MarkerDetection, Missed, MissReason
from tests.path.marker.scene import (
    VGA,
    Optics,
    View,
    background,
    random_view,
    render,
    tilted,
    true_corners,
)

GROUND = background(VGA, np.random.default_rng(0))
UP = single_marker()
Z = np.array([0.0, 0.0, 1.0])


def turned(layout: MarkerLayout, degrees: float) -> MarkerLayout:
    """The layout as its markers hang on the plate when that is glued on counter-clockwise by so
    much.
    """
    turn = Pose(rotation.exp(math.radians(degrees) * Z), np.zeros(3))
    return MarkerLayout(
        tuple(dataclasses.replace(each, T_v_m=turn @ each.T_v_m) for each in layout.markers),
        layout.dictionary,
    )


def seen(view: View, as_glued: MarkerLayout) -> tuple[MarkerDetection, ...]:
    return tuple(
        MarkerDetection(m.id, true_corners(VGA, view.T_c_v, as_glued, m.id), 0.05**2 * np.eye(8))
        for m in as_glued.markers
    )


def vec3(vector: np.ndarray) -> Vec3:
    x, y, z = vector.tolist()
    return x, y, z


def posed(
    view: View,
    as_glued: MarkerLayout,
    layout: MarkerLayout,
    gravity_v: np.ndarray,
    gravity_c: np.ndarray,
) -> MarkerPose | Missed:
    return estimate_pose(
        seen(view, as_glued), layout, VGA, vec3(gravity_v), vec3(gravity_c), PoseSettings()
    )


def views(seed: int, count: int) -> list[View]:
    rng = np.random.default_rng(seed)
    return [random_view(rng, VGA, 0.5, 1.3, 45.0) for _ in range(count)]


@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_APRILTAG_36h11", "DICT_APRILTAG_16h5"])
@pytest.mark.parametrize(
    ("degrees", "words"),
    [(180.0, "right way up"), (90.0, "90 degrees counter"), (-90.0, "90 degrees clock")],
)
def test_a_plate_that_is_turned_in_its_plane_gives_no_pose_but_its_likely_cause(
    dictionary: str, degrees: float, words: str
):
    layout = single_marker(marker_id=3, dictionary=dictionary)
    for view in views(1, 10):
        missed = posed(view, turned(layout, degrees), layout, view.gravity_v, view.gravity_c)
        assert isinstance(missed, Missed)
        assert missed.reason is MissReason.MARKER_TURNED
        assert missed.cause is not None and words in missed.cause
        assert ("AprilTags are turned" in missed.cause) == (
            dictionary != "DICT_4X4_50" and degrees == 180.0
        )


def test_two_markers_on_a_plate_that_is_turned_say_the_same():
    two = MarkerLayout(
        tuple(
            Marker(i, 0.04, 0.0002, Pose(np.eye(3), np.array([0.06 * i - 0.03, 0.0, 0.0])))
            for i in range(2)
        )
    )
    for view in views(2, 5):
        missed = posed(view, turned(two, 180.0), two, view.gravity_v, view.gravity_c)
        assert isinstance(missed, Missed)
        assert missed.reason is MissReason.MARKER_TURNED


def test_gravity_that_points_up_is_told():
    for view in views(3, 5):
        missed = posed(view, UP, UP, view.gravity_v, -view.gravity_c)
        assert isinstance(missed, Missed)
        assert missed.reason is MissReason.MARKER_TURNED
        assert missed.cause is not None and (
            "point up" in missed.cause or "right way up" in missed.cause
        )


def test_a_mount_far_from_what_the_rig_says_is_told():
    for view in views(4, 5):
        sideways = (
            rotation.exp(math.radians(35.0) * np.cross(view.gravity_v, [0.0, 0.0, 1.0]))
            @ view.gravity_v
        )
        missed = posed(view, UP, UP, sideways, view.gravity_c)
        assert isinstance(missed, Missed)
        assert missed.reason is MissReason.MARKER_TURNED
        assert missed.cause is not None and "mounted as the rig says" in missed.cause


def test_attitudes_three_times_worse_than_stated_are_borne():
    """What the world of a careless crew has; the covariance grows instead."""
    rng = np.random.default_rng(5)
    three = 3.0 * PoseSettings().attitude_v_sigma_rad
    for view in views(5, 60):
        down_v, down_c = tilted(view.gravity_v, three, rng), tilted(view.gravity_c, three, rng)
        found = posed(view, UP, UP, down_v, down_c)
        assert not (isinstance(found, Missed) and found.reason is MissReason.MARKER_TURNED)


def test_corners_that_are_off_far_are_not_blamed_on_gravity():
    (view,) = views(6, 1)
    (found,) = seen(view, UP)
    bent = found.corners_px + np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    pose = estimate_pose(
        (dataclasses.replace(found, corners_px=bent, covariance_px2=0.02**2 * np.eye(8)),),
        UP, VGA, vec3(view.gravity_v), vec3(view.gravity_c), PoseSettings(),
    )  # fmt: skip
    assert not (isinstance(pose, Missed) and pose.reason is MissReason.MARKER_TURNED)


def test_an_official_april_tag_seen_upright_is_told_in_the_image_too():
    """OpenCV draws the same id turned by 180 degrees against the pictures that people print."""
    layout = single_marker(dictionary="DICT_APRILTAG_36h11")
    official = turned(layout, 180.0)
    (view,) = views(7, 1)
    image = render(VGA, view.T_c_v, official, np.random.default_rng(4), Optics(), GROUND)
    down_v, down_c = Gravity(vec3(view.gravity_v)), Gravity(vec3(view.gravity_c))
    found = locate_marker(image, VGA, official, gravity_v=down_v, gravity_c=down_c)
    assert isinstance(found, LocatedMarker)
    assert isinstance(locate_marker(image, VGA, layout), LocatedMarker)
    missed = locate_marker(image, VGA, layout, gravity_v=down_v, gravity_c=down_c)
    assert isinstance(missed, Missed)
    assert missed.reason is MissReason.MARKER_TURNED
    assert missed.cause is not None and "OpenCV's AprilTags" in missed.cause

"""Prints that were cut out with too little white around them, or none, and glued to a plate."""

from __future__ import annotations

import numpy as np
import pytest

from path.marker.detect import detect_markers
from path.marker.layout import single_marker
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from tests.path.marker.scene import (
    VGA,
    Optics,
    Plate,
    View,
    background,
    random_view,
    region_around,
    render,
    true_corners,
)

GROUND = background(VGA, np.random.default_rng(0))
OPTICS = Optics(samples=6)


def views(count: int, far_m: float = 0.9) -> list[View]:
    rng = np.random.default_rng(21)
    return [random_view(rng, VGA, 0.4, far_m, 45.0) for _ in range(count)]


@pytest.mark.parametrize("border", [0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8])
@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_APRILTAG_36h11"])
def test_too_little_white_on_a_plate_moves_no_corner(border: float, dictionary: str):
    """Neither where a marker is decoded nor where it is expected, on plates from black to almost
    white.
    """
    layout = single_marker(marker_id=2, dictionary=dictionary)
    off_px, squared = list[float](), list[float]()
    for view in views(3):
        truth = true_corners(VGA, view.T_c_v, layout, 2)
        (gx, gy, gz), (cx, cy, cz) = view.gravity_v.tolist(), view.gravity_c.tolist()
        for grey in (5.0, 15.0, 60.0, 110.0, 150.0):
            image = render(
                VGA,
                view.T_c_v,
                layout,
                np.random.default_rng(4),
                OPTICS,
                GROUND,
                Plate(border, grey),
            )
            for expected in (None, view.T_c_v):
                for found in detect_markers(
                    image, region_around(truth, 80.0), layout, VGA, expected=expected
                ):
                    off_px.append(float(np.abs(found.corners_px - truth).max()))
                    pose = estimate_pose(
                        (found,), layout, VGA, (gx, gy, gz), (cx, cy, cz), PoseSettings()
                    )
                    assert isinstance(pose, MarkerPose)
                    off = pose.T_c_v.t - view.T_c_v.t
                    squared.append(float(off @ np.linalg.solve(pose.covariance[:3, :3], off)) / 3.0)
    assert len(off_px) > 10
    assert max(off_px) < 0.25
    assert max(squared) < 4.0


def test_opencvs_corners_are_given_of_no_print_without_a_border():
    """They are where black ends, which is at the plate's edge then."""
    layout = single_marker()
    for view in views(4):
        truth = true_corners(VGA, view.T_c_v, layout)
        for border in (0.0, 0.2, 0.3):
            image = render(
                VGA,
                view.T_c_v,
                layout,
                np.random.default_rng(4),
                OPTICS,
                GROUND,
                Plate(border, 15.0),
            )
            assert (
                detect_markers(image, region_around(truth, 90.0), layout, VGA, refine="subpix")
                == ()
            )

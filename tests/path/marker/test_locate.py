"""The estimator used alone, as docs/marker.md says."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker import locate
from path.marker.detect import detect_markers
from path.marker.layout import Marker, MarkerLayout, single_marker
from path.marker.locate import Gravity, LocatedMarker, locate_marker
from path.marker.pose import PoseSettings
from path.observations import Missed, MissReason, Region
from tests.path.marker.scene import HD, VGA, Optics, background, render, true_corners

LAYOUT = single_marker()
# the marker leans back by 45 degrees, the camera is pitched down by 45: both see the other straight
# ahead
FACING = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
DOWN_V, DOWN_C = (0.0, -math.sqrt(0.5), -math.sqrt(0.5)), (0.0, math.sqrt(0.5), math.sqrt(0.5))
GROUND = background(VGA, np.random.default_rng(0))


def leaning(distance_m: float = 1.0, turn_rad: float = 0.5) -> tuple[Pose, Gravity, Gravity]:
    """A marker turned about the vertical, with both gravities as they are."""
    R = rotation.exp(turn_rad * np.array(DOWN_C)) @ FACING
    down_v = R.T @ np.array(DOWN_C)
    x, y, z = down_v.tolist()
    return Pose(R, np.array([0.05, -0.04, distance_m])), Gravity((x, y, z)), Gravity(DOWN_C)


def image_of(pose: Pose, layout: MarkerLayout = LAYOUT) -> NDArray[np.uint8]:
    return render(VGA, pose, layout, np.random.default_rng(4), Optics(), GROUND)


def test_the_example_of_the_documentation_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    page = (Path(__file__).parents[3] / "docs" / "marker.md").read_text("utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    pose, _, _ = leaning(1.1, 0.0)
    drawn = render(HD, pose, LAYOUT, np.random.default_rng(2), Optics(samples=16))
    cv2.imwrite(str(tmp_path / "marker.png"), drawn)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(example, "docs/marker.md", "exec"), names)
    found = names["found"]
    assert isinstance(found, LocatedMarker)
    assert found.T_c_v.t == pytest.approx(pose.t, abs=0.005)
    turned = rotation.log(found.T_c_v.R @ pose.R.T)
    off = np.concatenate([found.T_c_v.t - pose.t, turned])
    assert float(off @ np.linalg.solve(found.covariance, off)) / 6.0 < 2.0
    assert float(np.linalg.norm(turned)) < math.radians(1.0)
    said = capsys.readouterr().out
    assert "marker in the camera's frame" in said and "could be" in said


def test_everything_that_is_known_of_a_marker_comes_out():
    pose, gravity_v, gravity_c = leaning()
    found = locate_marker(image_of(pose), VGA, LAYOUT, gravity_v=gravity_v, gravity_c=gravity_c)
    assert isinstance(found, LocatedMarker)
    error = np.concatenate([found.T_c_v.t - pose.t, rotation.log(found.T_c_v.R @ pose.R.T)])
    assert error @ np.linalg.solve(found.covariance, error) < 16.8  # 99 % of six
    assert 0.004 < math.sqrt(found.covariance[2, 2]) < 0.008  # the print alone is 0.5 % of a metre
    assert found.incidence_rad == pytest.approx(
        math.acos(-(pose.R[:, 2] @ pose.t) / np.linalg.norm(pose.t)), abs=0.02
    )
    assert found.side_px == pytest.approx(0.04 * VGA.fx, rel=0.15)
    assert found.ambiguity < 1e-6 and found.rms < 1.5
    assert [round(c.likelihood, 6) for c in found.candidates] == [1.0, 0.0]
    assert [d.marker_id for d in found.detections] == [0]
    assert found.detections[0].corners_px == pytest.approx(true_corners(VGA, pose, LAYOUT), abs=0.1)


def test_a_grey_and_a_colour_image_are_the_same():
    pose, gravity_v, gravity_c = leaning()
    grey = image_of(pose)
    color = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    one, two = (
        locate_marker(i, VGA, LAYOUT, gravity_v=gravity_v, gravity_c=gravity_c)
        for i in (grey, color)
    )
    assert isinstance(one, LocatedMarker) and isinstance(two, LocatedMarker)
    assert (one.T_c_v.t == two.T_c_v.t).all()


def test_without_gravity_who_wants_both_poses_gets_both():
    pose, _, _ = leaning(1.6, 0.1)
    settings = PoseSettings(max_ambiguity=1.0)
    found = locate_marker(image_of(pose), VGA, LAYOUT, refine="subpix", settings=settings)
    assert isinstance(found, LocatedMarker)
    assert len(found.candidates) == 2
    assert found.ambiguity == found.candidates[1].likelihood > 0.01
    refused = locate_marker(image_of(pose), VGA, LAYOUT, refine="subpix")
    assert refused == Missed(MissReason.POSE_UNCERTAIN)


def test_each_gravity_comes_with_its_own_sigma():
    pose, gravity_v, gravity_c = leaning(1.5, 0.2)
    image = image_of(pose)
    spread = list[float]()
    for sigma_v, sigma_c in ((0.002, 0.002), (0.03, 0.002), (0.002, 0.03)):
        found = locate_marker(
            image,
            VGA,
            LAYOUT,
            gravity_v=Gravity(gravity_v.direction, sigma_v),
            gravity_c=Gravity(gravity_c.direction, sigma_c),
            refine="subpix",
        )
        assert isinstance(found, LocatedMarker)
        spread.append(float(np.trace(found.covariance[3:, 3:])))
    assert 2.0 * spread[0] < spread[1]
    assert spread[1] == pytest.approx(spread[2], rel=0.05)


def test_gravity_may_have_any_length_but_must_have_a_direction():
    assert Gravity((0.0, 9.81, 0.0)).unit == (0.0, 1.0, 0.0)
    for direction in ((0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (math.inf, 0.0, 0.0)):
        with pytest.raises(ValueError, match="points nowhere"):
            Gravity(direction)
    for sigma_rad in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="sigma_rad"):
            Gravity((0.0, 0.0, 1.0), sigma_rad)


@pytest.fixture
def areas(monkeypatch: pytest.MonkeyPatch) -> list[Region | None]:
    """The areas that were looked at."""
    looked: list[Region | None] = []

    def spy(image: NDArray[np.uint8], region: Region | None, *rest: object, **named: object):
        looked.append(region)
        return detect_markers(image, region, *rest, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(locate, "detect_markers", spy)
    return looked


def test_a_previous_pose_is_where_to_look_first(areas: list[Region | None]):
    pose, gravity_v, gravity_c = leaning()
    near = Pose(pose.R, pose.t + np.array([0.02, 0.01, 0.03]))
    found = locate_marker(
        image_of(pose), VGA, LAYOUT, gravity_v=gravity_v, gravity_c=gravity_c, previous=near
    )
    assert isinstance(found, LocatedMarker)
    (area,) = areas
    assert area is not None and area.x1 - area.x0 < 120.0
    everywhere = locate_marker(
        image_of(pose), VGA, LAYOUT, gravity_v=gravity_v, gravity_c=gravity_c
    )
    assert isinstance(everywhere, LocatedMarker)
    assert found.T_c_v.t == pytest.approx(everywhere.T_c_v.t, abs=2e-4)


@pytest.mark.parametrize("moved", [(0.35, 0.2, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, -3.0)])
def test_a_marker_that_moved_on_is_found_all_the_same(
    moved: tuple[float, float, float], areas: list[Region | None]
):
    pose, gravity_v, gravity_c = leaning()
    previous = Pose(pose.R, pose.t + np.array(moved))
    found = locate_marker(
        image_of(pose), VGA, LAYOUT, gravity_v=gravity_v, gravity_c=gravity_c, previous=previous
    )
    assert isinstance(found, LocatedMarker)
    assert areas[-1] is None


def test_only_the_region_is_looked_at():
    pose, gravity_v, gravity_c = leaning()
    elsewhere = Region(0.0, 0.0, 150.0, 150.0)
    missed = locate_marker(
        image_of(pose), VGA, LAYOUT, gravity_v=gravity_v, gravity_c=gravity_c, region=elsewhere
    )
    assert missed == Missed(MissReason.NO_MARKER)


def test_every_marker_of_a_layout_is_used():
    layout = MarkerLayout(
        (
            Marker(0, 0.04, 0.0002, Pose(np.eye(3), np.zeros(3))),
            Marker(5, 0.06, 0.0003, Pose(np.eye(3), np.array([0.12, 0.0, 0.0]))),
        )
    )
    pose, gravity_v, gravity_c = leaning()
    found = locate_marker(
        image_of(pose, layout), VGA, layout, gravity_v=gravity_v, gravity_c=gravity_c
    )
    assert isinstance(found, LocatedMarker)
    assert [d.marker_id for d in found.detections] == [0, 5]
    assert found.T_c_v.t == pytest.approx(pose.t, abs=0.003)


def test_why_there_is_no_pose():
    pose, gravity_v, gravity_c = leaning()
    empty = np.full((VGA.height, VGA.width), 90, np.uint8)
    assert locate_marker(empty, VGA, LAYOUT) == Missed(MissReason.NO_MARKER)
    strict = PoseSettings(max_incidence_rad=0.1)
    oblique = locate_marker(
        image_of(pose),
        VGA,
        LAYOUT,
        gravity_v=gravity_v,
        gravity_c=gravity_c,
        previous=pose,
        settings=strict,
    )
    assert oblique == Missed(MissReason.MARKER_OBLIQUE)
    for image in (
        np.zeros((10, 10), np.uint8),
        np.zeros((480, 640)),
        np.zeros((480, 640, 4), np.uint8),
    ):
        with pytest.raises(ValueError, match="image"):
            locate_marker(image, VGA, LAYOUT)  # type: ignore[arg-type]


def test_the_package_itself_stays_light():
    code = "import sys, path.marker.layout; sys.exit(any(name in sys.modules for name in ('cv2', 'numba')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

"""Finding markers in exact images."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker import detect
from path.marker.detect import detect_markers
from path.marker.layout import Marker, MarkerLayout, single_marker
from path.marker.photometric.texture import cells, dictionary_of
from path.marker.pose import PoseSettings, estimate_pose
from path.observations import Missed, MissReason, Region
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


def facing(distance_m: float, x_m: float = 0.0, y_m: float = 0.0, tilt_rad: float = 0.4) -> Pose:
    """The marker turned to the camera, tilted a little."""
    return Pose(
        rotation.exp(np.array([math.pi - tilt_rad, 0.0, 0.3])), np.array([x_m, y_m, distance_m])
    )


def image_of(
    pose: Pose,
    layout: MarkerLayout = LAYOUT,
    ground: NDArray[np.float64] = GROUND,
    optics: Optics | None = None,
) -> NDArray[np.uint8]:
    return render(VGA, pose, layout, np.random.default_rng(4), optics or Optics(), ground)


@pytest.mark.parametrize(
    ("near_m", "far_m", "needed"), [(0.4, 0.8, 1.0), (0.8, 1.3, 1.0), (1.3, 1.8, 0.9)]
)
def test_small_markers_are_found_in_a_region(near_m: float, far_m: float, needed: float):
    """The farthest are 12 to 18 px on their side before they are foreshortened."""
    rng = np.random.default_rng(11)
    found = 0
    for _ in range(20):
        view = random_view(rng, VGA, near_m, far_m, 45.0)
        truth = true_corners(VGA, view.T_c_v, LAYOUT)
        region = region_around(truth + rng.uniform(-10.0, 10.0, 2), 70.0)
        detections = detect_markers(
            render(VGA, view.T_c_v, LAYOUT, rng, ground=GROUND), region, LAYOUT, VGA
        )
        assert len(detections) <= 1
        found += len(detections)
        for detection in detections:
            assert detection.corners_px == pytest.approx(truth, abs=0.15)
    assert found >= needed * 20


def test_what_a_first_look_misses_a_second_may_find(monkeypatch: pytest.MonkeyPatch):
    def found() -> int:
        rng, count = np.random.default_rng(11), 0
        for _ in range(20):
            view = random_view(rng, VGA, 0.4, 1.5, 45.0)
            region = region_around(true_corners(VGA, view.T_c_v, LAYOUT), 50.0)
            dim = Optics(black=80.0, white=100.0, samples=4)
            image = render(VGA, view.T_c_v, LAYOUT, rng, dim, GROUND)
            count += len(detect_markers(image, region, LAYOUT, VGA))
        return count

    twice = found()
    monkeypatch.setattr(detect, "RETRY_PIXELS", 0.0)
    assert twice >= found() + 2


def test_a_marker_of_12_px_is_found_in_the_whole_image():
    pose = facing(2.0, 0.3, -0.2, 0.2)
    image = cv2.cvtColor(image_of(pose), cv2.COLOR_GRAY2BGR)
    before = image.copy()
    (found,) = detect_markers(np.asarray(image, dtype=np.uint8), None, LAYOUT, VGA)
    assert found.corners_px == pytest.approx(true_corners(VGA, pose, LAYOUT), abs=0.1)
    assert (image == before).all()


def test_a_large_marker_is_found_too():
    pose = facing(0.2)  # 120 px
    region = region_around(true_corners(VGA, pose, LAYOUT), 130.0)
    (found,) = detect_markers(image_of(pose, optics=Optics(samples=4)), region, LAYOUT, VGA)
    assert found.corners_px == pytest.approx(true_corners(VGA, pose, LAYOUT), abs=0.05)


def test_subpixel_corners_claim_what_they_are_good_for():
    rng, surprises = np.random.default_rng(3), list[float]()
    for _ in range(25):
        view = random_view(rng, VGA, 0.7, 1.3, 50.0)
        truth = true_corners(VGA, view.T_c_v, LAYOUT)
        image = render(VGA, view.T_c_v, LAYOUT, rng, ground=GROUND)
        (found,) = detect_markers(image, region_around(truth, 60.0), LAYOUT, VGA, refine="subpix")
        error = (found.corners_px - truth).ravel()
        surprises.append(float(error @ np.linalg.solve(found.covariance_px2, error)) / 8.0)
    assert 0.3 < np.mean(surprises) < 2.0


def test_where_the_fit_fails_corners_are_subpixel_ones(monkeypatch: pytest.MonkeyPatch):
    pose = facing(1.0)
    region = region_around(true_corners(VGA, pose, LAYOUT), 60.0)
    (plain,) = detect_markers(image_of(pose), region, LAYOUT, VGA, refine="subpix")

    def fails(*_: object, **_how: object) -> None:
        return None

    monkeypatch.setattr(detect, "fit", fails)
    (found,) = detect_markers(image_of(pose), region, LAYOUT, VGA)
    assert (found.corners_px == plain.corners_px).all()
    assert math.sqrt(found.covariance_px2[0, 0]) > 0.3


def test_an_id_that_the_layout_does_not_have_is_none():
    image = image_of(facing(0.8), single_marker(marker_id=7))
    for region in (None, Region(200.0, 120.0, 440.0, 360.0)):
        assert detect_markers(image, region, LAYOUT, VGA) == ()
        (found,) = detect_markers(image, region, single_marker(marker_id=7), VGA)
        missed = estimate_pose((found,), LAYOUT, VGA, None, None, PoseSettings())
        assert missed == Missed(MissReason.WRONG_MARKER)


def test_the_same_marker_in_two_places_is_seen_twice():
    first = image_of(facing(0.8, -0.1)).astype(np.float64)
    image = image_of(facing(0.9, 0.12, 0.05), ground=first)
    found = detect_markers(image, None, LAYOUT, VGA)
    assert [detection.marker_id for detection in found] == [0, 0]
    missed = estimate_pose(found, LAYOUT, VGA, None, None, PoseSettings())
    assert missed == Missed(MissReason.MARKER_TWICE)


def test_all_markers_of_a_layout_are_found():
    side_by_side = MarkerLayout(
        (
            Marker(0, 0.04, 0.0, Pose(np.eye(3), np.zeros(3))),
            Marker(5, 0.08, 0.0, Pose(np.eye(3), np.array([0.12, 0.0, 0.0]))),
        )
    )
    pose = facing(1.0, -0.06)
    found = detect_markers(image_of(pose, side_by_side), None, side_by_side, VGA)
    assert [detection.marker_id for detection in found] == [0, 5]
    for detection in found:
        truth = true_corners(VGA, pose, side_by_side, detection.marker_id)
        assert detection.corners_px == pytest.approx(truth, abs=0.05)


def test_the_region_bounds_the_search():
    image = image_of(facing(0.8))
    assert detect_markers(image, Region(0.0, 0.0, 150.0, 150.0), LAYOUT, VGA) == ()
    assert detect_markers(image, Region(-50.0, -50.0, -1.0, -1.0), LAYOUT, VGA) == ()
    (found,) = detect_markers(image, Region(-1e3, -1e3, 1e4, 1e4), LAYOUT, VGA)
    assert found.corners_px == pytest.approx(true_corners(VGA, facing(0.8), LAYOUT), abs=0.1)


def test_ground_without_a_marker_shows_none():
    rng = np.random.default_rng(8)
    for _ in range(3):
        image = np.clip(background(VGA, rng) + rng.normal(0.0, 4.0, (480, 640)), 0.0, 255.0).astype(
            np.uint8
        )
        assert detect_markers(image, None, LAYOUT, VGA) == ()


def crowd(rng: np.random.Generator) -> tuple[NDArray[np.uint8], MarkerLayout]:
    """Eighty small tags, steep, dim and blurred, each a cell from the next."""
    layout = MarkerLayout(
        tuple(Marker(i, 0.04, 0.0, Pose(np.eye(3), np.zeros(3))) for i in range(80)),
        "DICT_APRILTAG_36h11",
    )
    image = GROUND.copy()
    for i in range(80):
        printed = 30.0 + 60.0 * np.pad(cells(layout.dictionary, i), 1, constant_values=1.0)
        large = np.kron(printed, np.ones((10, 10)))
        x, y = 25.0 + 58.0 * (i % 10), 22.0 + 56.0 * (i // 10)
        wide, high = rng.uniform(16.0, 30.0, 2)
        lean = rng.uniform(-5.0, 5.0)
        to = np.array(
            [[x, y], [x + wide, y + lean], [x + wide + lean, y + high], [x + lean, y + high - lean]]
        )
        of = np.array([[0.0, 0.0], [99.0, 0.0], [99.0, 99.0], [0.0, 99.0]])
        H = cv2.getPerspectiveTransform(of.astype(np.float32), to.astype(np.float32))
        over = cv2.warpPerspective(np.ones_like(large), H, (640, 480), flags=cv2.INTER_AREA)
        image = np.where(
            over > 0.5, cv2.warpPerspective(large, H, (640, 480), flags=cv2.INTER_AREA), image
        )
    blurred = cv2.GaussianBlur(image, (0, 0), 0.7) + rng.normal(0.0, 1.5, image.shape)
    return np.clip(blurred, 0.0, 255.0).astype(np.uint8), layout


def test_in_a_whole_image_what_is_small_and_close_to_others_is_found():
    image, layout = crowd(np.random.default_rng(8))
    found = detect_markers(image, None, layout, VGA, refine="subpix")
    parameters = cv2.aruco.DetectorParameters()
    by_opencv, _, _ = cv2.aruco.ArucoDetector(
        dictionary_of(layout.dictionary), parameters
    ).detectMarkers(image)
    assert len({each.marker_id for each in found}) == len(found)  # each once
    assert len(found) >= max(75, 2 * len(by_opencv))
    assert detect_markers(GROUND.astype(np.uint8), None, layout, VGA) == ()


def coded(
    pattern: NDArray[np.float64], side_px: float, rng: np.random.Generator, coarse: int = 1
) -> NDArray[np.uint8]:
    """A print seen at a slant, its picture enlarged so many times without smoothing, 240x240."""
    n, small = len(pattern), 240 // coarse
    side = side_px / coarse * n / (n - 2)
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    to = (square + rng.uniform(-0.12, 0.12, (4, 2))) * side + 0.5 * (small - side)
    H = cv2.getPerspectiveTransform(
        (12.0 * n * square - 0.5).astype(np.float32), (4.0 * to).astype(np.float32)
    )
    large = cv2.warpPerspective(
        np.kron(30.0 + 170.0 * pattern, np.ones((12, 12))),
        H,
        (4 * small, 4 * small),
        borderValue=(120.0,),
    )
    seen = cv2.resize(
        cv2.GaussianBlur(large, (0, 0), 2.8), (small, small), interpolation=cv2.INTER_AREA
    )
    noisy = np.clip(seen + rng.normal(0.0, 2.0, seen.shape), 0.0, 255.0).astype(np.uint8)
    return np.kron(noisy, np.ones((coarse, coarse), np.uint8))


def all_of(dictionary: str, count: int) -> MarkerLayout:
    return MarkerLayout(
        tuple(Marker(i, 0.04, 0.0, Pose(np.eye(3), np.zeros(3))) for i in range(count)), dictionary
    )


@pytest.mark.parametrize(
    ("dictionary", "flipped", "coarse"),
    [
        ("DICT_4X4_50", 2, 1), ("DICT_APRILTAG_16h5", 2, 1), ("DICT_6X6_50", 4, 1),
        ("DICT_APRILTAG_36h11", 4, 1), ("DICT_APRILTAG_36h11", 5, 1),
        ("DICT_APRILTAG_36h11", 4, 4), ("DICT_6X6_50", 4, 4),
    ],
)  # fmt: skip
def test_a_code_that_is_several_bits_away_is_another_one(
    dictionary: str, flipped: int, coarse: int
):
    """Of another family's sheet; a decoder corrects up to five of 36 bits, and one or two of 16."""
    rng, layout = np.random.default_rng(6), all_of(dictionary, 30)
    camera = dataclasses.replace(VGA, width=240, height=240, cx=120.0, cy=120.0)
    found = 0
    for _ in range(15):
        pattern = np.pad(cells(dictionary, int(rng.integers(30))), 1, constant_values=1.0)
        bits = pattern[2:-2, 2:-2]
        for place in rng.choice(bits.size, flipped, replace=False):
            at = np.unravel_index(place, bits.shape)
            bits[at] = 1.0 - bits[at]
        image = coded(pattern, rng.uniform(40.0, 110.0), rng, coarse)
        found += len(detect_markers(image, None, layout, camera))
        found += len(detect_markers(image, Region(0.0, 0.0, 240.0, 240.0), layout, camera))
    assert found == 0


def test_a_bar_of_lights_is_no_marker():
    rng, camera = (
        np.random.default_rng(1),
        dataclasses.replace(VGA, width=300, height=300, cx=150.0, cy=150.0),
    )
    for _ in range(10):
        image = np.zeros((300, 300))
        cv2.line(
            image,
            tuple(rng.integers(60, 240, 2).tolist()),
            tuple(rng.integers(60, 240, 2).tolist()),
            (255.0,),
            14,
        )
        image *= rng.uniform(0.3, 1.0, (75, 75)).repeat(4, axis=0).repeat(4, axis=1)
        seen = np.clip(
            cv2.GaussianBlur(image, (0, 0), 2.0) + rng.normal(0.0, 2.0, image.shape), 0.0, 255.0
        )
        for dictionary in ("DICT_APRILTAG_16h5", "DICT_4X4_50"):
            for region in (None, Region(0.0, 0.0, 300.0, 300.0), Region(50.0, 50.0, 250.0, 250.0)):
                assert (
                    detect_markers(seen.astype(np.uint8), region, all_of(dictionary, 30), camera)
                    == ()
                )

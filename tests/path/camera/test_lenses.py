"""Lenses of others: each projects as OpenCV has it, and comes back; none is taken for one that it
is not.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from path.camera.lenses import MOST_PX, Lens, LensKind, as_brown_conrady
from path.camera.model import CameraModel

SIZE = (1280, 720)
CAMERA = (*SIZE, 900.0, 905.0, 633.0, 365.0)
COEFFICIENTS: dict[LensKind, tuple[float, ...]] = {
    "brown_conrady": (0.11, -0.23, 0.001, -0.0005, 0.09),
    "inverse_brown_conrady": (-0.055, 0.066, 0.0003, 0.0007, -0.0215),
    "modified_brown_conrady": (0.1, -0.2, 0.001, 0.0005, 0.1),
    "rational": (0.4, -2.4, 0.0003, 0.0007, 1.5, 0.3, -2.2, 1.4),
    "equidistant": (-0.02, 0.003, -0.002, 0.0005),
}
USUAL = (-0.055, 0.066, 0.0003, 0.0007, -0.0215)  # of a D455
PIXELS = np.stack(np.meshgrid(np.linspace(0, 1279, 17), np.linspace(0, 719, 11)), axis=-1).reshape(
    -1, 2
)


def lens_of(kind: LensKind) -> Lens:
    return Lens(kind, *CAMERA, COEFFICIENTS[kind])


@pytest.mark.parametrize("kind", list(COEFFICIENTS))
def test_pixels_and_rays_lead_to_each_other(kind: LensKind) -> None:
    lens = lens_of(kind)
    rays = lens.rays(PIXELS)
    assert np.isfinite(rays).all()
    assert lens.project(rays) == pytest.approx(PIXELS, abs=1e-6)


@pytest.mark.parametrize("kind", ["brown_conrady", "rational", "equidistant"])
def test_a_lens_projects_as_opencv_does(kind: LensKind) -> None:
    lens = lens_of(kind)
    rays = lens.rays(PIXELS)
    K = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    coefficients = np.array(lens.coefficients)
    if kind == "equidistant":
        seen = cv2.fisheye.distortPoints(rays[None], K, coefficients)[0]
    else:
        points = np.column_stack((rays, np.ones(len(rays))))
        seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, coefficients)[0][:, 0]
    assert lens.project(rays) == pytest.approx(seen, abs=1e-6)


def test_the_inverse_lens_deprojects_as_librealsense_does() -> None:
    """rsutil.h, rs2_deproject_pixel_to_point, one pixel by hand."""
    lens = lens_of("inverse_brown_conrady")
    k1, k2, p1, p2, k3 = lens.coefficients
    x, y = (100.0 - lens.cx) / lens.fx, (650.0 - lens.cy) / lens.fy
    r2 = x * x + y * y
    f = 1 + k1 * r2 + k2 * r2 * r2 + k3 * r2 * r2 * r2
    expected = (
        x * f + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * f + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
    )
    assert lens.rays(np.array([[100.0, 650.0]]))[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("kind", ["inverse_brown_conrady", "modified_brown_conrady"])
def test_the_lens_that_stands_for_another_is_no_further_off_than_it_says(
    kind: LensKind, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    strength, noise = (
        float(rng.uniform(-1.5, 1.5)),
        rng.normal(0.0, (0.003, 0.003, 0.0003, 0.0003, 0.003)),
    )
    k = tuple(strength * each + off for each, off in zip(USUAL, noise.tolist(), strict=True))
    fx, fy, cx, cy = rng.uniform((600, 600, 620, 340), (1000, 1000, 660, 380)).tolist()
    lens = Lens(kind, *SIZE, fx, fy, cx, cy, k)
    found = as_brown_conrady(lens)
    off_px = np.hypot(
        *(
            found.camera.project(np.column_stack((lens.rays(PIXELS), np.ones(len(PIXELS)))))
            - PIXELS
        ).T
    )
    assert off_px.max() <= max(1.1 * found.worst_px, 1e-6)
    assert found.worst_px <= MOST_PX


def test_a_brown_conrady_lens_stands_for_itself() -> None:
    found = as_brown_conrady(lens_of("brown_conrady"))
    assert found.worst_px == 0.0
    assert found.camera == CameraModel(*CAMERA, COEFFICIENTS["brown_conrady"])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("focal_px", "said"),
    [
        (700.0, r"kind equidistant, from which .* is off by 1\.\d+ px"),
        (400.0, "shows what is beside the camera"),
    ],
    ids=["wide", "wider than half of all around"],
)
def test_a_fisheye_that_bends_too_much_is_refused_with_what_it_is(
    focal_px: float, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        as_brown_conrady(
            Lens(
                "equidistant", *SIZE, focal_px, focal_px, 640.0, 360.0, COEFFICIENTS["equidistant"]
            )
        )


def test_a_lens_of_other_numbers_than_its_kind_has_is_refused() -> None:
    with pytest.raises(ValueError, match="kind equidistant has 4 coefficients, not 5"):
        Lens("equidistant", *CAMERA, (0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="not finite"):
        Lens("equidistant", *CAMERA, (0.1, float("nan"), 0.0, 0.0))

"""Shots of one condition with one camera, and what every method makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flight.harness.renderer import FrameRenderer, RendererSetup
from missions.trials.pose.corners.conditions import (
    CAMERAS,
    CONDITIONS,
    LAYOUT,
    corners_px,
    marker_in,
    view,
)
from missions.trials.pose.corners.methods import METHODS, FoundMarker, find
from path.arrays import Image
from path.geometry.rotation import exp
from path.geometry.transforms import Matrix, Pose
from path.messages import Role
from path.observations import Region
from path.values import frozen

AROUND = 0.6  # of the marker's extent: how far the predicted region reaches beyond it, each way
OFF = 0.1  # of the extent: how wrong the prediction is
# per axis, an expected pose: what the motion between two frames leaves unknown
OFF_M = 0.0015
OFF_RAD = 0.005
REGION_STREAM = 2
EXPECTED_STREAM = 3


@frozen
class CornerShot:
    """One shot.

    Attributes:
        true_px: (4, 2).
        found: by method.
        picture: (h, w, 3) BGR around the marker, whose first pixel is ``corner_px``; only of the
            view that is shown.
    """

    camera: str
    condition: str
    view: int
    true_px: Matrix
    found: dict[str, FoundMarker | None]
    picture: Image | None = None
    corner_px: tuple[int, int] = (0, 0)


def shoot(
    kind: type[FrameRenderer],
    T_b_v: Pose,
    camera_name: str,
    condition_name: str,
    seed: int,
    views: Sequence[int],
    shown: int,
) -> list[CornerShot]:
    """Shoot some views with one camera in one condition; ``shown``: whose picture is kept.

    Views and noise of the sensor are the same in every condition.
    """
    camera = CAMERAS[camera_name]
    condition = CONDITIONS[condition_name]
    here = Pose(np.eye(3), np.zeros(3))
    setup = RendererSetup(camera, here, T_b_v, LAYOUT, condition.imaging, condition.printing)
    renderer = kind(setup, seed)
    samples: list[CornerShot] = []
    for number in views:
        stage = view(seed, number, camera, T_b_v)
        T_c_v = marker_in(stage, T_b_v)
        true_px = corners_px(T_c_v, camera)
        image = renderer.shoot(stage, Role.RECEIVER, number).color
        region = _predicted(true_px, np.random.default_rng([seed, REGION_STREAM, number]))
        expected = _expected(T_c_v, seed, number)
        found = {
            method: find(method, image, region, LAYOUT, camera, expected) for method in METHODS
        }
        sample = CornerShot(camera_name, condition_name, number, true_px, found)
        samples.append(_pictured(sample, image) if number == shown else sample)
    return samples


def _predicted(true_px: Matrix, rng: np.random.Generator) -> Region:
    """Return the region in which flight would look for the marker."""
    low = true_px.min(axis=0)
    high = true_px.max(axis=0)
    extent = float((high - low).max())
    low, high = (
        end + rng.uniform(-OFF, OFF, 2) * extent
        for end in (low - AROUND * extent, high + AROUND * extent)
    )
    return Region(float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def _expected(
    T_c_v: Pose,
    seed: int,
    number: int,
) -> Pose:
    """Return the pose that flight would expect."""
    rng = np.random.default_rng([seed, EXPECTED_STREAM, number])
    return Pose(exp(rng.normal(0.0, OFF_RAD, 3)) @ T_c_v.R, T_c_v.t + rng.normal(0.0, OFF_M, 3))


def _pictured(sample: CornerShot, image: Image) -> CornerShot:
    u, v = sample.true_px.mean(axis=0)
    reach = 0.75 * float(np.ptp(sample.true_px, axis=0).max())
    u0 = max(round(u - reach), 0)
    v0 = max(round(v - reach), 0)
    cut = image[v0 : round(v + reach) + 1, u0 : round(u + reach) + 1].copy()
    return replace(sample, picture=cut, corner_px=(u0, v0))

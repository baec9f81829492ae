"""A picture whose rows are read one after another shows each corner where it is when its own row is
read.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.render.renderer import Renderer
from hil.render.sensor import SensorNoise
from hil.render.shutter import LONGEST_PX, Shutter, blurred_px, carried, smear_px
from hil.world.snapshot import DroneTruth, Snapshot
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.marker.layout import single_marker
from path.messages import Role
from tests.hil.geometric.noise_measurement import CAMERA, T_B_C, T_B_V, scenes

LAYOUT = single_marker()
QUIET = SensorNoise(0.6, 0.3, 0.0, 0.0)
READOUT_S = 0.02
MOTIONS = {
    "camera turns": ((0.0, 0.0, 0.0), (0.3, -0.5, 0.4), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "camera moves": ((0.6, -0.4, 0.3), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "marker turns and moves": (
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        (-0.5, 0.3, -0.2),
        (0.6, 0.2, -0.5),
    ),
    "both": ((0.3, 0.2, -0.2), (-0.4, 0.3, 0.2), (0.5, -0.3, 0.1), (0.3, -0.5, 0.4)),
}

Vec3 = tuple[float, float, float]


def moment() -> Snapshot:
    """A moment in which D2 sees D1's marker large, away from the middle row."""
    for snapshot in scenes(3, 200):
        corners = seen_at(snapshot, 0.0)
        side = np.hypot(*(corners - np.roll(corners, 1, axis=0)).T).min()
        if (
            side > 30.0
            and corners.min() > 40.0
            and corners[:, 0].max() < 600.0
            and abs(corners[:, 1].mean() - 240) > 60
        ):
            return snapshot
    raise AssertionError("no such moment")


def moving(
    snapshot: Snapshot, eye_mps: Vec3, eye_radps: Vec3, other_mps: Vec3, other_radps: Vec3
) -> Snapshot:
    drones = {
        Role.RECEIVER: replace(
            snapshot.drones[Role.RECEIVER], velocity_w_mps=eye_mps, rates_b_radps=eye_radps
        ),
        Role.SENDER: replace(
            snapshot.drones[Role.SENDER], velocity_w_mps=other_mps, rates_b_radps=other_radps
        ),
    }
    return replace(snapshot, drones=drones)


def later(drone: DroneTruth, by_s: float) -> Pose:
    T = drone.T_w_b
    return Pose(
        T.R @ exp(by_s * np.array(drone.rates_b_radps)), T.t + by_s * np.array(drone.velocity_w_mps)
    )


def seen_at(snapshot: Snapshot, by_s: float) -> NDArray[np.float64]:
    """Corners of the marker in D2's image at an instant."""
    T_w_c = later(snapshot.drones[Role.RECEIVER], by_s) @ T_B_C
    T_w_v = later(snapshot.drones[Role.SENDER], by_s) @ T_B_V
    return CAMERA.project((T_w_c.inverse() @ T_w_v).apply(LAYOUT.markers[0].corners_v))


def as_read(snapshot: Snapshot) -> NDArray[np.float64]:
    """Each corner at the instant at which its row is read."""
    corners = seen_at(snapshot, 0.0)
    for _ in range(5):
        late_s = READOUT_S * (corners[:, 1] - 0.5 * (CAMERA.height - 1)) / CAMERA.height
        corners = np.stack([seen_at(snapshot, float(by_s))[k] for k, by_s in enumerate(late_s)])
    return corners


def found(snapshot: Snapshot, shutter: Shutter | None) -> NDArray[np.float64]:
    renderer = Renderer(CAMERA, T_B_C, T_B_V, LAYOUT, QUIET, shutter=shutter)
    color, _ = renderer.render(snapshot, Role.RECEIVER, 0)
    markers = detect_markers(color, None, LAYOUT, CAMERA)
    assert len(markers) == 1
    return markers[0].corners_px


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_each_corner_is_where_it_is_when_its_row_is_read(
    motion: tuple[Vec3, Vec3, Vec3, Vec3],
) -> None:
    snapshot = moving(moment(), *motion)
    corners = found(snapshot, Shutter(readout_s=READOUT_S))
    # there is something to see
    assert np.abs(as_read(snapshot) - seen_at(snapshot, 0.0)).max() > 0.7
    assert np.abs(corners - as_read(snapshot)).max() < 0.08
    assert np.abs(found(snapshot, None) - seen_at(snapshot, 0.0)).max() < 0.08


def test_nothing_moves_is_one_instant() -> None:
    snapshot = moment()
    shown = [
        Renderer(CAMERA, T_B_C, T_B_V, LAYOUT, QUIET, shutter=shutter).render(
            snapshot, Role.RECEIVER, 0
        )[0]
        for shutter in (None, Shutter(0.01, READOUT_S))
    ]
    assert np.abs(shown[0].astype(int) - shown[1]).max() <= 1


def test_motion_during_the_exposure_is_that_of_what_is_in_the_middle() -> None:
    snapshot = moving(moment(), (0.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    renderer = Renderer(CAMERA, T_B_C, T_B_V, LAYOUT, QUIET)
    own = snapshot.drones[Role.RECEIVER]
    seen = carried(own.T_w_b, T_B_C, np.zeros(3), own.T_w_b.R @ np.array(own.rates_b_radps))
    u, v = smear_px(
        renderer.bodies(snapshot, Role.RECEIVER), seen, CAMERA, Shutter(exposure_s=0.01)
    )
    assert math.hypot(u, v) == pytest.approx(0.01 * 0.5 * CAMERA.fx, rel=0.5)
    assert abs(v) > abs(u)  # it pitches
    far = smear_px(renderer.bodies(snapshot, Role.RECEIVER), seen, CAMERA, Shutter(exposure_s=10.0))
    assert math.hypot(*far) == pytest.approx(LONGEST_PX)
    assert smear_px([], seen, CAMERA, Shutter(0.01)) == (0.0, 0.0)


def test_motion_widens_the_blur() -> None:
    assert blurred_px(0.75, 0.0) == 0.75
    assert blurred_px(0.0, math.sqrt(12.0)) == pytest.approx(1.0)

"""The receiver's view of the marker.

Where it looks, what it takes for a pose, and what it remembers while it sees none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.rig.parts import Mount
from flight.config import MissionConfig
from flight.guidance import Vec3
from flight.rendezvous.marker_view import (
    MarkerFix,
    MarkerView,
    VehicleMotions,
    _relative_settings,
    levelled,
)
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior
from path.geometry.rigid import rigid
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Matrix, Pose
from path.marker.layout import Marker, MarkerLayout, single_marker
from path.observations import Box, Depth, Detection, MarkerDetection, Missed, MissReason, Region
from path.relative_pose.filter import RelativeSettings

MOUNT = Mount(Pose(np.eye(3), np.zeros(3)), Pose(np.eye(3), np.zeros(3)))
CAMERA = CameraModel(640, 480, 612.8, 613.1, 317.6, 238.2, (0.104, -0.221, -0.0003, 0.0007, 0.088))
LAYOUT = single_marker()
TURNED = R_from_rpy(math.pi, 0.0, 0.0)  # the print faces the camera
R_N_C = R_from_rpy(0.0, 0.3, 1.0) @ np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
MS = 1_000_000
FRAME_NS = 20 * MS


def marker_at(x: float, y: float, z: float, tilt: float = 0.6) -> Pose:
    """``T_c_v``: seen at an angle, as no two solutions are alike then."""
    return Pose(R_from_rpy(tilt, 0.25, 0.0) @ TURNED, np.array([x, y, z]))


@dataclass
class FakeView:
    """One marker, or none, found only where it is looked for."""

    stamp_ns: int
    T_c_v: Pose | None
    frame_id: int = 0
    asked: list[Region | None] = field(default_factory=list[Region | None])
    expected: Pose | None = None

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        self.asked.append(region)
        self.expected = expected
        if self.T_c_v is None:
            return []
        corners = CAMERA.project(self.T_c_v.apply(LAYOUT.markers[0].corners_v))
        if region is not None and not all(region.contains(u, v) for u, v in corners.tolist()):
            return []
        return [MarkerDetection(0, corners, 0.02**2 * np.eye(8))]

    def targets(self, region: Region | None) -> Sequence[Detection]:
        return []

    def depth(self, box: Box) -> Depth | None:
        return None

    def image(self) -> NDArray[np.uint8] | None:
        return None


@dataclass
class Watch:
    """A receiver that looks at frame after frame."""

    view: MarkerView = field(
        default_factory=lambda: MarkerView(LAYOUT, CAMERA, MOUNT, MethodConfig(), MissionConfig())
    )
    stamp_ns: int = 1_000 * MS
    last: FakeView = field(default_factory=lambda: FakeView(0, None))

    def look(
        self, T_c_v: Pose | None, R_n_c: Matrix = R_N_C, after_ns: int = FRAME_NS
    ) -> MarkerFix | Missed:
        self.stamp_ns += after_ns
        self.last = FakeView(self.stamp_ns, T_c_v)
        gravity_c = tuple((R_n_c.T @ (0.0, 0.0, 1.0)).tolist())
        gravity_v = None if T_c_v is None else tuple((T_c_v.R.T @ np.array(gravity_c)).tolist())
        return self.view.look(self.last, R_n_c, gravity_v, gravity_c)

    def see(self, T_c_v: Pose, frames: int = 1) -> MarkerFix:
        for _ in range(frames):
            fix = self.look(T_c_v)
            assert isinstance(fix, MarkerFix), fix
        return fix  # type: ignore[possibly-undefined]


def motion(
    stamp_ns: int, peer_n_mps: Vec3, own_n_mps: Vec3, peer_yaw_rad: float = 0.0
) -> VehicleMotions:
    return VehicleMotions(stamp_ns, own_n_mps, stamp_ns, peer_n_mps, peer_yaw_rad)


NEAR = marker_at(0.1, -0.1, 1.2)


def test_the_pose_is_that_of_the_marker_seen() -> None:
    fix = Watch().see(NEAR)
    assert fix.T_c_v.t == pytest.approx(NEAR.t, abs=1e-3)
    assert pytest.approx(NEAR.R, abs=1e-2) == fix.T_c_v.R
    assert fix.side_px == pytest.approx(612.8 * 0.04 / 1.2, rel=0.2)
    assert [found.marker_id for found in fix.detections] == [0]


def test_the_first_look_is_everywhere_the_next_where_the_marker_was() -> None:
    watch = Watch()
    watch.see(NEAR)
    assert watch.last.asked == [None]
    watch.see(NEAR)
    (region,) = watch.last.asked
    assert region is not None
    u, v = CAMERA.project_point((0.1, -0.1, 1.2))
    assert region.contains(u, v)
    assert region.x1 - region.x0 < 250.0


def test_a_marker_is_expected_where_it_will_be_shortly_after_a_fix_only() -> None:
    watch = Watch()
    watch.see(NEAR)
    assert watch.last.expected is None
    watch.see(NEAR, 5)
    turn = R_from_rpy(0.0, 0.0, 0.2)
    moved = Pose((turn @ R_N_C).T @ R_N_C @ NEAR.R, (turn @ R_N_C).T @ R_N_C @ NEAR.t)
    watch.look(moved, turn @ R_N_C)
    assert watch.last.expected is not None
    assert watch.last.expected.t == pytest.approx(moved.t, abs=2e-3)
    watch.look(moved, turn @ R_N_C, after_ns=200 * MS)
    assert watch.last.asked != [None]
    assert watch.last.expected is None


def test_the_region_follows_the_marker_as_the_camera_turns() -> None:
    """The way to the marker is kept in a frame that does not turn with the camera."""
    watch = Watch()
    watch.see(NEAR, 5)
    turn = R_from_rpy(0.0, 0.0, 0.2)
    moved = Pose((turn @ R_N_C).T @ R_N_C @ NEAR.R, (turn @ R_N_C).T @ R_N_C @ NEAR.t)
    assert isinstance(watch.look(moved, turn @ R_N_C), MarkerFix)
    (region,) = watch.last.asked
    assert region is not None
    x, y, z = moved.t.tolist()
    assert region.contains(*CAMERA.project_point((x, y, z)))


def test_all_markers_of_a_plate_are_in_the_region() -> None:
    """Cut off, the larger one is not found; the smaller one may be too small from there."""
    T_c_v = marker_at(0.1, -0.2, 1.4)
    large = Marker(1, 0.15, 0.0002, Pose(np.eye(3), np.array([0.0, 0.11, 0.0])))
    layout = MarkerLayout((LAYOUT.markers[0], large), LAYOUT.dictionary)
    watch = Watch(MarkerView(layout, CAMERA, MOUNT, MethodConfig(), MissionConfig()))
    watch.see(T_c_v, 50)
    (region,) = watch.last.asked
    assert region is not None
    for marker in layout.markers:
        # with its white border
        quiet_v = marker.T_v_m.t + (1.0 + 2.0 / 6.0) * (marker.corners_v - marker.T_v_m.t)
        assert all(region.contains(u, v) for u, v in CAMERA.project(T_c_v.apply(quiet_v)).tolist())
    assert region.x1 - region.x0 < 2.5 * CAMERA.fx * 0.15 / 1.4


def test_the_whole_image_is_searched_no_more_often_than_told() -> None:
    watch = Watch()
    looked = 0
    for _ in range(100):
        missed = watch.look(None)
        assert missed == Missed(MissReason.NO_MARKER)
        looked += len(watch.last.asked)
    assert looked == pytest.approx(100 * 0.02 * MissionConfig().search_hz, abs=1)


def test_fixes_are_counted_for_half_a_second() -> None:
    watch = Watch()
    watch.see(NEAR, 10)
    assert watch.view.fixes(watch.stamp_ns) == 10
    assert watch.view.fixes(watch.stamp_ns + 400 * MS) == 5
    assert watch.view.found(watch.stamp_ns + 400 * MS)
    assert watch.view.fixes(watch.stamp_ns + 420 * MS) == 4
    assert not watch.view.found(watch.stamp_ns + 420 * MS)
    assert watch.view.fixes(watch.stamp_ns + 501 * MS) == 0


def test_an_unseen_marker_is_predicted_for_a_second() -> None:
    watch = Watch()
    assert watch.view.predict(watch.stamp_ns) is None
    assert watch.view.unseen_s(watch.stamp_ns) == math.inf
    watch.see(NEAR, 20)
    later = watch.view.predict(watch.stamp_ns + 900 * MS)
    assert later is not None
    assert later.marker_n_m == pytest.approx(tuple((R_N_C @ NEAR.t).tolist()), abs=0.05)
    assert watch.view.unseen_s(watch.stamp_ns + 900 * MS) == pytest.approx(0.9)
    assert watch.view.predict(watch.stamp_ns + 1_100 * MS) is None


def test_an_unseen_marker_moves_as_the_two_vehicles_say() -> None:
    watch = Watch()
    watch.view.note_motion(motion(watch.stamp_ns, (0.5, 0.0, 0.0), (0.2, 0.0, 0.0)))
    watch.see(NEAR)
    now = watch.view.predict(watch.stamp_ns)
    later = watch.view.predict(watch.stamp_ns + 500 * MS)
    assert now is not None and later is not None
    assert later.marker_n_m[0] - now.marker_n_m[0] == pytest.approx(0.15, abs=0.02)
    assert later.marker_n_m[1:] == pytest.approx(now.marker_n_m[1:], abs=0.02)
    assert later.sigma_m > now.sigma_m


def test_a_pose_that_turns_over_is_no_fix() -> None:
    watch = Watch()
    watch.see(NEAR, 5)
    before = watch.view.predict(watch.stamp_ns)
    missed = watch.look(marker_at(0.1, -0.1, 1.2, tilt=-0.6))
    assert missed == Missed(MissReason.MARKER_FLIPPED)
    after = watch.view.predict(watch.stamp_ns - FRAME_NS)
    assert before is not None and after is not None
    assert after.marker_n_m == pytest.approx(before.marker_n_m)


def test_a_jump_is_no_fix() -> None:
    """Farther than both drones could have moved since."""
    watch = Watch()
    watch.view.note_motion(motion(watch.stamp_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    watch.see(NEAR, 10)
    assert watch.look(marker_at(0.12, -0.1, 1.1)) == Missed(MissReason.POSE_UNCERTAIN)
    assert watch.view.fixes(watch.stamp_ns) == 10


def test_the_markers_attitude_is_that_of_the_drone_that_carries_it() -> None:
    """Roll and pitch by its gravity, heading by its status, for a marker that is mounted askew."""
    R_b_v = R_from_rpy(0.3, -0.8, 1.9)
    R_n_b = R_from_rpy(0.1, -0.2, 2.5)
    x, y, z = ((R_n_b @ R_b_v).T @ (0.0, 0.0, 1.0)).tolist()
    assert levelled((x, y, z), R_b_v) == pytest.approx(R_from_rpy(0.1, -0.2, 0.0) @ R_b_v)
    assert levelled((x, y, z), R_b_v, 2.5) == pytest.approx(R_n_b @ R_b_v)


def test_a_prediction_turns_with_the_drone_that_carries_the_marker() -> None:
    """Its heading comes with its status; without that nothing is known of its attitude."""
    watch = Watch()
    watch.see(NEAR)
    assert watch.view.R_n_v is None
    watch.view.note_motion(
        motion(watch.stamp_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), peer_yaw_rad=0.7)
    )
    fix = watch.see(NEAR)
    assert watch.view.R_n_v is not None
    assert watch.view.R_n_v[2] == pytest.approx(R_N_C[2] @ fix.T_c_v.R, abs=1e-3)  # down


def test_a_marker_seen_from_the_side_is_too_oblique() -> None:
    missed = Watch().look(marker_at(0.0, 0.0, 0.8, tilt=1.3))
    assert missed == Missed(MissReason.MARKER_OBLIQUE)


def test_a_marker_behind_the_camera_is_searched_for_everywhere() -> None:
    """After a half turn, where the marker was is no place in the image."""
    watch = Watch()
    watch.see(NEAR, 3)
    half = R_from_rpy(0.0, 0.0, math.pi) @ R_N_C
    assert watch.look(None, half, after_ns=200 * MS) == Missed(MissReason.NO_MARKER)
    assert watch.last.asked == [None]


def test_the_targets_place_is_kept_for_the_heading() -> None:
    watch = Watch()
    assert watch.view.target_n_m is None
    pixel = CAMERA.project_point((0.3, 0.4, 2.0))
    region = Region(0.0, 0.0, 1.0, 1.0)
    watch.view.note_target(
        Prior(pixel, 2.0, (1.0, 0.0, 1.0), region, 1, rigid(NEAR), 0.01, (0.0, 0.0, 1.0)), R_N_C
    )
    assert watch.view.target_n_m == pytest.approx(
        tuple((R_N_C @ (0.3, 0.4, 2.0)).tolist()), abs=1e-6
    )


def test_a_computer_that_does_not_keep_up_searches_more_rarely() -> None:
    watch = Watch()
    watch.view.search_every = 4
    asked = list[Region | None]()
    for _ in range(50):  # a second
        watch.look(None)
        asked += watch.last.asked
        assert watch.view.searched(watch.stamp_ns) == bool(watch.last.asked)
    assert 1 <= len(asked) <= MissionConfig().search_hz / 4 + 1
    assert set(asked) == {None}
    watch.view.search_every = 1
    watch.look(None, after_ns=1_000 * MS)
    assert watch.last.asked == [None]
    watch.look(NEAR, after_ns=1_000 * MS)
    watch.see(NEAR)
    assert not watch.view.searched(watch.stamp_ns)


@pytest.mark.parametrize("wander_deg", [0.0, 0.5, 5.0])
def test_a_drones_attitude_wanders_as_the_mission_says_and_its_heading_no_less_than_usual(
    wander_deg: float,
) -> None:
    usual = RelativeSettings()
    settings = _relative_settings(replace(MissionConfig(), attitude_wander_deg=wander_deg))
    assert settings.tilt_wander_rad == pytest.approx(math.radians(wander_deg))
    assert settings.yaw_wander_rad == max(usual.yaw_wander_rad, math.radians(wander_deg))
    assert settings.coast_s == MissionConfig().deadlines.marker_coast_s

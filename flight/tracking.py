"""Following one object from frame to frame: a constant-velocity filter in NED, associated in the image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.interfaces import View
from flight.guidance import Vec3, add, norm, scale, subtract
from path.camera import CameraModel
from path.geometry import Pose
from path.observations import Box, Depth, Detection, MissReason, Region

Pixel = tuple[float, float]

MIN_SCORE = 0.3
_MEASUREMENT_SIGMA_M = 0.05
_ACCELERATION_SIGMA_MPS2 = 0.6
_GATE_FLOOR_M = 0.10  # a box's noise, and an attitude a degree off
_GATE_MOST_M = 0.45  # a track that knows no better does not know which object it would find
_GATE_LEAST_M = 0.05
_RIVAL_SHARE = 0.4  # of the way to the nearest other object: where that is known to be, the gate ends before it
_RIVAL_REACH_M = 0.6
_RIVAL_S = 3.0  # for so long an object that was seen beside the target is taken to be there still
_UNSEEN_S = 0.5  # after so long anything else in reach might as well be the object
_UNSEEN_REACH_M = 2.0
_AMBIGUITY = 0.6
_CLEARLY_NEARER = 1.5
_MIN_DESCENT = 0.2  # per metre along the optical axis
_DEPTH_FLOOR_M, _DEPTH_SIGMAS = 0.2, 3.0  # how far a depth may put the object from its prediction
_COARSE_M = 0.12  # a range that is no better is estimated, not measured


@dataclass(frozen=True, slots=True)
class Sighting:
    """The tracked object in one frame. ``depth`` is None where the depth camera gave nothing to be trusted."""

    box: Box
    depth: Depth | None


class TargetTrack:
    """Position and velocity of one object in ``n``; the same filter on each axis (Kalman, constant velocity).

    ``accel_mps2``: how hard it may be expected to speed up, brake and turn.
    """

    def __init__(self, position_n_m: Vec3, stamp_ns: int, accel_mps2: float = _ACCELERATION_SIGMA_MPS2) -> None:
        self.position_n_m = position_n_m
        self.velocity_n_mps: Vec3 = (0.0, 0.0, 0.0)
        self.stamp_ns = stamp_ns
        self.seen_ns = stamp_ns
        self.rival_m = math.inf  # from the target to the nearest other object
        self.rival_ns = stamp_ns
        self._accel_mps2 = accel_mps2
        self._pp = 0.3**2
        self._pv = 0.0
        self._vv = 0.5**2

    def predict(self, stamp_ns: int) -> tuple[Vec3, float]:
        """Position (m) and its standard deviation per axis at a stamp, the filter left as it is."""
        dt = max(0.0, (stamp_ns - self.stamp_ns) * 1e-9)
        variance = self._pp + 2.0 * dt * self._pv + dt * dt * self._vv + (self._accel_mps2 * dt * dt / 2) ** 2
        return add(self.position_n_m, scale(self.velocity_n_mps, dt)), math.sqrt(variance)

    def gate_m(self, sigma_m: float, stamp_ns: int) -> float:
        """Returns how far from its prediction, with this standard deviation, the object may be found at a stamp."""
        most_m = min(_GATE_MOST_M, _RIVAL_SHARE * self.rival_m) if self._rival_known(stamp_ns) else _GATE_MOST_M
        return max(_GATE_LEAST_M, min(3.0 * sigma_m + _GATE_FLOOR_M, most_m))

    def note_rival(self, distance_m: float, stamp_ns: int) -> None:
        """Another object was seen that far from this one; a nearer one is remembered for a while."""
        if distance_m <= self.rival_m or not self._rival_known(stamp_ns):
            self.rival_m, self.rival_ns = distance_m, stamp_ns

    def _rival_known(self, stamp_ns: int) -> bool:
        return stamp_ns - self.rival_ns <= _RIVAL_S * 1e9

    def update(self, measured_n_m: Vec3, stamp_ns: int) -> None:
        """Fuse one measured position; older stamps than the newest are ignored."""
        dt = (stamp_ns - self.stamp_ns) * 1e-9
        if dt < 0.0:
            return
        q = self._accel_mps2**2
        position = add(self.position_n_m, scale(self.velocity_n_mps, dt))
        pp = self._pp + 2.0 * dt * self._pv + dt * dt * self._vv + q * dt**4 / 4.0
        pv = self._pv + dt * self._vv + q * dt**3 / 2.0
        vv = self._vv + q * dt * dt
        gain_p = pp / (pp + _MEASUREMENT_SIGMA_M**2)
        gain_v = pv / (pp + _MEASUREMENT_SIGMA_M**2)
        innovation = subtract(measured_n_m, position)
        self.position_n_m = add(position, scale(innovation, gain_p))
        self.velocity_n_mps = add(self.velocity_n_mps, scale(innovation, gain_v))
        self._pp, self._pv, self._vv = (1.0 - gain_p) * pp, (1.0 - gain_p) * pv, vv - gain_v * pv
        self.stamp_ns = self.seen_ns = stamp_ns


def point_in_camera(box: Box, z_m: float, camera: CameraModel) -> Vec3:
    """The point at a box's centre and a depth, in the camera frame (eq. target_backprojection)."""
    x, y = camera.ray(*box.center)
    return x * z_m, y * z_m, z_m


def to_local(point_c: Vec3, T_n_c: Pose) -> Vec3:
    """Camera coordinates to local NED."""
    north, east, down = T_n_c.apply(np.asarray(point_c)).tolist()
    return north, east, down


def acquire(
    view: View, T_n_c: Pose, camera: CameraModel, place_n_m: Vec3, radius_m: float
) -> tuple[Sighting, Vec3] | MissReason:
    """The object at a designated place: no farther from it than ``radius_m``, and clearly nearer than any other.

    Returns the sighting and its position in ``n``, or why there is none. A position estimate that is off by half the
    distance between two objects would make the wrong one the nearest: then neither is taken.
    """
    seen: list[tuple[float, Sighting, Vec3]] = []
    for detection in view.targets(None):
        if detection.score < MIN_SCORE:
            continue
        depth = view.depth(detection.box)
        if depth is None:
            continue
        position = place(detection.box, depth, camera, T_n_c, place_n_m[2])
        seen.append((norm(subtract(position, place_n_m)), Sighting(detection.box, depth), position))
    seen.sort(key=lambda item: item[0])
    if not seen or seen[0][0] > radius_m:
        return MissReason.NO_TARGET
    if len(seen) > 1 and seen[1][0] < _CLEARLY_NEARER * seen[0][0]:
        return MissReason.AMBIGUOUS_TARGET
    return seen[0][1], seen[0][2]


def follow(view: View, T_n_c: Pose, camera: CameraModel, track: TargetTrack) -> Sighting | MissReason:
    """Find the tracked object in a view and update the track.

    The object must be where the track predicts it, and clearly nearer to there than anything that looks alike. Where
    such a thing was seen beside it, the gate does not reach it, however long the object is missed; and an object that
    was out of sight for a while is taken again only when nothing else is about.
    Without depth, or with a range that is only estimated, it is taken to be as high as it was: so the drone keeps
    following while the frame is a miss, and does not follow a range that changes with the target's heading. A depth
    that puts it elsewhere on its ray is of something else, such as the other drone in front of it: that is no depth.
    """
    predicted_n, sigma_m = track.predict(view.stamp_ns)
    x, y, z = T_n_c.inverse().apply(np.asarray(predicted_n)).tolist()
    if z <= 0.1 or not camera.sees((x, y, z)):
        return MissReason.NO_TARGET
    u, v = camera.project_point((x, y, z))
    gate_m = track.gate_m(sigma_m, view.stamp_ns)
    px_per_m = camera.fx / z
    unseen = view.stamp_ns - track.stamp_ns > _UNSEEN_S * 1e9
    reach_px = px_per_m * (_UNSEEN_REACH_M if unseen else max(gate_m / _AMBIGUITY, _RIVAL_REACH_M))
    found = view.targets(Region(u - reach_px, v - reach_px, u + reach_px, v + reach_px))
    ranked = _by_distance(found, (u, v))
    if not ranked or math.dist(ranked[0].box.center, (u, v)) > px_per_m * gate_m:
        return MissReason.NO_TARGET
    chosen = ranked[0]
    if len(ranked) > 1:
        track.note_rival(_nearest_m(ranked, px_per_m), view.stamp_ns)
        if unseen or _nearly_as_near(ranked, (u, v)):
            return MissReason.AMBIGUOUS_TARGET
    depth = view.depth(chosen.box)
    if depth is not None:
        shown = to_local(point_in_camera(chosen.box, depth.z_m, camera), T_n_c)
        reach_m = _DEPTH_FLOOR_M + _DEPTH_SIGMAS * math.hypot(sigma_m, depth.sigma_m)
        depth = depth if math.dist(shown, predicted_n) <= reach_m else None
    if depth is None:
        measured = _at_height(chosen.box, camera, T_n_c, track.position_n_m[2])
    else:
        measured = place(chosen.box, depth, camera, T_n_c, track.position_n_m[2])
    if measured is not None:
        track.update(measured, view.stamp_ns)
    return Sighting(chosen.box, depth)


def place(box: Box, depth: Depth, camera: CameraModel, T_n_c: Pose, down_m: float) -> Vec3:
    """Returns the place of a box's object in ``n``: by its depth, or where its ray meets a height if that is better.

    Args:
        down_m: of the object, when it stands on the ground that the drone measures its own height from.
    """
    if depth.sigma_m > _COARSE_M:
        on_ground = _at_height(box, camera, T_n_c, down_m)
        if on_ground is not None:
            return on_ground
    return to_local(point_in_camera(box, depth.z_m, camera), T_n_c)


def _at_height(box: Box, camera: CameraModel, T_n_c: Pose, down_m: float) -> Vec3 | None:
    """Returns where the ray of a box's centre comes down to a height; None for a ray that hardly does."""
    x, y = camera.ray(*box.center)
    ray = T_n_c.R @ (x, y, 1.0)
    if ray[2] < _MIN_DESCENT:
        return None
    north, east, down = (T_n_c.t + (down_m - T_n_c.t[2]) / ray[2] * ray).tolist()
    return north, east, down


def _by_distance(found: Sequence[Detection], pixel: Pixel) -> list[Detection]:
    return sorted((d for d in found if d.score >= MIN_SCORE), key=lambda d: math.dist(d.box.center, pixel))


def _nearest_m(ranked: Sequence[Detection], px_per_m: float) -> float:
    """Returns the distance from the first detection to the nearest other one, m."""
    first, *others = (d.box.center for d in ranked)
    return min(math.dist(first, other) for other in others) / px_per_m


def _nearly_as_near(ranked: Sequence[Detection], pixel: Pixel) -> bool:
    """Returns whether the second detection might be the one expected at a pixel as well as the first."""
    first, second = (math.dist(d.box.center, pixel) for d in ranked[:2])
    return first > _AMBIGUITY * second

"""The viewpoint planner: where D2 must be to see marker and target, well and safely (section 3 of
the mission).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from flight.config import RendezvousConfig, SeparationConfig
from flight.rendezvous.common_ground import CommonGround
from flight.tilt import tilted
from path.arrays import Flags
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.values import frozen

Floats = NDArray[np.float64]

_DISTANCES = 17  # from the nearest to the farthest
# times the least separation
_NEAREST = 8.0 / 7.0
_FARTHEST = 16.0 / 7.0
_BEYOND = 1.18  # times the distance between the bodies that is asked for, where that is more
_AZIMUTHS_RAD = np.radians(np.arange(-70.0, 71.0, 10.0))
_ELEVATIONS_RAD = np.radians(np.arange(0.0, 61.0, 7.5))
_YAW_SHARES = (0.35, 0.5, 0.65)
_SAME_M = 1e-6
# Of what both cameras see: with less not every common view is found (``common_ground``); more than
# the second betters none.
LEAST_COMMON = 0.4
ENOUGH_COMMON = 0.6


@frozen
class ViewpointScene:
    """The planner's knowledge, in D1's heading frame ``h`` (forward, right, down), origin at the
    marker.
    """

    target_h_m: Floats  # (3,)
    marker_normal_h: Floats  # (3,), out of the print
    marker_side_m: float
    body_h_m: Floats  # (3,), middle of D1
    body_radius_m: float = 0.30
    target_radius_m: float = 0.25


@frozen
class Viewpoint:
    """A place for D2's camera in ``h``, the yaw relative to D1's heading, and what it gives.

    ``common``: share of the ground in both views, where that was asked for.
    """

    camera_h_m: tuple[float, float, float]
    yaw_h_rad: float
    marker_px: float
    incidence_rad: float
    margin_px: float
    common: float = 1.0


@frozen
class NoViewpoint:
    """No candidate survived; ``rejected`` counts them by the first rule each broke."""

    rejected: dict[str, int]

    def __str__(self) -> str:
        reasons = ", ".join(
            f"{name} {count}"
            for name, count in sorted(self.rejected.items(), key=lambda kv: -kv[1])
        )
        return f"no viewpoint: {reasons}"


def plan_viewpoint(
    scene: ViewpointScene,
    camera: CameraModel,
    T_b_c: Pose,
    rendezvous: RendezvousConfig,
    separation: SeparationConfig,
    tilt_h: Floats | None = None,
    ground: CommonGround | None = None,
) -> Viewpoint | NoViewpoint:
    """The best place for D2's camera among a grid around the marker.

    ``tilt_h`` is D2's body z axis in ``h`` while it hovers (unit, (3,)): wind tilts a drone, and
    with it a camera that is fixed to it. None: level.

    Rules, in this order: separation ellipsoid, air of the upper drone, marker size in the image,
    incidence on the marker, range to the target, not too near to it, marker and target inside the
    image with margin, D1's body not in front of the target. The best of the rest has the
    largest margin for its marker size. One that is nearer to the marker than
    ``separation.marker_m`` is taken only where there is no other, and then the farthest: two drones
    swing. With ``ground``, a place where common views do not carry the pose is taken only where
    there is no other, and then that with the most in common.
    """
    candidates = _candidates(separation)
    distance = np.linalg.norm(candidates, axis=1)
    to_marker = -candidates / distance[:, None]
    incidence = np.arccos(np.clip(-(to_marker @ scene.marker_normal_h), -1.0, 1.0))
    marker_px = 0.5 * (camera.fx + camera.fy) * scene.marker_side_m / distance
    to_body = scene.body_h_m - candidates
    horizontal = np.hypot(to_body[:, 0], to_body[:, 1])
    to_target = scene.target_h_m - candidates
    target_range = np.linalg.norm(to_target, axis=1)

    rules: list[tuple[str, Flags]] = [
        (
            "separation",
            (horizontal / separation.horizontal_m) ** 2
            + (to_body[:, 2] / separation.vertical_m) ** 2
            >= 1.0,
        ),
        ("too close", np.linalg.norm(to_body, axis=1) >= separation.viewpoint_m),
        ("downwash", beside_wash_m(to_body, separation, tilt_h) >= 0.0),
        ("marker too small", marker_px >= rendezvous.min_marker_px),
        ("too oblique", incidence <= math.radians(rendezvous.max_incidence_deg)),
        ("target too far", target_range <= rendezvous.max_range_m),
        ("target too near", target_range >= separation.minimum_m + scene.target_radius_m),
        ("target hidden by D1", _clear_of_body(to_body, to_target, scene)),
    ]
    alive = np.ones(len(candidates), dtype=bool)
    rejected: dict[str, int] = {}
    for name, passed in rules:
        rejected[name] = int(np.count_nonzero(alive & ~passed))
        alive &= passed
    if not alive.any():
        return NoViewpoint(rejected)

    places = candidates[alive]
    yaw, margin, R_h_c = _look(
        places,
        scene,
        camera,
        T_b_c,
        np.eye(3) if tilt_h is None else tilted(tilt_h),
    )
    # a wider margin is worth a smaller marker, up to what a drone swings in a gust
    score = np.minimum(margin, 150.0) + (2.0 * marker_px[alive] - 20.0 * incidence[alive])[:, None]
    score[margin < rendezvous.image_margin_px] = -np.inf
    most_m = np.max(distance[alive], where=np.isfinite(score).any(axis=1), initial=0.0)
    score[distance[alive] < min(separation.marker_m, most_m) - _SAME_M] = -np.inf
    common = np.ones_like(score)
    if ground is not None:
        common = ground.seen_by(camera, places, R_h_c)
        score += 0.5 * camera.width * np.minimum(common, ENOUGH_COMMON)
        most = np.max(common, where=np.isfinite(score), initial=0.0)
        score[common < min(LEAST_COMMON, most)] = -np.inf
    index, share = np.unravel_index(int(np.argmax(score)), score.shape)
    if not np.isfinite(score[index, share]):
        return NoViewpoint({**rejected, "not both in view": len(places)})
    forward, right, down = places[index].tolist()
    return Viewpoint(
        (forward, right, down),
        float(yaw[index, share]),
        float(marker_px[alive][index]),
        float(incidence[alive][index]),
        float(margin[index, share]),
        float(common[index, share]),
    )


def beside_wash_m(
    to_other: Floats, separation: SeparationConfig, tilt_h: Floats | None = None
) -> Floats:
    """Return how far the lower of two drones is outside of the upper one's air, shape (n,).

    The jet leans as a hovering drone does: it is thrown along its axis, and wind carries it on.

    Args:
        to_other: ways from this drone to the other, shape (n, 3), the third downward.
        tilt_h: body z axis of a drone that hovers in that wind, in the same frame; None: no wind.
    """
    below = np.abs(to_other[:, 2])
    to_lower = np.where(to_other[:, 2:] > 0.0, to_other[:, :2], -to_other[:, :2])
    lean = np.zeros(2) if tilt_h is None else separation.wash_lean * tilt_h[:2] / tilt_h[2]
    beside = np.linalg.norm(to_lower - below[:, None] * lean, axis=1)
    return beside - separation.wash_m - separation.wash_per_m * below


def farthest_m(separation: SeparationConfig) -> float:
    """Return the farthest from the marker that a viewpoint is looked for: it grows with the
    bodies.
    """
    return max(_FARTHEST * separation.minimum_m, _BEYOND * separation.viewpoint_m)


def _candidates(separation: SeparationConfig) -> Floats:
    """Return places behind and above the marker, shape (n, 3) in ``h``."""
    distances_m = np.linspace(_NEAREST * separation.minimum_m, farthest_m(separation), _DISTANCES)
    distance, azimuth, elevation = np.meshgrid(
        distances_m,
        _AZIMUTHS_RAD,
        _ELEVATIONS_RAD,
        indexing="ij",
    )
    level = distance * np.cos(elevation)
    places = np.stack(
        [-level * np.cos(azimuth), level * np.sin(azimuth), -distance * np.sin(elevation)], axis=-1
    )
    return places.reshape(-1, 3)


def _clear_of_body(
    to_body: Floats,
    to_target: Floats,
    scene: ViewpointScene,
) -> Flags:
    """Return whether D1's body leaves the line of sight to the whole target free."""
    body_range = np.linalg.norm(to_body, axis=1)
    target_range = np.linalg.norm(to_target, axis=1)
    cosine = np.sum(to_body * to_target, axis=1) / (body_range * target_range)
    apart = np.arccos(np.clip(cosine, -1.0, 1.0))
    return apart >= np.arctan2(scene.body_radius_m, body_range) + np.arctan2(
        scene.target_radius_m, target_range
    )


def _look(
    places_h: Floats,
    scene: ViewpointScene,
    camera: CameraModel,
    T_b_c: Pose,
    tilt: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Yaws between the bearings of marker and target, and the smaller margin (px) of the two, of
    shape (n, shares); and the camera's attitudes with them, (n, shares, 3, 3).

    The margin is minus infinity where one of them is behind the camera, or beyond the rim of the
    lens.
    """
    # (n, 2, 3) from the camera
    points_h = np.stack([np.zeros(3), scene.target_h_m])[None] - places_h[:, None]
    bearings = np.arctan2(points_h[:, :, 1], points_h[:, :, 0])
    turn = bearings[:, 1] - bearings[:, 0]
    turn = np.arctan2(np.sin(turn), np.cos(turn))
    yaw = bearings[:, :1] + turn[:, None] * np.array(_YAW_SHARES)
    c = np.cos(yaw)
    s = np.sin(yaw)
    zero = np.zeros_like(yaw)
    one = np.ones_like(yaw)
    R_level_b = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(
        *yaw.shape,
        3,
        3,
    )
    R_h_c = tilt @ R_level_b @ T_b_c.R
    points_c = np.einsum("nkji,nmj->nkmi", R_h_c, points_h)  # (n, shares, 2, 3)
    pixels = camera.project(points_c.reshape(-1, 3)).reshape(*points_c.shape[:-1], 2)
    radius = camera.fx * np.array([scene.marker_side_m, scene.target_radius_m]) / points_c[..., 2]
    left_top = pixels.min(axis=-1) - radius
    right_bottom = (
        np.minimum(camera.width - pixels[..., 0], camera.height - pixels[..., 1]) - radius
    )
    margin = np.minimum(left_top, right_bottom).min(axis=-1)
    # beyond its largest radius a lens folds what is outside back into the image
    off_axis = np.hypot(points_c[..., 0], points_c[..., 1])
    seen = np.all(
        (points_c[..., 2] > 0.1) & (off_axis <= camera.max_radius * points_c[..., 2]), axis=-1
    )
    return yaw, np.where(seen & np.isfinite(margin), margin, -np.inf), R_h_c

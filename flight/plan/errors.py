"""What a hand-over's geometry makes of the errors that last: how far D2's box of the target is off
D1's own. Pure.

D2 sees the target at a pixel, puts it at the depth that D1's point has for it, and maps it into
D1's image. What it is off there, across D1's line of sight at the target's depth, is a function
o(e) of small errors e that are drawn once: of D1's depth, of lens, mount and plate, of D2's pose,
of both boxes. To first order

    o = sum_s J_s e_s,    B = sum_s J_s C_s J_s^T,    J_s = do/de_s at 0

J is found by differences of the very chain (equations target_backprojection to bbox_rescaling of
the paper), C_s is what the rig states or the table of docs/errors.md has. For a body of k times the
size at k times the distance o is k times as large, as far as the errors themselves are angles or
shares.

The target's point, as D2 has it in its own camera, errs by D1's depth and mount, by D2's pose (its
angle with the whole way to the target for a lever), and by how the target moves in D1's frame,
which sways, until D2's frame is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from flight.plan.facts import Facts
from flight.plan.geometry import Layout
from flight.plan.ranging import lasting_m
from flight.rendezvous.viewpoint import Viewpoint
from path.arrays import Array
from path.geometry.transforms import Pose
from path.values import frozen

STEP = 1e-5  # of the differences: small against every error, large against rounding
# What docs/errors.md has for a careful crew where the rig states nothing.
FOCAL_SHARE = 0.002
CENTER_PX = 1.0
SIDE_SHARE = 0.0025
BOX_PX = 1.5
LASTING_CORNER_PX = 0.05
# of the same corners from frame to frame, as much as D2's filter leaves of it
CORNER_PX = 0.05
LATE_S = 0.005
MOUNT_DEG = 0.3
# of the target's diameter: the middle depth of its box against the surface in the box's middle
DEPTH_ON_BODY = 0.02
# from D1's frame to D2's, over which D2 carries the target on, and what of that it does not know
FORETOLD_S = 0.05
USUAL_SPEED = 0.6  # of the target's fastest
TILT_RAD = math.radians(4.7)  # of a correction; a camera that is fixed to the body tilts with it
BODY_SHARE = 0.05  # of the target's diameter, by which its box's middle differs from two sides
_LEAST_SLANT = math.radians(20.0)


@frozen
class Source:
    """One kind of error that lasts: its standard deviation per component, and what it adds to B,
    shape (2, 2), m^2.
    """

    name: str
    sigma: str
    adds: Array

    @property
    def sigma_m(self) -> float:
        """Return its standard deviation per axis across the line of sight, m."""
        return math.sqrt(0.5 * float(np.trace(self.adds)))


@frozen
class Predicted:
    """The predicted errors of a hand-over, m: how large D2's and the target's usually are (median)."""

    sources: tuple[Source, ...]
    receiver_m: float
    target_m: float

    @property
    def offset_sigma_m(self) -> float:
        """Return the standard deviation per axis of D2's box from D1's, at the target's depth."""
        return math.sqrt(0.5 * float(np.trace(self.offset_cov_m2)))

    @property
    def offset_cov_m2(self) -> Array:
        """Return its covariance, B, shape (2, 2)."""
        return np.sum([source.adds for source in self.sources], axis=0)


def predict(facts: Facts, placed: Layout) -> Predicted:
    """Predict the errors of a hand-over at a layout that has a viewpoint. Raises ValueError for one
    without.
    """
    if placed.T_h_c2 is None or not isinstance(placed.viewpoint, Viewpoint):
        raise ValueError("a layout without a viewpoint has no errors")
    chain = _Chain(facts, placed.target_h, placed.T_h_c2)
    pose = _pose_sigmas(facts, placed.viewpoint)
    method = facts.method
    span_m = facts.target.span_m
    focal1 = min(facts.sender.camera.fx, facts.sender.camera.fy)
    focal2 = min(facts.receiver.camera.fx, facts.receiver.camera.fy)
    mount_rad = math.radians(method.mount_sigma_deg)
    lag_m = LATE_S * facts.target.max_speed_mps
    z1_m = placed.range_m
    range_m = lasting_m(facts, z1_m, placed.target_h)
    sources = (
        chain.source("D1's range", 1, range_m, "m", chain.by_depth),
        chain.source("mount, place", 3, method.mount_sigma_m, "m", chain.by_mount),
        chain.source("mount, angle", 3, mount_rad, "rad", chain.by_mount_angle),
        chain.source("D2's pose, place", 3, pose.place_m, "m", chain.by_pose),
        chain.source("D2's pose, angle", 3, pose.angle_rad, "rad", chain.by_pose_angle),
        chain.source("D1's lens", 2, _lens_rad(focal1), "rad", chain.by_sight1),
        chain.source("D2's lens", 2, _lens_rad(focal2), "rad", chain.by_sight2),
        chain.source("D1's box", 2, BOX_PX / focal1, "rad", chain.by_sight1),
        chain.source("D2's box", 2, BOX_PX / focal2, "rad", chain.by_sight2),
        Source("body from two sides", f"{BODY_SHARE * span_m:.3g} m", _even(BODY_SHARE * span_m)),
        Source("stamps", f"{LATE_S * 1e3:g} ms", _even(lag_m)),
    )
    sways_rad_s = TILT_RAD / facts.drone.response_s
    moves_mps = USUAL_SPEED * facts.target.max_speed_mps + z1_m * sways_rad_s
    # each of the three axes in turn, along D1's line of sight first
    every = method.mount_sigma_m**2 + pose.place_m**2 + (FORETOLD_S * moves_mps) ** 2 / 3.0
    along = every + range_m**2 + (DEPTH_ON_BODY * span_m) ** 2
    turned_m = math.hypot(z1_m * math.radians(MOUNT_DEG), placed.receiver_range_m * pose.angle_rad)
    across = every + turned_m**2
    target_m = usual_m((along, across, across))
    return Predicted(sources, pose.camera_m, target_m)


@frozen
class _PoseSigmas:
    """Of the plate in D2's camera per axis, of its turn per axis, and of D2's camera in the plate's
    frame.
    """

    place_m: float
    angle_rad: float
    camera_m: float


def _pose_sigmas(facts: Facts, viewpoint: Viewpoint) -> _PoseSigmas:
    """Return the lasting uncertainty of D2's pose by the plate, per axis.

    Gravity bounds the turn about level axes; the turn about the vertical is read off the plate's
    foreshortening, the better the more it is slanted. The place errs by the plate's size, and by
    that turn times the distance.
    """
    distance_m = math.hypot(*viewpoint.camera_h_m)
    slant = max(viewpoint.incidence_rad, _LEAST_SLANT)
    turn_rad = LASTING_CORNER_PX / (viewpoint.marker_px * math.sin(slant))
    # corners and the other drone's gravity have their say too
    level_rad = facts.attitude_sigma_rad / 3.0
    angle_rad = math.sqrt((turn_rad**2 + 2.0 * level_rad**2) / 3.0)
    along_m = distance_m * math.hypot(SIDE_SHARE, LASTING_CORNER_PX / viewpoint.marker_px)
    place_m = along_m / math.sqrt(3.0)
    return _PoseSigmas(place_m, angle_rad, _camera_m(viewpoint, distance_m, slant, level_rad))


def _camera_m(viewpoint: Viewpoint, distance_m: float, slant: float, level_rad: float) -> float:
    """Return how large the error of D2's camera in the plate's frame usually is in a single frame.

    The turn about level axes is read off the plate too: of a large one better than off gravity.
    """
    corner = math.hypot(LASTING_CORNER_PX, CORNER_PX) / viewpoint.marker_px
    turn_rad = corner / math.sin(slant)
    both_rad = 1.0 / math.hypot(1.0 / turn_rad, 1.0 / max(level_rad, 1e-9))
    across = (turn_rad**2 + 2.0 * both_rad**2) / 3.0
    return distance_m * usual_m((SIDE_SHARE**2 + corner**2, across, across))


def usual_m(variances: tuple[float, ...]) -> float:
    """Return the median length of a vector whose components have these variances.

    Its square is about a gamma variable with the same mean and variance (Wilson and Hilferty 1931).
    """
    mean = sum(variances)
    if not mean > 0.0:
        return 0.0
    shape = mean**2 / (2.0 * sum(each**2 for each in variances))
    return math.sqrt(mean) * (1.0 - 1.0 / (9.0 * shape)) ** 1.5


def _lens_rad(focal_px: float) -> float:
    """Return the angle by which a careful calibration's centre and focal length put a ray off, near
    the axis.
    """
    return math.hypot(CENTER_PX / focal_px, 0.2 * FOCAL_SHARE)


def _even(sigma_m: float) -> Array:
    return sigma_m * sigma_m * np.eye(2)


class _Chain:
    """The chain of a pair from D1's depth to D2's box in D1's image, with one error at a time."""

    def __init__(self, facts: Facts, target_h: Array, T_h_c2: Pose) -> None:
        sender = facts.sender.mount
        self._T_v_c1 = sender.T_v_c
        T_h_v = sender.T_b_v
        self._T_c2_v = T_h_c2.inverse() @ T_h_v
        self._point_c1 = sender.T_b_c.inverse().apply(target_h)
        self._point_c2 = T_h_c2.inverse().apply(target_h)

    def source(
        self, name: str, size: int, sigma: float, unit: str, off: Callable[[Array], Array]
    ) -> Source:
        """Return what an error of ``size`` independent components adds to B."""
        jacobian = np.column_stack(
            [(off(STEP * axis) - off(-STEP * axis)) / (2.0 * STEP) for axis in np.eye(size)]
        )
        said = f"{math.degrees(sigma):.2g} deg" if unit == "rad" else f"{1e3 * sigma:.2g} mm"
        return Source(name, said, sigma * sigma * jacobian @ jacobian.T)

    def by_depth(self, error: Array) -> Array:
        """D1's depth is off, m."""
        z = float(self._point_c1[2])
        return self._offset(self._point_c1 * (1.0 + float(error[0]) / z))

    def by_mount(self, error: Array) -> Array:
        """The place of D1's camera against its plate is off, m."""
        return self._offset(self._point_c1, mount=Pose(self._T_v_c1.R, self._T_v_c1.t + error))

    def by_mount_angle(self, error: Array) -> Array:
        """Its angle is off, rad."""
        return self._offset(
            self._point_c1, mount=Pose(_turn(error) @ self._T_v_c1.R, self._T_v_c1.t)
        )

    def by_pose(self, error: Array) -> Array:
        """The place of the plate, as D2 has it, is off, m."""
        return self._offset(self._point_c1, pose=Pose(self._T_c2_v.R, self._T_c2_v.t + error))

    def by_pose_angle(self, error: Array) -> Array:
        """Its angle is off, rad."""
        return self._offset(
            self._point_c1, pose=Pose(_turn(error) @ self._T_c2_v.R, self._T_c2_v.t)
        )

    def by_sight1(self, error: Array) -> Array:
        """D1's ray to the target is off, rad right and down."""
        z = float(self._point_c1[2])
        return self._offset(self._point_c1 + z * np.array([error[0], error[1], 0.0]))

    def by_sight2(self, error: Array) -> Array:
        """D2's ray to the target is off, rad right and down."""
        return self._offset(self._point_c1, sight2=(float(error[0]), float(error[1])))

    def _offset(
        self,
        point_c1: Array,
        *,
        mount: Pose | None = None,
        pose: Pose | None = None,
        sight2: tuple[float, float] = (0.0, 0.0),
    ) -> Array:
        """Return D2's box, mapped into D1's image, from D1's own: m at the target's depth, shape
        (2,).
        """
        T_v_c1 = mount or self._T_v_c1
        T_c2_v = pose or self._T_c2_v
        depth2_m = float(T_c2_v.apply(T_v_c1.apply(point_c1))[2])
        ray2 = self._point_c2[:2] / self._point_c2[2] + np.array(sight2)
        mapped_c2 = depth2_m * np.array([ray2[0], ray2[1], 1.0])
        mapped_c1 = T_v_c1.inverse().apply(T_c2_v.inverse().apply(mapped_c2))
        return point_c1[2] * (mapped_c1[:2] / mapped_c1[2] - point_c1[:2] / point_c1[2])


def _turn(error: Array) -> Array:
    """Return a small rotation, to first order."""
    x, y, z = error.tolist()
    return np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])

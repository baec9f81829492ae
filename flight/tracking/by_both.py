"""D2's target by both drones' views: what its own track begins with, and what the log says of the
target's place.

Called with each answer that has been sent. Nothing of it goes back into an answer:
``path.target.both_views`` says why.
"""

from __future__ import annotations

import math

import numpy as np

from flight.guidance import Vec3
from flight.tracking.ranging import COARSE
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior
from path.geometry.rigid import rigid
from path.geometry.transforms import Matrix, Pose, Vector
from path.observations import Box, Depth, RangeSource
from path.target.both_views import BothViews, Sighted, triangulate, with_range
from path.target.cylinder import behind_m, middle_v, off_middle
from path.target.place import across_sigma
from path.target.range import DEPTH_SHARE, Body
from path.values import value

BODY_SHARE = 0.05  # of its span, by which the middle of a body's box differs from its cylinder's
AVERAGED = 50  # frames
CENTER_PX = 1.0  # of a calibrated lens (docs/errors.md)


@value
class ByBoth:
    """The target by both views.

    Attributes:
        depth: of its surface on D2's line of sight, for D2's own track.
        point_v_m: as D1 means it, in the marker's frame; ``sigma_m`` its standard deviation where
            it is the least sure.
        chi2: of D2's line of sight against D1's point; ``agree``: that is believed.
    """

    depth: Depth
    point_v_m: Vec3
    sigma_m: float
    chi2: float
    agree: bool


class FromBothViews:
    """D2's reckoning, for one leg. ``T_v_c1``: the mounting of D1's camera; ``sender``: that
    camera, ``own``: D2's.

    What D2's own range is off D1's is mostly what both depth cameras are wrong by in scale, which
    lasts: it is averaged, and the noise of single frames with it.
    """

    def __init__(
        self,
        method: MethodConfig,
        sender: CameraModel,
        T_v_c1: Pose,
        own: CameraModel,
    ) -> None:
        self._method = method
        self._sender = sender
        self._T_v_c1 = T_v_c1
        self._own = own
        self._body = Body(method.evidence.span_m, method.evidence.height_m)
        # D2's own range less that by D1, and of how many frames that is the mean
        self._off_m = 0.0
        self._frames = 0

    def place(
        self,
        prior: Prior,
        point_sigma_m: float,
        pose: Matrix,
        gravity_c: Vec3,
        box: Box,
        depth: Depth | None,
    ) -> ByBoth:
        """Return the target's place in a frame of D2.

        Args:
            prior: of the frame, with D1's point and D2's pose; ``pose``: (6, 6), that pose's
                covariance.
            point_sigma_m: what D1 says of its point.
            gravity_c: unit vector of gravity in D2's camera frame.
            box, depth: D2's own of the target.
        """
        T_c_v = Pose(np.array(prior.T_c2_v[:9]).reshape(3, 3), np.array(prior.T_c2_v[9:]))
        surface_c = T_c_v.apply(np.array(prior.point_v_m))
        middle_c = self._middle(surface_c, T_c_v, gravity_c)
        said = self._said(point_sigma_m, T_c_v, surface_c, middle_c, pose)
        x, y = self._own.ray(*box.center)
        sight = self._to_middle((x, y, 1.0), float(middle_c[2]), gravity_c)
        both = triangulate(said, sight, self._ray_sigma_rad(float(np.linalg.norm(middle_c))))
        behind = self._behind(sight, gravity_c)
        if depth is not None:
            both = self._with_own(both, sight, depth, behind)
        length = math.hypot(*sight)
        z_m, lasting_m = both.along(sight)
        sigma_m = math.hypot(lasting_m, point_sigma_m)  # D1's noise of this frame is still in it
        surface_z_m = max(z_m - behind / length, 0.5 * z_m)
        moved_v = T_c_v.R.T @ (both.point_c - middle_c)
        vx, vy, vz = (np.array(prior.point_v_m) + moved_v).tolist()
        source = RangeSource.VIEWS
        if depth is not None and depth.sigma_m < sigma_m:
            source = depth.source
        return ByBoth(
            Depth(surface_z_m, sigma_m, source),
            (vx, vy, vz),
            math.hypot(both.sigma_m, point_sigma_m),
            both.chi2,
            both.agree,
        )

    def _said(
        self,
        point_sigma_m: float,
        T_c_v: Pose,
        surface_c: Vector,
        middle_c: Vector,
        pose: Matrix,
    ) -> Sighted:
        """Return D1's word. Its one standard deviation is the range's, mostly: across it pixels and
        mount are known.
        """
        eye_c = T_c_v.apply(self._T_v_c1.t)
        from_eye_c = surface_c - eye_c
        distance_m = float(np.linalg.norm(from_eye_c))
        across_m = math.hypot(
            across_sigma(self._sender, distance_m, self._method), self._method.mount_sigma_m
        )
        # Of a range that is measured what lasts counts against what lasts of D2's own; its noise is
        # averaged below.
        measured = point_sigma_m <= COARSE * distance_m
        along_m = DEPTH_SHARE * distance_m if measured else point_sigma_m
        own_m = self._of_body()
        return Sighted(
            middle_c,
            from_eye_c,
            middle_c - T_c_v.t,
            along_m,
            math.hypot(across_m, own_m),
            pose,
        )

    def _of_body(self) -> float:
        """Return by how much the two cameras mean different points of the body, m."""
        return (
            BODY_SHARE * self._body.span_m
            if self._body.known
            else self._method.target_center_sigma_m
        )

    def _middle(
        self,
        surface_c: Vector,
        T_c_v: Pose,
        gravity_c: Vec3,
    ) -> Vector:
        """Return the middle of the body that D1 has that point of."""
        if not self._body.known:
            return surface_c
        x, y, z = surface_c.tolist()
        T_c2_c1 = rigid(T_c_v @ self._T_v_c1)
        return np.array(
            middle_v(T_c2_c1, (x, y, z), gravity_c, self._body.span_m, self._body.height_m)
        )

    def _to_middle(
        self,
        ray_c: Vec3,
        z_m: float,
        gravity_c: Vec3,
    ) -> Vec3:
        """Return the line of sight to the body's middle, from that to its box's, per metre of
        depth.
        """
        if not self._body.known:
            return ray_c
        x, y, _ = ray_c
        point_c = x * z_m, y * z_m, z_m
        off_x, off_y, _ = off_middle(point_c, gravity_c, self._body.span_m, self._body.height_m)
        return x - off_x / z_m, y - off_y / z_m, 1.0

    def _behind(self, sight: Vec3, gravity_c: Vec3) -> float:
        """Return how far the body's middle is behind its surface, along D2's line of sight."""
        if not self._body.known:
            return 0.0
        falling = sum(a * b for a, b in zip(sight, gravity_c, strict=True)) / math.hypot(*sight)
        return behind_m(falling, self._body.span_m, self._body.height_m)

    def _ray_sigma_rad(self, distance_m: float) -> float:
        """Return the standard deviation of D2's line of sight: pixels, lens, and the body."""
        pixels = math.hypot(self._method.pixel_sigma_px, CENTER_PX) / min(
            self._own.fx, self._own.fy
        )
        return math.hypot(pixels, self._of_body() / distance_m)

    def _with_own(
        self,
        both: BothViews,
        sight: Vec3,
        depth: Depth,
        behind: float,
    ) -> BothViews:
        """Add D2's own range."""
        length = math.hypot(*sight)
        by_other_m = length * both.along(sight)[0]
        measured = depth.source is RangeSource.DEPTH
        noise_m, lasting_m = (
            (depth.sigma_m, DEPTH_SHARE * depth.z_m) if measured else (0.0, depth.sigma_m)
        )
        self._frames = min(self._frames + 1, AVERAGED)
        self._off_m += (length * depth.z_m + behind - by_other_m - self._off_m) / self._frames
        sigma_m = length * math.hypot(noise_m / math.sqrt(self._frames), lasting_m)
        return with_range(
            both,
            sight,
            by_other_m + self._off_m,
            math.hypot(sigma_m, self._of_body()),
        )

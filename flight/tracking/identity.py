"""Whether the box that a drone follows is of the designated object: ``path.belief`` fed by what a
camera shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.interfaces import View
from flight.config import MissionConfig
from flight.guidance import Vec3
from flight.tracking.largest_box import LargestBox
from flight.tracking.objects import CUT_SCORE, MIN_SCORE, cut_sides
from path.belief.boxes import Measured
from path.belief.motion import Array, Motion, along_ray
from path.belief.objects import Belief
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box, Detection, Region, common_area
from path.target.range import LEAST_DESCENT

BOX_SIGMA_PX = 1.5
"""Noise of a box's middle; twice that of its sides."""
_ON_BODY = 0.1
"""Of a box's larger side: how far from the object's middle its depth is taken, from frame to
frame.
"""
_BY_HEIGHT = 0.1
_UNKNOWN = 0.3
"""Of a distance: the error of one by the height of the ground, and of one that is taken to be as it
was.
"""
_ELSEWHERE = 0.01
"""The number of boxes of a frame that are of nothing known: inventions, and what comes into
view.
"""
_NEWCOMERS_HZ = 0.05
"""The number of objects that come into view in a second."""
_POOR = 10.0
"""Times as many are among boxes with a low score."""
_AROUND = 3.0
"""Standard deviations of a known object's place, and times half its size: there it is looked
for.
"""
LEAST_IDENTITY = 0.9
"""Nothing is offered that is the designated object with a lower probability
(docs/decisions/0215).
"""


class Identity:
    """The belief of one drone over what is around the object that it follows. One instance for one
    track.
    """

    def __init__(self, mission: MissionConfig, largest: LargestBox | None) -> None:
        self._wander_rad = math.radians(mission.attitude_wander_deg)
        self._accel_mps2 = mission.follow.target_accel_mps2
        self._flies = mission.target.flies
        self._largest = largest
        self.belief: Belief | None = None
        self._boxes: list[Box] = []

    def region(self, own: Region | None, T_n_c: Pose, camera: CameraModel) -> Region | None:
        """Return a region with everything in it that is known to be in view: what is lost from
        sight is mistaken.

        Args:
            own: where the followed object is looked for; None when that is outside the image.
        """
        whole = own
        T_c_n = T_n_c.inverse()
        for track in () if self.belief is None else self.belief.tracks:
            x, y, z = T_c_n.apply(track.motion.place_m).tolist()
            if not (track.confirmed and z > 0.0 and camera.sees((x, y, z))):
                continue
            u, v = camera.project_point((x, y, z))
            sigma_m = math.sqrt(float(np.trace(track.motion.place_covariance_m2)) / 3.0)
            side_px = float(np.max(np.exp(track.log_sides))) * camera.fx / z
            half_px = _AROUND * (sigma_m * camera.fx / z + 0.5 * side_px)
            around = Region(u - half_px, v - half_px, u + half_px, v + half_px, side_px=side_px)
            whole = around if whole is None else _both(whole, around)
        return whole

    def note(
        self,
        view: View,
        T_n_c: Pose,
        camera: CameraModel,
        region: Region,
        found: Sequence[Detection],
        expected: tuple[Vec3, float],
    ) -> None:
        """Take in what the detector found in a region.

        Args:
            expected: the followed object's place in the local frame, and its depth.
        """
        seen = [
            each
            for each in found
            if each.score >= CUT_SCORE and each.box.w > 0.0 and each.box.h > 0.0
        ]
        place_n, z_m = expected
        measured = [self._measured(view, T_n_c, camera, each, place_n[2], z_m) for each in seen]
        self._boxes = [each.box for each in seen]
        if self.belief is None:
            if not measured:
                return
            place = np.asarray(place_n)
            nearest = min(measured, key=lambda each: float(np.linalg.norm(each.place_m - place)))
            self.belief = Belief(self._accel_mps2, flies=self._flies)
            self.belief.designate(place, nearest, view.stamp_ns)

        T_c_n = T_n_c.inverse()

        def sees(place_m: Array) -> bool:
            x, y, z = T_c_n.apply(place_m).tolist()
            return (
                z > 0.0
                and camera.sees((x, y, z))
                and region.contains(*camera.project_point((x, y, z)))
            )

        self.belief.update(measured, sees, view.stamp_ns)

    def carry(self, place_n: Vec3, stamp_ns: int) -> None:
        """Take in where the followed object's depth is, in a frame without a box of it."""
        if self.belief is not None:
            self.belief.carry(np.asarray(place_n), stamp_ns)

    def of(self, box: Box) -> float:
        """Return the probability that a box of the newest frame is of the designated object."""
        column = self._column(box)
        return 0.0 if self.belief is None or column is None else self.belief.identity_of(column)

    def is_other(self, box: Box) -> bool:
        """Return whether a box of the newest frame is of an object that is surely not the
        designated one.
        """
        column = self._column(box)
        track = None if self.belief is None or column is None else self.belief.track_of(column)
        if self.belief is None or track is None or not track.confirmed:
            return False
        return self.belief.probability(track.number) <= 1.0 - LEAST_IDENTITY

    @property
    def stated(self) -> tuple[Box, float] | None:
        """Return the likeliest object's own box in the newest frame, and the probability that it is
        the designated one.

        None where the frame does not show it, or not alone.
        """
        belief = self.belief
        likeliest = None if belief is None else belief.likeliest
        if belief is None or likeliest is None:
            return None
        own = (
            box for column, box in enumerate(self._boxes) if belief.track_of(column) is likeliest
        )
        box = next(own, None)
        return None if box is None else (box, belief.probability(likeliest.number))

    def shown(self, least: float) -> Motion | None:
        """Return where the object is, by the newest frame, that is the designated one with at least
        that probability; None where the frame does not show it.
        """
        stated = self.stated
        if self.belief is None or stated is None or stated[1] < least:
            return None
        likeliest = self.belief.likeliest
        return None if likeliest is None else likeliest.motion

    def _column(self, box: Box) -> int | None:
        shared = [
            (common_area(box, each) / max(each.area, box.area), k)
            for k, each in enumerate(self._boxes)
        ]
        most, column = max(shared, default=(0.0, -1))
        return column if most > 0.0 else None

    def _measured(
        self,
        view: View,
        T_n_c: Pose,
        camera: CameraModel,
        detection: Detection,
        down_m: float,
        expected_z_m: float,
    ) -> Measured:
        box = detection.box
        x, y = camera.ray(*box.center)
        depth = view.depth(box)
        if depth is not None:
            z_m = depth.z_m
            along_m = depth.sigma_m
        else:
            sinking = float(T_n_c.R[2] @ (x, y, 1.0))
            fall_m = down_m - float(T_n_c.t[2])
            if sinking > LEAST_DESCENT and fall_m > 0.0:
                z_m = fall_m / sinking
                along_m = _BY_HEIGHT * z_m
            else:
                z_m = expected_z_m
                along_m = _UNKNOWN * expected_z_m
        wide_m = float(box.w) * z_m / camera.fx  # detectors say float32
        high_m = float(box.h) * z_m / camera.fy
        along_m = math.hypot(along_m, _ON_BODY * max(wide_m, high_m))
        across = math.hypot(BOX_SIGMA_PX / min(camera.fx, camera.fy), self._wander_rad) * z_m
        ray = T_n_c.R @ (x, y, 1.0)
        covariance = along_ray(ray, across**2, along_m**2)
        most = (
            (math.inf, math.inf) if self._largest is None else self._largest.most_m(box, z_m, T_n_c)
        )
        share = _ELSEWHERE * (1.0 if detection.score >= MIN_SCORE else _POOR)
        view_m3 = camera.width * camera.height * z_m**3 / (camera.fx * camera.fy)
        side_sigma = math.hypot(2.0 * BOX_SIGMA_PX / max(1.0, min(box.w, box.h)), along_m / z_m)
        left, right = cut_sides(box.x, box.w, camera.width)
        top, bottom = cut_sides(box.y, box.h, camera.height)
        place = T_n_c.apply(np.array((x * z_m, y * z_m, z_m)))
        return Measured(
            place_m=place, covariance_m2=covariance, eye_m=T_n_c.t, axes=T_n_c.R, sides_m=(wide_m, high_m),
            side_sigma=side_sigma, most_m=most, elsewhere_m3=share / view_m3, newcomers_m3_s=_NEWCOMERS_HZ / view_m3,
            cut_edges=((left, top), (right, bottom)),
        )  # fmt: skip


def _both(a: Region, b: Region) -> Region:
    x0 = min(a.x0, b.x0)
    y0 = min(a.y0, b.y0)
    side_px = a.side_px or b.side_px
    return Region(x0, y0, max(a.x1, b.x1), max(a.y1, b.y1), side_px=side_px)

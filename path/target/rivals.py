"""The objects that D1 sees beside its target: D2's box could be of one of them, and lies at a distance from each.

D2's box gives a line of sight. Where that passes the target, at the target's depth, it is some way off D1's own box;
where it passes another object, at that one's depth, some way off that one's. Both are offsets in D1's image, in metres
at the depth of what they are measured from. Where the middle of a box lies on a body, as each camera sees it, is
reckoned with when the rig states the body's size (``path.target.cylinder``). Errors that last (calibration, mounts,
attitude, what a body differs from its cylinder) move both alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import TwoViews, depth_in, map_box
from path.gate.window import Offset, Offsets
from path.geometry.rigid import Rigid, transform, transform_back
from path.messages import Vec3
from path.observations import Box, Depth
from path.target.cylinder import box_middle_v, middle_v
from path.target.place import back_project, locate

SAME_M = 0.15
"""Two sightings that are nearer to each other than that are of one object."""
MOST, REMEMBERED = 3, 8
"""The numbers of those told of and of those remembered: the nearest ones."""
SEEN_TIMES = 3
"""One that was seen less often may be nothing: detectors invent, but hardly ever several times in the same place."""
_LEAST_DESCENT = 0.1  # of a line of sight towards the target's level, per metre of depth


@dataclass(frozen=True, slots=True)
class Rival:
    """Another object that looks like the target, as D1 sees it.

    ``depth``: over its box; None where there is none, then it is taken to be as high as the target.
    """

    box: Box
    depth: Depth | None = None


@dataclass(frozen=True, slots=True)
class _Beside:
    """One of them against the target in the same frame: pixels of the centre, depth and place in ``v``, in m."""

    stamp_ns: int
    du: float
    dv: float
    dz: float
    dpoint: Vec3
    times: int = 1


def placed(mapped: Box, own: Box, offset_m: Offset, z_m: float, camera: CameraModel) -> Box:
    """D2's box in D1's image, as far off D1's own as the target's middle is, instead of the middles of the boxes.

    Args:
        offset_m: of D2's box from the target (``Rivals.offsets``).
        z_m: the target's distance along D1's optical axis.
    """
    u, v = own.center
    left = u + offset_m[0] * camera.fx / z_m - 0.5 * mapped.w
    top = v + offset_m[1] * camera.fy / z_m - 0.5 * mapped.h
    return Box(left, top, mapped.w, mapped.h)


class Rivals:
    """The objects beside the target that D1 saw in its last frames. One instance for one attempt."""

    def __init__(self, views: TwoViews, config: MethodConfig) -> None:
        self._views, self._config = views, config
        self._remember_ns = round(config.evidence.rival_s * 1e9)
        self._beside: list[_Beside] = []

    def note(
        self, stamp_ns: int, own: Box, z_m: float, point_v: Vec3, gravity_v: Vec3, rivals: Sequence[Rival]
    ) -> None:
        """A frame of D1 that shows the target, and what else it shows."""
        if not (rivals or self._beside):
            return
        seen: list[_Beside] = []
        u, v = own.center
        for rival in rivals:
            place = self._place(rival, z_m, point_v, gravity_v)
            if place is not None:
                (x, y, z), z1 = place
                there = x - point_v[0], y - point_v[1], z - point_v[2]
                seen.append(_Beside(stamp_ns, rival.box.center[0] - u, rival.box.center[1] - v, z1 - z_m, there))
        known = [old for old in self._beside if stamp_ns - old.stamp_ns <= self._remember_ns]
        for k, new in enumerate(seen):
            old = min(known, key=lambda each: math.dist(each.dpoint, new.dpoint), default=None)
            if old is not None and math.dist(old.dpoint, new.dpoint) <= SAME_M:
                known.remove(old)
                seen[k] = replace(new, times=old.times + 1)
        seen += known
        seen.sort(key=lambda each: math.hypot(*each.dpoint))
        self._beside = seen[:REMEMBERED]

    def offsets(self, T_v_c2: Rigid, box2: Box, own: Box, z_m: float, point_v: Vec3, gravity_v: Vec3) -> Offsets | None:
        """The distances of D2's box from the target and from each object beside it; None when they cannot be told.

        Args:
            own, z_m, point_v, gravity_v: D1's target at D2's capture instant.
        """
        target = self._offset(T_v_c2, box2, own.center, z_m, point_v, gravity_v)
        if target is None:
            return None
        u, v = own.center
        others: list[Offset] = []
        for each in [each for each in self._beside if each.times >= SEEN_TIMES][:MOST]:
            there = point_v[0] + each.dpoint[0], point_v[1] + each.dpoint[1], point_v[2] + each.dpoint[2]
            offset = self._offset(T_v_c2, box2, (u + each.du, v + each.dv), z_m + each.dz, there, gravity_v)
            if offset is not None:
                others.append(offset)
        return Offsets(target, tuple(others))

    def _offset(
        self, T_v_c2: Rigid, box2: Box, center: tuple[float, float], z_m: float, point_v: Vec3, gravity_v: Vec3
    ) -> Offset | None:
        stated = self._config.evidence
        if stated.span_m > 0.0:
            return self._offset_of_stated(T_v_c2, box2, point_v, gravity_v, stated.span_m, stated.height_m)
        z2 = depth_in(T_v_c2, point_v)
        mapped = map_box(self._views, T_v_c2, box2, (z_m, z2), "center") if z2 > 0.0 and z_m > 0.0 else None
        if mapped is None:
            return None
        u, v = mapped.center
        camera = self._views.camera1
        return (u - center[0]) * z_m / camera.fx, (v - center[1]) * z_m / camera.fy

    def _offset_of_stated(
        self, T_v_c2: Rigid, box2: Box, point_v: Vec3, gravity_v: Vec3, span_m: float, height_m: float
    ) -> Offset | None:
        """The middle of D2's box against where it is of a body of that size with this point in D1's box's middle."""
        T_v_c1 = self._views.T_v_c1
        middle = middle_v(T_v_c1, point_v, gravity_v, span_m, height_m)
        expected = box_middle_v(T_v_c2, middle, gravity_v, span_m, height_m)
        z2 = depth_in(T_v_c2, expected)
        seen = transform(T_v_c2, back_project(self._views.camera2, *box2.center, z2))
        (x, y, z), (xe, ye, ze) = transform_back(T_v_c1, seen), transform_back(T_v_c1, expected)
        if not (z2 > 0.0 and z > 0.0 and ze > 0.0):  # also when the pixel has no ray
            return None
        return x * ze / z - xe, y * ze / z - ye

    def _place(self, rival: Rival, z_m: float, point_v: Vec3, gravity_v: Vec3) -> tuple[Vec3, float] | None:
        """A rival's place in ``v``, and its depth; None when its pixel has no ray."""
        views, config = self._views, self._config
        depth = rival.depth
        if depth is not None and config.min_depth_m <= depth.z_m <= config.max_depth_m:
            found = locate(views.camera1, views.T_v_c1, rival.box, depth, config)
            return (found.point_v_m, depth.z_m) if math.isfinite(sum(found.point_v_m)) else None
        ray_c = back_project(views.camera1, *rival.box.center, 1.0)
        if not math.isfinite(ray_c[0] + ray_c[1]):
            return None
        eye = transform(views.T_v_c1, (0.0, 0.0, 0.0))
        ahead = transform(views.T_v_c1, ray_c)
        ray = ahead[0] - eye[0], ahead[1] - eye[1], ahead[2] - eye[2]
        sinking = sum(a * b for a, b in zip(ray, gravity_v, strict=True))
        if sinking > _LEAST_DESCENT:
            z = sum((p - e) * g for p, e, g in zip(point_v, eye, gravity_v, strict=True)) / sinking
        else:
            z = z_m
        if not z > 0.0:
            return None
        return (eye[0] + z * ray[0], eye[1] + z * ray[1], eye[2] + z * ray[2]), z

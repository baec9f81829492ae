"""The objects that D1 sees beside its target: D2's box could be of one of them, and lies at a
distance from each.

D2's box gives a line of sight. Where that passes the target, at the target's depth, it is some way
off D1's own box; where it passes another object, at that one's depth, some way off that one's. Both
are offsets in D1's image, in metres at the depth of what they are measured from. Where the middle
of a box lies on a body, as each camera sees it, is reckoned with when the rig states the body's
size (``path.target.cylinder``). Errors that last (calibration, mounts, attitude, what a body
differs from its cylinder) move both alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from path.config import MethodConfig
from path.gate.agreement import TwoViews, plain_box
from path.gate.kernels import offset
from path.gate.window import Offset, Offsets
from path.geometry.rigid import Rigid, transform
from path.messages import Vec3
from path.observations import Box, Depth
from path.target.place import back_project, locate
from path.timeline import Values
from path.values import value

SAME_M = 0.15
"""Two sightings that are nearer to each other than that are of one object."""
MOST = 3
REMEMBERED = 8
"""The numbers of those told of and of those remembered: the nearest ones."""
SEEN_TIMES = 3
"""One that was seen less often may be nothing: detectors invent, but hardly ever several times in
the same place.
"""
_LEAST_DESCENT = 0.1  # of a line of sight towards the target's level, per metre of depth


@value
class Rival:
    """Another object that looks like the target, as D1 sees it.

    ``depth``: over its box; None where there is none, then it is taken to be as high as the target.
    """

    box: Box
    depth: Depth | None = None


@value
class _Beside:
    """One of them against the target in the same frame.

    Pixels of the centre, depth and place in ``v``, in m.
    """

    stamp_ns: int
    du: float
    dv: float
    dz: float
    dpoint: Vec3
    times: int = 1


class Rivals:
    """The objects beside the target that D1 saw in its last frames.

    One instance for one attempt.
    """

    def __init__(self, views: TwoViews, config: MethodConfig) -> None:
        self._views = views
        self._config = config
        self._body = config.evidence.span_m, config.evidence.height_m
        self._remember_ns = round(config.evidence.rival_s * 1e9)
        self._beside: list[_Beside] = []

    def note(
        self,
        stamp_ns: int,
        own: Box,
        z_m: float,
        point_v: Vec3,
        gravity_v: Vec3,
        rivals: Sequence[Rival],
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
                beside_u, beside_v = plain_box(rival.box).center
                seen.append(_Beside(stamp_ns, beside_u - u, beside_v - v, z1 - z_m, there))
        known = [old for old in self._beside if stamp_ns - old.stamp_ns <= self._remember_ns]
        for k, new in enumerate(seen):
            old = min(known, key=lambda each: math.dist(each.dpoint, new.dpoint), default=None)
            if old is not None and math.dist(old.dpoint, new.dpoint) <= SAME_M:
                known.remove(old)
                seen[k] = replace(new, times=old.times + 1)
        seen += known
        seen.sort(key=lambda each: math.hypot(*each.dpoint))
        self._beside = seen[:REMEMBERED]

    @property
    def known(self) -> bool:
        """Return whether there is anything beside the target."""
        return bool(self._beside)

    def offsets(
        self,
        target_m: Offset,
        T_v_c2: Rigid,
        box2: Box,
        own: Box,
        place: Values,
    ) -> Offsets:
        """The distances of D2's box from the target, as given, and from each object beside it.

        Args:
            own, place: D1's target at D2's capture instant, and its sample then
                (``path.gate.kernels.Own``).
        """
        (u, v), (x, y, z), z_m, gravity_v = own.center, place[4:7], place[7], place[9:12]
        box = box2.x, box2.y, box2.w, box2.h
        others: list[Offset] = []
        for each in [each for each in self._beside if each.times >= SEEN_TIMES][:MOST]:
            there = x + each.dpoint[0], y + each.dpoint[1], z + each.dpoint[2]
            center = u + each.du, v + each.dv
            dx, dy = offset(
                self._views.numbers,
                self._body,
                T_v_c2,
                box,
                center,
                z_m + each.dz,
                there,
                gravity_v,
            )
            if not math.isnan(dx):
                others.append((dx, dy))
        return Offsets(target_m, tuple(others))

    def _place(
        self,
        rival: Rival,
        z_m: float,
        point_v: Vec3,
        gravity_v: Vec3,
    ) -> tuple[Vec3, float] | None:
        """A rival's place in ``v``, and its depth; None when its pixel has no ray."""
        views = self._views
        config = self._config
        depth = rival.depth
        if depth is not None and config.min_depth_m <= depth.z_m <= config.max_depth_m:
            found = locate(views, plain_box(rival.box), depth, config)
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

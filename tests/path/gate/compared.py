"""A box of D2 held against D1's target, as a candidate would bring it."""

from __future__ import annotations

from path.config import MethodConfig
from path.gate.agreement import Comparer, Comparison, TwoViews
from path.geometry.rotation import quat_from_R
from path.geometry.transforms import Pose
from path.messages import Candidate, Vec3
from path.observations import Box
from path.timeline import Values


def own_values(box: Box, z_m: float, point_v: Vec3, gravity_v: Vec3 = (0.0, 0.0, 1.0)) -> Values:
    """D1's sample of its target."""
    return (box.x, box.y, box.w, box.h, *point_v, z_m, 0.01, *gravity_v, 0.0)


def compared(
    views: TwoViews, T_v_c2: Pose, own: Values, box2: Box, config: MethodConfig
) -> Comparison:
    x, y, z = T_v_c2.t.tolist()
    candidate = Candidate(1, 1, 1, 0, 0, 0, box2, None, (x, y, z), quat_from_R(T_v_c2.R), 0.01)
    return Comparer(views, config).compare(own, candidate, box2)

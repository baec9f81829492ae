"""Taking one object for the target that an operator designated."""

from __future__ import annotations

import math

from drivers.interfaces import View
from flight.config import Designated
from flight.guidance import Vec3
from flight.tracking.association import Sighting, acquire
from flight.tracking.largest_box import LargestBox
from flight.tracking.objects import MIN_SCORE
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, MissReason, common_area

STEADY_FRAMES = 5
STEADY_M = 0.25
ROOM = 0.2  # of the image, at each side
INSIDE = 0.9  # of a box that is in another one


class Acquisition:
    """Takes the object at the designated place for the target once it was seen there alone in several frames.

    ``ambiguous``: in the newest frame there were two that it can be.
    """

    def __init__(self, camera: CameraModel, method: MethodConfig) -> None:
        self._camera, self._largest = camera, LargestBox.of(camera, method)
        self._steady: list[Vec3] = []
        self.ambiguous = False

    def look(self, view: View, T_n_c: Pose, designated: Designated) -> Vec3 | None:
        """Returns the target's position in ``n`` when this frame makes it sure."""
        found = acquire(view, T_n_c, self._camera, designated)
        self.ambiguous = found is MissReason.AMBIGUOUS_TARGET
        if isinstance(found, MissReason) or not (
            self._well_inside(found[0].box) and self._alone(found[0], view, T_n_c)
        ):
            self._steady.clear()
            return None
        position = found[1]
        if self._steady and math.dist(position, self._steady[-1]) > STEADY_M:
            self._steady.clear()
        self._steady.append(position)
        return position if len(self._steady) >= STEADY_FRAMES else None

    def _well_inside(self, box: Box) -> bool:
        """Returns whether the box is so far inside the image that a gust would not take it out at once."""
        u, v = box.center
        room_u, room_v = ROOM * self._camera.width, ROOM * self._camera.height
        return room_u <= u <= self._camera.width - room_u and room_v <= v <= self._camera.height - room_v

    def _alone(self, seen: Sighting, view: View, T_n_c: Pose) -> bool:
        """Returns whether the box is no larger than the target can be, and nothing nearer or farther off is in it.

        Two, one behind the other, are one box; at times the detector gives one of them besides.
        """
        depth, largest = seen.depth, self._largest
        if depth is None or largest is None:
            return True
        if not largest.holds(seen.box, depth.z_m, depth.sigma_m, T_n_c):
            return False
        others = [each.box for each in view.targets(None) if each.score >= MIN_SCORE and each.box != seen.box]
        within = [view.depth(box) for box in others if common_area(box, seen.box) >= INSIDE * box.area]
        return not any(other is not None and largest.apart(depth, other) for other in within)

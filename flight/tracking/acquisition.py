"""Taking one object for the target that an operator designated."""

from __future__ import annotations

import math

import numpy as np

from drivers.interfaces import View
from flight.config import Designated
from flight.guidance import Vec3, norm, subtract
from flight.tracking.association import Sighting
from flight.tracking.largest_box import LargestBox
from flight.tracking.objects import CUT_SCORE, MIN_SCORE, is_cut
from flight.tracking.places import at_height, place
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, MissReason, common_area

STEADY_FRAMES = 5
STEADY_M = 0.25
ROOM = 0.2  # of the image, at each side
INSIDE = 0.9  # of a box that is in another one
_CLEARLY_NEARER = 1.5
_ROUND = 16  # places on the rim of where a designated object can be


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


def acquire(view: View, T_n_c: Pose, camera: CameraModel, designated: Designated) -> tuple[Sighting, Vec3] | MissReason:
    """The one object that the designated one can be, with its position in ``n``; or why there is none.

    Two that it can be are never told apart by their distances: neither is taken, until one is left. Nor is one that is
    hardly nearer than the next: the place may be off by more than was thought. When the object may have driven since
    it was pointed at, one alone is taken only if it would be seen wherever it is.
    """
    place_n_m, radius_m = designated.place_n_m, designated.radius_m
    seen: list[tuple[float, Sighting | None, Vec3]] = []
    for detection in view.targets(None):
        box = detection.box
        cut = is_cut(box, camera)
        if detection.score < (CUT_SCORE if cut else MIN_SCORE):
            continue
        depth = None if cut else view.depth(box)
        position = (
            at_height(box.center, camera, T_n_c, place_n_m[2])
            if depth is None
            else place(box, depth, camera, T_n_c, place_n_m[2])
        )
        if position is not None:
            off_m = norm(subtract(position, place_n_m))
            seen.append((off_m, None if depth is None else Sighting(box, depth), position))
    seen.sort(key=lambda item: item[0])
    if not seen or seen[0][0] > radius_m:
        return MissReason.NO_TARGET
    if len(seen) > 1 and seen[1][0] < max(radius_m, _CLEARLY_NEARER * seen[0][0]):
        return MissReason.AMBIGUOUS_TARGET
    _, sighting, position = seen[0]
    if sighting is None:
        return MissReason.NO_TARGET
    if designated.drift_m > 0.0 and not _overlooks(T_n_c, camera, designated):
        return MissReason.AMBIGUOUS_TARGET
    return sighting, position


def _overlooks(T_n_c: Pose, camera: CameraModel, designated: Designated) -> bool:
    """Returns whether the camera sees everywhere that the object can have gone to."""
    (north, east, down), radius_m = designated.place_n_m, designated.radius_m
    turns = [2.0 * math.pi * k / _ROUND for k in range(_ROUND)]
    rim = [(north + radius_m * math.cos(turn), east + radius_m * math.sin(turn), down) for turn in turns]
    T_c_n = T_n_c.inverse()
    return all(camera.sees((x, y, z)) for x, y, z in T_c_n.apply(np.array(rim)).tolist())

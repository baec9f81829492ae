"""D1 in a Monte-Carlo hand-over follows the target as it does in flight
(``flight.tracking.association``).
"""

from __future__ import annotations

import numpy as np

from flight.config import MissionConfig
from flight.guidance import Vec3
from flight.harness.montecarlo import StatedIdentity
from flight.tracking.association import Sighting, follow
from flight.tracking.largest_box import LargestBox
from flight.tracking.objects import MIN_SCORE
from flight.tracking.places import place
from flight.tracking.ranging import Ranging
from flight.tracking.target_track import TargetTrack
from hil.montecarlo.perception import HandoverView
from hil.montecarlo.scene import Things
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.observations import MissReason

# for so long D1 has followed the target when an attempt begins
FOLLOWED_S = 1.0
STEPS = 25
TARGET = 0


class Follower:
    """D1's track of the target. D1 is given the right object in the first frame that shows it, and
    has followed it.

    Args:
        camera: as D1 believes it to be.
        things: the target's true motion. down_m: of its middle.

    Attributes:
        stated: in every frame with a box of what it takes for the target.
    """

    def __init__(
        self,
        camera: CameraModel,
        mission: MissionConfig,
        method: MethodConfig,
        things: Things,
        down_m: float,
    ) -> None:
        self._camera = camera
        self._mission = mission
        self._things = things
        self._down_m = down_m
        self._largest = LargestBox.of(camera, method)
        self._ranging = Ranging.of(mission, method)
        self._track: TargetTrack | None = None
        self.stated: list[StatedIdentity] = []

    def look(
        self,
        view: HandoverView,
        time_s: float,
        T_n_c: Pose,
    ) -> Sighting | MissReason:
        """The target in D1's next frame, taken at an instant of the attempt. ``T_n_c``: as D1
        believes.
        """
        track = self._track
        if track is None:
            found = self._shown(view, T_n_c)
            if isinstance(found, MissReason):
                return found
            track = self._track = self._followed(found, view.stamp_ns, time_s)
        if view.stamp_ns - track.stamp_ns > 1e9 * self._mission.deadlines.target_coast_s:
            return MissReason.NO_TARGET  # given up
        seen = follow(view, T_n_c, self._camera, track)
        stated = None if track.identity is None else track.identity.stated
        if stated is not None:
            box, probability = stated
            self.stated.append(StatedIdentity(probability, view.whose(box) == TARGET))
        return seen

    def _shown(self, view: HandoverView, T_n_c: Pose) -> Vec3 | MissReason:
        """The target's place by its own box: what D1 follows has D1's errors in it."""
        for detection in view.targets(None):
            if view.whose(detection.box) == TARGET and detection.score >= MIN_SCORE:
                depth = view.depth(detection.box)
                if depth is None:
                    return MissReason.NO_DEPTH
                return place(detection.box, depth, self._camera, T_n_c, self._down_m)
        return MissReason.NO_TARGET

    def _followed(
        self,
        place_n_m: Vec3,
        stamp_ns: int,
        time_s: float,
    ) -> TargetTrack:
        """A track of what moved as the target did, up to where it is now."""
        before_s = np.linspace(-FOLLOWED_S, 0.0, STEPS, endpoint=False)
        moved = self._things.at(time_s + np.append(before_s, 0.0))[0][:, TARGET]
        north, east, down = place_n_m
        places = [(north + n, east + e, down) for n, e in (moved - moved[-1]).tolist()]
        stamps = [stamp_ns + round(1e9 * each) for each in before_s.tolist()]
        track = TargetTrack.of(self._mission, places[0], stamps[0], self._largest, self._ranging)
        for each, at_ns in zip(places[1:], stamps[1:], strict=False):
            track.update(each, at_ns)
        return track

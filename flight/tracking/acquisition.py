"""Taking one object for the target: the one that, by all that was said, is the one meant, or none.

D1 tracks everything it sees (``candidates``) and asks which of it is meant (``statements``). It
takes an object only when it is the one with a probability of at least ``SURE``, is in the image as
a whole, and is alone in its box. As long as none is, it waits, looks on, and has a question for
whoever can answer. Nothing is ever taken for lack of time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.interfaces import View
from drivers.operator.interfaces import Chosen, Question, Shown, Told
from flight.config import MissionConfig
from flight.guidance import Vec3
from flight.tracking.candidates import (
    COASTED_S,
    REMEMBERED_S,
    STEADY_FRAMES,
    Candidate,
    Candidates,
    Observed,
)
from flight.tracking.largest_box import LargestBox
from flight.tracking.objects import MIN_SCORE
from flight.tracking.ranging import Ranging
from flight.tracking.statements import Look, Motion, Shares, Statements
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, Depth, common_area

SURE = 0.999
ROOM = 0.2  # of the image, at each side
INSIDE = 0.9  # of a box that is in another one
PLAUSIBLE = 0.05  # the share from which on an object is worth staying for
# of looking at something that it can be: by then what can be told by itself is told
ASKED_AFTER_S = 2.0
# where something else has come into view, or what was shown is not known to be the same any more
ASKED_AGAIN_S = 3.0
REMINDED_S = 6.0  # nobody answered
MOST_SHOWN = 9
# times as far off as it is followed from: what is surely the target is taken once D1 is so near
NEAR = 1.4
LOOKS_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class Taken:
    """The target: where it is in ``n``, and its velocity. ``chosen``: by somebody who was asked."""

    position_n_m: Vec3
    velocity_n_mps: Vec3
    share: float
    chosen: bool


class Acquisition:
    """Which of the objects in view is the one that is meant.

    Attributes:
        ambiguous: in the newest frame there was something that it can be, and none that it surely
            is.
        question: what is to be asked of whoever can answer; None when nothing is.
        shares: how likely each object of the newest frame is the one meant.
    """

    def __init__(
        self,
        camera: CameraModel,
        method: MethodConfig,
        mission: MissionConfig,
        ranging: Ranging | None = None,
    ) -> None:
        """``ranging``: what tells how far away something is beyond the reach of depth; its ground
        is kept up.
        """
        self._ranging = ranging or Ranging.of(mission, method)
        motion = Motion.of(mission)
        self._camera, self._largest = camera, LargestBox.of(camera, method)
        self._statements = Statements(motion)
        attitude_rad = math.radians(mission.attitude_sigma_deg)
        self._candidates = Candidates(
            camera,
            method,
            attitude_rad,
            motion.fastest_mps,
            motion.accel_mps2,
            flies=mission.target.flies,
        )
        self._usual_down_m = -mission.target.height_m
        self._flies = mission.target.flies
        self._fastest_mps = motion.fastest_mps
        self._looks: deque[Look] = deque()
        self._seen: list[Candidate] = []
        self._plausible_ns: int | None = None
        self._questions = 0
        self._asked: list[Question] = []
        self._chosen: Candidate | None = None
        self._chosen_since_ns = 0
        self._settled_share = 0.0
        follow = mission.follow
        below_m = follow.height_m - mission.target.height_m
        self._near_m = NEAR * math.hypot(follow.behind_m, below_m) if below_m > 0.0 else math.inf
        self._none_of: set[tuple[int, int]] = set()
        self.question: Question | None = None
        self.shares = Shares({}, 1.0)
        self.ambiguous = False

    def tell(self, told: Told) -> None:
        """Take up a statement; places are in this drone's own frame."""
        self._statements.tell(told)

    def choose(self, answer: Chosen) -> bool:
        """Take up an answer. Returns whether it is of use: the object is still known to be the one
        that was shown.
        """
        question = next((each for each in self._asked if each.number == answer.question), None)
        if question is None:
            return False
        known = {
            each.number: each for each in self._candidates.all if each.since_ns <= question.stamp_ns
        }
        if answer.number == 0:
            self._none_of |= {
                (each.number, known[each.number].since_ns)
                for each in question.shown
                if each.number in known
            }
            self.question = None
            return True
        if (
            answer.number not in {each.number for each in question.shown}
            or answer.number not in known
        ):
            self.question = None
            return False
        self._chosen = known[answer.number]
        self.question = None
        self._settled_share = 1.0
        self._chosen_since_ns = self._chosen.since_ns
        return True

    def where(self, stamp_ns: int) -> tuple[Vec3, float] | None:
        """Return the place to look at, and how far from it the object may be; None when nobody said
        where it is.
        """
        said = self._statements.where(stamp_ns)
        best = self._likeliest(stamp_ns)
        if best is None:
            return said
        place, sigma_m = best.predicted(stamp_ns, 0.0)
        if best is self._chosen:
            return place, 3.0 * sigma_m
        return place, 3.0 * sigma_m if said is None else said[1] + math.dist(place, said[0])

    def moves(self, stamp_ns: int) -> Vec3:
        """Return the velocity of the object at the place to look at; nothing where none is the
        likeliest.

        Whoever only flies to where a fast one is stays behind it, and never comes near.
        """
        best = self._likeliest(stamp_ns)
        if best is None:
            return 0.0, 0.0, 0.0
        return self._velocity_of(best)

    def _velocity_of(self, one: Candidate) -> Vec3:
        north, east, down = one.likely_velocity_n_mps(self._fastest_mps)
        return north, east, down if self._flies else 0.0

    def _likeliest(self, stamp_ns: int) -> Candidate | None:
        """The object in view that is more likely the one meant than not; None when none is.

        What a detector misses in a frame is in view all the same.
        """
        in_view = [
            each for each in self._candidates.all if stamp_ns - each.stamp_ns <= COASTED_S * 1e9
        ]
        best = max(in_view, key=lambda each: self.shares.of.get(each.number, 0.0), default=None)
        return best if best is not None and self.shares.of.get(best.number, 0.0) > 0.5 else None

    def look(self, view: View, T_n_c: Pose) -> Taken | None:
        """Take up one frame. Returns the target once this frame makes it sure."""
        stamp_ns = view.stamp_ns
        self._note_look(stamp_ns, T_n_c)
        self.watch(view, T_n_c)
        self.shares = self._judged()
        best = max(self._seen, key=lambda each: self.shares.of[each.number], default=None)
        share = 0.0 if best is None else self.shares.of[best.number]
        self.ambiguous = PLAUSIBLE <= share < SURE
        if best is not None and share >= SURE and self._fit(best, view, T_n_c):
            self.question = None
            self._settle(best, share)
            if math.dist(best.position_n_m, T_n_c.t.tolist()) <= self._near_m:
                asked = self._settled_share >= 1.0
                return Taken(best.position_n_m, self._velocity_of(best), self._settled_share, asked)
        self._ask(stamp_ns, share)
        return None

    def watch(self, view: View, T_n_c: Pose) -> Sequence[Candidate]:
        """Take up one frame, and judge nothing. Returns all that is known to be there."""
        expected = self._statements.where(view.stamp_ns)
        down_m = self._usual_down_m if expected is None else expected[0][2]
        self._seen = self._candidates.look(view, T_n_c, down_m)
        return self._candidates.all

    def why(self) -> str:
        """Return what D1 knows, and what would tell it more, for the crew."""
        if not self._seen:
            return "nothing was seen where it can be: say where it is now, or look from elsewhere"
        parts = [
            f"object {each.number} at {each.position_n_m[0]:.1f} m north, {each.position_n_m[1]:.1f} m east "
            f"({100.0 * self.shares.of.get(each.number, 0.0):.0f} %)"
            for each in sorted(self._seen, key=lambda each: -self.shares.of.get(each.number, 0.0))[
                :MOST_SHOWN
            ]
        ]
        told = f"out of sight {100.0 * self.shares.elsewhere:.0f} %"
        return f"{', '.join(parts)}, {told}; a later place, a smaller error or an answer would tell"

    # --- which ---

    def _settle(self, one: Candidate, share: float) -> None:
        """What is surely the one stays it, as long as it is known to be the same: D1 may look from
        nearer now.
        """
        if self._chosen is not one:
            self._chosen = one
            self._chosen_since_ns = one.since_ns
            self._settled_share = share

    def _note_look(self, stamp_ns: int, T_n_c: Pose) -> None:
        looks = self._looks
        if not looks or stamp_ns - looks[-1].stamp_ns >= LOOKS_EVERY_S * 1e9:
            looks.append(Look(stamp_ns, T_n_c))
        while stamp_ns - looks[0].stamp_ns > REMEMBERED_S * 1e9:
            looks.popleft()

    def _judged(self) -> Shares:
        """The shares, by what was said and what was answered."""
        chosen = self._chosen
        if chosen is not None:
            if chosen in self._candidates.all and chosen.since_ns == self._chosen_since_ns:
                return Shares(
                    {each.number: float(each is chosen) for each in self._candidates.all}, 0.0
                )
            self._chosen = None  # it was lost from sight, or might have been exchanged
        possible = [
            each
            for each in self._candidates.all
            if (each.number, each.since_ns) not in self._none_of
        ]
        shares = self._statements.shares(possible, tuple(self._looks), self._camera)
        return Shares(
            {each.number: shares.of.get(each.number, 0.0) for each in self._candidates.all},
            shares.elsewhere,
        )

    def _ask(self, stamp_ns: int, share: float) -> None:
        """Have a question once something that it can be has been in view for a while, and again
        when it is stale.
        """
        if share < PLAUSIBLE:
            self._plausible_ns = None
            return
        if self._plausible_ns is None:
            self._plausible_ns = stamp_ns
        if stamp_ns - self._plausible_ns < ASKED_AFTER_S * 1e9 or self._chosen is not None:
            return
        if self.question is not None:
            again_s = REMINDED_S if self._still(self.question) else ASKED_AGAIN_S
            if stamp_ns - self.question.stamp_ns < again_s * 1e9:
                return
        ranked = sorted(self._seen, key=lambda each: -self.shares.of[each.number])
        shown = tuple(self._shown(each) for each in ranked if each.frames >= STEADY_FRAMES)[
            :MOST_SHOWN
        ]
        if shown and shown[0].number == ranked[0].number:
            self._questions += 1
            self.question = Question(self._questions, stamp_ns, shown)
            self._asked = [*self._asked[-3:], self.question]

    def _still(self, question: Question) -> bool:
        """Whether all that it can be are among those shown, and still known to be the same."""
        shown = {each.number for each in question.shown}
        likely = [each for each in self._seen if self.shares.of[each.number] >= PLAUSIBLE]
        return all(each.number in shown and each.since_ns <= question.stamp_ns for each in likely)

    def _shown(self, one: Candidate) -> Shown:
        share = self.shares.of[one.number]
        return Shown(one.number, one.observed.box, one.position_n_m, one.velocity_n_mps, share)

    # --- whether it can be taken as it is in a frame ---

    def _fit(self, one: Candidate, view: View, T_n_c: Pose) -> bool:
        seen = one.observed
        depth = self._depth_of(one.observed, T_n_c)
        steady = one.frames >= STEADY_FRAMES and depth is not None
        return steady and self._well_inside(seen.box) and self._alone(seen, depth, view, T_n_c)

    def _depth_of(self, seen: Observed, T_n_c: Pose) -> Depth | None:
        """Return its depth; beyond the reach of the depth camera what else tells how far away it
        is.
        """
        if seen.depth is not None:
            return seen.depth
        _, _, expected_z_m = T_n_c.inverse().apply(np.array(seen.place_n_m)).tolist()
        ranged = self._ranging.ranged(None, seen.box, self._camera, T_n_c, expected_z_m)
        return None if ranged is None else ranged.depth

    def _well_inside(self, box: Box) -> bool:
        """Return whether the box is so far inside the image that a gust would not take it out at
        once.
        """
        u, v = box.center
        room_u = ROOM * self._camera.width
        room_v = ROOM * self._camera.height
        return (
            room_u <= u <= self._camera.width - room_u
            and room_v <= v <= self._camera.height - room_v
        )

    def _alone(self, seen: Observed, depth: Depth | None, view: View, T_n_c: Pose) -> bool:
        """Return whether the box is no larger than the target can be, and nothing nearer or
        farther off is in it.

        Two, one behind the other, are one box; at times the detector gives one of them besides.
        """
        largest = self._largest
        if depth is None or largest is None:
            return True
        if not largest.holds(seen.box, depth.z_m, depth.sigma_m, T_n_c):
            return False
        others = [
            each.box
            for each in view.targets(None)
            if each.score >= MIN_SCORE and each.box != seen.box
        ]
        within = [
            view.depth(box) for box in others if common_area(box, seen.box) >= INSIDE * box.area
        ]
        return not any(other is not None and largest.apart(depth, other) for other in within)

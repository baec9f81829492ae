"""D1 finds out which object is meant: it hears what is said, looks, and asks whoever can answer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drivers.interfaces import View
from drivers.operator.interfaces import BearingTold, Chosen, PlaceTold, Question, Told
from flight.guidance import Vec3, add
from flight.tracking.acquisition import Acquisition, Taken
from flight.tracking.candidates import Candidate
from flight.tracking.look_round import LookRound
from flight.tracking.ranging import Ranging
from missions.fly.leg.numbered import NOTHING, pictured
from missions.fly.leg.session import RoleSession
from missions.ground.journal import question_record, taken_record, told_record
from path.camera.model import CameraModel
from path.geometry.transforms import Pose

_HEARD_EVERY_S = 0.1
_VIEW_SHARE = 0.8  # of half the image: what is searched is to be in it
_WIDEST = 2.0  # times as far off as the target is followed from


class Designating:
    """The way from what is said to the one object.

        Args:
            points: what somebody who goes on pointing says now; None when nobody does.
            first: what is known from the beginning; None: what the rig's mission says.
    ####        ranging: of D1, with the ground below it as it is known now.
    """

    def __init__(
        self,
        session: RoleSession,
        camera: CameraModel,
        look_round: LookRound,
        points: Callable[[], PlaceTold | None],
        first: PlaceTold | None = None,
        ranging: Ranging | None = None,
    ) -> None:
        self._session = session
        self._camera = camera
        self._look_round = look_round
        self._acquisition = Acquisition(camera, session.rig.method, session.config, ranging)
        self._points = points
        self._first = first or session.config.target.told(session.now_ns())
        self._told_first = False
        self._asked: Question | None = None
        self._view: View | None = None
        if session.operator is not None:
            pictured(np.zeros((48, 64, 3), np.uint8), NOTHING)  # the first one takes long

    # --- what is said and asked ---

    async def listen(self) -> None:
        """Hear for ever, in turns with looking."""
        while True:
            self.hear()
            await asyncio.sleep(_HEARD_EVERY_S)

    def hear(self) -> None:
        """Take up what was said since the last time, and show what is asked."""
        session = self._session
        operator = self._session.operator
        pointed = self._points()
        if pointed is not None:
            self._tell(pointed)
        elif not self._told_first:
            self._told_first = True
            self._tell(self._first)
        if operator is None:
            return
        for said in operator.heard():
            if isinstance(said, Chosen):
                used = self._acquisition.choose(said)
                session.log.write("/told", session.now_ns(), told_record(said, used=used))
            else:
                self._tell(said)
        question = self._acquisition.question
        if question is not self._asked:
            self._show(question)

    def stop(self) -> None:
        """Ask nothing any more."""
        if self._session.operator is not None:
            self._session.operator.ask(None, None)

    def _tell(self, told: Told) -> None:
        """Places are said in the crew's frame: this drone's own is off from it as it was at
        home.
        """
        own = shifted(told, self._session.off_n_m)
        if isinstance(own, PlaceTold) and not own.height_told:
            north, east, _ = own.place_n_m
            own = replace(own, place_n_m=(north, east, -self._session.config.target.height_m))
        self._acquisition.tell(own)
        self._session.log.write("/told", self._session.now_ns(), told_record(own, used=True))

    def _show(self, question: Question | None) -> None:
        session = self._session
        operator = self._session.operator
        assert operator is not None
        self._asked = question
        picture: bytes | None = None
        if question is not None:
            session.log.write("/question", session.now_ns(), question_record(question))
            session.say(f"which of {len(question.shown)} is the target? {self._acquisition.why()}")
            image = None if self._view is None else self._view.image()
            if image is not None:
                picture = pictured(image, question)
        operator.ask(question, picture)

    # --- looking ---

    def look(self, view: View, T_n_c: Pose) -> Taken | None:
        """Take up one frame. Returns the target once it is sure."""
        self._view = view
        taken = self._acquisition.look(view, T_n_c)
        if self._acquisition.ambiguous:
            self._look_round.hold()
        if taken is not None:
            self._session.log.write("/taken", view.stamp_ns, taken_record(taken))
        return taken

    def watch(self, view: View, T_n_c: Pose) -> Sequence[Candidate]:
        """Take up one frame without asking which is meant. Returns all that is known to be there."""
        return self._acquisition.watch(view, T_n_c)

    def where(self, now_ns: int) -> tuple[Vec3, float]:
        """Return the place to look at, and how many times as far off as usual to look at all of
        where it can be.
        """
        config = self._session.config
        if not self._told_first:
            self.hear()
        found = self._acquisition.where(now_ns)
        if found is None:
            north, east, down = add(self._first.place_n_m, self._session.off_n_m)
            return (north, east, down), _WIDEST
        place, radius_m = found
        range_m = (
            config.follow.behind_m**2 + (config.follow.height_m - config.target.height_m) ** 2
        ) ** 0.5
        half_m = (
            0.5
            * _VIEW_SHARE
            * range_m
            * min(self._camera.width, self._camera.height)
            / self._camera.fx
        )
        return place, min(max(1.0, radius_m / half_m), _WIDEST)

    def moves(self, now_ns: int) -> Vec3:
        """Return the velocity of what is at the place to look at, as far as it is known which that
        is.
        """
        return self._acquisition.moves(now_ns)

    def why(self) -> str:
        """Return why there is no target yet, for the crew."""
        return self._acquisition.why()


def shifted(told: Told, off_n_m: Vec3) -> Told:
    """Return a statement in the frame of a drone that is that far off."""
    north, east, _ = off_n_m
    if isinstance(told, PlaceTold):
        return replace(told, place_n_m=add(told.place_n_m, (north, east, 0.0)))
    if isinstance(told, BearingTold):
        return replace(told, from_n_m=(told.from_n_m[0] + north, told.from_n_m[1] + east))
    return replace(told, corners_n_m=tuple((n + north, e + east) for n, e in told.corners_n_m))

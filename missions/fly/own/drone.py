"""One drone, as a mission of a person's own flies it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, NoReturn

from drivers.interfaces import Received, RecordStore, VehicleState, VelocitySetpoint, View
from drivers.rig.parts import Rig
from flight.camera_pose import CameraPose
from flight.guidance import Anchor, Vec3, norm, subtract
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from flight.pilot import Guidance
from flight.tracking.objects import MIN_SCORE
from flight.tracking.places import place
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import bring_down, take_off
from missions.fly.own.handing import Giving, Taking
from missions.ground.journal import frame_record
from path.camera.model import CameraModel
from path.geometry.rotation import yaw_of
from path.geometry.transforms import Pose
from path.messages import Message, Role, Status
from path.observations import Box

_CLIMB_GAIN_PER_S = 0.8


class Drone:
    """A drone on the ground, armable, with the other one heard: all a mission has to do with it.

    Places are (north, east, down) in m from the mission's origin, by the vehicle's own estimate,
    less what that has stepped by in flight. Every wait has an end.
    Whatever is raised in a mission ends it, and the drone lands.

    Attributes:
        name: ``sender`` or ``receiver``, the rig's table of this drone.
        rig: the rig that is flown.
        camera: the calibrated camera of this drone.
        observing: what the other drone hears of this one in ``other.observing``.
    """

    def __init__(self, session: RoleSession, store: RecordStore) -> None:
        self._session = session
        self._store = store
        self._handing: Giving | Taking | None = None
        self._camera_pose = CameraPose(session.vehicle, session.own.mount)
        self.name: str = session.role.value
        self.rig: Rig = session.rig
        self.camera: CameraModel = session.own.camera

    # --- where it is, and flying

    @property
    def state(self) -> VehicleState:
        """The vehicle's newest telemetry."""
        return self._session.vehicle.state

    @property
    def position_n_m(self) -> Vec3:
        """The drone's place: north, east, down."""
        return self.state.position_n_m

    @property
    def now_s(self) -> float:
        """This drone's clock."""
        return self._session.now_ns() * 1e-9

    async def take_off(self, height_m: float) -> None:
        """Arm, climb and stay there. Ends the mission when the vehicle refuses."""
        if self._session.pilot.in_control:
            self.fail("take_off in the air")
        session = self._session
        config = session.config
        session.note_home(
            config.target.home_m if session.role is Role.SENDER else config.rendezvous.home_m
        )
        await take_off(session, height_m)
        self._session.enter(Phase.MISSION)

    async def fly_to(
        self,
        north_m: float,
        east_m: float,
        height_m: float,
        *,
        heading_deg: float | None = None,
        speed_mps: float = 0.8,
        near_m: float = 0.3,
        within_s: float = 60.0,
    ) -> None:
        """Fly to a place and stay there; the nose stays as it is unless a heading is given (0:
        north, clockwise).

        Returns within ``near_m`` of it. The mission fails when that takes longer than ``within_s``.
        """
        yaw_rad = yaw_of(self.state.q_n_b) if heading_deg is None else math.radians(heading_deg)
        there = Anchor((north_m, east_m, -height_m), yaw_rad)
        towards = self._session.fence.towards

        def guidance(state: VehicleState) -> VelocitySetpoint:
            return there.hold(state, _CLIMB_GAIN_PER_S, speed_mps, towards)

        self.guide(guidance)
        await self.until(
            lambda: norm(subtract(there.position_n_m, self.position_n_m)) < near_m,
            within_s,
            f"not at north {north_m:.1f} m, east {east_m:.1f} m, height {height_m:.1f} m",
        )

    def guide(self, guidance: Guidance) -> None:
        """Fly from now on what this gives for the vehicle's state, control_hz times a second; it
        must not block.
        """
        if not self._session.pilot.in_control:
            self.fail("to be flown it has to take off first: await drone.take_off(height_m)")
        self._session.pilot.guidance = guidance

    def stay(self) -> None:
        """Stay at the present place."""
        self._session.pilot.hold_here()

    # --- seeing

    async def look(self, within_s: float | None = None) -> View:
        """The newest camera frame not yet looked at, logged. Ends the mission as ``camera_lost``
        when none comes.
        """
        session = self._session
        view = await session.frames.view(
            session.config.guard.frame_age_s if within_s is None else within_s
        )
        session.log.write("/frame", view.stamp_ns, frame_record(view, session.now_ns()))
        session.frames.log_image(view)
        return view

    def camera_pose(self, view: View) -> Pose:
        """``T_n_c``: the camera's pose when the frame was taken."""
        return self._camera_pose.T_n_c(view.stamp_ns, self._camera_pose.R_n_b(view.stamp_ns))

    def where(self, view: View, box: Box) -> Vec3 | None:
        """Return the place of the object in a box of the frame.

        None when the camera does not tell how far away it is.
        """
        depth = view.depth(box)
        return (
            None if depth is None else place(box, depth, self.camera, self.camera_pose(view), 0.0)
        )

    def objects(self, view: View) -> list[Vec3]:
        """Return the places of all objects that the detector finds in the frame, and whose
        distance is known.
        """
        found = (self.where(view, one.box) for one in view.targets(None) if one.score >= MIN_SCORE)
        return [position for position in found if position is not None]

    # --- the other drone

    @property
    def other(self) -> Status | None:
        """The newest word of the other drone: position_n_m, observing, battery ...; None before the
        first.
        """
        return self._session.peer

    @property
    def other_silence_s(self) -> float:
        """The time for which nothing was heard of the other drone."""
        return self._session.peer_silence_s()

    @property
    def observing(self) -> bool:
        return self._session.observing

    @observing.setter
    def observing(self, value: bool) -> None:
        self._session.observing = value

    def send(self, message: Message) -> None:
        """Send one of the dialect's messages; it may be lost."""
        self._session.link.send(message)

    def on_message(self, heard: Callable[[Received], None]) -> None:
        """Have this called with every message that is neither a status nor of the clocks; it must
        not block.
        """
        self._session.on_message = heard

    # --- handing over

    async def hand_over(
        self,
        place_n_m: Vec3 | None = None,
        *,
        error_m: float = 0.5,
        to: str = "receiver",
    ) -> None:
        """Find the object at a place, follow it, and hand it over with proof; the other drone calls
        ``take_over``.

        Returns once the other drone holds it; this one has then made room, and stays. Of two
        objects that it could be neither is taken. The mission ends with the outcome of a hand-over
        (``target_not_found``, ``no_agreement`` ...) when it does not come to that.

        Args:
            place_n_m: where the object was seen last, as ``objects`` gives it; None: where the
                rig's mission says.
            error_m: standard deviation of that place, the same on each axis.
            to: who takes it over: ``receiver``, whose camera sees the marker that this drone
                carries.
        """
        if self._session.role is not Role.SENDER:
            self.fail("only the sender carries the marker: it hands over, the receiver takes over")
        if to != Role.RECEIVER.value:
            self.fail(f"there is no drone {to!r} that could take the target over: to is 'receiver'")
        if not self._session.pilot.in_control:
            self.fail("to hand over it has to take off first: await drone.take_off(height_m)")
        giving = Giving(self._session, self._store, place_n_m, error_m)
        self._handing = giving
        await giving.give()
        self.stay()

    async def take_over(self, *, then_follow_s: float = 0.0) -> None:
        """Take the sender's target over: wait for its offer, fly to where marker and target are
        seen, and verify.

        Takes off by itself when it is on the ground. Returns once this drone is responsible for the
        target and has followed it for ``then_follow_s``; the mission ends with the outcome of a
        hand-over when it does not come to it.
        """
        if self._session.role is not Role.RECEIVER:
            self.fail("the sender carries the marker: it hands over, the receiver takes over")
        taking = Taking(self._session, self._store)
        self._handing = taking
        await taking.take()
        await taking.keep(then_follow_s)
        taking.let_go()
        self.stay()

    async def recover(self, end: MissionEnd | None) -> bool:
        """Bring the vehicle down, out of the other drone's way where it was handing over. For the
        program's end.
        """
        if self._handing is not None:
            return await self._handing.recover(end)
        return await bring_down(
            self._session,
            end,
            Anchor(self.position_n_m, yaw_of(self.state.q_n_b)),
        )

    # --- the course

    async def until(
        self,
        condition: Callable[[], bool],
        within_s: float,
        what: str,
    ) -> None:
        """Wait for a condition; the mission fails, saying ``what``, when it does not come true
        within that time.
        """
        await self._session.until(condition, within_s, Outcome.MISSION_FAILED, what)

    def beside(self, task: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run beside the mission until the drone is down; an error in it ends the mission."""
        return self._session.spawn(task)

    def say(self, note: str) -> None:
        """One line for the crew."""
        self._session.say(note)

    def log(self, topic: str, record: Mapping[str, Any]) -> None:
        """One record into the drone's log, as ``/mission/<topic>``."""
        self._session.log.write(f"/mission/{topic}", self._session.now_ns(), record)

    def fail(self, why: str) -> NoReturn:
        """End the mission as ``mission_failed``: the drone lands where it is."""
        raise MissionEnd(Outcome.MISSION_FAILED, why)

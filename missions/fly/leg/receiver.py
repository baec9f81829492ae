"""D2, the receiver: flies to the sender by its marker, finds the target where the sender says,
takes it over.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence

from drivers.interfaces import Received, RecordStore, VehicleState, VelocitySetpoint, View
from flight.camera_pose import CameraPose, gravity_in
from flight.config import MissionConfig
from flight.frame.receiver import ReceiverSide
from flight.frame.records import (
    AttemptId,
    attempt_record,
    both_record,
    candidate_record,
    heard_target_record,
    marker_record,
    motion_record,
)
from flight.frame.sender import PairCameras
from flight.guard.limits import check_separation
from flight.guidance import (
    BELOW_FENCE_M,
    Anchor,
    Vec3,
    add,
    approach,
    bearing,
    from_heading,
    norm,
    subtract,
    within_fence,
)
from flight.keep_out import Body, followed
from flight.outcome import KEPT_S, MissionEnd, Outcome
from flight.phases import Phase
from flight.rendezvous.course import Rendezvous
from flight.rendezvous.marker_view import MarkerFix, MarkerView, VehicleMotions
from flight.rendezvous.viewpoint import NoViewpoint
from flight.tracking.association import follow
from flight.tracking.by_both import FromBothViews
from flight.tracking.largest_box import LargestBox
from flight.tracking.places import place
from flight.tracking.ranging import Ranging
from flight.tracking.target_track import TargetTrack
from flight.way_out import way_out_m
from missions.fly.leg.handover import ReceiverHandover
from missions.fly.leg.keyframes import CommonViews
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import bring_down, preflight, take_off
from missions.ground.journal import frame_record, track_record
from path.cycle.prior import Prior
from path.geometry.rotation import yaw_of
from path.geometry.transforms import Matrix, Pose
from path.marker.instead import grey_of, seen_instead
from path.marker.size_check import SizeCheck
from path.messages import Candidate, KeyframePart, Status, Target
from path.observations import Missed, MissReason
from path.protocol.values import Handoff

_ARRIVED_S = 0.6
_RETREAT_M = 1.8
_ABLE_S = 0.5
_REPLAN_S = 0.5
_PEER_POLL_S = 0.25
_LOOK_S = 0.05
# in which it flies relative to the sender
_RELATIVE = (
    Phase.STAND_OFF,
    Phase.SEARCH,
    Phase.APPROACH,
    Phase.VERIFY,
)


class Receiver:
    """The receiver's course and what it does with every frame and message."""

    def __init__(self, session: RoleSession, store: RecordStore) -> None:
        rig = session.rig
        mount = rig.receiver.mount
        config = session.config
        self._session = session
        self._config: MissionConfig = config
        self._camera = rig.receiver.camera
        self._camera_pose = CameraPose(session.vehicle, mount)
        self._marker = MarkerView(
            rig.layout,
            rig.receiver.camera,
            mount,
            rig.method,
            config,
        )
        self._size = SizeCheck(rig.layout, rig.method)
        self._handover = ReceiverHandover(session, store, self._able)
        self._side: ReceiverSide | None = None
        self._rendezvous = Rendezvous(
            config,
            self._camera,
            mount,
            rig.layout,
            self._marker,
            self._peer,
            session.now_ns,
            rig.sender if rig.method.common_view else None,
        )
        self._newest: Target | None = None
        self._live: Handoff | None = None
        # when it took the target over; a relief of a relay goes on as something else then
        self._taken_ns = 0
        self._watching = True
        self._leaving = False
        self._seen: View | None = None
        self._track: TargetTrack | None = None
        self._by_both = FromBothViews(
            rig.method,
            rig.sender.camera,
            rig.sender.mount.T_v_c,
            rig.receiver.camera,
        )
        self._keep_n_m: Vec3 | None = None  # from the target to this drone, once it follows
        self._searched: View | None = None  # the newest view that was searched for the marker
        # of looks at the marker that gave no pose, each told once
        self._causes: dict[MissReason, str] = {}
        self._common: CommonViews | None = None
        if rig.method.common_view:
            self._common = CommonViews(session, self._marker)
        session.bodies = self._bodies
        session.on_message = self._on_message
        session.on_status = self._handover.on_status

    # --- course

    async def course(self) -> None:
        await self._handover.resume()
        await preflight(self._session)
        await self.take_over()
        await self.keep(self._config.follow_after_s)

    async def take_over(self) -> None:
        """Wait for the sender's offer, fly to a viewpoint, and return once this drone holds the
        target for good.
        """
        session = self._session
        config = self._config
        deadlines = self._config.deadlines
        session.spawn(self._watch_peer())
        self._handover.start()

        session.enter(Phase.WAITING, "for the sender to follow the target")
        await session.until(
            lambda: self._newest is not None,
            deadlines.receiver_ready_s,
            Outcome.PEER_ABORTED,
            "no target was sent",
        )
        await self._until_planned(deadlines.viewpoint_s)  # the wind's part is known only in the air
        await self._rise()
        self._rendezvous.fence = session.fence

        session.spawn(self._watch())
        await session.look_about()
        if self._common is not None:
            session.spawn(self._common.run())
        await self._find_marker(self._near)
        left = config.rendezvous.go_arounds
        while why := await self._approach():
            if not left:
                raise why
            left -= 1
            session.say(f"goes around: {why.detail}")
            await self._find_marker(lambda: False)

        session.enter(Phase.VERIFY)
        session.observing = True
        await self._handover.until_held(2.0 * deadlines.verify_s)

        session.enter(Phase.FOLLOW, "responsible for the target")
        self._taken_ns = session.now_ns()

    async def keep(self, for_s: float) -> None:
        """Follow the target that was taken over for so long, and until it is in view. Raises
        MissionEnd when it is lost.
        """
        await asyncio.sleep(for_s)
        try:
            await self._session.until(
                self._in_view,
                self._config.deadlines.target_regain_s,
                Outcome.TARGET_LOST,
                "the target was not seen",
            )
        except MissionEnd as end:
            raise self._lost(end.detail) from end

    async def _rise(self) -> None:
        """From the ground to where the rendezvous begins."""
        self._session.note_home(self._config.rendezvous.home_m)
        await take_off(self._session, self._config.receiver_take_off_height_m)

    async def _find_marker(self, near_enough: Callable[[], bool]) -> None:
        """Fly to the stand-off, or until it is near enough, within its bounds again; then look
        for the marker.
        """
        session = self._session
        rendezvous = self._rendezvous
        deadlines = self._config.deadlines

        def at_stand_off() -> bool:
            is_there = rendezvous.at_stand_off(session.vehicle.state)
            if not (is_there or near_enough()):
                return False
            return not rendezvous.out_of_bounds()

        def sees_marker() -> bool:
            return self._marker.found(session.now_ns())

        session.enter(Phase.STAND_OFF)
        session.pilot.guidance = rendezvous.to_stand_off
        await session.until(
            at_stand_off,
            deadlines.stand_off_s,
            Outcome.APPROACH_FAILED,
            "the stand-off was not reached",
        )
        session.enter(Phase.SEARCH)
        rendezvous.begin_search()
        session.pilot.guidance = rendezvous.search
        await session.until(
            sees_marker,
            deadlines.search_s,
            Outcome.MARKER_NOT_FOUND,
            self._marker_not_seen,
        )

    def _marker_not_seen(self) -> str:
        said = ["the sender's marker was not seen"]
        said += self._causes.values()
        return "; ".join(said)

    async def _approach(self) -> MissionEnd | None:
        """Fly to the planned viewpoint; return what the mission would end with when something is
        out of its bounds.

        It has arrived once the camera is there, slow, for a while.
        """
        session = self._session
        rendezvous = self._rendezvous
        deadlines = self._config.deadlines
        await self._until_planned(deadlines.viewpoint_s)
        session.enter(Phase.APPROACH)
        session.pilot.guidance = rendezvous.to_viewpoint
        loop = asyncio.get_running_loop()
        end_s = loop.time() + deadlines.approach_s
        steady_since_s = loop.time()
        while loop.time() - steady_since_s <= _ARRIVED_S:
            now_ns = session.now_ns()
            unseen_s = self._marker.unseen_s(now_ns)
            bearable_s = deadlines.marker_coast_s + deadlines.marker_regain_s
            if unseen_s > bearable_s:
                return MissionEnd(Outcome.MARKER_LOST, f"marker not seen for {unseen_s:.1f} s")
            out = rendezvous.out_of_bounds()
            if out:
                return MissionEnd(Outcome.APPROACH_FAILED, out)
            if loop.time() > end_s:
                return MissionEnd(
                    Outcome.APPROACH_FAILED,
                    f"no viewpoint reached in {deadlines.approach_s:.0f} s",
                )
            await asyncio.sleep(_LOOK_S)
            if not rendezvous.at_viewpoint():
                steady_since_s = loop.time()
        return None

    def _bodies(self) -> Sequence[Body]:
        """Return what this drone tracks, to keep out of its way."""
        if self._track is None:
            return ()
        return followed(self._track, self._config, self._session.now_ns())

    async def recover(self, end: MissionEnd | None) -> bool:
        self._leaving = True
        self._handover.end(end)
        self._session.say_if_unfollowed(end)
        state = self._session.vehicle.state
        yaw_rad = yaw_of(state.q_n_b)
        back_m = self._retreat_m(state, yaw_rad)
        back = from_heading((-back_m, 0.0, 0.0), yaw_rad)
        place = add(state.position_n_m, back)
        way_out = Anchor(place, yaw_rad)
        landed = await self._come_down(end, way_out)
        await self._handover.finish()
        outcome = None if end is None else end.outcome
        if landed and outcome is Outcome.MARKER_NOT_FOUND:
            self._say_instead()
        return landed

    def _retreat_m(self, state: VehicleState, yaw_rad: float) -> float:
        """Return how far back to go before it lands: off the target's way, where it follows one."""
        if self._track is None:
            return _RETREAT_M
        back_n = from_heading((-1.0, 0.0, 0.0), yaw_rad)
        return way_out_m(
            self._track,
            state.position_n_m,
            back_n,
            self._config,
            self._session.now_ns(),
            _RETREAT_M,
        )

    async def _come_down(
        self,
        end: MissionEnd | None,
        way_out: Anchor,
    ) -> bool:
        """Bring the vehicle down, and return whether the script landed it."""
        return await bring_down(self._session, end, way_out)

    def _peer(self) -> Status:
        peer = self._session.peer
        assert peer is not None, "preflight waits for the sender's first Status"
        return self._session.here(peer)

    def _near(self) -> bool:
        """Return whether the marker is already nearer than the stand-off, which reported positions
        put farther on.
        """
        now_ns = self._session.now_ns()
        if not self._marker.found(now_ns):
            return False
        relative = self._marker.predict(now_ns)
        if relative is None:
            return False
        distance_m = norm(relative.marker_n_m)
        return distance_m < self._rendezvous.stand_off_m

    async def _until_planned(self, timeout_s: float) -> None:
        """Plan until there is a viewpoint: the sender may still be on its way to its place behind
        the target.
        """
        loop = asyncio.get_running_loop()
        end_s = loop.time() + timeout_s
        assert self._newest is not None
        plan = self._rendezvous.plan(self._newest)
        while isinstance(plan, NoViewpoint):
            if loop.time() > end_s:
                raise MissionEnd(Outcome.NO_VIEWPOINT, str(plan))
            await asyncio.sleep(_REPLAN_S)
            plan = self._rendezvous.plan(self._newest)
        place = ", ".join(f"{part:+.2f}" for part in plan.camera_h_m)
        seen = f"{plan.marker_px:.0f} px, margin {plan.margin_px:.0f} px"
        self._session.say(f"viewpoint ({place}) m from the marker, {seen}")

    # --- guidance

    def _follow_target(self, state: VehicleState) -> VelocitySetpoint:
        """Keep the place relative to the target that the hand-over found this drone in."""
        assert self._track is not None
        assert self._keep_n_m is not None
        config = self._config
        guard = config.guard
        now_ns = self._session.now_ns()
        target, velocity = self._track.believed(now_ns)
        north, east, down = velocity
        if not config.target.flies:
            down = 0.0
        moves = (north, east, down)
        highest_m = guard.fence_height_m - BELOW_FENCE_M
        place = add(target, self._keep_n_m)
        place = within_fence(place, math.inf, highest_m)
        if self._session.fence.confines:
            place = self._session.fence.nearest(place)
        error = self._session.fence.towards(place, state.position_n_m)
        answer = config.follow.answer(config.max_accel_mps2)
        to_fly = approach(error, state.velocity_n_mps, moves, answer)
        to_target = subtract(target, state.position_n_m)
        yaw_rad = bearing(to_target)
        return VelocitySetpoint(to_fly, yaw_rad)

    # --- what runs beside the course

    async def _watch(self) -> None:
        """Look at every frame, at some once the target is held. Raises CameraError when the camera
        stops.
        """
        session = self._session
        guard = self._config.guard
        while self._watching:
            view = await session.frames.view(guard.frame_age_s)
            record = frame_record(view, session.now_ns())
            session.log.write("/frame", view.stamp_ns, record)
            R_n_b = self._camera_pose.R_n_b(view.stamp_ns)
            self._rendezvous.tilt.note(R_n_b)
            if guard.unmeasured:
                session.note_standing(view, self._camera_pose.T_n_c(view.stamp_ns, R_n_b))
                self._rendezvous.fence = session.fence
            if self._leaving:
                self._look_out(view, R_n_b)
                await asyncio.sleep(1.0 / self._config.status_hz)
                continue
            if self._handover.holds:
                self._follow_once(view, R_n_b)
            else:
                self._cycle_once(view, R_n_b)
            session.frames.log_image(view)
            self._seen = view
            if session.phase is Phase.FOLLOW:
                await session.skip_frames()

    def _look_out(self, view: View, R_n_b: Matrix) -> None:
        """Keep up what is tracked, while this drone comes down."""
        if self._track is not None:
            T_n_c = self._camera_pose.T_n_c(view.stamp_ns, R_n_b)
            follow(view, T_n_c, self._camera, self._track)

    async def _watch_peer(self) -> None:
        """The sender must be heard until this drone holds the target; within a lease, the lease
        decides.
        """
        session = self._session
        while not self._handover.holds_for_good:
            if not self._handover.within_lease:
                session.require_peer()
                if self._sender_leaves():
                    raise MissionEnd(Outcome.PEER_ABORTED, "the sender is on its way down")
            await asyncio.sleep(_PEER_POLL_S)

    def _sender_leaves(self) -> bool:
        peer = self._session.peer
        if peer is None:
            return False
        return Phase.DEPART.reached(peer.phase)

    def _cycle_once(self, view: View, R_n_b: Matrix) -> None:
        """One cycle of PATH: the marker gives the pose, the pose the prior, the detector looks
        there, D1 gets a box.
        """
        session = self._session
        side = self._side
        if side is None:
            return
        stamp_ns = view.stamp_ns
        gravity_v = side.gravity_v(stamp_ns)
        T_n_c = self._camera_pose.T_n_c(stamp_ns, R_n_b)
        motion = self._motion()
        self._marker.note_motion(motion)
        with session.stage("marker"):
            fix = self._look(view, T_n_c.R, gravity_v)
        if isinstance(fix, Missed):
            self._note_cause(fix)
        else:
            self._check_size(view, fix)
        if self._common is not None:
            peer = self._peer()
            self._common.note_peer(motion.peer_stamp_ns, peer.position_n_m, peer.velocity_n_mps)
            self._common.look(view, T_n_c)
            if isinstance(fix, Missed):
                fix = self._marker.carried(stamp_ns, T_n_c.R) or fix
        with session.stage("log"):
            found = marker_record(stamp_ns, fix)
            session.log.write("/marker", stamp_ns, found)
            moved = motion_record(
                motion,
                T_n_c.R,
                self._marker.R_n_v,
                fix,
            )
            session.log.write("/motion", stamp_ns, moved)
        self._judge_marker(stamp_ns)
        with session.stage("projection"):
            prior = side.prior(fix, stamp_ns)
            if isinstance(prior, Prior):
                self._marker.note_target(prior, T_n_c.R)
        if session.phase is not Phase.VERIFY:
            return
        with session.stage("target"):
            answer = side.look(view, prior)
        if answer is None:
            return
        with session.stage("link"):
            session.link.send(answer.candidate)
        with session.stage("log"):
            record = candidate_record(answer)
            session.log.write("/candidate", stamp_ns, record)
        if answer.candidate.box is None:
            return
        if isinstance(prior, Prior) and isinstance(fix, MarkerFix):
            with session.stage("depth"):
                self._note_found(
                    view,
                    T_n_c,
                    answer.candidate,
                    prior,
                    fix,
                )

    def _look(
        self,
        view: View,
        R_n_c: Matrix,
        gravity_v: Vec3 | None,
    ) -> MarkerFix | Missed:
        """The marker, searched for as often as this computer can."""
        self._marker.search_every = self._session.frames.shedding.search_every
        gravity_c = gravity_in(R_n_c)
        fix = self._marker.look(view, R_n_c, gravity_v, gravity_c)
        if self._marker.searched(view.stamp_ns):
            self._searched = view
        return fix

    def _check_size(self, view: View, fix: MarkerFix) -> None:
        """Raise MissionEnd(MARKER_SIZE) when depth contradicts the marker's size, which scales
        every distance to D1.
        """
        with self._session.stage("depth"):
            self._size.look(
                fix.T_c_v,
                fix.covariance,
                fix.detections,
                view.depth,
            )
        contradiction = self._size.contradiction()
        if contradiction is not None:
            raise MissionEnd(Outcome.MARKER_SIZE, str(contradiction))

    def _note_cause(self, missed: Missed) -> None:
        """Tell the crew what is likely wrong with the marker, once for each kind."""
        if missed.cause is None or missed.reason in self._causes:
            return
        self._causes[missed.reason] = missed.cause
        self._session.say(f"the sender's marker: {missed.cause}")

    def _say_instead(self) -> None:
        """Tell what was seen in place of the marker: on the ground, since setpoints cannot wait for
        it.
        """
        session = self._session
        view = self._searched
        if view is None:
            return
        image = view.image()
        if image is None:
            return
        instead = seen_instead(grey_of(image), session.rig.layout)
        if instead is None:
            return
        missed = Missed(MissReason.NO_MARKER, cause=instead)
        record = marker_record(view.stamp_ns, missed)
        session.log.write("/marker", view.stamp_ns, record)
        self._note_cause(missed)

    def _motion(self) -> VehicleMotions:
        """Return both vehicles' newest reports."""
        session = self._session
        peer = self._peer()
        own = session.vehicle.state
        peer_ns = session.peer_heard_ns
        if session.alignment.ready:
            peer_ns = session.alignment.to_own_ns(peer.stamp_ns)
        return VehicleMotions(
            own.stamp_ns,
            own.velocity_n_mps,
            peer_ns,
            peer.velocity_n_mps,
            peer.yaw_rad,
        )

    def _judge_marker(self, stamp_ns: int) -> None:
        """Separation from the marker's own measurement, and how long it may stay unseen."""
        session = self._session
        deadlines = self._config.deadlines
        relative = self._marker.predict(stamp_ns)
        if relative is not None:
            distance_m = norm(relative.marker_n_m)
            session.note_separation(distance_m)
            check_separation(distance_m, self._config.separation.minimum_m)
            if session.phase in _RELATIVE:
                own = session.vehicle.state
                self._rendezvous.note_seen(own, relative.marker_n_m)
        if session.phase is not Phase.VERIFY:
            return
        unseen_s = self._marker.unseen_s(stamp_ns)
        bearable_s = deadlines.marker_coast_s + deadlines.marker_regain_s
        if unseen_s > bearable_s + deadlines.marker_away_s:
            raise MissionEnd(Outcome.MARKER_LOST, f"marker not seen for {unseen_s:.1f} s")
        if session.pilot.in_control:
            self._regain(is_lost=unseen_s > bearable_s)

    def _regain(self, is_lost: bool) -> None:
        """Hold off where the marker must be in view, in verification, and come back once it is
        found. The evidence stays.
        """
        pilot = self._session.pilot
        rendezvous = self._rendezvous
        holds_off = pilot.guidance == rendezvous.hold_off
        if is_lost and not holds_off:
            self._session.say("the sender's marker is out of sight: holds off and looks for it")
            pilot.guidance = rendezvous.hold_off
        elif holds_off and self._marker.found(self._session.now_ns()):
            self._session.say("the sender's marker is found again")
            pilot.guidance = rendezvous.to_viewpoint

    def _note_found(
        self,
        view: View,
        T_n_c: Pose,
        candidate: Candidate,
        prior: Prior,
        fix: MarkerFix,
    ) -> None:
        """Keep the target's own position ready, so that following can begin in the frame that hands
        it over.

        By both views, which nothing that is sent may rest on (``path.target.both_views``).
        """
        box = candidate.box
        assert box is not None
        assert self._newest is not None
        both = self._by_both.place(
            prior,
            self._newest.sigma_m,
            fix.covariance,
            gravity_in(T_n_c.R),
            box,
            view.depth(box),
        )
        record = both_record(candidate, both)
        self._session.log.write("/both_views", view.stamp_ns, record)
        down_m = -self._config.target.height_m
        position = place(box, both.depth, self._camera, T_n_c, down_m)
        if self._track is None:
            method = self._session.rig.method
            largest = LargestBox.of(self._camera, method)
            ranging = Ranging.of(self._config, method)
            self._track = TargetTrack.of(
                self._config,
                position,
                view.stamp_ns,
                largest,
                ranging,
            )
        else:
            self._track.update(position, view.stamp_ns)

    def _follow_once(self, view: View, R_n_b: Matrix) -> None:
        """Follow the target by this drone's own track, after the hand-over."""
        session = self._session
        track = self._track
        if track is None:
            raise MissionEnd(Outcome.TARGET_LOST, "the target was handed over but never located")
        follows = session.phase is Phase.FOLLOW
        begins = follows and self._keep_n_m is None
        if begins and session.pilot.in_control:
            here = session.vehicle.state.position_n_m
            self._keep_n_m = subtract(here, track.position_n_m)
            session.pilot.guidance = self._follow_target
        T_n_c = self._camera_pose.T_n_c(view.stamp_ns, R_n_b)
        seen = follow(view, T_n_c, self._camera, track)
        record = track_record(seen)
        session.log.write("/track", view.stamp_ns, record)
        deadlines = self._config.deadlines
        unseen_ns = view.stamp_ns - track.stamp_ns
        unseen_s = unseen_ns * 1e-9
        bearable_s = deadlines.target_coast_s + deadlines.target_regain_s
        if follows and unseen_s > bearable_s:
            raise self._lost(f"target not seen for {unseen_s:.1f} s")

    def _lost(self, detail: str) -> MissionEnd:
        """The end of a receiver that does not see its target any more: soon after it took it over,
        or later.
        """
        seen_ns = 0 if self._track is None else self._track.seen_ns
        kept_ns = seen_ns - self._taken_ns
        was_taken = self._taken_ns > 0
        outcome = Outcome.TARGET_LOST
        if was_taken and kept_ns * 1e-9 < KEPT_S:
            outcome = Outcome.LOST_AFTER
        return MissionEnd(outcome, detail)

    # --- messages

    def _on_message(self, received: Received) -> None:
        handover = self._handover
        held = handover.holds
        handover.on_message(received)
        takes_over = handover.holds and not held
        if takes_over and self._seen is not None:
            self._session.frames.log_image(self._seen, wanted=True)
        message = received.message
        if isinstance(message, Target):
            self._on_target(message)
        if isinstance(message, KeyframePart) and self._common is not None:
            self._common.hear(message)

    def _on_target(self, target: Target) -> None:
        """Take the target's place. The protocol has seen the message first and says which attempt
        is live.
        """
        session = self._session
        live = self._handover.live
        if live is None or not session.alignment.ready:
            return
        if live.follows(self._live):
            self._live = live
            attempt = AttemptId(
                live.handoff_id,
                live.epoch,
                live.target_id,
            )
            cameras = PairCameras.of(session.rig)
            self._side = ReceiverSide(cameras, session.rig.method, attempt)
            begun = attempt_record(attempt)
            session.log.write("/attempt", session.now_ns(), begun)
        assert self._side is not None
        capture_ns = session.alignment.to_own_ns(target.capture_ns)
        now_ns = session.now_ns()
        missed = self._side.hear(target, capture_ns, now_ns)
        record = heard_target_record(target, capture_ns)
        session.log.write("/heard_target", now_ns, record)
        if missed is None:
            self._newest = target

    def _in_view(self) -> bool:
        """Return whether the target that it follows was seen within the time that may be
        coasted.
        """
        coast_s = self._config.deadlines.target_coast_s
        return self._unseen_s() <= coast_s

    def _able(self) -> bool:
        """Return whether the target was seen lately, by this drone itself."""
        return self._unseen_s() < _ABLE_S

    def _unseen_s(self) -> float:
        """Return for how long the target was not seen; infinite where it never was."""
        track = self._track
        if track is None:
            return math.inf
        unseen_ns = self._session.now_ns() - track.seen_ns
        return unseen_ns * 1e-9

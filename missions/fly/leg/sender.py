"""D1, the sender: finds the target, follows it, runs its side of PATH, hands over, leaves and
lands.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.interfaces import Received, RecordStore, VehicleState, VelocitySetpoint, View
from drivers.operator.interfaces import PlaceTold
from flight.camera_pose import CameraPose
from flight.config import MissionConfig
from flight.frame.records import (
    AttemptId,
    OwnFrame,
    attempt_record,
    counted,
    heard_candidate_record,
    target_record,
)
from flight.frame.sender import PairCameras, SenderSide
from flight.guidance import (
    BELOW_FENCE_M,
    Anchor,
    Vec3,
    add,
    approach,
    bearing,
    from_heading,
    norm,
    scale,
    spare_accel,
    subtract,
    within_fence,
)
from flight.keep_out import Body, followed, seen
from flight.obstacles.side import free_heading
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from flight.tilt import Tilt
from flight.tracking.association import Sighting, follow
from flight.tracking.candidates import Candidate as Seen
from flight.tracking.largest_box import LargestBox
from flight.tracking.look_round import LookRound
from flight.tracking.ranging import Ranging
from flight.tracking.target_track import TargetTrack
from flight.way_out import way_out_m
from missions.fly.leg.designating import Designating
from missions.fly.leg.handover import SenderHandover
from missions.fly.leg.keyframes import KeyframesOut
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import bring_down, preflight, take_off
from missions.ground.journal import frame_record, track_record
from path.cycle.sender import PairVerdict
from path.geometry.rotation import yaw_of
from path.geometry.transforms import Matrix
from path.messages import Candidate, Target

_PEER_POLL_S = 0.25
_ACQUIRED_POLL_S = 0.05
_SLANT = math.sqrt(0.5)  # level share of the way from D1 to D2, and the share of it upward
_TURN_RADPS = 0.3  # about the target, among obstacles
_WIDER = 1.4  # times the distance, to see it again


class Sender:
    """The sender's course and what it does with every frame and message."""

    def __init__(
        self,
        session: RoleSession,
        store: RecordStore,
        told: PlaceTold | None = None,
    ) -> None:
        """``told``: where the target is; None: what the rig's mission says."""
        rig = session.rig
        config = session.config
        self._session = session
        self._config: MissionConfig = config
        self._camera = rig.sender.camera
        self._camera_pose = CameraPose(session.vehicle, rig.sender.mount)
        self._tilt = Tilt()
        # the camera's optical axis in the body frame
        axis_b = rig.sender.mount.T_b_c.R[:, 2]
        ahead, right, down = axis_b.tolist()
        self._axis_b: Vec3 = (ahead, right, down)
        self._heading_rad = math.radians(config.heading_deg)
        self._track: TargetTrack | None = None
        self._largest = LargestBox.of(self._camera, rig.method)
        self._look_round = LookRound(config)
        self._ranging = Ranging.of(config, rig.method)
        self._designating = Designating(
            session,
            self._camera,
            self._look_round,
            self._pointed_at,
            told,
            ranging=self._ranging,
        )
        self._watching = True
        self._leaving = False
        self._handover = SenderHandover(session, store)
        self._side: SenderSide | None = None
        # as measured on the marker: -1 left of D1, 1 right
        self._receiver_side: float | None = None
        self._keyframes = KeyframesOut(session) if rig.method.common_view else None
        self._candidates = 0
        self._way_out: Anchor | None = None
        self._around: Sequence[Seen] = ()  # until there is a target
        session.bodies = self._bodies
        session.on_message = self._on_message
        session.on_status = self._handover.on_status
        session.on_step = self._on_step

    # --- course

    async def course(self) -> None:
        await self._handover.resume()
        await preflight(self._session)
        await self._handover.until_free()
        self._session.note_home(self._config.target.home_m)
        await take_off(self._session, self._config.take_off_height_m)
        await self.acquire()
        await self.hand_over()

    async def acquire(self) -> None:
        """Find the target from the air above the take-off place, until it is tracked."""
        session = self._session
        deadlines = self._config.deadlines
        session.enter(Phase.ACQUIRE)
        session.spawn(self._watch())
        await session.look_about()
        session.pilot.guidance = self._to_first_place
        listening = session.spawn(self._designating.listen())
        await self._until_acquired(deadlines.acquire_s)
        listening.cancel()
        self._designating.stop()

    async def _until_acquired(self, timeout_s: float) -> None:
        """Wait for a target. Raises MissionEnd(TARGET_NOT_FOUND) with what was seen, and what would
        have told.
        """
        loop = asyncio.get_running_loop()
        end_s = loop.time() + timeout_s
        while self._track is None:
            if loop.time() > end_s:
                why = self._designating.why()
                raise MissionEnd(Outcome.TARGET_NOT_FOUND, f"within {timeout_s:.0f} s: {why}")
            await asyncio.sleep(_ACQUIRED_POLL_S)

    async def hand_over(self) -> None:
        """Follow the tracked target, and offer it, until the other drone is known to hold it."""
        session = self._session
        deadlines = self._config.deadlines
        session.enter(Phase.FOLLOW, "target acquired, waiting for the receiver")
        session.observing = True
        await self._handover.offer()
        self._begin_attempt()
        session.pilot.guidance = self._follow_target
        session.spawn(self._watch_peer())
        if self._keyframes is not None:
            session.spawn(self._keyframes.run())
        await session.until(
            lambda: self._candidates > 0,
            deadlines.receiver_ready_s,
            Outcome.NO_AGREEMENT,
            "the receiver never sent a candidate",
        )

        session.enter(Phase.VERIFY)
        await self._handover.until_decided(deadlines.verify_s, self._begin_attempt)
        session.say("handed over")
        # not behind the target: a receiver that died hangs beside it
        session.pilot.guidance = self._leave_watching
        await self._handover.until_settled()
        session.observing = False

    def _begin_attempt(self) -> None:
        """A count of its own for every epoch."""
        session = self._session
        config = self._config
        attempt = AttemptId(
            config.handoff_id,
            self._handover.epoch,
            config.target_id,
        )
        cameras = PairCameras.of(session.rig)
        self._side = SenderSide(cameras, session.rig.method, attempt)
        record = attempt_record(attempt)
        session.log.write("/attempt", session.now_ns(), record)

    def _bodies(self) -> Sequence[Body]:
        """Return what this drone tracks, to keep out of its way."""
        now_ns = self._session.now_ns()
        if self._track is None:
            return seen(self._around, self._config, now_ns)
        return followed(self._track, self._config, now_ns)

    async def recover(self, end: MissionEnd | None) -> bool:
        self._leaving = True
        self._handover.end(end)
        self._session.say_if_unfollowed(end)
        way_out = self._leave()
        landed = await self._come_down(end, way_out)
        await self._handover.finish()
        return landed

    async def _come_down(
        self,
        end: MissionEnd | None,
        way_out: Anchor,
    ) -> bool:
        """Bring the vehicle down, and return whether the script landed it."""
        return await bring_down(self._session, end, way_out)

    def _leave(self) -> Anchor:
        """Return the place to go to before landing: away from the receiver, sideways, the same
        however often asked.

        It is so far away that the target cannot be under this drone before it is down, or twice the
        usual way.
        """
        if self._way_out is None:
            self._way_out = self._planned_way_out()
        return self._way_out

    def _planned_way_out(self) -> Anchor:
        state = self._session.vehicle.state
        yaw_rad = yaw_of(state.q_n_b)
        here = state.position_n_m
        if self._track is None:
            return Anchor(here, yaw_rad)
        side = self._side_of_receiver(state)
        other_side_h = (0.0, -side, 0.0)  # away from the receiver
        aside = from_heading(other_side_h, self._heading_rad)
        away_m = way_out_m(
            self._track,
            here,
            aside,
            self._config,
            self._session.now_ns(),
            self._config.depart_m,
        )
        out = scale(aside, away_m)
        return Anchor(add(here, out), yaw_rad)

    def _side_of_receiver(self, state: VehicleState) -> float:
        """-1 left, 1 right; by both drones' own positions until it was measured on the marker."""
        if self._receiver_side is not None:
            return self._receiver_side
        session = self._session
        peer = self._session.peer
        if peer is None:
            return -1.0
        # a receiver that died flew on at first, as it was flying when it was last heard
        longest_s = self._config.guard.near_silence_s
        flown_on_s = min(session.peer_silence_s(), longest_s)
        flown_on = scale(peer.velocity_n_mps, flown_on_s)
        heard_at = session.here(peer).position_n_m
        receiver = add(heard_at, flown_on)
        offset_n = subtract(receiver, state.position_n_m)
        _, right_m, _ = from_heading(offset_n, -self._heading_rad)
        return 1.0 if right_m > 0.0 else -1.0

    def _may_regain(self) -> bool:
        """Return whether there is room to back off: the receiver is not on its way to this drone
        yet.
        """
        peer = self._session.peer
        if peer is None:
            return True
        return not Phase.STAND_OFF.reached(peer.phase)

    def _comes_near(self) -> bool:
        """Return whether the receiver is near this drone, or was closing in on it when it was last
        heard.
        """
        session = self._session
        peer = session.peer
        if session.phase is Phase.VERIFY:
            return True
        if peer is None:
            return False
        return Phase.APPROACH.reached(peer.phase)

    def _regaining(self) -> bool:
        """The target was out of sight for a while: more of the ground is seen from farther off."""
        track = self._track
        if track is None or not self._may_regain():
            return False
        unseen_ns = self._session.now_ns() - track.stamp_ns
        coast_s = self._config.deadlines.target_coast_s
        return unseen_ns * 1e-9 > 0.5 * coast_s

    def _to_first_place(self, state: VehicleState) -> VelocitySetpoint:
        """Lead to where all the ground is in view that the target can be on, and round it where
        nothing is found.
        """
        session = self._session
        look_round = self._look_round
        now_ns = session.now_ns()
        went = look_round.going
        there, wider = self._place_to_look_at(now_ns)
        if self._track is None:
            viewpoint = self._view_of(there, wider)
            left_m = math.dist(viewpoint, state.position_n_m)
            look_round.step(now_ns, left_m, there)
            self._heading_rad = look_round.heading_rad
        if look_round.going and not went:
            session.say("nothing was found from here: looks from other sides")
        target_moves = self._designating.moves(now_ns)
        moves = add(target_moves, look_round.velocity_n_mps)
        # Once more: by the heading that was just set.
        viewpoint = self._view_of(there, wider)
        way = self._approach(viewpoint, moves, state)
        yaw_rad = look_round.yaw_rad(state.position_n_m, there)
        if session.fence.obstacles:
            yaw_rad = bearing(subtract(there, state.position_n_m))
        return replace(way, yaw_rad=yaw_rad)

    def _approach(
        self,
        place_n_m: Vec3,
        velocity_n_mps: Vec3,
        state: VehicleState,
    ) -> VelocitySetpoint:
        """To a moving place, and to rest there: past it the target would be below the image."""
        follow = self._config.follow
        error = self._session.fence.towards(place_n_m, state.position_n_m)
        spare_mps2 = spare_accel(
            self._config.max_accel_mps2,
            norm(velocity_n_mps),
            follow.target_accel_mps2,
            follow.response_s,
        )
        answer = follow.answer(spare_mps2)
        velocity = approach(error, state.velocity_n_mps, velocity_n_mps, answer)
        return VelocitySetpoint(velocity, self._heading_rad)

    def _view_of(
        self,
        target_n_m: Vec3,
        wider: float = 1.0,
    ) -> Vec3:
        """Behind and above the target, in the heading it was approached with; a drone that is
        tilted stands aside.

        However far up a target seems to be, it is below the fence. ``wider``: times as far off as
        usual.
        """
        keep = self._config.follow
        guard = self._config.guard
        heading_rad = self._heading_rad
        if self._regaining():
            wider = max(wider, _WIDER)
        above_target_m = keep.height_m - self._config.target.height_m
        below_m = wider * above_target_m
        behind_m = wider * keep.behind_m
        behind = from_heading((-behind_m, 0.0, -below_m), heading_rad)
        aside = self._tilt.aim(
            self._axis_b,
            heading_rad,
            below_m,
        )
        place = add(target_n_m, behind)
        place = add(place, aside)
        highest_m = guard.fence_height_m - BELOW_FENCE_M
        place = within_fence(place, math.inf, highest_m)
        if self._session.fence.confines:
            return self._session.fence.nearest(place)
        return place

    def _follow_target(self, state: VehicleState) -> VelocitySetpoint:
        """Keep the target in view from behind."""
        assert self._track is not None
        session = self._session
        silence_s = session.peer_silence_s()
        is_silent = silence_s > self._config.guard.near_silence_s
        if is_silent and self._comes_near():
            # The receiver may hang or sink where it was last, and the target may lead there.
            return VelocitySetpoint((0.0, 0.0, 0.0), self._heading_rad)

        now_ns = session.now_ns()
        target, velocity = self._track.believed(now_ns)
        north, east, down = velocity
        if not self._config.target.flies:
            down = 0.0
        moves = (north, east, down)
        self._turn_where_there_is_room(target)
        place = self._view_of(target)
        left_m = math.dist(place, state.position_n_m)
        slower_mps = math.dist(state.velocity_n_mps, moves)
        self._look_round.settle(left_m, slower_mps)
        way = self._approach(place, moves, state)
        yaw_rad = self._look_round.yaw_rad(state.position_n_m, target)
        if session.fence.obstacles:
            yaw_rad = bearing(subtract(target, state.position_n_m))
        return replace(way, yaw_rad=yaw_rad)

    def _turn_where_there_is_room(self, target_n_m: Vec3) -> None:
        """Turn the heading to follow with so that obstacles leave room for both drones, and hide
        nothing.
        """
        fence = self._session.fence
        if not fence.obstacles:
            return
        keep = self._config.follow
        above_m = keep.height_m - self._config.target.height_m
        aside_m = _SLANT * self._config.separation.viewpoint_m
        behind = np.array(
            [
                (-keep.behind_m, 0.0, -above_m),
                (-keep.behind_m - aside_m, 0.0, -above_m - aside_m),
            ]
        )
        step_rad = _TURN_RADPS / self._config.control_hz
        self._heading_rad = free_heading(fence, target_n_m, behind, self._heading_rad, step_rad)

    def _leave_watching(self, state: VehicleState) -> VelocitySetpoint:
        """Make room, the camera still on the target: nobody has it for sure until the hand-over is
        settled.
        """
        assert self._track is not None
        now_ns = self._session.now_ns()
        target, _ = self._track.predict(now_ns)
        way_out = self._leave()
        way = way_out.hold(state, towards=self._session.fence.towards)
        to_target = subtract(target, state.position_n_m)
        yaw_rad = bearing(to_target)
        return replace(way, yaw_rad=yaw_rad)

    # --- what runs beside the course

    async def _watch(self) -> None:
        """Look at every frame while the receiver is near, else at some. Raises CameraError when the
        camera stops.
        """
        session = self._session
        while self._watching:
            oldest_s = self._config.guard.frame_age_s
            view = await session.frames.view(oldest_s)
            R_n_b = self._camera_pose.R_n_b(view.stamp_ns)
            self._tilt.note(R_n_b)
            self._note_ground()
            session.note_steps()  # before what this frame shows is added to what others showed
            if self._config.guard.unmeasured:
                session.note_standing(view, self._camera_pose.T_n_c(view.stamp_ns, R_n_b))
            if self._leaving:
                self._look_out(view, R_n_b)
                await asyncio.sleep(1.0 / self._config.status_hz)
            elif self._track is None:
                if session.frames.recorded:
                    self._log_view(view, R_n_b)
                self._try_to_acquire(view, R_n_b)
            else:
                self._cycle_once(view, R_n_b, self._track)
            is_verifying = session.phase is Phase.VERIFY
            if not is_verifying and not self._is_sought():
                await session.skip_frames()

    def _look_out(self, view: View, R_n_b: Matrix) -> None:
        """Keep up what is tracked, while this drone comes down."""
        T_n_c = self._camera_pose.T_n_c(view.stamp_ns, R_n_b)
        if self._track is None:
            self._around = self._designating.watch(view, T_n_c)
        else:
            follow(view, T_n_c, self._camera, self._track)

    def _is_sought(self) -> bool:
        """Return whether the receiver looks for this drone's marker already, or is nearer."""
        peer = self._session.peer
        if peer is None:
            return False
        return Phase.SEARCH.reached(peer.phase)

    def _note_ground(self) -> None:
        """Keep up what is known of the ground below, for ranging what stands on it."""
        session = self._session
        session.note_ground()
        if self._config.target.flies:
            return
        if session.ground is not None:
            self._ranging.ground = session.ground.ground

    async def _watch_peer(self) -> None:
        """The receiver must be heard for as long as the hand-over is undecided."""
        while not self._handover.handed_over:
            if not self._handover.released:
                self._session.require_peer()
            await asyncio.sleep(_PEER_POLL_S)

    def _try_to_acquire(self, view: View, R_n_b: Matrix) -> None:
        # whoever says which object is meant looks at it too
        self._session.frames.log_image(view)
        T_n_c = self._camera_pose.T_n_c(view.stamp_ns, R_n_b)
        taken = self._designating.look(view, T_n_c)
        if taken is None:
            return
        track = TargetTrack.of(
            self._config,
            taken.position_n_m,
            view.stamp_ns,
            self._largest,
            self._ranging,
        )
        track.velocity_n_mps = taken.velocity_n_mps
        self._track = track
        here = self._session.vehicle.state.position_n_m
        self._heading_rad = self._look_round.found(here, taken.position_n_m)
        if self._session.fence.obstacles:
            # From the side where it was led to: the way round to another could pass the target.
            self._heading_rad = bearing(subtract(taken.position_n_m, here))

    def _place_to_look_at(self, now_ns: int) -> tuple[Vec3, float]:
        """The place to look at until there is a target, and how many times as far off as usual."""
        return self._designating.where(now_ns)

    def _pointed_at(self) -> PlaceTold | None:
        """What somebody says who goes on pointing at the target; None: the mission's
        designation.
        """
        return None

    def _cycle_once(
        self,
        view: View,
        R_n_b: Matrix,
        track: TargetTrack,
    ) -> None:
        """One cycle of PATH: follow the box, say where the target is, judge the receiver's
        answers.
        """
        session = self._session
        stamp_ns = view.stamp_ns
        with session.stage("target"):
            T_n_c = self._camera_pose.T_n_c(stamp_ns, R_n_b)
            seen = follow(
                view,
                T_n_c,
                self._camera,
                track,
            )
        is_seen = isinstance(seen, Sighting)
        if is_seen and self._config.level_ground:
            _, _, target_down_m = track.position_n_m
            session.note_height(target_down_m + self._config.target.height_m)

        unseen_ns = stamp_ns - track.stamp_ns
        unseen_s = unseen_ns * 1e-9
        deadlines = self._config.deadlines
        bearable_s = deadlines.target_coast_s + deadlines.target_regain_s
        is_lost = unseen_s > bearable_s
        if is_lost and not self._handover.handed_over:
            raise MissionEnd(Outcome.TARGET_LOST, f"target not seen for {unseen_s:.1f} s")

        side = self._side
        if side is None:
            self._log_view(view, R_n_b)
            record = track_record(seen)
            session.log.write("/track", stamp_ns, record)
            return

        if self._keyframes is not None and self._receiver_looks():
            self._keyframes.offer(view, T_n_c.R)
        with session.stage("projection"):
            gravity_v = self._camera_pose.gravity_v(R_n_b)
            frame = side.observe(
                view.frame_id,
                stamp_ns,
                seen,
                gravity_v,
            )
        if isinstance(frame.message, Target):
            with session.stage("link"):
                session.link.send(frame.message)
        now_ns = session.now_ns()
        with session.stage("log"):
            self._log_view(view, R_n_b)
            self._log_frame(view, frame, now_ns)
        with session.stage("agreement"):
            pairs = side.judge(now_ns)
        with session.stage("log"):
            for pair in pairs:
                self._note_pair(pair, side)
        if side.gate.complete and not self._handover.released:
            session.frames.log_image(view, wanted=True)
            self._handover.agreed(self._config.target_id)

    def _receiver_looks(self) -> bool:
        """Return whether the receiver looks for this drone, or verifies with it."""
        peer = self._session.peer
        looks = peer is not None and Phase.STAND_OFF.reached(peer.phase)
        return looks and not self._handover.released

    # --- messages and records

    def _on_message(self, received: Received) -> None:
        message = received.message
        if isinstance(message, Candidate):
            self._on_candidate(message)
        self._handover.on_message(received)

    def _on_step(self, stamp_ns: int) -> None:
        """Of either drone's estimator: what agreed before and what agrees after it are not added
        up.
        """
        if self._side is not None:
            self._side.begin_evidence_anew(stamp_ns)

    def _on_candidate(self, candidate: Candidate) -> None:
        session = self._session
        side = self._side
        if side is None or not session.alignment.ready:
            return
        capture_ns = session.alignment.to_own_ns(candidate.capture_ns)
        now_ns = session.now_ns()
        missed = side.hear(candidate, capture_ns, now_ns)
        record = heard_candidate_record(candidate, capture_ns)
        session.log.write("/heard_candidate", now_ns, record)
        if missed is not None:
            return
        self._candidates += 1
        if candidate.box is not None:
            x, y, z = candidate.position_v_m
            self._receiver_side = 1.0 if x > 0.0 else -1.0
            separation2 = x * x + y * y + z * z
            session.shown.separation_m = math.sqrt(separation2)

    def _note_pair(self, pair: PairVerdict, side: SenderSide) -> None:
        """Log one verdict and show it."""
        session = self._session
        shown = session.shown
        count, evidence = counted(pair, side.gate)
        shown.count = count
        shown.evidence = evidence
        shown.iou = pair.verdict.iou
        record = side.record(pair)
        session.log.write("/agreement", session.now_ns(), record)

    def _log_view(self, view: View, R_n_b: Matrix) -> None:
        session = self._session
        T_n_c = None
        if session.frames.recorded:
            T_n_c = self._camera_pose.T_n_c(view.stamp_ns, R_n_b)
        ground = self._ranging.ground
        record = frame_record(
            view,
            session.now_ns(),
            T_n_c,
            ground,
        )
        session.log.write("/frame", view.stamp_ns, record)

    def _log_frame(
        self,
        view: View,
        frame: OwnFrame,
        now_ns: int,
    ) -> None:
        session = self._session
        record = target_record(frame, now_ns)
        session.log.write("/target", view.stamp_ns, record)
        session.frames.log_image(view)

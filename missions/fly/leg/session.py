"""The session that both roles share: parts, the link pump, status, clocks, waits, and the end of a
mission.
"""

from __future__ import annotations

import asyncio
import math
import random
import sys
import traceback
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from drivers.interfaces import (
    CameraError,
    Clock,
    Link,
    LinkError,
    Log,
    Perception,
    Received,
    StateError,
    TakenOver,
    Vehicle,
    VehicleError,
    VehicleState,
    VelocitySetpoint,
    View,
)  # fmt: skip
from drivers.link.flood import LinkAlarm
from drivers.operator.interfaces import Operator
from drivers.rig.parts import Rig, RoleRig, ended_by
from drivers.stages import Stages
from flight.clocks import ClockAlignment, ClockConfig, answer
from flight.config import MissionConfig, off_from
from flight.fence import Fence
from flight.ground_below import GroundBelow
from flight.guard.under_guard import UnderGuard
from flight.guidance import Anchor, Vec3, add, subtract
from flight.harness.flights import Emit, Progress
from flight.keep_out import Body
from flight.obstacles.seen import SeenObstacles, points_seen
from flight.outcome import MissionEnd, Outcome, name_of
from flight.phases import Phase
from flight.pilot import Pilot
from flight.steady_vehicle import SteadyVehicle
from missions.fly.leg.alike import alike_of
from missions.fly.leg.frames import Frames
from missions.fly.leg.guarding import Guarding
from missions.ground.journal import estimator_step_record, peer_record
from path.alike import Alike
from path.gate.window import Evidence
from path.geometry.rotation import wrapped, yaw_of
from path.geometry.transforms import Pose
from path.messages import STEPS, Ping, Pong, Role, Status
from path.protocol.values import TakeResponsibility

Result = TypeVar("Result")

_NO_STAGE = nullcontext()
_POLL_S = 0.05
# of what a drone sees standing about: times its diameter, of a cell, and of what is tall
_CELL = 0.4
_TALL = 0.6
_STANDING_NS = 250_000_000
_ABOUT_S = 6.0  # once round
_GOODBYES = 5
_GOODBYE_S = 0.05
_PROGRESS_PERIOD_S = 0.2
_ENDS = (
    (CameraError, Outcome.CAMERA_LOST),
    (TakenOver, Outcome.PILOT_OVERRIDE),  # before what it is a kind of
    (VehicleError, Outcome.VEHICLE_REFUSED),
    (LinkError, Outcome.PEER_LOST),
    (StateError, Outcome.STATE_LOST),
)


def _ignore(_: object) -> None:
    pass


@dataclass(slots=True)
class ConsoleLine:
    """The console's view of the handshake; the role keeps it current."""

    count: int = 0
    evidence: Evidence | None = None
    iou: float | None = None
    tau: float | None = None
    separation_m: float | None = None
    note: str = ""


class RoleSession:
    """One role's open parts and its shared machinery. Made by ``open_session``."""

    def __init__(
        self,
        rig: Rig,
        role: Role,
        config: MissionConfig,
        log: Log,
        emit: Emit,
        stop: asyncio.Event,
        parts: tuple[Clock, Vehicle, Perception, Link],
        entropy: random.Random,
        guard: UnderGuard | None = None,
        stages: Stages | None = None,
    ) -> None:
        self.guarding = Guarding(self, guard)
        self.stages = stages  # None in virtual time, in which logs tell nothing of the machine
        self.rig = rig
        self.role = role
        self.own: RoleRig = rig.role(role)
        self.config = config
        self.log = log
        self.stop = stop
        self.entropy = entropy
        self._link_alarm = LinkAlarm()
        self.clock, vehicle, self.perception, self.link = parts
        self.vehicle = SteadyVehicle.of(vehicle, config)
        self.frames = Frames(self.perception, self.clock, config, log)
        self.pilot = Pilot(self.vehicle, self.clock, config, log, guard)
        self.alignment = ClockAlignment(ClockConfig(max_uncertainty_s=config.clock_uncertainty_s))
        self._site = self.pilot.fence  # without what this drone sees
        self._standing: SeenObstacles | None = None
        if config.guard.unmeasured:
            wide_m = config.separation.horizontal_m
            self._standing = SeenObstacles(_CELL * wide_m, _TALL * wide_m)
        self._stood_ns = 0
        self.phase = Phase.PREFLIGHT
        self.shown = ConsoleLine()
        self.peer: Status | None = None
        self.peer_heard_ns = 0
        self._peer_logged_ns = 0  # its own clock's: a status is logged once
        self.claim: TakeResponsibility | None = None
        self.instance: Callable[[], int] = int  # what a Status of this drone names
        self.alike = alike_of(rig, config.separation)
        self.peer_alike: Alike | None = None  # the newest that was said
        self._peer_end_told = ""
        self.observing = False
        self.operator: Operator | None = None  # who says which object is meant; a receiver has none
        # of this drone's own position, as at home; its height as it is now
        self.off_n_m: Vec3 = (0.0, 0.0, 0.0)
        self.ground = GroundBelow(rig.height) if rig.height is not None else None
        self._here: tuple[Status, Status] | None = None  # as it came, and in this drone's frame
        self.on_message: Callable[[Received], None] = _ignore
        self.on_status: Callable[[Status], None] = _ignore
        self.on_step: Callable[[int], None] = _ignore
        # what the role tracks, to keep out of its way
        self.bodies: Callable[[], Sequence[Body]] = tuple
        self._peer_steps: dict[tuple[Role, int], int] = {}
        # what this drone's course ended in; the other drone is told
        self.end: MissionEnd | None = None
        self.ended_s: float | None = None  # when it did, by the loop's time
        self.ended: asyncio.Future[MissionEnd] = asyncio.get_running_loop().create_future()
        self._steps_told = len(self.vehicle.steps)
        self._spawned: list[asyncio.Task[None]] = []
        self._emit = emit
        self._pings = 0
        self._traffic: list[tuple[float, int]] = []

    @property
    def fence(self) -> Fence:
        """Return the space in which this drone may be, in its own coordinates."""
        return self.pilot.fence

    def note_standing(self, view: View, T_n_c: Pose) -> None:
        """Keep off what this drone's depth camera sees standing about, where a site is not all
        measured.
        """
        standing = self._standing
        due_ns = self._stood_ns + _STANDING_NS
        if standing is None or not self.pilot.in_control or view.stamp_ns < due_ns:
            return
        self._stood_ns = view.stamp_ns
        bodies = self.bodies()
        apart_m = self.config.separation.minimum_m
        moving = [(*body.place_n_m[:2], apart_m + body.half_m) for body in bodies]
        if self.peer is not None:
            north, east, _ = self.here(self.peer).position_n_m
            unsure_m = self.config.rendezvous.positions_within_m
            moving.append((north, east, apart_m + unsure_m))
        standing.note(points_seen(view, self.own.camera, T_n_c), moving)
        north, east, _ = self.vehicle.state.position_n_m
        seen = standing.obstacles((north, east))
        self.pilot.fence = replace(self._site, obstacles=(*self._site.obstacles, *seen))

    async def look_about(self) -> None:
        """Turn once round on the spot, where a site is not all measured: a camera sees only what is
        ahead.
        """
        if self._standing is None:
            return
        state = self.vehicle.state
        here = Anchor(state.position_n_m, yaw_of(state.q_n_b))
        began_ns = self.now_ns()

        def turning(state: VehicleState) -> VelocitySetpoint:
            turned_rad = math.tau * (self.now_ns() - began_ns) * 1e-9 / _ABOUT_S
            return replace(here.hold(state), yaw_rad=wrapped(here.yaw_rad + turned_rad))

        self.pilot.guidance = turning
        await asyncio.sleep(_ABOUT_S)

    # --- time and waiting

    def now_ns(self) -> int:
        return self.clock.now_ns()

    def note_home(self, home_m: tuple[float, ...] | None) -> None:
        """Takes what this drone's position is off, where it stands, for what it will be off."""
        north, east = off_from(home_m, self.vehicle.state.position_n_m)
        self.off_n_m = (north, east, 0.0)
        self._site = self.pilot.fence = self.config.fence.shifted(north, east)
        self._here = None
        self.log.write("/home", self.now_ns(), {"off_m": (north, east)})
        self.note_ground()  # it stands on it

    def note_height(self, off_down_m: float) -> None:
        """Takes what a target that stands on level ground is too low by for what this drone is too
        low by itself.
        """
        north, east, _ = self.off_n_m
        self.off_n_m = (north, east, off_down_m)
        self._here = None

    def note_ground(self) -> None:
        """Take what the vehicle says now of the ground below it, and tell the crew what contradicts
        itself.
        """
        said = "" if self.ground is None else self.ground.note(self.vehicle.state)
        if said:
            self.say(said)

    def note_steps(self) -> None:
        """Tell what the estimator stepped by since the last time, to the log, the crew and the
        role.
        """
        _ = self.vehicle.state  # whose steps are those of the states that were asked for
        new = self.vehicle.steps[self._steps_told :]
        self._steps_told += len(new)
        for step in new:
            self.log.write("/estimator_step", step.stamp_ns, estimator_step_record(step))
            self.say(f"ALARM: the estimator stepped: {step}; the flight goes on as if it had not")
            self.on_step(step.stamp_ns)

    def _note_peer_steps(self, status: Status) -> None:
        """What the other drone told lately is of its frame before the step, or after it: nothing
        says which.
        """
        who = status.role, status.instance
        before = self._peer_steps.get(who, status.steps)
        self._peer_steps[who] = status.steps
        # One that was started again counts from nothing: that is no step.
        if 0 < (status.steps - before) % STEPS < STEPS // 2:
            now_ns = self.now_ns()
            self.log.write("/peer_step", now_ns, {"steps": status.steps})
            self.say("ALARM: the other drone's estimator stepped")
            self.on_step(now_ns)

    def _note_peer_end(self) -> None:
        """Tell the crew what the other drone's flight has ended in, each end once: on this console
        too they read the cause.
        """
        if self.peer is not None and self.peer_left not in ("", self._peer_end_told):
            self._peer_end_told = self.peer_left
            had = "; it has the target, and follows it no more" if self.peer.responsible else ""
            self.say(f"the other drone: {self.peer_left}{had}")

    def say_if_unfollowed(self, end: MissionEnd | None) -> None:
        """Tell the crew that the target is this drone's, and that it follows it no more."""
        if end is not None and self.responsible:
            self.say("this drone has the target, and follows it no more: nobody does")

    def here(self, peer: Status) -> Status:
        """The other drone's Status, its position in this drone's own frame: each tells it without
        what it is off.
        """
        # it is asked many times for each Status
        if self._here is None or self._here[0] is not peer:
            self._here = peer, replace(peer, position_n_m=add(peer.position_n_m, self.off_n_m))
        return self._here[1]

    def peer_silence_s(self) -> float:
        return (self.now_ns() - self.peer_heard_ns) * 1e-9

    def require_peer(self) -> None:
        """Raise MissionEnd: PEER_ABORTED when the other drone's flight has ended, with what in;
        PEER_LOST when it was not heard for too long. Near it that is sooner.
        """
        if self.peer_left:
            raise MissionEnd(Outcome.PEER_ABORTED, f"the other drone: {self.peer_left}")
        guard = self.config.guard
        limit_s = guard.near_silence_s if self.phase is Phase.VERIFY else guard.peer_silence_s
        silence_s = self.peer_silence_s()
        if silence_s > limit_s:
            raise MissionEnd(
                Outcome.PEER_LOST, f"nothing heard from the other drone for {silence_s:.1f} s"
            )

    @property
    def peer_left(self) -> str:
        """What the other drone's flight ended in, in words, as far as it was heard to say; empty
        while it goes on.
        """
        peer = self.peer
        return (
            f"its flight has ended: {name_of(peer.ended)}"
            if peer is not None and peer.ended
            else ""
        )

    async def say_goodbye(self) -> None:
        """Tell the other drone, which may be waiting, how this flight has ended; a few times, as a
        link loses some.
        """
        if self.end is None:
            return
        for _ in range(_GOODBYES):
            self.link.send(self._status())
            await asyncio.sleep(_GOODBYE_S)

    async def until(
        self,
        condition: Callable[[], bool],
        timeout_s: float,
        outcome: Outcome,
        detail: str | Callable[[], str],
    ) -> None:
        """Wait for a condition; raises MissionEnd(outcome) when it did not come true in time.

        ``detail``: what to say then, or what is asked for it then.
        """
        loop = asyncio.get_running_loop()
        end_s = loop.time() + timeout_s
        while not condition():
            if loop.time() > end_s:
                said = detail if isinstance(detail, str) else detail()
                raise MissionEnd(outcome, f"{said} within {timeout_s:.0f} s")
            await asyncio.sleep(_POLL_S)

    async def skip_frames(self) -> None:
        """Let frames pass: following alone needs only ``follow_hz`` of them a second."""
        await asyncio.sleep(0.8 / self.config.follow_hz)

    def note_separation(self, distance_m: float) -> None:
        """Between the two bodies, as it was just measured."""
        self.shown.separation_m = distance_m
        self.guarding.note_separation(distance_m)

    # --- processor time

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Returns a context whose body is a stage of a frame's cycle; stages do not contain one
        another.
        """
        return _NO_STAGE if self.stages is None else self.stages(name)

    # --- what the others see

    def enter(self, phase: Phase, note: str = "") -> None:
        self.phase = phase
        self.shown.note = note
        self.log.write("/phase", self.now_ns(), {"phase": phase.title, "note": note})
        self.show()

    def say(self, note: str) -> None:
        """One line for the crew."""
        self.shown.note = note
        self.log.write("/note", self.now_ns(), {"note": note})
        self.show()

    @property
    def clocks_known(self) -> str:
        """Return how well the other drone's clock is known, and what would be needed, in words."""
        alignment = self.alignment
        needed_s = self.config.clock_uncertainty_s
        return (
            f"known to {alignment.uncertainty_at(self.now_ns()) * 1e-9:.3f} s by {alignment.samples} pings,"
            f" mission.clock_uncertainty_s = {needed_s:g} s is needed; half a round trip is the bound,"
            " so say [link] latency_s in the rig"
        )

    @property
    def responsible(self) -> bool:
        """Returns whether this drone is responsible at this very instant.

        A lease that is over is over, whatever was slept through.
        """
        return self.responsible_at(self.now_ns())

    def responsible_at(self, now_ns: int) -> bool:
        return self.claim is not None and self.claim.at(now_ns)

    def set_claim(self, claim: TakeResponsibility | None) -> None:
        """Sets what this drone is responsible by from now on; None: it is not."""
        self.claim = claim
        record = {
            "responsible": claim is not None,
            "until_ns": None if claim is None else claim.until_ns,
        }
        self.log.write("/responsibility", self.now_ns(), record)

    def show(self) -> None:
        counters = self.link.counters
        evidence = self.shown.evidence
        self._emit(
            Progress(
                role=self.role,
                stamp_ns=self.now_ns(),
                phase=self.phase.title,
                count=self.shown.count,
                needed=self.rig.method.needed_pairs,
                iou=self.shown.iou,
                tau=self.shown.tau,
                separation_m=self.shown.separation_m,
                link_bytes_per_s=self._bytes_per_s(counters.bytes_sent + counters.bytes_received),
                responsible=self.responsible,
                note=self.shown.note,
                evidence=(evidence.reached, evidence.needed) if evidence else None,
            )
        )

    def _bytes_per_s(self, total: int) -> float:
        now_s = asyncio.get_running_loop().time()
        self._traffic.append((now_s, total))
        while now_s - self._traffic[0][0] > 2.0:
            self._traffic.pop(0)
        first_s, first = self._traffic[0]
        return (total - first) / (now_s - first_s) if now_s > first_s else 0.0

    # --- background tasks

    async def pump(self) -> None:
        """Take messages from the link for ever: clocks and status here, the rest to the role."""
        while True:
            received = await self.link.receive()
            self.peer_heard_ns = received.arrival_ns
            message = received.message
            if isinstance(message, Ping):
                self.link.send(answer(message, received.arrival_ns, self.now_ns()))
            elif isinstance(message, Pong):
                self.alignment.on_pong(message, received.arrival_ns)
            elif isinstance(message, Status):
                self.peer = message
                self._note_peer_steps(message)
                self._note_peer_end()
                self.peer_alike = message.alike or self.peer_alike
                self.on_status(message)
            else:
                self.on_message(received)

    async def report(self) -> None:
        """Send Status and Ping, and tell the console, for ever. Raises MissionEnd when a clock was
        stepped.
        """
        rate_hz = (
            self.config.status_hz if self.role is Role.SENDER else self.config.receiver_status_hz
        )
        period_s = 1.0 / rate_hz
        pings_every = max(1, round(rate_hz / self.config.ping_hz))
        shows_every = max(1, round(_PROGRESS_PERIOD_S / period_s))
        tick = 0
        while True:
            self.link.send(self._status())
            if self.alignment.fault:
                raise MissionEnd(
                    Outcome.CLOCK_FAULT, "the other drone's clock was stepped, or this one's"
                )
            if tick % (pings_every if self.alignment.ready else 1) == 0:
                self._pings += 1
                self.link.send(Ping(self._pings, self.now_ns()))
            if tick % shows_every == 0:
                self.show()
            if tick % round(rate_hz) == 0:
                self._log_link()
            tick += 1
            await asyncio.sleep(period_s)

    def _status(self) -> Status:
        state = self.vehicle.state
        now_ns = self.now_ns()
        return Status(
            role=self.role,
            stamp_ns=now_ns,
            position_n_m=subtract(state.position_n_m, self.off_n_m),
            velocity_n_mps=state.velocity_n_mps,
            yaw_rad=yaw_of(state.q_n_b),
            phase=int(self.phase),
            responsible=self.responsible_at(now_ns),
            observing=self.observing,
            battery=state.battery,
            instance=self.instance(),
            steps=len(self.vehicle.steps) % STEPS,
            ended=0 if self.end is None else self.end.outcome.exit_code,
            # then every byte counts, and it is known
            alike=None if self.phase is Phase.VERIFY else self.alike,
        )

    def _log_link(self) -> None:
        counters = self.link.counters
        record: dict[str, Any] = {
            "packets_sent": counters.packets_sent,
            "packets_received": counters.packets_received,
            "bytes_sent": counters.bytes_sent,
            "bytes_received": counters.bytes_received,
            "dropped": dict(counters.dropped),
            "clock_offset_ns": self.alignment.offset_ns if self.alignment.ready else None,
            "clock_uncertainty_ns": self.alignment.uncertainty_ns if self.alignment.ready else None,
        }
        self.log.write("/link", self.now_ns(), record)
        if self.peer is not None and self.peer.stamp_ns != self._peer_logged_ns:
            self._peer_logged_ns = self.peer.stamp_ns
            self.log.write("/peer", self.now_ns(), peer_record(self.peer))
        alarm = self._link_alarm.look(counters, self.now_ns())
        if alarm:
            self.say(alarm)

    def spawn(self, task: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run beside the course until the vehicle is down; an error in it ends the course."""
        spawned = asyncio.create_task(unless_exit(task))
        self._spawned.append(spawned)
        spawned.add_done_callback(self._on_done)
        return spawned

    def _on_done(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None and not self.ended.done():
            self.ended.set_result(as_end(error))

    async def cancel_spawned(self) -> None:
        for task in self._spawned:
            task.cancel()
        await asyncio.gather(*self._spawned, return_exceptions=True)

    async def stopped(self) -> None:
        await self.stop.wait()
        raise MissionEnd(Outcome.INTERRUPTED, "told to stop")


async def unless_exit(task: Awaitable[Result]) -> Result:
    """Await what a program does, and turn a ``sys.exit`` in it into a named end.

    asyncio lets SystemExit through at once: the program would be gone, with its drone in the air
    and exit code 0. Raises MissionEnd.
    """
    try:
        return await task
    except SystemExit as error:
        raise MissionEnd(Outcome.CRASHED, f"what this program calls {ended_by(error)}") from error


def as_end(error: BaseException) -> MissionEnd:
    """Any error as the named end it means. Errors nobody foresaw are printed: they are bugs."""
    if isinstance(error, MissionEnd):
        return error
    for kind, outcome in _ENDS:
        if isinstance(error, kind):
            return MissionEnd(outcome, str(error))
    traceback.print_exception(error, file=sys.stderr)
    return MissionEnd(Outcome.CRASHED, f"{type(error).__name__}: {error}")

"""The timing of a simulated camera's pictures: fixed instants of the loop's time, newest first,
none for nobody.

Perception at both sim levels is built on it, so that the two differ in what a view holds and in
nothing else.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from drivers.interfaces import CameraError, Clock
from drivers.rig.parts import PartContext
from flight.harness.renderer import Imaging
from hil.world.config import SceneName, imaging_of, scene_of
from hil.world.errors import Built, SensorErrors, StampErrors
from hil.world.seam import Freeze, PartHarness
from hil.world.snapshot import Snapshot
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.messages import Role
from path.values import frozen, value

T = TypeVar("T")

RECEIVER_PHASE = 0.37  # of a period


@frozen
class TrueCamera:
    """A role's camera and what it looks at, as they truly are. ``imaging``: None for an ideal
    sensor.
    """

    camera: CameraModel
    T_b_c: Pose
    T_b_v: Pose
    layout: MarkerLayout
    errors: SensorErrors
    scene: SceneName = "plain"
    imaging: Imaging | None = None


def true_camera(context: PartContext, built: Built | None) -> TrueCamera:
    """Return the camera that ``context`` describes, or what was built of it."""
    if built is None:
        mount = context.mount
        return TrueCamera(context.camera, mount.T_b_c, mount.T_b_v, context.layout, SensorErrors())
    own = built.rig.role(context.role)
    mounts = own.mount
    sensors = built.sensors[context.role]
    scene = scene_of(built.rig)
    imaging = imaging_of(built.rig)
    return TrueCamera(
        own.camera,
        mounts.T_b_c,
        mounts.T_b_v,
        built.rig.layout,
        sensors,
        scene,
        imaging,
    )


@frozen
class CaptureTiming:
    """Pictures at ``phase_s + k / rate_hz`` of the loop's time, each there ``latency_s`` later."""

    rate_hz: float = 50.0
    phase_s: float = 0.0
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        if not self.rate_hz > 0.0:
            raise ValueError(f"rate_hz: {self.rate_hz!r} is not above 0")
        if not self.latency_s >= 0.0:
            raise ValueError(f"latency_s: {self.latency_s!r} is below 0")

    def index_at_or_after(self, time_s: float) -> int:
        return math.ceil((time_s - self.phase_s) * self.rate_hz - 1e-6)

    def time_s(self, index: int) -> float:
        return self.phase_s + index / self.rate_hz


def timing_of(
    role: Role,
    rate_hz: float,
    phase_s: float | None,
    latency_s: float,
) -> CaptureTiming:
    """The timing of one role's camera; by default the receiver's is out of step with the sender's,
    as real ones are.
    """
    if phase_s is None:
        phase_s = 0.0 if role is Role.SENDER else RECEIVER_PHASE / rate_hz
    return CaptureTiming(rate_hz, phase_s, latency_s)


@value
class Capture(Generic[T]):
    """One picture: when (role clock), which (its index since the loop's time 0), and what came of
    it.
    """

    stamp_ns: int
    frame_id: int
    content: T


class CaptureTicker(Generic[T]):
    """Takes a picture at each instant while somebody reads, and hands out the newest one not yet
    given.

    It stops when a picture lies unread, and starts again with the next read: a camera nobody looks
    at costs nothing. ``take(snapshot, frame_id)`` makes the content at the instant of capture.
    ``skipped`` counts pictures replaced by a newer one before they were read.
    """

    def __init__(
        self,
        name: str,
        timing: CaptureTiming,
        role: Role,
        clock: Clock,
        harness: PartHarness,
        take: Callable[[Snapshot, int], T],
    ) -> None:
        self._name = name
        self._timing = timing
        self._role = role
        self._clock = clock
        self._harness = harness
        self._take = take
        sensor = SensorErrors() if harness.built is None else harness.built.sensors[role]
        self._stamps = StampErrors(sensor, timing.rate_hz)
        self._timer: asyncio.TimerHandle | None = None
        self._under_way: deque[tuple[asyncio.TimerHandle, Capture[T]]] = deque()
        self._arrived: Capture[T] | None = None
        self._arrived_s = -math.inf
        self._last: Capture[T] | None = None
        self._waiting: asyncio.Future[None] | None = None
        self._patience: asyncio.TimerHandle | None = None
        self._give_up_s = math.inf
        self._last_index = -(1 << 62)
        self.skipped = 0

    @property
    def awaited(self) -> bool:
        """Return whether somebody waits for a picture now."""
        return self._waiting is not None

    async def next(self, timeout_s: float) -> Capture[T]:
        """The newest picture not yet given. Raises CameraError when none came in time."""
        loop = asyncio.get_running_loop()
        if self._timer is None and loop.time() - self._arrived_s > 1.0 / self._timing.rate_hz:
            self._arrived = None  # from before the camera stopped for want of a reader
        if self._arrived is None:
            if self._timer is None:
                self._schedule(loop)
            self._waiting = loop.create_future()
            self._give_up_s = loop.time() + timeout_s
            self._wait_until(loop, self._give_up_s)
            try:
                await self._waiting
            finally:
                self._waiting = None
        capture = self._arrived
        self._arrived = None
        if capture is None:
            raise CameraError(
                f"no frame from {self._name} for {timeout_s:g} s", "the simulated camera is frozen"
            )
        return capture

    def close(self) -> None:
        for timer in (self._timer, self._patience):
            if timer is not None:
                timer.cancel()
        self._timer = self._patience = None
        while self._under_way:
            self._under_way.popleft()[0].cancel()
        self._arrived = self._last = None
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)  # else nobody would tell it when its time is over

    def _schedule(self, loop: asyncio.AbstractEventLoop) -> None:
        index = max(self._timing.index_at_or_after(loop.time()), self._last_index + 1)
        self._timer = loop.call_at(self._timing.time_s(index), self._on_tick, loop, index)

    def _on_tick(self, loop: asyncio.AbstractEventLoop, index: int) -> None:
        self._timer = None
        self._last_index = index
        freeze = self._harness.frozen_cameras.get(self._role)
        if freeze is None:
            snapshot = self._harness.world.snapshot()
            self._last = Capture(
                self._clock.now_ns() + self._stamps.next_ns(),
                index,
                self._take(snapshot, index),
            )
        if self._last is not None and freeze is not Freeze.SILENT:
            if self._timing.latency_s > 0.0:
                due = loop.call_at(loop.time() + self._timing.latency_s, self._on_arrival)
                self._under_way.append((due, self._last))
            else:
                self._arrive(self._last)
        # Late pictures: the next one is taken before these are read, else the latency would cost
        # frames.
        if self._waiting is not None or (self._under_way and self._arrived is None):
            self._schedule(loop)

    def _on_arrival(self) -> None:
        self._arrive(self._under_way.popleft()[1])

    def _arrive(self, capture: Capture[T]) -> None:
        if self._arrived is not None:
            self.skipped += 1
        self._arrived, self._arrived_s = capture, asyncio.get_running_loop().time()
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)

    def _wait_until(self, loop: asyncio.AbstractEventLoop, end_s: float) -> None:
        """One timer for many waits: it looks when it is due whether it still is."""
        if self._patience is not None:
            if self._patience.when() <= end_s:
                return
            self._patience.cancel()
        self._patience = loop.call_at(end_s, self._give_up, loop)

    def _give_up(self, loop: asyncio.AbstractEventLoop) -> None:
        self._patience = None
        if self._waiting is None or self._waiting.done():
            return
        if loop.time() < self._give_up_s:
            self._wait_until(loop, self._give_up_s)
        else:
            self._waiting.set_result(None)

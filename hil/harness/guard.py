"""The guard of the sim levels: the same rules behind the same loop, in this process and in virtual
time.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace
from typing import Self

from drivers.interfaces import Clock, FlightMode, Log, VehicleError
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, GuardView, Watched
from drivers.rig.parts import NoOptions, PartContext, PartSpec, create
from flight.config import MissionConfig
from flight.guard.watch import GuardWatch, watch
from hil.world.seam import harness_of

TICK_S = 0.05  # in the loop of a thousand runs; the program beside a real role ticks faster


class SimGuard:
    """A ``drivers.mavlink.guard.interfaces.Watched`` on a drone of ``hil.world.world``."""

    Config = NoOptions

    def __init__(self, config: NoOptions, context: PartContext) -> None:
        del config
        self._harness = harness_of(context.harness, "hil.harness.guard:SimGuard", VehicleError)
        self._role = context.role
        self._clock = context.clock
        self._seen: GuardView | None = None
        self._acked: bool | None = None
        self._open = False
        self.ignored: dict[str, int] = {}  # nothing else speaks here

    @property
    def name(self) -> str:
        return f"the {self._role.value}'s simulated vehicle"

    async def __aenter__(self) -> Self:
        self._open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self._open = False

    @property
    def _reached(self) -> bool:
        return self._open and self._role not in self._harness.lost_vehicles

    def view(self) -> GuardView | None:
        if not self._reached:
            return self._seen and replace(self._seen, acked=self._acked)
        drone = self._harness.world.drone(self._role)
        now_ns = self._clock.now_ns()
        autopilot = drone.autopilot
        self._seen = GuardView(
            heartbeat_ns=now_ns,
            position_ns=now_ns,
            armed=autopilot.powered,
            in_air=not autopilot.landed,
            mode=autopilot.mode,
            position_n_m=drone.position_n_m,
            battery=autopilot.battery,
            acked=self._acked,
        )
        return self._seen

    def hold(self) -> None:
        self._request(FlightMode.HOLD)

    def land(self) -> None:
        self._request(FlightMode.LAND)

    def _request(self, mode: FlightMode) -> None:
        self._acked = None
        if self._reached:
            world = self._harness.world
            self._acked = (
                world.drone(self._role).autopilot.request_mode(world.time_s, mode).accepted
            )


@dataclass(slots=True)
class MemoryGuardLine:
    """The role's end; ``cut`` when its program was killed."""

    clock: Clock
    _to: MemoryBeatLine
    name: str = "this process"
    cut: bool = False
    answered: tuple[int, GuardAnswer] | None = None
    _open: bool = False

    async def __aenter__(self) -> Self:
        self._open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self._open = False

    def beat(self, beat: Beat) -> None:
        if self._open and not self.cut:
            self._to.newest_beat = self.clock.now_ns(), beat, self

    def answer(self) -> tuple[int, GuardAnswer] | None:
        return self.answered


@dataclass(slots=True)
class MemoryBeatLine:
    """The guard's end, of all programs that one role has one after the other."""

    clock: Clock
    ignored: dict[str, int] = field(default_factory=dict[str, int])  # nothing else speaks here
    newest_beat: tuple[int, Beat, MemoryGuardLine] | None = None  # its arrival, and who sent it
    _newest: MemoryGuardLine | None = None
    _from: MemoryGuardLine | None = None

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None: ...

    def newest(self) -> tuple[int, Beat] | None:
        newest = self.newest_beat
        self.newest_beat = None
        if newest is None:
            return None
        arrival_ns, beat, self._from = newest
        return arrival_ns, beat

    def answer(self, answer: GuardAnswer) -> None:
        if self._from is not None:
            self._from.answered = self.clock.now_ns(), answer

    def role_end(self) -> MemoryGuardLine:
        """Return the role's end of the line for a program that begins."""
        self.cut()
        self._newest = MemoryGuardLine(self.clock, self)
        return self._newest

    def cut(self) -> None:
        """The program is dead."""
        if self._newest is not None:
            self._newest.cut = True


async def keep_watch(
    spec: PartSpec,
    context: PartContext,
    beats: MemoryBeatLine,
    config: MissionConfig,
    log: Log,
) -> None:
    """A drone's guard; it outlives the drone's programs, and goes on until it is cancelled."""
    vehicle: Watched = create(spec, context)
    guard = GuardWatch(vehicle, beats, context.clock, config, log)
    async with vehicle:
        await watch((guard,), asyncio.Event(), TICK_S)

"""One drone of the sim levels: what its parts and its program are connected to, and its disk."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future

from drivers.interfaces import Kept
from drivers.log.state_file import MemoryStore
from drivers.mavlink.guard.interfaces import GuardLine
from hil.harness.guard import MemoryBeatLine
from hil.link.faulty import MemoryHub
from hil.world.errors import Built
from hil.world.seam import Freeze, PartWorld
from hil.world.snapshot import Snapshot
from hil.world.world import Fleet, SimDrone
from path.messages import Role
from path.protocol.values import ReceiverRecord, SenderRecord


class Disk(MemoryStore):
    """The disk of one drone. It outlives the drone's programs; ``saved`` is told each duty that was
    written.

    Attributes:
        loses: how many of the newest records are gone when a program is started again.
    """

    def __init__(self, saved: Callable[[str], None]) -> None:
        super().__init__()
        self._saved = saved
        self._earlier: list[Kept | None] = []
        self.loses = 0
        self.writable = True  # not by a program that was killed
        # of its program, which is told of what is on the disk no sooner
        self.stands_until_s = -math.inf

    def save(self, record: SenderRecord | ReceiverRecord) -> None:
        if self.writable:
            self._earlier.append(self.kept)
            super().save(record)
            self._saved(record.duty)

    def lose(self) -> bool:
        """Loses the newest records, once; returns whether there were any to lose."""
        gone = min(self.loses, len(self._earlier))
        self.loses = 0
        for _ in range(gone):
            self.kept = self._earlier.pop()
        return gone > 0

    def begin_save(self, record: SenderRecord | ReceiverRecord) -> Future[None]:
        saved = super().begin_save(record)
        loop = asyncio.get_running_loop()
        if loop.time() >= self.stands_until_s or saved.exception() is not None:
            return saved
        told = Future[None]()
        loop.call_at(self.stands_until_s, told.set_result, None)
        return told


class PairView:
    """A world of two, for the parts of one drone."""

    def __init__(self, world: Fleet, own: str) -> None:
        self._world = world
        self._own = own
        self.other: str | None = None
        self._seen: Snapshot | None = None
        self._seen_other: str | None = None

    @property
    def time_s(self) -> float:
        return self._world.time_s

    def drone(self, role: Role) -> SimDrone:
        """Its own, whatever it is called: a part knows no other vehicle."""
        del role
        return self._world.drone(self._own)

    def snapshot(self) -> Snapshot:
        if (
            self._seen is None
            or self._seen.time_s != self._world.time_s
            or self._seen_other != self.other
        ):
            self._seen = self._world.view(self._own, self.other)
            self._seen_other = self.other
        return self._seen


class DroneHarness:
    """``PartContext.harness`` of one drone's parts, and ``flight.harness.flights.InProcess`` of its
    program.

    Args:
        view: the world as this drone's parts know it.
        advance: brings that world to the loop's present.
        seed: of the noise of its parts.
        role, hub: of the leg under way, and its link.

    Attributes:
        frozen: its camera gives nothing any more.
        silent: its vehicle hears nothing any more; ``lost``: because the vehicle's own link is cut.
        beats: the line to its guard; None when it has none.
        cut_off_s: when the harness itself stopped its setpoints.
    """

    def __init__(
        self,
        view: PartWorld,
        advance: Callable[[float], None],
        seed: int,
        built: Built,
        role: Role,
        hub: MemoryHub,
    ) -> None:
        self._view = view
        self._advance = advance
        self.seed = seed
        self.built = built
        self.role = role
        self.hub = hub
        self.beats: MemoryBeatLine | None = None
        self.frozen = self.silent = self.lost = False
        self.cut_off_s: list[float] = []

    @property
    def world(self) -> PartWorld:
        """The world at the loop's present."""
        now_s = asyncio.get_running_loop().time()
        if now_s != self._view.time_s:
            self._advance(now_s)
        return self._view

    @property
    def frozen_cameras(self) -> Mapping[Role, Freeze]:
        return dict.fromkeys(Role, Freeze.SILENT) if self.frozen else {}

    @property
    def silent_vehicles(self) -> set[Role]:
        return set(Role) if self.silent else set()

    @property
    def lost_vehicles(self) -> set[Role]:
        return set(Role) if self.lost else set()

    def guard_line(self, role: Role) -> GuardLine:
        """The program's way to its guard."""
        del role
        assert self.beats is not None, "the rig has no guard"
        return self.beats.role_end()


def present_s() -> float:
    """The loop's time, which is the world's."""
    return asyncio.get_running_loop().time()


async def until(condition: Callable[[], bool], limit_s: float) -> None:
    """Wait until something is true of the world, or for so long."""
    end_s = present_s() + limit_s
    while present_s() < end_s and not condition():  # noqa: ASYNC110 (polls truth)
        await asyncio.sleep(0.1)

"""One session on a link, a vehicle and a log that stand in, in virtual time."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

from drivers.interfaces import FlightMode, LinkCounters, Received, VehicleState
from drivers.stages import Stages
from flight.config import MissionConfig
from flight.harness.flights import Progress, RoleResult
from flight.outcome import MissionEnd
from hil.harness.virtual_time import run_virtual
from missions.fly.leg.course import fly_course
from missions.fly.leg.session import RoleSession
from path.messages import Message, Role
from tests.doubles import LoopClock

T = TypeVar("T")
STATE = VehicleState(
    0,
    0,
    (1.0, 2.0, -1.5),
    (0.1, 0.0, 0.0),
    (1.0, 0.0, 0.0, 0.0),
    True,
    True,
    True,
    FlightMode.OFFBOARD,
    0.9,
)


@dataclass
class FakeLink:
    counters: LinkCounters = field(default_factory=LinkCounters)
    sent: list[tuple[float, Message]] = field(default_factory=list[tuple[float, Message]])
    waiting: asyncio.Queue[Message | Exception] = field(
        default_factory=asyncio.Queue[Message | Exception]
    )

    def send(self, message: Message) -> None:
        self.sent.append((asyncio.get_running_loop().time(), message))
        self.counters.bytes_sent += 100

    async def receive(self) -> Received:
        message = await self.waiting.get()
        if isinstance(message, Exception):
            raise message
        return Received(message, LoopClock(1.0).now_ns())

    def of(self, kind: type[T]) -> list[T]:
        return [message for _, message in self.sent if isinstance(message, kind)]


@dataclass
class FakeVehicle:
    state: VehicleState = STATE


@dataclass
class Recorder:
    entries: list[tuple[str, int, dict[str, Any]]] = field(
        default_factory=list[tuple[str, int, dict[str, Any]]]
    )
    images: list[int] = field(default_factory=list[int])

    def write(self, topic: str, stamp_ns: int, record: Any) -> None:
        self.entries.append((topic, stamp_ns, dict(record)))

    def image(self, topic: str, stamp_ns: int, image: Any) -> None:
        self.images.append(stamp_ns)

    def of(self, topic: str) -> list[dict[str, Any]]:
        return [record for name, _, record in self.entries if name == topic]


class Bench:
    """A session on fakes, and what it was seen to do."""

    def __init__(
        self,
        rig: Any,
        config: MissionConfig | None = None,
        role: Role = Role.SENDER,
        stages: Stages | None = None,
    ) -> None:
        self.link, self.log, self.vehicle = FakeLink(), Recorder(), FakeVehicle()
        self.shown: list[Progress] = []
        self.stop = asyncio.Event()
        parts = cast(Any, (LoopClock(1.0), self.vehicle, None, self.link))
        self.session = RoleSession(
            rig,
            role,
            config or MissionConfig(),
            self.log,
            self.shown.append,
            self.stop,
            parts,
            random.Random(1),
            stages=stages,
        )
        self.recovered: list[MissionEnd | None] = []
        self.landed = True
        self.fails: Exception | None = None

    async def recover(self, end: MissionEnd | None) -> bool:
        self.recovered.append(end)
        await asyncio.sleep(1.0)
        if self.fails is not None:
            raise self.fails
        return self.landed

    async def fly(self, course: Callable[[], Awaitable[None]]) -> RoleResult:
        complaints: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(
            lambda _, context: complaints.append(context)
        )
        result = await fly_course(self.session, course, self.recover)
        assert complaints == []
        assert len(asyncio.all_tasks()) == 1  # nothing goes on after the end
        return result


def virtual(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


def noting(into: list[Any]) -> Any:
    """Return a function that keeps what it is called with."""

    def note(*args: Any) -> None:
        into.append(args)

    return note


def giving(value: Any) -> Any:
    """Return a function that gives the same whatever it is asked."""

    def give(*_: Any) -> Any:
        return value

    return give


async def for_ever() -> None:
    await asyncio.sleep(1e6)

"""The seam of a relay or a team: what a harness with many drones is asked for and what it answers.

A relay hands one target from drone to drone as batteries run down. Each drone runs one program at a
time, and each hand-over is a *leg* between two of them, on a link of its own.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from drivers.rig.parts import Rig
from flight.harness.fleet import NamedTarget, RelayConfig
from flight.harness.flights import Emit, ProgramContext, Report, RoleResult
from path.values import frozen

POINTING_M = 0.1  # standard deviation, on each axis, of where a person points

OFTEN = frozenset({
    "/frame", "/target", "/track", "/setpoint", "/state", "/agreement", "/candidate", "/marker", "/motion", "/link",
    "/guard_view", "/late",
})  # fmt: skip
"""Topics logged many times a second: hours of them are left out unless they are asked for."""
WATCHED: Mapping[str, float] = {
    "/phase": 0.0, "/responsibility": 0.0, "/epoch": 0.0, "/commit": 0.0, "/decision": 0.0, "/agreement": 0.0,
    "/frame": 0.2, "/target": 0.2, "/track": 0.2, "/link": 0.5,
    "/late": 0.0,
}  # fmt: skip
"""The topics that the monitors read of a drone's log, and the least seconds between two of a
kind.
"""


class OneFlight(Protocol):
    """One flight of a drone, from opening its parts to the vehicle on the ground."""

    async def run(self) -> RoleResult: ...


DroneProgram = Callable[[str, ProgramContext], OneFlight]
"""The program of any drone, which makes the flight of the one that is named."""


class RelayField(Protocol):
    """The place where a relay or a team is flown, as those who stand there can act on it."""

    def begin(self, name: str, program: DroneProgram) -> Awaitable[RoleResult | None]:
        """Start a drone's program; None when it died. The drone is switched on, if it is not."""
        ...

    def open_leg(
        self,
        number: int,
        sender: str,
        receiver: str,
    ) -> None:
        """Give two drones a link to each other; it takes the place of any that either had."""
        ...

    def close_leg(self, number: int) -> None:
        """The hand-over is over, done or not: so is what went wrong in it alone. The link stays."""
        ...

    def landed(self, name: str) -> bool:
        """Return whether it is seen to stand on the ground, its motors off."""
        ...

    def battery(self, name: str) -> float:
        """Return the charge of a drone that has landed, 0..1."""
        ...

    def swap(self, name: str, battery: float) -> None:
        """Carry a drone to its home, with a battery of that charge in it, and switch it off until
        it is called.
        """
        ...

    # --- of a team; targets are told apart by their number in the rig's order ---

    def assign(self, name: str, target: int) -> None:
        """Before it is begun: a drone is sent to find a target."""
        ...

    def given_up(self, target: int) -> None:
        """Nobody has the target any more, and everybody knows."""
        ...

    def point_at(self, target: int) -> Pointed:
        """Return the place at which a person on the ground sees a target now."""
        ...


@frozen
class DroneProcesses:
    """The drones' programs as processes, and their way to those on the ground: lines of JSON,
    either way.

    Attributes:
        command: of a drone's program. It prints ``flight.harness.flights.encode_event``'s lines,
            ``{"event": "record", "record": [drone, topic, stamp_ns, record]}`` of what is
            ``WATCHED``, and what it has to say to the ground.
        guard_command: of the guard beside it, in a rig with guards.
        news: what a drone has to know at present; it is told whenever that changes, on its stdin.
        heard: takes what a drone's program said to the ground.
    """

    command: Callable[[str], Sequence[str]]
    guard_command: Callable[[str], Sequence[str]]
    news: Callable[[str], Mapping[str, Any]]
    heard: Callable[[str, Mapping[str, Any]], None]


@frozen
class Pointed:
    """A person's word on a target's place: NED in m and m/s, at an instant of the ground's
    clock.
    """

    place_n_m: tuple[float, float, float]
    velocity_n_mps: tuple[float, float, float]
    time_s: float

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return its place by then."""
        since_s = time_s - self.time_s
        n, e, d = (
            p + since_s * v for p, v in zip(self.place_n_m, self.velocity_n_mps, strict=True)
        )
        return n, e, d


@frozen
class RelayRequest:
    """One relay, or the flights of a team.

    Attributes:
        processes: for a harness whose drones' programs are processes of their own.
        hours: how long it is to last, about.
        main: flies it to its end; told to stop by the event.
        faults: by the number of their leg; of 0 those of all legs.
        whole_log: everything into the logs, not only what is rare.
        targets: of a team; a relay has the one of ``[world.target]``.
    """

    rig: Rig
    config: RelayConfig
    out: Path
    seed: int
    faults: Mapping[int, Sequence[str]]
    main: Callable[[RelayField, asyncio.Event, Emit], Awaitable[None]]
    emit: Emit
    processes: DroneProcesses
    hours: float = 8.0
    whole_log: bool = False
    targets: Sequence[NamedTarget] = ()


@frozen
class FlightTruth:
    """One flight in truth, from switching on to the ground."""

    drone: str
    began_s: float
    ended_s: float
    battery: float  # when it stood, or the smallest while it was armed


@frozen
class FieldSample:
    """The truth now and then: who is responsible (by their own word), and every battery."""

    time_s: float
    responsible: tuple[str, ...]
    battery: tuple[float, ...]
    airborne: tuple[str, ...]


@frozen
class TargetWatch:
    """The times for which one target was kept in view, in truth.

    Attributes:
        first_s: when a drone was responsible for it for the first time; None: never.
        observed_s: for how long since then somebody responsible for it looked at it, and at nothing
            else.
        of_s: out of how many seconds.
        spells: (from, to) of the times in which nobody did.
    """

    first_s: float | None
    observed_s: float
    of_s: float
    spells: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class RelayReport(Report):
    """The harness's report of a relay.

    ``gaps_s``: by leg, the longest time with nobody responsible in its hand-over; ``watched``: by
    target, in their order; ``bytes_sent``, ``aloft_s``: by drone, on its links and in the air;
    ``cpu_s``: of this process.
    """

    gaps_s: Mapping[int, float]
    flown: Sequence[FlightTruth]
    samples: Sequence[FieldSample]
    closest_m: float
    closest_pair: Sequence[str] = ()
    log_failure: str = ""
    watched: Sequence[TargetWatch] = ()
    bytes_sent: Mapping[str, int] = field(default_factory=dict[str, int])
    aloft_s: Mapping[str, float] = field(default_factory=dict[str, float])
    cpu_s: float = 0.0


FlyRelay = Callable[[RelayRequest], RelayReport]
"""A harness's way to fly one: it blocks until the relay is over and every drone is down, or the
bound on that is over.
"""

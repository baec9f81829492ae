"""Values and Protocols between a role's program, its guard and the vehicle that the guard watches.

The guard is a process of its own with a MAVLink link of its own; the role's program tells it many
times a second that it lives and what it does with the vehicle, and hears in return whether it is
watched and whether the vehicle was taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from typing import Protocol

from drivers.interfaces import SURE, FlightMode, Part
from path.values import value

Vec3 = tuple[float, float, float]
NOWHERE: Vec3 = (math.nan, math.nan, math.nan)


class Script(Enum):
    """The doings of a role's program with its vehicle just now."""

    IDLE = 0  # nothing: before the flight, or after it
    CLIMB = 1  # armed or about to be, on its way to offboard control
    CONTROL = 2  # setpoints flow
    LANDING = 3  # told to land
    LET_GO = 4  # somebody else flies it, for the rest of this flight

    @property
    def flies(self) -> bool:
        return self in (Script.CLIMB, Script.CONTROL, Script.LANDING)


@value
class Beat:
    """One sign of life of a role's program.

    Attributes:
        setpoints: how many were sent since the program began.
        separation_m: between the two bodies, as measured since the last beat; NaN: not measured.
        peer_n_m: where the other drone says it is, in this role's local frame; NaN: not known, or
            old.
    """

    script: Script
    setpoints: int
    separation_m: float = math.nan
    peer_n_m: Vec3 = NOWHERE


class Hand(Enum):
    """The one who has the vehicle, as the guard sees it."""

    FREE = 0  # not armed, or not flown by a script
    SCRIPT = 1
    GUARD = 2  # taken from the script, until it is disarmed
    # a pilot, another ground station or the autopilot itself took it: the guard does nothing any
    # more
    OTHER = 3


@value
class GuardAnswer:
    """The guard's answer to a beat.

    Attributes:
        sees: its own link to the vehicle brings telemetry.
        reason: why it took the vehicle, or let go of it.
        alarm: what it ignores that the crew must know of: the newest kind.
    """

    sees: bool
    hand: Hand
    reason: str = ""
    alarm: str = ""


@value
class GuardView:
    """The newest of a vehicle on the guard's own link; stamps are arrivals on the guard's clock.

    Attributes:
        acked: whether the last command was accepted; None while there is no answer.
        battery: 0..1, the newest that was told; NaN before the first.
        battery_ns: when it was told; None: with every view.
        mode_told: how many messages in a row have said this mode.
    """

    heartbeat_ns: int
    position_ns: int
    armed: bool
    in_air: bool
    mode: FlightMode
    position_n_m: Vec3
    battery: float
    acked: bool | None
    mode_told: int = SURE
    battery_ns: int | None = None


class GuardLine(Part, Protocol):
    """The role's end of the line to its guard. Never blocks, never raises once it is open."""

    @property
    def name(self) -> str:
        """The guard's expected place, for messages."""
        ...

    def beat(self, beat: Beat) -> None: ...

    def answer(self) -> tuple[int, GuardAnswer] | None:
        """The newest answer and its arrival, role clock; None when there never was one."""
        ...


class BeatLine(Part, Protocol):
    """The guard's end of the line."""

    def newest(self) -> tuple[int, Beat] | None:
        """The newest beat since the last call and its arrival, guard's clock; None when none
        came.
        """
        ...

    def answer(self, answer: GuardAnswer) -> None:
        """Send an answer to whoever beat last."""
        ...

    @property
    def ignored(self) -> Mapping[str, int]:
        """Numbers of messages that came and were not believed, by why, in words."""
        ...


class Watched(Part, Protocol):
    """A vehicle as its guard has it: telemetry of an own link, and two commands, each sent once a
    call.
    """

    @property
    def name(self) -> str: ...

    def view(self) -> GuardView | None:
        """None until it was heard. Never blocks."""
        ...

    def hold(self) -> None: ...

    def land(self) -> None: ...

    @property
    def ignored(self) -> Mapping[str, int]:
        """Numbers of messages that came and were not believed, by why, in words."""
        ...

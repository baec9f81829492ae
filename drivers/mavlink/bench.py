"""A vehicle on a bench: flown through its real driver, with ears on its cable, a second ground
station and the truth.

What is measured on it is how an autopilot behaves; the rig names the bench (``[trials] bench``).
Times are seconds of the vehicle's own time since it was switched on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol, Self

from drivers.interfaces import FlightMode, Vehicle, VehicleState
from path.messages import Quat, Vec3
from path.values import frozen


@frozen
class Instant:
    """The truth at one moment, and what the driver said then.

    Attributes:
        height_m: of the legs over where they stood at the start.
        position_n_m: NED from the mission's origin, as ``said.position_n_m``.
        said: None while the driver is not open.
    """

    time_s: float
    height_m: float
    position_n_m: Vec3
    velocity_n_mps: Vec3
    q_n_b: Quat
    said: VehicleState | None = None


@frozen
class HeartbeatShown:
    """One heartbeat of the vehicle."""

    time_s: float
    mode: FlightMode
    custom_mode: int
    armed: bool


@frozen
class CommandAnswer:
    """A COMMAND_ACK. ``to``: the system it was sent to, 0 when it does not say; ``result`` is
    MAV_RESULT.
    """

    time_s: float
    command: int
    result: int
    to: int


@dataclass(slots=True)
class HeardOnCable:
    """The messages that came over the cable from the vehicle, oldest first; the lists only grow.

    Attributes:
        arrivals_s: of every message, by its id.
        landed: EXTENDED_SYS_STATE's MAV_LANDED_STATE.
        checks: SYS_STATUS's bit of the arming checks.
        texts: (time, MAV_SEVERITY, text).
    """

    arrivals_s: dict[int, list[float]] = field(default_factory=dict[int, list[float]])
    shown: list[HeartbeatShown] = field(default_factory=list[HeartbeatShown])
    landed: list[tuple[float, int]] = field(default_factory=list[tuple[float, int]])
    checks: list[tuple[float, bool]] = field(default_factory=list[tuple[float, bool]])
    texts: list[tuple[float, int, str]] = field(default_factory=list[tuple[float, int, str]])
    answers: list[CommandAnswer] = field(default_factory=list[CommandAnswer])


class VehicleBench(Protocol):
    """Entering it switches the vehicle on; leaving it leaves nothing behind."""

    @property
    def kind(self) -> str:
        """The autopilot whose modes it has, a name of ``drivers.mavlink.modes.KINDS``."""
        ...

    @property
    def what(self) -> str:
        """The vehicle in words, for reports."""
        ...

    @property
    def heard(self) -> HeardOnCable:
        """Recorded from the start on."""
        ...

    @property
    def instants(self) -> list[Instant]:
        """Recorded from the start on, at 50 Hz."""
        ...

    @property
    def cut(self) -> bool:
        """Return whether the companion's cable is cut, both ways; the bench goes on hearing the
        vehicle.
        """
        ...

    @cut.setter
    def cut(self, cut: bool, /) -> None: ...

    async def __aenter__(self) -> Self: ...

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None: ...

    @property
    def now_s(self) -> float: ...

    def check(self) -> None:
        """Raise PartError when the bench itself has failed: the vehicle is not to blame."""
        ...

    def watch(self, vehicle: Vehicle | None) -> None:
        """Records the ``state`` of this vehicle in ``instants`` from now on."""
        ...

    def vehicle(self) -> Vehicle:
        """The driver, closed."""
        ...

    def order(self, command: int, *params: float) -> None:
        """A COMMAND_LONG from a second ground station, sent once."""
        ...

    def sag_battery(self, fraction: float) -> None:
        """Leave this much of its charge, 0..1."""
        ...

"""The Protocols every part is behind. Missions and flight code know only these.

Every part is an async context manager: entering it opens and checks the real thing with a bounded
wait, leaving it is bounded in time and leaves no process, port or thread behind.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from enum import Enum
from types import TracebackType
from typing import Any, Protocol, Self, runtime_checkable

from path.arrays import Depths, Image
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.messages import Message, Vec3
from path.observations import Box, Depth, Detection, MarkerDetection, Region
from path.protocol.values import ReceiverRecord, SenderRecord
from path.values import frozen, value


class PartError(Exception):
    """A part of the rig cannot do what was asked. ``remedy`` is the next step for the person
    reading it.
    """

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.remedy = remedy


class VehicleError(PartError):
    """The vehicle refused, did not answer in time, or is gone."""


class TakenOver(VehicleError):
    """Somebody else has the vehicle: a pilot, a ground station, or the autopilot's own failsafe."""


def too_high(reached_m: float, height_m: float) -> VehicleError:
    """Return the error of a take-off that the vehicle ended above the height it was told: no pilot
    was in it.
    """
    return VehicleError(
        f"take-off ended at {reached_m:.1f} m, by the vehicle's own reckoning, and {height_m:g} m were asked for",
        "its estimator stepped, or it climbs higher than it is told; it lands",
    )


class CameraError(PartError):
    """The camera gave no frame in time, or not what its calibration says."""


class LinkError(PartError):
    """The link to the other drone cannot be opened or used."""


class BeaconError(PartError):
    """The beacons give no positions, or their records are none. ``final``: reading again is of no
    use.
    """

    def __init__(self, message: str, remedy: str = "", *, final: bool = False) -> None:
        super().__init__(message, remedy)
        self.final = final


class StateError(PartError):
    """The record that a role must have after a restart cannot be written, or not be read."""


class Part(Protocol):
    """Opened and closed by ``async with``."""

    async def __aenter__(self) -> Self: ...

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None: ...


class Capability(Enum):
    """An ability that a mission may need of a part. A part that lacks some says so in ``lacks``, a
    set of these.

    Attributes:
        GEOFENCE: the vehicle keeps a fence of its own.
        GLOBAL_POSITION: its position does not drift.
        PILOT_OVERRIDE: a pilot can take it over by remote control.
        RANGE: the camera's frames tell how far away a box is.
    """

    GEOFENCE = "geofence"
    GLOBAL_POSITION = "global_position"
    PILOT_OVERRIDE = "pilot_override"
    RANGE = "range"


def lacking(part: object) -> frozenset[Capability]:
    """Return the abilities that a part says it does not have."""
    return getattr(part, "lacks", frozenset[Capability]())


class Clock(Protocol):
    """One drone's clock. Every stamp a role makes or compares is of this clock."""

    def now_ns(self) -> int: ...


@frozen
class Kept:
    """The record that a role had written down before it was started again.

    Attributes:
        same_clock: the record's instants are of the clock that runs now; after a reboot they are
            not.
    """

    record: SenderRecord | ReceiverRecord
    same_clock: bool


class RecordStore(Protocol):
    """One record that outlives the role's program."""

    def load(self) -> Kept | None:
        """Return the record that was saved last; None when nothing ever was. Raises StateError."""
        ...

    def save(self, record: SenderRecord | ReceiverRecord) -> None:
        """Save the record: on return it is safe from a crash of the program and of the computer.

        Raises StateError: then it may be either the old record or this one that is found later.
        """
        ...

    def begin_save(self, record: SenderRecord | ReceiverRecord) -> Future[None]:
        """``save`` that does not wait for the disk: done, or failed with StateError, when ``save``
        would have returned. The next one may begin only then."""
        ...


# --- vehicle


class FlightMode(Enum):
    """The modes the missions use; everything else a pilot may select is ``OTHER``."""

    HOLD = "hold"
    TAKEOFF = "takeoff"
    OFFBOARD = "offboard"
    RETURN = "return"
    LAND = "land"
    OTHER = "other"


@value
class Below:
    """What a rangefinder that looks down, along the body's own axis, measures.

    Attributes:
        stamp_ns: when it arrived, role clock.
        sigma_m: its standard deviation, as it says; None when it does not.
    """

    stamp_ns: int
    distance_m: float
    sigma_m: float | None = None


# messages in a row: then a mode, or that a vehicle is not armed, is more than one packet's word
SURE = 2


@value
class VehicleState:
    """The newest telemetry of a vehicle, one value.

    Attributes:
        stamp_ns: when the newest position/attitude arrived, role clock.
        position_n_m: (north, east, down) from the mission origin, by the vehicle's own estimate.
        velocity_n_mps: NED.
        q_n_b: attitude wxyz, body FRD to NED.
        heartbeat_ns: arrival of the newest heartbeat, role clock.
        battery: 0..1, the newest that was told; NaN before the first.
        battery_ns: when it was told, role clock; before the first, when the vehicle was first
            heard. None: with every state.
        position_sigma_m: horizontal standard deviation per axis, where the driver itself has to
            reckon the position.
        mode_told, armed_told: how many messages in a row have said this mode, and whether it is
            armed.
        resets: the autopilot's own count of the steps of its estimate; None where it does not tell
            one.
        below: what a rangefinder that looks down says; None where there is none, or it says nothing
            at present.
        gps: its fix, a number of MAVLink's GPS_FIX_TYPE, and satellites; None where none is told.
        radio: the pilot's is heard; None where that is not told.
    """

    stamp_ns: int
    heartbeat_ns: int
    position_n_m: tuple[float, float, float]
    velocity_n_mps: tuple[float, float, float]
    q_n_b: tuple[float, float, float, float]
    armed: bool
    in_air: bool
    armable: bool
    mode: FlightMode
    battery: float
    position_sigma_m: float | None = None
    mode_told: int = SURE
    armed_told: int = SURE
    battery_ns: int | None = None
    resets: int | None = None
    below: Below | None = None
    gps: tuple[int, int] | None = None
    radio: bool | None = None


@value
class VelocitySetpoint:
    """Fly this velocity (NED, m/s) with the nose at this yaw (rad, 0 = north, clockwise)."""

    velocity_n_mps: tuple[float, float, float]
    yaw_rad: float


class Vehicle(Part, Protocol):
    """A drone that can be flown by velocity setpoints.

    No method retries a motion command. Every wait is bounded and ends in VehicleError. ``state``
    never blocks; how old it is, is the caller's business (``VehicleState.stamp_ns``).
    """

    @property
    def state(self) -> VehicleState: ...

    def attitude_at(self, stamp_ns: int) -> tuple[float, float, float, float]:
        """Attitude ``q_n_b`` (wxyz) at a role-clock stamp, interpolated; the nearest one when out
        of range.
        """
        ...

    async def wait_armable(self, timeout_s: float) -> None: ...

    async def arm(self) -> None: ...

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        """Climb to ``height_m`` above home; return once there and holding."""
        ...

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        """Enter velocity control; returns once the vehicle says it is in OFFBOARD."""
        ...

    def fly(self, setpoint: VelocitySetpoint) -> None:
        """Send one setpoint now. Never blocks, never repeats by itself."""
        ...

    async def hold(self) -> None: ...

    async def land(self, timeout_s: float) -> None:
        """Land where it is; returns once disarmed on the ground."""
        ...


@runtime_checkable
class Wary(Protocol):
    """A part that does not believe everybody who speaks for what it drives."""

    @property
    def ignored(self) -> Mapping[str, int]:
        """Everything that was not believed, in words, and its count."""
        ...


# --- camera


@frozen
class Frame:
    """One colour image with depth registered to it.

    Attributes:
        stamp_ns: mid-exposure, role clock.
        color: (h, w, 3) uint8 BGR, distorted as the lens gives it.
        depth_mm: (h, w) uint16, z along the optical axis in millimetres, 0 = no measurement; None
            without depth.
    """

    stamp_ns: int
    frame_id: int
    color: Image
    depth_mm: Depths | None

    @property
    def sizes(self) -> Mapping[str, tuple[int, int]]:
        """Width and height of each stream that there is; to ask for them is not to look at
        pixels.
        """
        streams = {"colour": self.color, "depth": self.depth_mm}
        return {
            kind: (image.shape[1], image.shape[0])
            for kind, image in streams.items()
            if image is not None
        }


class Camera(Part, Protocol):
    """A calibrated camera. ``read`` gives the newest frame not yet given, waiting at most
    ``timeout_s``.

    One that knows its serial number once it is open says so in an attribute ``serial``, and is then
    held against the calibration's.
    """

    @property
    def model(self) -> CameraModel: ...

    async def read(self, timeout_s: float) -> Frame:
        """Raise CameraError when no new frame came in time."""
        ...


class View(Protocol):
    """A view of one camera frame. Nothing is computed before it is asked."""

    @property
    def stamp_ns(self) -> int: ...

    @property
    def frame_id(self) -> int: ...

    def targets(self, region: Region | None) -> Sequence[Detection]:
        """Target-like objects whose box centre is in ``region`` (None: whole image)."""
        ...

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        """Markers of the layout in ``region`` (None: whole image), with corner covariance.

        ``expected`` is ``T_c_v`` as far as it is known, where it is known well: a help to find them
        sooner.
        """
        ...

    def depth(self, box: Box) -> Depth | None:
        """Robust depth over a box; None when there is none to be trusted (a hole, outside
        limits).
        """
        ...

    def image(self) -> Image | None:
        """The colour image (BGR) for logs and pictures; None where there are no pixels."""
        ...


@runtime_checkable
class Framed(Protocol):
    """A view that has its frame, as the camera gave it; where there are no pixels a view is
    none.
    """

    @property
    def frame(self) -> Frame: ...


class Perception(Part, Protocol):
    """A camera with what finds things in its frames: the perception seam of a role."""

    @property
    def model(self) -> CameraModel: ...

    async def view(self, timeout_s: float) -> View:
        """The newest view not yet given. Raises CameraError when none came in time."""
        ...


class Detector(Protocol):
    """Finds target-like objects in an image, from its pixels alone.

    One with an attribute ``whole_image`` that is true is shown every image once, as it is; other
    ones may be shown an image from which depth has cut what is nearer or farther than what is
    looked for.
    """

    def detect(self, image: Image, region: Region | None) -> Sequence[Detection]: ...


# --- link


@value
class Received:
    message: Message
    arrival_ns: int  # role clock


@dataclass(slots=True)
class LinkCounters:
    """Counted at the socket. ``bytes_*`` include UDP/IP headers (28 B a packet) where there are
    any.
    """

    packets_sent: int = 0
    packets_received: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0
    dropped: dict[str, int] = field(default_factory=dict[str, int])  # by reason


class Link(Part, Protocol):
    """Carries messages to and from the other drone. May lose, delay, duplicate and reorder; never
    raises on input.
    """

    @property
    def counters(self) -> LinkCounters: ...

    def send(self, message: Message) -> None: ...

    async def receive(self) -> Received: ...


# --- beacons


@frozen
class BeaconFix:
    """One position of one mobile beacon.

    Attributes:
        stamp_ns: its instant, by the beacon system's clock.
        address: of the beacon.
        position_m: in the beacon system's frame: z up, turned about the vertical and shifted
            against any other.
        quality: 0..100, as the system rates it; NaN when it does not.
        host_ns: the same instant by the clock of the computer that listens; None in records that do
            not have it. It is late by what the system does not know of its own delay.
    """

    stamp_ns: int
    address: int
    position_m: Vec3
    quality: float = math.nan
    host_ns: int | None = None


class Beacons(Part, Protocol):
    """Positions of beacons as a system or a record gives them, each once, in the order they
    came.
    """

    async def read(self, timeout_s: float) -> BeaconFix | None:
        """The next position; None at the end of a record. Raises BeaconError when none came in
        time, saying why.
        """
        ...


# --- log


class Log(Protocol):
    """The log of all that a role sees and decides. Never raises: flight goes on with a full
    disk.
    """

    def write(self, topic: str, stamp_ns: int, record: Mapping[str, Any]) -> None:
        """One record: JSON-able mapping, stamp of the role clock."""
        ...

    def image(self, topic: str, stamp_ns: int, image: Image) -> None: ...


@runtime_checkable
class FrameLog(Protocol):
    """A log that takes every frame of a camera too. Never raises, and never waits: what it cannot
    take is dropped.
    """

    def frame(self, frame: Frame) -> None: ...

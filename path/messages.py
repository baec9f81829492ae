"""The messages two drones exchange, as values. How they look on the wire is ``drivers.link.wire``.

Stamps are nanoseconds of the *sending* drone's clock; the receiver converts them
(``flight.clocks``). An ``instance`` names one receiver: a number of 24 bits that its program draws
when it starts, or takes over from its record; never 0.
"""

from __future__ import annotations

from enum import Enum, StrEnum

from path.alike import Alike
from path.observations import Box, MissReason
from path.values import frozen, value

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]  # wxyz


class Role(StrEnum):
    """The role of a drone in a leg, and the name of a pair's drone, which never changes it."""

    SENDER = "sender"
    RECEIVER = "receiver"

    __hash__ = str.__hash__  # Enum's own is a call of Python's for each look into a table


@value
class Target:
    """D1 -> D2: where the target is, in the marker frame (eq. target_virtual)."""

    handoff_id: int  # u16
    epoch: int  # u16
    target_id: int  # u8, the object D1 says it tracks
    sequence: int  # u16, one per distinct D1 frame
    capture_ns: int  # when D1's frame was taken, D1's clock
    point_v_m: Vec3
    gravity_v: Vec3  # unit vector of gravity in ``v`` at capture, from D1's attitude
    sigma_m: float  # standard deviation of the point


@value
class Candidate:
    """D2 -> D1: the box D2's own detector found (eq. d2_candidate), and the pose it used; or why
    there is none.
    """

    handoff_id: int
    epoch: int
    target_id: int
    sequence: int  # u16, one per distinct D2 frame
    target_sequence: int  # the Target this answers
    capture_ns: int  # when D2's frame was taken, D2's clock
    box: Box | None  # None exactly when ``reason`` is set
    reason: MissReason | None
    position_v_m: Vec3  # T_v_c2
    rotation_v_c2: Quat
    sigma_m: float  # position standard deviation of T_v_c2


STEPS = 64
"""The count of an estimator's steps in a Status begins again after so many."""


@value
class Status:
    """A drone's state for coarse rendezvous, feed-forward and the console, sent both ways, a few
    times a second.
    """

    role: Role
    stamp_ns: int
    position_n_m: Vec3  # own estimate, in the mission's local NED frame
    velocity_n_mps: Vec3
    yaw_rad: float
    phase: int  # index into flight phases
    responsible: bool
    observing: bool
    battery: float  # 0..1; NaN: the vehicle does not tell it
    # of a receiver its own; of a sender that of the receiver it committed to, 0 for none
    instance: int = 0
    # exit code of the end that its flight has come to; 0: it goes on, or has come to its own end
    ended: int = 0
    steps: int = 0  # how often the drone's estimator has stepped, modulo STEPS
    # what both must have alike; None from a version of PATH that does not say
    alike: Alike | None = None


@value
class Ping:
    """Clock exchange, first half."""

    nonce: int  # u32
    sent_ns: int


@value
class Pong:
    """Clock exchange, second half: echoes the ping."""

    nonce: int
    ping_sent_ns: int
    received_ns: int
    sent_ns: int


@frozen
class Commit:
    """D1 -> D2: D1 has released the target; D2 may hold it provisionally until the lease ends."""

    handoff_id: int
    epoch: int
    target_id: int
    nonce: int  # u32
    lease_end_ns: int  # D1's clock
    stamp_ns: int
    instance: int  # of the one receiver it is for


@frozen
class Accept:
    """D2 -> D1: taken provisionally; repeated until confirmed."""

    handoff_id: int
    epoch: int
    target_id: int
    nonce: int
    stamp_ns: int
    instance: int  # who took it


@frozen
class Confirm:
    """D1 -> D2: D2 holds the target for good; one for every Accept."""

    handoff_id: int
    epoch: int
    target_id: int
    nonce: int
    stamp_ns: int
    instance: int  # of the receiver that holds it


class AbortReason(Enum):
    PILOT = "pilot"
    TIMEOUT = "timeout"
    TARGET_LOST = "target_lost"
    MARKER_LOST = "marker_lost"
    VEHICLE = "vehicle"
    CAMERA = "camera"
    GUARD = "guard"
    SHUTDOWN = "shutdown"


@frozen
class Abort:
    """Either way: this handoff is over; nothing is transferred by it."""

    handoff_id: int
    epoch: int
    reason: AbortReason
    stamp_ns: int
    instance: int = 0  # of the receiver that the attempt was committed to; 0 before a COMMIT


PART_BYTES = 59
"""Of a keyframe, in one packet."""


@frozen
class KeyframePart:
    """D1 -> D2: a part of what D1's camera saw at an instant (``path.common_view.parts``).

    Each part says all that is not in ``data``, so that any of them may be lost.
    """

    capture_ns: int  # D1's clock
    rotation_n_c: Quat  # D1's camera, by D1's attitude
    patch_m: float
    corners: int  # u8, how many the whole keyframe has
    number: int  # u8, of this part
    data: bytes  # PART_BYTES


Message = (
    Target | Candidate | Status | Ping | Pong | Commit | Accept | Confirm | Abort | KeyframePart
)

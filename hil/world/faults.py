"""Faults are data: what goes wrong, how much, for whom and when. The harness switches them on
behind the drivers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, get_args

from drivers.interfaces import PartError
from flight.harness.flights import Progress
from flight.phases import COURSE, Phase
from path.messages import Role
from path.protocol.values import ReceiverDuty, SenderDuty
from path.values import frozen

AT_COUNT = 20
LONGEST_S = 600.0
VIRTUAL = ("sim", "sim-rendered")

DUTIES: dict[Role, tuple[str, ...]] = {
    Role.SENDER: get_args(SenderDuty),
    Role.RECEIVER: get_args(ReceiverDuty),
}


FaultValue = Literal["no", "may", "must"]


@frozen
class FaultKind:
    """One kind of fault by name.

    A fault of the ``whole_run`` is there from the start; any other begins while the views agree,
    when nothing else is said. A value is from 0 to ``most``.

    Attributes:
        role: whom it concerns; None for both, and then "when" is of the sender's course.
        own: only where programs are processes of their own; what stalls, in a single hand-over in
            virtual time too.
        least: the smallest value.
        virtual: only in a single hand-over in virtual time.
        geometric: only at level ``sim``, where observations come from geometry: elsewhere there are
            real detectors.
        drawn: only where frames are drawn.
        value: whether it is a quantity (``link_loss=0.3``), and whether that may be left out.
    """

    name: str
    role: Role | None
    value: FaultValue
    meaning: str
    whole_run: bool = False
    most: float = 1.0
    own: bool = False
    least: float = 0.0
    geometric: bool = False
    drawn: bool = False
    virtual: bool = False

    @property
    def followed(self) -> Role:
        """The role whose course says when it begins."""
        return self.role or Role.SENDER

    @property
    def moments(self) -> tuple[str, ...]:
        """The moments that may stand behind the ``@``: phases of a course, and what the hand-over's
        records say.
        """
        phases = (*COURSE[self.followed], Phase.MISSION)
        return tuple(phase.title for phase in phases) + DUTIES[self.followed]


_RADIO_FAULTS: tuple[tuple[str, FaultValue, str], ...] = (
    ("rc_mode", "no", "the {}'s pilot turns the transmitter's mode switch"),
    ("rc_kill", "no", "the {}'s pilot throws the transmitter's kill switch"),
    ("rc_sticks", "no", "the {}'s pilot grabs the sticks"),
    ("rc_lost", "may", "the {}'s transmitter falls silent, for so many seconds"),
)
_ESTIMATOR_FAULTS: tuple[tuple[str, str, float], ...] = (
    ("step_north", "the {}'s estimate of its place steps north by so many metres", 100.0),
    ("step_east", "the {}'s estimate of its place steps east by so many metres", 100.0),
    ("step_height", "the {}'s estimate of its height steps up by so many metres", 100.0),
    ("step_yaw", "the {}'s estimate of its heading steps clockwise by so many degrees", 180.0),
)
FAULTS: dict[str, FaultKind] = {
    kind.name: kind
    for kind in (
        FaultKind("lookalike", None, "no", "an identical object drives past the target, 0.35 m from it"),
        FaultKind(
            "marker_hidden", Role.SENDER, "may", "the marker on the sender is covered, for so many seconds",
            most=LONGEST_S,
        ),
        FaultKind("depth_holes", Role.SENDER, "no", "the depth cameras measure nothing on objects"),
        FaultKind(
            "wash", None, "must", "the air that drones throw down is so many times as fast as by their mass", True, 3.0
        ),
        FaultKind(
            "compass", None, "must", "each drone's heading goes off by so many degrees within a minute", True, 90.0
        ),
        FaultKind(
            "leg", Role.SENDER, "must", "something of the sender is before its marker for this share of the time", True,
        ),
        FaultKind(
            "slope", None, "must", "the ground rises to the north by so many metres in a metre", True, 0.5, least=-0.5,
            geometric=True,
        ),
        FaultKind("exposure", None, "must", "exposures swing by so many stops, up and down", True, 4.0, drawn=True),
        FaultKind(
            "smudge", None, "must", "a smudge on each lens is as wide as this share of the image's height", True,
            drawn=True,
        ),
        FaultKind("link_loss", None, "must", "this share of the packets is lost, both ways", True),
        FaultKind(
            "link_delay", None, "must", "packets come this many seconds late, with as much jitter", True, 60.0
        ),
        FaultKind("link_jitter", None, "must", "packets come up to this many seconds late, in their order", True, 60.0),
        FaultKind("link_duplicate", None, "must", "this share of the packets comes twice", True),
        FaultKind("link_corrupt", None, "must", "this share of the packets comes damaged", True),
        FaultKind("link_reorder", None, "must", "this share of the packets is overtaken by later ones", True),
        FaultKind("link_out", None, "must", "nothing passes for this many seconds, either way", False, LONGEST_S),
        FaultKind(
            "attack", None, "must", "a third process floods both drones with this many forged and repeated packets a "
            "second", True, 100_000.0,
        ),
        FaultKind(
            "detector_recall", None, "must", "both detectors find a thing in this share of the frames", True,
            geometric=True,
        ),
        FaultKind(
            "detector_miss_frames", None, "must", "they miss it for so many frames at a time, in the mean", True,
            1000.0, least=1.0, geometric=True,
        ),
        FaultKind(
            "detector_false", None, "must",
            "both detectors find something where nothing is in this share of the frames", True, 0.9, geometric=True,
        ),
        FaultKind(
            "detector_bias", None, "must", "their boxes lie so many pixels to the right and down", True, 100.0,
            geometric=True,
        ),
        FaultKind("camera_freeze", Role.RECEIVER, "no", "the receiver's camera gives no new frames"),
        FaultKind(
            "kill_receiver", Role.RECEIVER, "may",
            "the receiver's program dies without a word, and is started again so many seconds later", most=LONGEST_S,
        ),
        FaultKind(
            "kill_sender", Role.SENDER, "may",
            "the sender's program dies without a word, and is started again so many seconds later", most=LONGEST_S,
        ),
        FaultKind("stop_receiver", Role.RECEIVER, "no", "the receiver's program stands still for good", own=True),
        FaultKind("stop_sender", Role.SENDER, "no", "the sender's program stands still for good", own=True),
        FaultKind(
            "stall_receiver", Role.RECEIVER, "must", "the receiver's program stands still for so many seconds",
            most=LONGEST_S, own=True,
        ),
        FaultKind(
            "stall_sender", Role.SENDER, "must", "the sender's program stands still for so many seconds",
            most=LONGEST_S, own=True,
        ),
        *(
            FaultKind(
                f"disk_{role.value}", role, "must",
                f"the {role.value}'s disk has lost so many of its newest records when the program is started again",
                most=100.0, least=1.0, virtual=True,
            )
            for role in Role
        ),
        FaultKind("guard_death", Role.SENDER, "no", "the sender's guard dies without a word", own=True),
        FaultKind("no_failsafe", None, "no", "the autopilots fly on when setpoints stop, as some are delivered", True),
        FaultKind("fc_link_loss", Role.RECEIVER, "no", "the receiver's flight controller falls silent"),
        FaultKind("pilot_takeover", Role.RECEIVER, "no", "the receiver's pilot changes the mode"),
        FaultKind("motor_kill", Role.RECEIVER, "no", "the receiver's pilot stops the motors in the air"),
        *(
            FaultKind(f"{name}_{role.value}", role, value, meaning.format(role.value), most=LONGEST_S)
            for name, value, meaning in _RADIO_FAULTS
            for role in Role
        ),
        *(
            FaultKind(
                f"{name}_{role.value}",
                role,
                "must",
                meaning.format(role.value),
                most=most,
                least=-most,
            )
            for name, meaning, most in _ESTIMATOR_FAULTS
            for role in Role
        ),
        FaultKind("battery_sag", Role.SENDER, "may", "the sender's battery drops to this share, or to 15 %"),
    )
}  # fmt: skip


@frozen
class Fault:
    """
    Attributes:
        value: None when there is none, or it was left out.
        moment: one of the kind's ``moments``; "" for the usual one.
        after_s: seconds from that moment.
    """

    kind: FaultKind
    value: float | None = None
    moment: str = ""
    after_s: float = 0.0

    @property
    def name(self) -> str:
        return self.kind.name

    @property
    def kills(self) -> Role | None:
        """The role whose program this fault ends without a word."""
        return self.kind.role if self.name.startswith("kill_") else None

    @property
    def stops(self) -> Role | None:
        """The role whose program this fault stops where it is."""
        return self.kind.role if self.name.startswith(("stop_", "stall_")) else None

    @property
    def stalls(self) -> bool:
        """Whether a program stands still for a while, which the plain simulation can do too."""
        return self.name.startswith("stall_")

    @property
    def forgets(self) -> bool:
        """Whether a disk loses what it had said that it has."""
        return self.name.startswith("disk_")

    @property
    def cuts_off(self) -> Role | None:
        """The role whose vehicle gets no more setpoints because of this fault."""
        return self.kind.role if self.kills or self.stops or self.name == "fc_link_loss" else None


class FaultTrigger:
    """Says when a fault begins: from the start, at its moment, or once the sender counted
    ``AT_COUNT`` agreeing pairs.

    Whoever is told that a fault begins has still to wait for its ``after_s``.
    """

    def __init__(self, faults: Sequence[Fault]) -> None:
        self._waiting = list(faults)

    def from_the_start(self) -> list[Fault]:
        return self._take(lambda fault: fault.kind.whole_run and not fault.moment)

    def on_progress(self, progress: Progress) -> list[Fault]:
        """The faults that begin with this progress of a role."""
        if not self._waiting:
            return []
        counted = progress.role is Role.SENDER and progress.count >= AT_COUNT

        def due(fault: Fault) -> bool:
            if fault.moment:
                return fault.kind.followed is progress.role and fault.moment == progress.phase
            return counted

        return self._take(due)

    def on_duty(self, role: Role, duty: str) -> list[Fault]:
        """The faults that begin when a role has written this duty down."""
        if not self._waiting:
            return []
        return self._take(lambda fault: fault.kind.followed is role and fault.moment == duty)

    def waits_for_duty(self, role: Role) -> bool:
        """Return whether ``on_duty`` can still bring something about."""
        return any(
            fault.kind.followed is role and fault.moment in DUTIES[role] for fault in self._waiting
        )

    def _take(self, due: Callable[[Fault], bool]) -> list[Fault]:
        taken = [fault for fault in self._waiting if due(fault)]
        self._waiting = [fault for fault in self._waiting if not any(fault is one for one in taken)]
        return taken


def parse_faults(texts: Sequence[str], level: str) -> list[Fault]:
    """The faults of a run on a rig of this level. Raises PartError."""
    faults = [parse_fault(text) for text in texts]
    for fault in faults:
        if fault.kind.geometric and level != "sim":
            raise PartError(
                f"fault {fault.name}: level {level} has real detectors", "use a rig of level sim"
            )
        if fault.kind.drawn and level == "sim":
            raise PartError(
                f"fault {fault.name}: level {level} draws no frames",
                "use a rig of level sim-rendered",
            )
        if fault.kind.virtual and level not in VIRTUAL:
            raise PartError(
                f"fault {fault.name} needs a disk in virtual time",
                "use a rig of level sim or sim-rendered",
            )
    return faults


def parse_fault(text: str) -> Fault:
    """``NAME[=VALUE][@MOMENT[+SECONDS]]``. Raises PartError."""
    what, at, when = text.partition("@")
    name, equals, written = what.partition("=")
    kind = FAULTS.get(name)
    if kind is None:
        raise PartError(f"there is no fault {name!r}", f"one of: {', '.join(sorted(FAULTS))}")
    value = _value(kind, written) if equals or kind.value == "must" else None
    if not at:
        return Fault(kind, value)
    moment, plus, seconds = when.partition("+")
    if moment not in kind.moments:
        raise PartError(
            f"fault {name}: {moment!r} is no moment of the {kind.followed.value}'s course",
            f"one of: {', '.join(kind.moments)}",
        )
    remedy = f"write how many seconds after it, for example --fault {what}@{moment}+2.5"
    after_s = _number(f"fault {name}@{moment}", seconds, LONGEST_S, remedy) if plus else 0.0
    return Fault(kind, value, moment, after_s)


def _value(kind: FaultKind, written: str) -> float:
    if kind.value == "no":
        raise PartError(f"fault {kind.name} takes no value", f"write --fault {kind.name}")
    example = f"{kind.name}={max(0.3, kind.least):g}"
    remedy = f"write it with a number from {kind.least:g} to {kind.most:g}, for example --fault {example}"
    if not written:
        raise PartError(f"fault {kind.name} needs a value", remedy)
    return _number(f"fault {kind.name}", written, kind.most, remedy, kind.least)


def _number(what: str, written: str, most: float, remedy: str, least: float = 0.0) -> float:
    try:
        value = float(written)
    except ValueError:
        raise PartError(f"{what}: {written!r} is not a number", remedy) from None
    if not least <= value <= most:
        raise PartError(f"{what}: {written} is not from {least:g} to {most:g}", remedy)
    return value

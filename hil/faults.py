"""Faults are data: what goes wrong, how much, and for whom. The harness switches them on behind the drivers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.interfaces import PartError
from flight.harness import Progress
from path.messages import Role

AT_COUNT = 50


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One kind of fault by name; ``needs_value`` when it is a quantity (``link_loss=0.3``).

    A fault of the ``whole_run`` is there from the start; any other begins while the views agree. A value is from 0 to
    ``most``.
    """

    name: str
    role: Role | None
    needs_value: bool
    meaning: str
    whole_run: bool = False
    most: float = 1.0


FAULTS: dict[str, FaultKind] = {
    kind.name: kind
    for kind in (
        FaultKind("lookalike", None, False, "an identical object drives past the target, 0.35 m from it"),
        FaultKind("marker_hidden", Role.SENDER, False, "the marker on the sender is covered"),
        FaultKind("depth_holes", Role.SENDER, False, "the depth cameras measure nothing on objects"),
        FaultKind("link_loss", None, True, "this share of the packets is lost, both ways", True),
        FaultKind(
            "link_delay", None, True, "packets come this many seconds late, both ways, with as much jitter", True, 60.0
        ),
        FaultKind("camera_freeze", Role.RECEIVER, False, "the receiver's camera gives no new frames"),
        FaultKind("kill_receiver", Role.RECEIVER, False, "the receiver's program dies without a word"),
        FaultKind("kill_sender", Role.SENDER, False, "the sender's program dies without a word"),
        FaultKind("fc_link_loss", Role.RECEIVER, False, "the receiver's flight controller falls silent"),
        FaultKind("pilot_takeover", Role.RECEIVER, False, "the receiver's pilot changes the mode"),
        FaultKind("battery_sag", Role.SENDER, False, "the sender's battery drops to 15 %"),
    )
}


class FaultError(PartError):
    """A fault that does not exist, or without its value."""


@dataclass(frozen=True, slots=True)
class Fault:
    kind: FaultKind
    value: float = 0.0

    @property
    def name(self) -> str:
        return self.kind.name

    @property
    def kills(self) -> Role | None:
        """The role whose program this fault ends without a word."""
        return self.kind.role if self.name.startswith("kill_") else None

    @property
    def cuts_off(self) -> Role | None:
        """The role whose vehicle gets no more setpoints because of this fault."""
        return self.kind.role if self.kills or self.name == "fc_link_loss" else None


class FaultTrigger:
    """Says when a fault begins: from the start, or once the sender has counted ``AT_COUNT`` agreeing pairs."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self._waiting = list(faults)

    def from_the_start(self) -> list[Fault]:
        return self._take(lambda fault: fault.kind.whole_run)

    def on_progress(self, progress: Progress) -> list[Fault]:
        """The faults that begin with this progress of a role."""
        if not self._waiting or progress.role is not Role.SENDER or progress.count < AT_COUNT:
            return []
        return self._take(lambda _: True)

    def _take(self, due: Callable[[Fault], bool]) -> list[Fault]:
        taken = [fault for fault in self._waiting if due(fault)]
        self._waiting = [fault for fault in self._waiting if fault not in taken]
        return taken


def parse_fault(text: str) -> Fault:
    """``NAME`` or ``NAME=VALUE``. Raises FaultError."""
    name, equals, written = text.partition("=")
    kind = FAULTS.get(name)
    if kind is None:
        raise FaultError(f"there is no fault {name!r}", f"one of: {', '.join(sorted(FAULTS))}")
    if not kind.needs_value:
        if equals:
            raise FaultError(f"fault {name} takes no value", f"write --fault {name}")
        return Fault(kind)
    remedy = f"write it with a number from 0 to {kind.most:g}, for example --fault {name}=0.3"
    if not written:
        raise FaultError(f"fault {name} needs a value", remedy)
    try:
        value = float(written)
    except ValueError:
        raise FaultError(f"fault {name}: {written!r} is not a number", remedy) from None
    if not 0.0 <= value <= kind.most:
        raise FaultError(f"fault {name}: {written} is not from 0 to {kind.most:g}", remedy)
    return Fault(kind, value)

"""What a part may tell ``doctor`` besides what its Protocol asks of it.

The short test of each kind of part is the same for all of its drivers and uses the Protocol alone
(``missions.doctor_sight``, ``doctor_link``, ``doctor_vehicle``, ``doctor_beacons``). What only a driver can know, such
as a firmware, whose clock stamps its frames or why a vehicle does not arm, it says itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

State = Literal["ok", "note", "fault"]


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found out about one thing. ``note``: a flight is possible, something else is not, or was not tested."""

    state: State
    name: str
    detail: str
    fix: str = ""


class Examined(Protocol):
    """A part that knows more of itself than its Protocol asks."""

    async def examine(self) -> Sequence[Finding]:
        """Asked while the part is open and has run for a while. Moves nothing, sets nothing, and is bounded in time.

        ``Finding.name`` is what was looked at; of whom is added by who asks. Raises PartError.
        """
        ...


async def examined(part: object) -> Sequence[Finding]:
    """What a part says of itself; nothing when it has nothing to say."""
    examine = getattr(part, "examine", None)
    return () if examine is None else await examine()


def rate_of(part: object) -> float | None:
    """How often a part is set to give something, Hz: its attribute ``rate_hz``; None when it has none."""
    return getattr(part, "rate_hz", None)

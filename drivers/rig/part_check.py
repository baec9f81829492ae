"""Findings that a part may give ``doctor`` besides what its Protocol asks of it.

The short test of each kind of part is the same for all of its drivers and uses the Protocol alone
(``missions.field.doctor.perception``, ``link``, ``vehicle``, ``beacons``). What only a driver can
know, such as a firmware, whose clock stamps its frames or why a vehicle does not arm, it says
itself.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, Protocol, runtime_checkable

from path.values import frozen

COUNT_S = 1.5
POLL_S = 0.002

State = Literal["ok", "note", "fault"]


@frozen
class Enough:
    """Shares of a rate that was asked for: below ``well`` it is a note, below ``at_all`` a
    fault.
    """

    well: float
    at_all: float


REPORTS = Enough(0.9, 0.5)  # of a state: the next one is as good


@frozen
class Finding:
    """A finding about one thing. ``note``: a flight is possible, something else is not, or was not
    tested.

    ``untested``: nothing is known of it, so that nothing may be promised.
    """

    state: State
    name: str
    detail: str
    fix: str = ""
    untested: bool = False


@runtime_checkable
class Examined(Protocol):
    """A part that knows more of itself than its Protocol asks."""

    async def examine(self) -> Sequence[Finding]:
        """Asked while the part is open and has run for a while. Moves nothing, sets nothing, and is
        bounded in time.

        ``Finding.name`` is what was looked at; of whom is added by who asks. Raises PartError.
        """
        ...


async def examined(part: object) -> Sequence[Finding]:
    """Return a part's findings on itself; none when it has nothing to say."""
    return await part.examine() if isinstance(part, Examined) else ()


def rate_of(part: object) -> float | None:
    """Return how often a part is set to give something, Hz: its attribute ``rate_hz``; None when
    it has none.
    """
    return getattr(part, "rate_hz", None)


async def counted(
    newest: Mapping[str, Callable[[], int | None]],
    wanted_hz: float,
    fix: str,
) -> Sequence[Finding]:
    """Counts how often each of some streams brings something new, against what was asked for.

    Args:
        newest: by the stream's name, when its newest came; None before.
        fix: for those that are slow.
    """
    loop = asyncio.get_running_loop()
    seen: dict[str, set[int | None]] = {name: set() for name in newest}
    start_s = loop.time()
    while (seconds := loop.time() - start_s) < COUNT_S:
        for name, read in newest.items():
            seen[name].add(read())
        await asyncio.sleep(POLL_S)
    return [
        rate_finding(name, (len(stamps) - 1) / seconds, wanted_hz, fix)
        for name, stamps in seen.items()
    ]


def rate_finding(
    name: str,
    found_hz: float,
    wanted_hz: float,
    fix: str,
    enough: Enough = REPORTS,
) -> Finding:
    detail = f"{found_hz:.1f} of {wanted_hz:g} a second"
    if found_hz >= enough.well * wanted_hz:
        return Finding("ok", name, detail)
    return Finding("fault" if found_hz < enough.at_all * wanted_hz else "note", name, detail, fix)

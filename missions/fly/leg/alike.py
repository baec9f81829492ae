"""What this drone has that the other one must have alike (``path.alike``), as digests of its rig
and its program.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import asdict
from functools import cache
from pathlib import Path

import drivers
import flight
import path
from drivers.rig.parts import Rig
from flight.config import SeparationConfig
from path.alike import BITS, SIDE_UNIT_M, Alike
from path.geometry.transforms import Pose

_DIALECT = Path(__file__).parents[3] / "drivers" / "link" / "dialect" / "path.xml"
_MADE = "path_dialect.py"  # from the dialect, by whichever version of mavgen there is
# places after the point: a rig that was written by another program may differ in the last digits
_ROUNDED = 6


def alike_of(rig: Rig, separation: SeparationConfig) -> Alike:
    """Return the digests of a rig and of the program that flies it."""
    markers = sorted(rig.layout.markers, key=lambda marker: marker.id)
    sides_m = [round(marker.side_m, _ROUNDED) for marker in markers]
    return Alike(
        dialect=_digest(_DIALECT.read_text("utf-8")),
        code=_code(),
        origin=_digest(asdict(rig.origin)),
        markers=_digest((rig.layout.dictionary, [marker.id for marker in markers])),
        sides=_digest(sides_m),
        places=_digest([_pose(marker.T_v_m) for marker in markers]),
        method=_digest(asdict(rig.method)),
        separation=_digest(asdict(separation)),
        first_side=round(sides_m[0] / SIDE_UNIT_M),
    )


def _pose(T: Pose) -> list[float]:
    return [round(float(value), _ROUNDED) + 0.0 for value in (*T.R.ravel(), *T.t)]


def _digest(value: object) -> int:
    """Return a number of so many bits, never 0, that stands for a value's text."""
    return _number(hashlib.sha256(repr(value).encode()).digest())


def _number(digest: bytes) -> int:
    return int.from_bytes(digest[:4], "big") % ((1 << BITS) - 1) + 1


@cache
def _code() -> int:
    """Stand for what decides in flight: the method, the drivers, what a drone does, and the course
    of a leg.
    """
    rooms = [Path(module.__file__ or "").parent for module in (path, drivers, flight)]
    digest = hashlib.sha256()
    for file in _sources((*rooms, Path(__file__).parent)):
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return _number(digest.digest())


def _sources(rooms: Iterable[Path]) -> Iterable[Path]:
    for room in rooms:
        yield from sorted(file for file in room.rglob("*.py") if file.name != _MADE)

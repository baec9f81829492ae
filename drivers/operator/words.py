"""What is said to D1 and what it asks, as one line of JSON each. ``docs/targets.md`` shows every
kind.

{"place": [4.0, 1.5], "error_m": 0.3, "age_s": 0.5}           north and east, m; "down_m", "velocity_mps", "holds_s"
{"bearing_deg": 40, "from": [0, 0], "error_deg": 5}           clockwise from north, as seen from a place
{"region": [[2, -1], [6, -1], [6, 1]]}                        corners of a polygon
{"question": 3, "number": 2}                                  the answer to a question; 0: none of those shown
{"hello": true}                                               only wants to be asked
"""

from __future__ import annotations

import base64
import math
from typing import Any

import msgspec

from drivers.operator.interfaces import (
    BearingTold,
    Chosen,
    Ground,
    PlaceTold,
    Question,
    RegionTold,
    Told,
)

MOST_BYTES = 60_000
PICTURE_BYTES = 40_000  # in base64, and room for a dozen objects
_FARTHEST_M = 10_000.0
_LONGEST_S = 3600.0


class WordsError(ValueError):
    """A line that says nothing that can be understood; the text says what is wrong."""


def decode(line: bytes, now_ns: int) -> Told | Chosen | None:
    """Return what a line says; None for a mere hello. Raises WordsError.

    Args:
        now_ns: of the drone's clock: ``age_s`` counts back from there.
    """
    try:
        said = msgspec.json.decode(line)
    except msgspec.DecodeError as error:
        raise WordsError(f"no JSON: {error}") from error
    if not isinstance(said, dict):
        raise WordsError("no JSON object")
    words = _Words(said)
    stamp_ns = now_ns - round(1e9 * words.number("age_s", 0.0, _LONGEST_S, 0.0))
    if "place" in said:
        told = _place(words, stamp_ns)
    elif "bearing_deg" in said:
        bearing = words.number("bearing_deg", -360.0, 360.0)
        error = words.number("error_deg", 0.01, 90.0)
        told = BearingTold(
            stamp_ns,
            words.ground("from"),
            math.radians(bearing),
            math.radians(error),
        )
    elif "region" in said:
        told = RegionTold(stamp_ns, words.corners("region"))
    elif "question" in said:
        told = Chosen(words.whole("question"), words.whole("number"))
    elif "hello" in said:
        told = None
    else:
        raise WordsError('says none of "place", "bearing_deg", "region", "question"')
    words.refuse_rest()
    return told


def _place(words: _Words, stamp_ns: int) -> PlaceTold:
    north, east = words.ground("place")
    down = words.number("down_m", -_FARTHEST_M, _FARTHEST_M, math.nan)
    velocity = words.ground("velocity_mps") if words.has("velocity_mps") else None
    holds_s = words.number("holds_s", 0.0, _LONGEST_S, 0.0)
    error_m = words.number("error_m", 0.01, 1000.0)
    height_told = not math.isnan(down)
    return PlaceTold(
        stamp_ns,
        (north, east, down if height_told else 0.0),
        error_m,
        height_told,
        velocity,
        holds_s,
    )


class _Words:
    """The words of one line, taken one by one."""

    def __init__(self, said: dict[str, Any]) -> None:
        self._said = said
        self._taken = {"hello"}

    def has(self, name: str) -> bool:
        return name in self._said

    def number(
        self,
        name: str,
        low: float,
        high: float,
        usual: float | None = None,
    ) -> float:
        self._taken.add(name)
        value = self._said.get(name, usual)
        if value is usual and usual is not None:
            return usual
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not low <= value <= high
        ):
            raise WordsError(f"{name}: {value!r} is no number from {low:g} to {high:g}")
        return float(value)

    def whole(self, name: str) -> int:
        self._taken.add(name)
        value = self._said.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 31:
            raise WordsError(f"{name}: {value!r} is no whole number from 0 on")
        return value

    def ground(self, name: str) -> Ground:
        self._taken.add(name)
        return _ground(name, self._said.get(name))

    def corners(self, name: str) -> tuple[Ground, ...]:
        self._taken.add(name)
        value = self._said.get(name)
        if not isinstance(value, list) or not 3 <= len(value) <= 64:
            raise WordsError(f"{name}: not 3 to 64 corners, each north and east in m")
        return tuple(_ground(name, corner) for corner in value)

    def refuse_rest(self) -> None:
        """Raise WordsError for a word that nothing was made of."""
        rest = sorted(self._said.keys() - self._taken - {"age_s"})
        if rest:
            raise WordsError(f"{rest[0]}: not a word of this statement")


def _ground(name: str, value: Any) -> Ground:
    good = isinstance(value, list) and len(value) == 2
    numbers = (
        [each for each in value if isinstance(each, int | float) and abs(each) <= _FARTHEST_M]
        if good
        else []
    )
    if len(numbers) != 2:
        raise WordsError(f"{name}: {value!r} is not north and east in m")
    return float(numbers[0]), float(numbers[1])


def encode_question(
    question: Question | None,
    now_ns: int,
    picture: bytes | None,
) -> bytes:
    """Return what D1 asks: the objects with their numbers, boxes and places, and the picture if it
    fits.
    """
    if question is None:
        return msgspec.json.encode({"asks": None})
    shown = [
        {
            "number": each.number,
            "box": [each.box.x, each.box.y, each.box.w, each.box.h],
            "north_m": round(each.place_n_m[0], 2),
            "east_m": round(each.place_n_m[1], 2),
            "speed_mps": round(math.hypot(*each.velocity_n_mps[:2]), 2),
            "share": round(each.share, 4),
        }
        for each in question.shown
    ]
    asked: dict[str, Any] = {
        "asks": question.number,
        "age_s": round((now_ns - question.stamp_ns) * 1e-9, 3),
        "objects": shown,
    }
    if picture is not None:
        whole = msgspec.json.encode({**asked, "jpeg": base64.b64encode(picture).decode()})
        if len(whole) <= MOST_BYTES:
            return whole
    return msgspec.json.encode(asked)

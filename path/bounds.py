"""Plausible bounds and units of a configuration's numbers, declared beside the field.

    take_off_height_m: Annotated[float, Bounds(0.3, 100.0)] = 1.5
    hold_frames: Annotated[int, Bounds(1, 100_000, "frames")] = 350

Bounds say what is plausible, so that a value in another unit is not flown. What must fit together
is checked by whoever knows all of it (``flight.plausible``, and the ``__post_init__`` of a
configuration).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from path.values import frozen

UNITS = {
    "deg": "deg", "rad": "rad", "dps": "deg/s", "radps": "rad/s", "mm": "mm", "cm": "cm", "m": "m", "ns": "ns",
    "us": "us", "ms": "ms", "s": "s", "px": "px", "hz": "Hz", "hz2": "1/s2", "mps": "m/s", "mps2": "m/s2", "ppm": "ppm",
    "db": "dB", "v": "V", "g": "g", "hours": "h", "seconds": "s",
}  # fmt: skip
"""Units by the ending of a field's name."""

_MISTAKES: Mapping[str, tuple[tuple[float, str], ...]] = {
    "m": ((1e-3, "millimetres"), (1e-2, "centimetres"), (0.3048, "feet")),
    "m/s": ((1.0 / 3.6, "km/h"), (1e-3, "millimetres a second"), (1e-2, "centimetres a second")),
    "s": ((1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")),
    "h": ((1.0 / 60.0, "minutes"), (1.0 / 3600.0, "seconds")),
    "Hz": ((1e-3, "millihertz"),),
    "of 1": ((1e-2, "per cent"),),
    "us": ((1e-3, "nanoseconds"),),
}
"""By unit: what a value that is too large may have been meant in, and how much of the unit that
is.
"""


@frozen
class Bounds:
    """The least and the largest plausible value.

    ``unit``: where the field's name does not end with it; in brackets when it is no measure, such
    as ``(an id)``.

    ``above``: the least value itself is already too small.
    """

    low: float
    high: float
    unit: str = ""
    above: bool = False

    def holds(self, value: float) -> bool:
        """Return whether a value is within the bounds; False for NaN."""
        return self.low <= value <= self.high and not (self.above and value == self.low)


AutopilotValues = Annotated[dict[str, float], Bounds(-3.4e38, 3.4e38, "as the autopilot has it")]
"""Parameters of an autopilot by name: any number that it can hold."""


def check_bounds(config: object) -> None:
    """Raise ValueError naming the first field of a dataclass that is out of its bounds, and what
    is allowed.
    """
    for name, (kind, bounds) in bounded_fields(type(config)).items():
        value = getattr(config, name)
        if kind is int and (isinstance(value, bool) or not isinstance(value, int)):
            raise ValueError(f"{name}: {value!r} is not a whole number")
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or not math.isfinite(value)
        ):
            raise ValueError(f"{name}: {value!r} is not a finite number")
        if not bounds.holds(value):
            raise ValueError(f"{name}: {refusal(name, value, bounds)}")


def out_of_bounds(config: object) -> list[tuple[str, str]]:
    """Every field of a dataclass with a number that is out of its bounds, and why it is not
    taken.
    """
    wrong: list[tuple[str, str]] = []
    for name, bounds in _bounds_by_field(type(config)).items():
        value = getattr(config, name)
        if dataclasses.is_dataclass(value):
            wrong += out_of_bounds(value)
        wrong += [
            (name, refusal(name, each, bounds))
            for each in numbers(value)
            if bounds and not bounds.holds(each)
        ]
    return wrong


def refusal(
    name: str,
    value: float,
    bounds: Bounds,
) -> str:
    """Return why a field's value is refused: the value, what is allowed, and the likely mistake."""
    unit = unit_of(name, bounds)
    shown = f" {unit}" if unit and not unit.startswith("(") else ""
    low, high = (
        str(each) if isinstance(each, int) else f"{each:g}" for each in (bounds.low, bounds.high)
    )
    between = f"above {low} and at most " if bounds.above else f"within {low}.."
    return f"{value!r}{shown} is not {between}{high}{shown}{_likely(value, bounds, unit)}"


def unit_of(name: str, bounds: Bounds) -> str:
    """The unit of a field; empty when neither its bounds nor its name say one."""
    return bounds.unit or UNITS.get(name.rpartition("_")[2], "")


def _likely(
    value: float,
    bounds: Bounds,
    unit: str,
) -> str:
    for factor, meant in _MISTAKES.get(unit, ()) if abs(value) > bounds.high else ():
        if bounds.holds(value * factor):
            return f": {meant}?"
    if bounds.low >= 0.0 > value and bounds.holds(-value):
        return ": a sign too many?"
    if unit == "deg" and bounds.holds(math.remainder(value, 360.0)):
        return ": more than a whole turn?"
    return ""


@cache
def bounded_fields(kind: type[Any]) -> dict[str, tuple[type[Any], Bounds]]:
    """The number fields of a dataclass that have bounds, with their kind."""
    hints = get_type_hints(kind, include_extras=True)
    found: dict[str, tuple[type[Any], Bounds]] = {}
    for each in dataclasses.fields(kind):
        bounds = bounds_of(hints[each.name])
        if bounds is not None and get_args(hints[each.name])[0] in (int, float):
            found[each.name] = get_args(hints[each.name])[0], bounds
    return found


@cache
def _bounds_by_field(kind: type[Any]) -> dict[str, Bounds | None]:
    return {
        name: bounds_of(hint) for name, hint in get_type_hints(kind, include_extras=True).items()
    }


def bounds_of(hint: Any) -> Bounds | None:
    """Return the bounds in an annotation; None without."""
    if get_origin(hint) is not Annotated:
        return None
    return next((each for each in hint.__metadata__ if isinstance(each, Bounds)), None)


def numbers(value: Any) -> Iterator[float]:
    """The numbers in a value: itself, or those in its tuples and mappings."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from numbers(item)
    elif isinstance(value, (tuple, list)):
        for item in value:
            yield from numbers(item)

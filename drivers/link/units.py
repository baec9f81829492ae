"""Numbers as the dialect's whole numbers, and back. Every one is checked when it is sent.

No field is a floating point number: NaN and infinity have no form on the wire. What a round trip
costs at the most:

=============  =========================================  ===========================
quantity       on the wire                                error
=============  =========================================  ===========================
point          24 bit a coordinate, 1/256 mm, ± 32.7 m    0.002 mm a coordinate
rotation       3 x 16 bit rotation vector, pi/32767 rad   0.0048 degrees (0.0024 RMS)
direction      2 x 16 bit octahedral                      0.0037 degrees
instant        48 bit, 10 us, rounded down                10 us, never later
sigma          16 bit, 0.1 mm                             0.05 mm
box edge       16 bit, 1/4 px, ± 8191 px                  0.125 px
=============  =========================================  ===========================
"""

from __future__ import annotations

import math

from path.messages import Quat, Vec3
from path.observations import Box

U8 = 2**8 - 1
U16 = 2**16 - 1
U24 = 2**24 - 1
U32 = 2**32 - 1
U64 = 2**64 - 1
I16 = 2**15 - 1
I32 = 2**31 - 1
INSTANT_NS = 10_000

_HIGH = 1 << 32
_NEWEST_NS = (1 << 48) * INSTANT_NS - 1
_PARTS = 256  # of a millimetre
_PER_METRE = 1000.0 * _PARTS
# of a coordinate, 24 bit
_LEAST = -_PARTS * (I16 + 1)
_MOST = _PARTS * (I16 + 1) - 1
_UNIT = float(I16)
_TURN = I16 / math.pi
_LONGEST_TURN = I16 + 1.0  # rounding may lengthen a half turn a little
_PIXEL = 4.0  # an edge of an 8K image, 7680 px, has to fit 16 bit
_SIGMA = 10000.0
_DIRECTION_TOLERANCE = 1e-2
_ROTATION_TOLERANCE = 1e-3


class OutOfRange(ValueError):
    """A number that the wire, or the meaning of its field, does not allow."""


def whole(
    name: str,
    value: int,
    high: int,
) -> int:
    """A whole number in ``0..high``."""
    if not 0 <= value <= high:
        raise OutOfRange(f"{name} = {value} is outside 0..{high}")
    return value


def scaled(
    name: str,
    value: float,
    scale: float,
    low: int,
    high: int,
) -> int:
    """``value * scale``, rounded, when that lies in ``low..high``."""
    if not math.isfinite(value):
        raise OutOfRange(f"{name} = {value} is not finite")
    number = round(value * scale)
    if not low <= number <= high:
        raise OutOfRange(f"{name} = {value} is outside {low / scale}..{high / scale}")
    return number


def instant_to(name: str, stamp_ns: int) -> tuple[int, int]:
    """Low 32 and high 16 bits of a stamp in 10 us; rounded down, so that nothing is claimed to be
    newer than it is.
    """
    number = whole(name, stamp_ns, _NEWEST_NS) // INSTANT_NS
    return number % _HIGH, number // _HIGH


def instant_from(low: int, high: int) -> int:
    """The stamp in ns."""
    return (high * _HIGH + low) * INSTANT_NS


def point_to(name: str, point: Vec3) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """Whole millimetres, rounded down, and what is left in 1/256 mm, of each coordinate in m."""
    x, y, z = point
    a = scaled(name, x, _PER_METRE, _LEAST, _MOST)
    b = scaled(name, y, _PER_METRE, _LEAST, _MOST)
    c = scaled(name, z, _PER_METRE, _LEAST, _MOST)
    return (a // _PARTS, b // _PARTS, c // _PARTS), (a % _PARTS, b % _PARTS, c % _PARTS)


def point_from(mm: tuple[int, int, int], parts: tuple[int, int, int]) -> Vec3:
    """The point in m."""
    return (
        (mm[0] * _PARTS + parts[0]) / _PER_METRE,
        (mm[1] * _PARTS + parts[1]) / _PER_METRE,
        (mm[2] * _PARTS + parts[2]) / _PER_METRE,
    )


def direction_to(name: str, direction: Vec3) -> tuple[int, int]:
    """A unit vector, projected onto an octahedron that is folded out into a square; its length is
    checked.

    ``(a, b) = (x, y) / (|x| + |y| + |z|)``; for z < 0 that is folded outward over the square's
    diagonals.
    """
    _length(name, direction, _DIRECTION_TOLERANCE)
    x, y, z = direction
    total = abs(x) + abs(y) + abs(z)
    a = x / total
    b = y / total
    if z < 0.0:
        a, b = _folded(a, b)
    return round(a * _UNIT), round(b * _UNIT)


def direction_from(first: int, second: int) -> Vec3:
    """The unit vector; every pair of numbers is one."""
    x = first / _UNIT
    y = second / _UNIT
    z = 1.0 - abs(x) - abs(y)
    if z < 0.0:
        x, y = _folded(x, y)
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


def rotation_to(name: str, rotation: Quat) -> tuple[int, int, int]:
    """A unit quaternion as rotation vector of at most a half turn; its length is checked."""
    _length(name, rotation, _ROTATION_TOLERANCE)
    w, x, y, z = rotation
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return 0, 0, 0
    scale = _TURN * 2.0 * math.atan2(sine, abs(w)) / sine
    if w < 0.0:
        scale = -scale
    return round(x * scale), round(y * scale), round(z * scale)


def rotation_from(name: str, numbers: tuple[int, int, int]) -> Quat:
    """The unit quaternion. Raises OutOfRange for more than a half turn, which nobody sends."""
    x, y, z = numbers
    length = math.sqrt(x * x + y * y + z * z)
    if length > _LONGEST_TURN:
        raise OutOfRange(f"{name} = {numbers} is more than a half turn")
    if length == 0.0:
        return 1.0, 0.0, 0.0, 0.0
    half = 0.5 * length / _TURN
    scale = math.sin(half) / length
    return math.cos(half), x * scale, y * scale, z * scale


def box_to(box: Box | None) -> tuple[int, int, int, int]:
    """Left, top, width, height; all zero without a box."""
    if box is None:
        return 0, 0, 0, 0
    return (
        scaled("box.x", box.x, _PIXEL, -I16, I16),
        scaled("box.y", box.y, _PIXEL, -I16, I16),
        scaled("box.w", box.w, _PIXEL, 1, U16),
        scaled("box.h", box.h, _PIXEL, 1, U16),
    )


def box_from(
    x: int,
    y: int,
    w: int,
    h: int,
) -> Box:
    """The box. Raises OutOfRange for an empty one."""
    if not (w and h):
        raise OutOfRange("an empty box")
    return Box(x / _PIXEL, y / _PIXEL, w / _PIXEL, h / _PIXEL)


def sigma_to(sigma_m: float) -> int:
    return scaled("sigma_m", sigma_m, _SIGMA, 0, U16)


def sigma_from(number: int) -> float:
    return number / _SIGMA


def _folded(a: float, b: float) -> tuple[float, float]:
    return math.copysign(1.0 - abs(b), a), math.copysign(1.0 - abs(a), b)


def _length(
    name: str,
    values: tuple[float, ...],
    tolerance: float,
) -> None:
    length = math.sqrt(sum([value * value for value in values]))
    if not abs(length - 1.0) <= tolerance:
        raise OutOfRange(f"{name} = {values} has length {length}, not 1")

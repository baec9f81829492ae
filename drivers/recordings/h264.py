"""Bare H.264 streams (Annex B), as people save a Tello's video: pictures without any stamps, some
of them lost.

FFmpeg gives what it can make of such a stream: pictures that lean on lost ones come out smeared, as
if they were whole, and what is missing closes up in time. Here the stream is taken apart first
(ITU-T H.264, 7.3 and 7.4): every picture says its number (``frame_num``), so that lost ones are
counted and time keeps their places, and after a loss nothing is believed until the next picture
that leans on none.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

SLICE = 1
IDR = 5
SPS = 7
PPS = 8
INTRA = (2, 7)  # slice types
HIGH_PROFILES = (100, 110, 122, 244, 44, 83, 86, 118, 128)
HEAD_BYTES = 64  # of a slice or a parameter set, in which its first numbers stand


@dataclass(slots=True)
class Picture:
    """One coded picture.

    Attributes:
        data: its slices, with what stands before them.
        fresh: it leans on no other.
        number: ``frame_num``; None when nothing said how to read it. ``is_start``: numbers begin
            again with it.
        is_reference: others lean on it, so that the next one's number is higher.
        is_cut: its first slice is missing.
        modulo: numbers begin again there.
        order: where it is shown (``pic_order_cnt_lsb``) and where that begins again; None when
            pictures are shown as they are coded.
        index: its place among what is coded, in pictures from the stream's first one. ``gap``: so
            many were lost before it.
        place: its place in time: another one where a picture leans on one that is shown after it.
    """

    data: bytes
    fresh: bool
    number: int | None
    is_start: bool
    is_reference: bool
    is_cut: bool
    modulo: int
    order: tuple[int, int] | None = None
    index: int = 0
    gap: int = 0
    place: int = 0


@dataclass(slots=True)
class _Sets:
    """What the parameter sets say of a slice's first numbers."""

    modulo: dict[int, int] = field(default_factory=dict[int, int])
    sequence: dict[int, int] = field(default_factory=dict[int, int])
    separate: dict[int, bool] = field(default_factory=dict[int, bool])
    order: dict[int, int] = field(default_factory=dict[int, int])  # pictures' orders begin again
    fields: dict[int, bool] = field(default_factory=dict[int, bool])


@dataclass(slots=True)
class _Slice:
    first_block: int
    fresh: bool
    number: int | None
    is_start: bool
    is_reference: bool
    modulo: int
    order: tuple[int, int] | None = None


def pictures(stream: bytes) -> list[Picture]:
    """Return the coded pictures of a stream in order, each with its place in time."""
    found = list(_taken_apart(stream))
    usual = _usual_length(found)
    index = -1
    since = 0
    before: Picture | None = None
    for picture in found:
        picture.gap = 0 if before is None else _gap(before, picture, since, usual)
        index += 1 + picture.gap
        picture.index = index
        # Pictures since the key frame, that one too; of a lost one, its number tells.
        since = 1 if picture.is_start else since + 1 + picture.gap
        if not picture.is_start and usual is not None and since > usual:
            since = (picture.number or 0) + 1
        before = picture
    _put_in_order(found)
    return found


def _put_in_order(found: list[Picture]) -> None:
    """Give each picture its place in time by what it says of its order (8.2.1.1)."""
    counted: list[tuple[Picture, int]] = []
    high = 0
    low = 0
    for picture in found:
        picture.place = picture.index
        if picture.order is None:
            continue
        value, modulo = picture.order
        if picture.is_start:
            high = 0
            low = 0
        if value < low and low - value >= modulo // 2:
            high += modulo
        elif value > low and value - low > modulo // 2:
            high -= modulo
        counted.append((picture, high + value))
        if picture.is_reference:
            low = value
    steps = [after[1] - before[1] for before, after in pairwise(counted) if not after[0].is_start]
    near = sorted({order for _, order in counted})
    if all(step > 0 for step in steps) or len(near) < 2:
        return
    apart = [after - before for before, after in pairwise(near)]
    step = max(apart, key=apart.count)  # 1 or 2; what is torn may say anything
    base: int | None = None
    for picture, order in counted:
        if base is None or picture.is_start:
            base = picture.index - order // step
        picture.place = base + order // step


def _usual_length(found: list[Picture]) -> int | None:
    """Return how many pictures a group has, if the stream lost some and its groups are of one
    length; else None.

    Of a whole stream nothing is missing at the end of a group, however short it is.
    """
    if not any(_step(before, after) for before, after in pairwise(found)):
        return None
    lengths: list[int] = []
    length = 0  # of a group whose key frame was seen
    for before, after in pairwise(found):
        length = 1 if before.is_start else length
        if after.is_start and length:
            lengths.append(length)
        elif length:
            length += 1 + _step(before, after)
    usual = max(lengths, key=lengths.count, default=0)
    return usual if usual > 1 and 3 * lengths.count(usual) >= len(lengths) else None


def _step(before: Picture, after: Picture) -> int:
    """Return how many pictures are missing between two, by their numbers."""
    if after.is_start or after.number is None or before.number is None:
        return 0
    return (after.number - before.number - before.is_reference) % after.modulo


def _gap(
    before: Picture,
    after: Picture,
    since: int,
    usual: int | None,
) -> int:
    """Return how many pictures were lost between two: also with a key frame, where numbers begin
    again.
    """
    missing = _step(before, after)
    if usual is None:
        return missing
    to_end = max(usual - since, 0)
    if after.is_start:
        return to_end
    with_start = to_end + (after.number or 0)
    return min(missing, with_start) if missing else 0


def _taken_apart(stream: bytes) -> Iterator[Picture]:
    sets = _Sets()
    before: list[bytes] = []  # units that belong to the next picture
    parts: list[bytes] = []
    current: Picture | None = None
    for unit in _units(stream):
        kind = unit[0] & 31
        if kind not in (SLICE, IDR):
            _read_set(unit, kind, sets)
            before.append(b"\0\0\0\1" + unit)
            continue
        one = _slice(unit, sets)
        another = current is None or one.first_block == 0 or one.number != current.number
        if another or current is None:
            if current is not None:
                current.data = b"".join(parts)
                yield current
            is_cut = one.first_block != 0
            current = Picture(
                b"",
                one.fresh,
                one.number,
                one.is_start,
                one.is_reference,
                is_cut,
                one.modulo,
                one.order,
            )
            parts = before
            before = []
        current.fresh = current.fresh and one.fresh
        parts.append(b"\0\0\0\1" + unit)
    if current is not None:
        current.data = b"".join(parts)
        yield current


def _units(stream: bytes) -> Iterator[bytes]:
    starts = [found.end() for found in re.finditer(b"\0\0\1", stream)]
    for begin, after in pairwise([*starts, len(stream) + 3]):
        unit = stream[begin : after - 3].rstrip(b"\0")
        if unit:
            yield unit


def _slice(unit: bytes, sets: _Sets) -> _Slice:
    is_start = unit[0] & 31 == IDR
    is_reference = (unit[0] >> 5) & 3 > 0
    bits = _Bits(unit)
    try:
        first = bits.golomb()
        kind = bits.golomb()
        picture_set = bits.golomb()
        sequence = sets.sequence.get(picture_set, -1)
        modulo = sets.modulo.get(sequence)
        if modulo is None:
            return _Slice(first, is_start, None, is_start, is_reference, 1)
        if sets.separate.get(sequence, False):
            bits.take(2)
        number = bits.take(modulo.bit_length() - 1)
        if sets.fields[sequence] and bits.take(1):
            bits.take(1)
        if is_start:
            bits.golomb()
        order = sets.order.get(sequence)
        shown = None if order is None else (bits.take(order.bit_length() - 1), order)
    except IndexError:
        return _Slice(0, False, None, is_start, is_reference, 1)
    fresh = is_start or kind in INTRA
    return _Slice(first, fresh, number, is_start, is_reference, modulo, shown)


def _read_set(
    unit: bytes,
    kind: int,
    sets: _Sets,
) -> None:
    try:
        if kind == SPS:
            _read_sequence(unit, sets)
        elif kind == PPS:
            bits = _Bits(unit)
            which = bits.golomb()
            sets.sequence[which] = bits.golomb()
    except IndexError:
        return


def _read_sequence(unit: bytes, sets: _Sets) -> None:
    """Read how long the numbers of pictures are out of a sequence parameter set."""
    bits = _Bits(unit)
    profile = bits.take(8)
    bits.take(16)
    which = bits.golomb()
    separate = False
    if profile in HIGH_PROFILES:
        chroma = bits.golomb()
        separate = chroma == 3 and bits.take(1) == 1
        bits.golomb()
        bits.golomb()
        bits.take(1)
        if bits.take(1):
            return  # scaling lists: no camera's stream has them
    length = bits.golomb() + 4
    order = _order_length(bits)
    bits.golomb()
    bits.take(1)
    bits.golomb()
    bits.golomb()
    fields = not bits.take(1)
    if length <= 16 and order <= 16:
        sets.modulo[which] = 1 << length
        sets.separate[which] = separate
        sets.fields[which] = fields
        sets.order.pop(which, None)
        if order:
            sets.order[which] = 1 << order


def _order_length(bits: _Bits) -> int:
    """Return how many bits tell a picture's order; 0 where a picture does not tell it itself."""
    kind = bits.golomb()
    if kind == 0:
        return bits.golomb() + 4
    if kind == 1:
        bits.take(1)
        bits.golomb()
        bits.golomb()
        for _ in range(min(bits.golomb(), 255)):
            bits.golomb()
    return 0


class _Bits:
    """Bits of a unit's beginning, without what was put between its bytes. Raises IndexError behind
    the end.
    """

    def __init__(self, unit: bytes) -> None:
        self._bytes = unit[1:HEAD_BYTES].replace(b"\0\0\3", b"\0\0")
        self._at = 0

    def take(self, count: int) -> int:
        value = 0
        for _ in range(count):
            value = value << 1 | (self._bytes[self._at >> 3] >> (7 - (self._at & 7))) & 1
            self._at += 1
        return value

    def golomb(self) -> int:
        zeros = 0
        while not self.take(1):
            zeros += 1
            if zeros > 31:
                raise IndexError
        return (1 << zeros) - 1 + self.take(zeros)

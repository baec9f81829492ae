"""Reads the few messages of Foxglove's that PATH itself reads back, without their schemas."""

from __future__ import annotations

from collections.abc import Iterator


def fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """The fields of a message: number, and an integer or what is in it. Raises ValueError for what
    is none.
    """
    at = 0

    def varint() -> int:
        nonlocal at
        value = 0
        shift = 0
        while True:
            byte = message[at]
            at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while at < len(message):
        key = varint()
        match key & 7:
            case 0:
                yield key >> 3, varint()
            case 2:
                length = varint()
                yield key >> 3, message[at : at + length]
                at += length
            case 5:
                yield key >> 3, int.from_bytes(message[at : at + 4], "little")
                at += 4
            case kind:
                raise ValueError(f"field {key >> 3} of a message is of kind {kind}")

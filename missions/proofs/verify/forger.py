"""The packets that somebody without the key can send.

Those of the pair altered, cut, mixed, signed anew, or sent once more.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable
from random import Random

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import KEY_LENGTH

HEADER = dialect.HEADER_LEN_V2
CRC = 2
SIGNATURE = dialect.MAVLINK_SIGNATURE_BLOCK_LEN
HASH = 6
LARGEST = HEADER + 255 + CRC + SIGNATURE
REMEMBERED = 400  # packets of each way
EXTRAS = {message: kind.crc_extra for message, kind in dialect.mavlink_map.items()}
FUTURE = 2**47  # units of 10 us: decades


class Forger:
    """Hears every packet, knows the dialect and the method's code, and has keys, but not the
    pair's.

    Args:
        rng: of this forger alone.
        toward: packets on their way to the victim that it has taken already; ``back``: those that
            it sent itself.
    """

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self.toward: deque[bytes] = deque(maxlen=REMEMBERED)
        self.back: deque[bytes] = deque(maxlen=REMEMBERED)
        self._key = rng.randbytes(KEY_LENGTH)
        self._ways: tuple[tuple[str, Callable[[], bytes]], ...] = (
            ("bits flipped", self._flipped),
            ("cut short", self._cut),
            ("made longer", self._longer),
            ("two packets mixed", self._mixed),
            ("payload altered, CRC right", self._altered),
            ("altered, signed with another key", self._signed_anew),
            ("stamp of another time, signed with another key", self._warped),
            ("stamp of another time, signature kept", self._restamped),
            ("on another link id", self._relinked),
            ("signature taken off", self._bare),
            ("sent once more", self._replayed),
            ("the victim's own sent back", self._reflected),
            ("from another system", self._stranger),
            ("of another id", self._other_id),
            ("random bytes", self._noise),
        )

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(name for name, _ in self._ways)

    def forge(self) -> tuple[str, bytes]:
        """The way, and a packet that differs from all that its owner sent, or that was taken
        before.
        """
        while True:
            name, way = self._rng.choice(self._ways)
            data = way()
            if name in ("sent once more", "the victim's own sent back") or data not in self.toward:
                return name, data

    def _heard(self) -> bytes:
        return self._rng.choice(self.toward)

    def _flipped(self) -> bytes:
        data = bytearray(self._heard())
        for _ in range(self._rng.choice((1, 1, 1, 2, 3, 8, 40))):
            data[self._rng.randrange(len(data))] ^= 1 << self._rng.randrange(8)
        return bytes(data)

    def _cut(self) -> bytes:
        data = self._heard()
        return data[: self._rng.randrange(len(data))]

    def _longer(self) -> bytes:
        return self._heard() + self._rng.randbytes(self._rng.randrange(1, 40))

    def _mixed(self) -> bytes:
        first = self._heard()
        second = self._heard()
        at = self._rng.randrange(1, min(len(first), len(second)))
        return first[:at] + second[at:]

    def _altered(self) -> bytes:
        """A packet whose CRC holds, with the old signature."""
        data = self._heard()
        payload = bytearray(data[HEADER : HEADER + data[1]])
        payload[self._rng.randrange(len(payload))] ^= self._rng.randrange(1, 256)
        return framed(data[:HEADER], bytes(payload)) + data[-SIGNATURE:]

    def _signed_anew(self) -> bytes:
        data = self._altered()
        return self._sign(data[:-SIGNATURE], data[-SIGNATURE:-6])

    def _warped(self) -> bytes:
        data = self._heard()
        stamp = self._rng.choice((self._rng.randrange(FUTURE), FUTURE, 2**48 - 1, 0))
        return self._sign(
            data[:-SIGNATURE], bytes((self._rng.randrange(256),)) + stamp.to_bytes(6, "little")
        )

    def _restamped(self) -> bytes:
        data = self._heard()
        stamp = int.from_bytes(data[1 - SIGNATURE : -6], "little") + self._rng.randrange(1, 2**40)
        return data[: 1 - SIGNATURE] + stamp.to_bytes(6, "little") + data[-6:]

    def _relinked(self) -> bytes:
        data = self._heard()
        other = (data[-SIGNATURE] + self._rng.randrange(1, 256)) % 256
        return data[:-SIGNATURE] + bytes((other,)) + data[1 - SIGNATURE :]

    def _bare(self) -> bytes:
        data = self._heard()
        header = bytearray(data[:HEADER])
        header[2] = 0
        return framed(bytes(header), data[HEADER : HEADER + data[1]])

    def _replayed(self) -> bytes:
        return self._heard()

    def _reflected(self) -> bytes:
        return self._rng.choice(self.back)

    def _stranger(self) -> bytes:
        data = self._heard()
        header = bytearray(data[:HEADER])
        header[self._rng.choice((5, 6))] ^= self._rng.randrange(1, 256)
        packet = framed(bytes(header), data[HEADER : HEADER + data[1]])
        return self._sign(packet, data[-SIGNATURE:-HASH])

    def _other_id(self) -> bytes:
        data = self._heard()
        header = bytearray(data[:HEADER])
        header[7:10] = self._rng.choice(
            (self._rng.choice(tuple(EXTRAS)), self._rng.randrange(2**24))
        ).to_bytes(3, "little")
        return framed(bytes(header), data[HEADER : HEADER + data[1]]) + data[-SIGNATURE:]

    def _noise(self) -> bytes:
        data = self._rng.randbytes(self._rng.randrange(LARGEST))
        return bytes((dialect.PROTOCOL_MARKER_V2,)) + data if self._rng.random() < 0.5 else data

    def _sign(self, packet: bytes, link_and_stamp: bytes) -> bytes:
        signed = packet + link_and_stamp
        return signed + sign(self._key, signed)


def sign(key: bytes, data: bytes) -> bytes:
    """The signature's hash, as MAVLink defines it."""
    return hashlib.sha256(key + data).digest()[:HASH]


def framed(header: bytes, payload: bytes) -> bytes:
    """Return a packet with a CRC that holds, as far as the id is known."""
    body = header[:1] + bytes((len(payload),)) + header[2:] + payload
    crc = dialect.x25crc(body[1:])
    crc.accumulate(bytes((EXTRAS.get(int.from_bytes(header[7:10], "little"), 0),)))
    return body + crc.crc.to_bytes(CRC, "little")

"""MAVLink 2 signatures between a companion and its autopilot, as the MAVLink guide says, hash
before stamp.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable, Mapping

from drivers.link.key import signing_time
from drivers.mavlink.transport.frames import SIGNATURE, SIGNED, V2, crc, head_of

_HASH = 6
_STAMP = 6
_CRC = 2


class Signer:
    """Makes one companion's frames signed ones.

    Args:
        key: 32 bytes that the autopilot has, too.
        link: names the way to it; each way has its own stamps.
        extras: the checksum's byte of each message that may be sent.
    """

    def __init__(
        self,
        key: bytes,
        link: int,
        extras: Mapping[int, int],
        clock: Callable[[], int] = signing_time,
    ) -> None:
        self._key = key
        self._link = link
        self._extras = extras
        self._clock = clock
        self._newest = 0

    def sign(self, frame: bytes) -> bytes | None:
        """The frame as it goes out; None for one of MAVLink 1, of an unknown message, or signed
        already.
        """
        extra = self._extras.get(head_of(frame).message)
        if frame[0] != V2 or frame[2] & SIGNED or extra is None:
            return None
        self._newest = max(self._newest + 1, self._clock())
        rest = bytes((frame[1], frame[2] | SIGNED)) + frame[3:-_CRC]
        signed = bytes((V2,)) + rest + crc(rest, extra) + bytes((self._link,))
        signed += self._newest.to_bytes(_STAMP, "little")
        return signed + _hash(self._key, signed)


class SignatureCheck:
    """Check that frames are signed with the key, each once and in order."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._newest: dict[tuple[int, int, int], int] = {}

    def holds(self, frame: bytes) -> bool:
        if frame[0] != V2 or not frame[2] & SIGNED:
            return False
        if not hmac.compare_digest(_hash(self._key, frame[:-_HASH]), frame[-_HASH:]):
            return False
        head = head_of(frame)
        stamp = int.from_bytes(frame[1 - SIGNATURE : -_HASH], "little")
        stream = head.system, head.component, frame[-SIGNATURE]
        if stamp <= self._newest.get(stream, -1):
            return False
        self._newest[stream] = stamp
        return True


def _hash(key: bytes, data: bytes) -> bytes:
    return hashlib.sha256(key + data).digest()[:_HASH]

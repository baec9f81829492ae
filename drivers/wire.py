"""Messages to packets and back: the ``path`` MAVLink 2 dialect, signed, one packet a datagram.

pymavlink packs, parses, checks and signs; this module adds what it leaves out:

* Its signing check stores a packet's time stamp *before* it compares the hash, so that one forged packet with a huge
  stamp locks the true sender out. Here the hash comes first, in constant time, and only then the stamp.
* Ids it does not know come back with neither CRC nor signature checked; here they are dropped.
* Lengths, source, numbers and ranges are checked, so that whatever bytes come in, what comes out is a valid message
  of the other drone or a ``Drop`` with its reason. ``decode`` never raises.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable
from enum import Enum
from typing import Any

from drivers.dialect import path_dialect as dialect
from drivers.wire_fields import FROM_WIRE, TO_WIRE, OutOfRange
from path.messages import Message, Role

KEY_LENGTH = 32
UDP_IP_OVERHEAD = 28  # IPv4 header 20 B, UDP header 8 B
SYSTEM_ID = {Role.SENDER: dialect.PATH_ROLE_SENDER, Role.RECEIVER: dialect.PATH_ROLE_RECEIVER}
COMPONENT_ID = dialect.MAV_COMP_ID_ONBOARD_COMPUTER

_MARKER = bytes([dialect.PROTOCOL_MARKER_V2])
_HEADER = dialect.HEADER_LEN_V2
_CRC = 2
_SIGNATURE = dialect.MAVLINK_SIGNATURE_BLOCK_LEN
_HASH = 6
_SIGNED = dialect.MAVLINK_IFLAG_SIGNED

# The library can be told by an environment variable to skip the CRC. Not here.
dialect.MAVLINK_IGNORE_CRC = 0


class EncodeError(ValueError):
    """A message holds a number that cannot go on the wire: not finite, or outside the field's range."""


class Drop(Enum):
    """Why a packet was not taken. Values are counted and logged."""

    NOT_MAVLINK = "not_mavlink"
    TRUNCATED = "truncated"
    WRONG_LENGTH = "wrong_length"
    UNKNOWN_ID = "unknown_id"
    WRONG_SYSTEM = "wrong_system"  # not the other role: a stranger, or our own packet reflected
    BAD_CRC = "bad_crc"
    UNSIGNED = "unsigned"
    UNEXPECTED_SIGNATURE = "unexpected_signature"  # signed, and this side has no key
    BAD_SIGNATURE = "bad_signature"
    REPLAYED = "replayed"
    NON_FINITE = "non_finite"
    OUT_OF_RANGE = "out_of_range"


class _Hardened(dialect.MAVLink):
    """pymavlink's parser, with the signature compared before anything of the packet is believed."""

    rejected = Drop.BAD_SIGNATURE

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:
        key = self.signing.secret_key
        assert key is not None
        digest = hashlib.sha256(key)
        digest.update(msgbuf[:-_HASH])
        if not hmac.compare_digest(digest.digest()[:_HASH], msgbuf[-_HASH:]):
            self.rejected = Drop.BAD_SIGNATURE
            return False
        # The base class compares the stamp with the stream's last one (or, for a new stream, with ours) and keeps it.
        self.rejected = Drop.REPLAYED
        return super().check_signature(msgbuf, srcSystem, srcComponent)


class Codec:
    """One end of a link: encodes this role's messages, decodes the other role's.

    Args:
        role: whose end this is; packets of any other system than the peer's are dropped.
        key: 32 bytes shared by the pair, or None for unsigned packets.
        link_id: MAVLink signing link id, names the channel.
        stamp: signing clock in units of 10 us. Must not start lower after a restart, so in the field it is wall time
            since 2015; it need not agree with the peer's, which pulls a slow one forward as the MAVLink rules say.
    """

    def __init__(self, role: Role, key: bytes | None, link_id: int = 0, stamp: Callable[[], int] = lambda: 0) -> None:
        if key is not None and len(key) != KEY_LENGTH:
            raise ValueError(f"a key has {KEY_LENGTH} bytes, not {len(key)}")
        peer = Role.RECEIVER if role is Role.SENDER else Role.SENDER
        self._peer_system = SYSTEM_ID[peer]
        self._signed = key is not None
        self._stamp = stamp
        self._mav = _Hardened(None, SYSTEM_ID[role], COMPONENT_ID)
        self._mav.signing.secret_key = key
        self._mav.signing.sign_outgoing = self._signed
        self._mav.signing.link_id = link_id

    def encode(self, message: Message) -> bytes:
        """The packet of a message. Raises EncodeError when a number does not fit."""
        try:
            packet = TO_WIRE[type(message)](message)
        except OutOfRange as error:
            raise EncodeError(f"{type(message).__name__}: {error}") from error
        signing = self._mav.signing
        signing.timestamp = max(signing.timestamp, self._stamp())
        data = packet.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return data

    def decode(self, data: bytes) -> Message | Drop:
        """The message in a datagram, or why it is not taken. Never raises."""
        fault = _shape(data) or self._origin(data)
        if fault is not None:
            return fault
        self._mav.rejected = Drop.BAD_CRC
        # A new stream is compared with our own stamp, so keep that at the present.
        signing = self._mav.signing
        signing.timestamp = max(signing.timestamp, self._stamp())
        try:
            packet: Any = self._mav.decode(bytearray(data))
        except dialect.MAVError:
            return self._mav.rejected
        try:
            return FROM_WIRE[type(packet)](packet)
        except OutOfRange as error:
            return Drop.OUT_OF_RANGE if error.finite else Drop.NON_FINITE

    def _origin(self, data: bytes) -> Drop | None:
        """Whether a well-formed packet is one of ours, from the other role, and signed exactly when it should be."""
        kind = dialect.mavlink_map.get(int.from_bytes(data[7:10], "little"))
        if kind not in FROM_WIRE:
            return Drop.UNKNOWN_ID
        if data[1] > kind.unpacker.size:
            return Drop.WRONG_LENGTH
        if data[5] != self._peer_system or data[6] != COMPONENT_ID:
            return Drop.WRONG_SYSTEM
        if bool(data[2]) != self._signed:
            return Drop.UNSIGNED if self._signed else Drop.UNEXPECTED_SIGNATURE
        return None


def _shape(data: bytes) -> Drop | None:
    """Whether a datagram is exactly one MAVLink 2 packet, as far as its header tells."""
    size = len(data)
    if data[:1] != _MARKER or (size > 2 and data[2] & ~_SIGNED):
        return Drop.NOT_MAVLINK
    if size < _HEADER + _CRC:
        return Drop.TRUNCATED
    expected = _HEADER + data[1] + _CRC + (_SIGNATURE if data[2] else 0)
    if size != expected:
        return Drop.TRUNCATED if size < expected else Drop.WRONG_LENGTH
    return None

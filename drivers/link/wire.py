"""Messages to packets and back: the ``path`` MAVLink 2 dialect, signed, one packet a datagram.

pymavlink's generated dialect has the messages, their layout and the CRC; packets are framed, signed
and checked here, as the MAVLink guide says, because of what its parser leaves out, and in two
thirds of its time:

* Its signing check stores a packet's time stamp *before* it compares the hash, so that one forged
  packet with a huge stamp locks the true sender out. Here the hash comes first, in constant time,
  and only then the stamp.
* Ids it does not know come back with neither CRC nor signature checked; here they are dropped.
* A process that was just started knows no stamps, and would believe a recording of the last minute.
  Here a stream is believed only once it has answered a ping of this process, which no recording
  can; until then it may ask, not tell.
* Lengths, source, numbers and ranges are checked, so that whatever bytes come in, what comes out is
  a valid message of the other drone or a ``Drop`` with its reason. ``decode`` never raises.
"""

from __future__ import annotations

import hashlib
import hmac
from collections import deque
from collections.abc import Callable
from enum import Enum

from drivers.link.dialect import path_dialect as dialect
from drivers.link.fields import FROM_WIRE, KINDS, NAMED, TO_WIRE
from drivers.link.units import OutOfRange
from path.messages import KeyframePart, Message, Ping, Pong, Role

KEY_LENGTH = 32
UDP_IP_OVERHEAD = 28  # IPv4 header 20 B, UDP header 8 B
SYSTEM_ID = {Role.SENDER: dialect.PATH_ROLE_SENDER, Role.RECEIVER: dialect.PATH_ROLE_RECEIVER}
COMPONENT_ID = dialect.MAV_COMP_ID_ONBOARD_COMPUTER

_MARKER = bytes([dialect.PROTOCOL_MARKER_V2])
HEADER_LENGTH = dialect.HEADER_LEN_V2
_CRC = 2
_SIGNATURE = dialect.MAVLINK_SIGNATURE_BLOCK_LEN
_HASH = 6
_STAMP = 6
_SIGNED = dialect.MAVLINK_IFLAG_SIGNED
# of the year 2104; a day before the end, so that no flight reaches it
LAST_STAMP = 2**48 - 1 - 24 * 3600 * 100_000
_ASKED = 16  # pings that an answer may be awaited to: a second of them


class EncodeError(ValueError):
    """A message holds a number that cannot go on the wire: not finite, or outside the field's
    range.
    """


class Drop(Enum):
    """The reason why a packet was not taken. Values are counted and logged."""

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
    # rightly signed, at the end of what a stamp can say: ours is not pulled there
    CLOCK_AT_END = "clock_at_end"
    # rightly signed, but perhaps a recording: the peer has not answered this process yet
    UNPROVEN = "unproven"
    OUT_OF_RANGE = "out_of_range"


class Codec:
    """One end of a link: encodes this role's messages, decodes the other role's.

    With a key, a stream of the peer's (one for each of its signing link ids) is proven by a Pong
    that answers a Ping which this codec encoded. Before that its Pings come through, so that both
    ends can prove themselves, and all else is dropped: what was recorded before this process began
    cannot know when its pings are sent.

    Args:
        role: whose end this is; packets of any other system than the peer's are dropped.
        key: 32 bytes shared by the pair, or None for unsigned packets.
        link_id: MAVLink signing link id, names the channel.
        stamp: signing clock in units of 10 us, in the field wall time since 2015. It need not agree
            with the peer's: every packet of the peer's pulls a slow one forward, also that of a
            process which began with a wrong time. A time that no stamp can say is as if the clock
            stood still.
    """

    def __init__(
        self,
        role: Role,
        key: bytes | None,
        link_id: int = 0,
        stamp: Callable[[], int] = lambda: 0,
    ) -> None:
        if key is not None and len(key) != KEY_LENGTH:
            raise ValueError(f"a key has {KEY_LENGTH} bytes, not {len(key)}")
        peer = Role.RECEIVER if role is Role.SENDER else Role.SENDER
        self._peer_system = SYSTEM_ID[peer]
        self._signed = key is not None
        self._stamp = stamp
        self._system = SYSTEM_ID[role]
        self._keyed = hashlib.sha256(key or b"")
        self._link_id = link_id
        self._sequence = 0
        self._newest = 0  # stamp, of those sent and received
        self._streams: dict[int, int] = {}  # link id of the peer: newest stamp
        self._proven: set[int] = set()  # link ids of streams that answered
        self._asked: deque[tuple[int, int]] = deque(maxlen=_ASKED)  # pings sent: nonce, instant

    def encode(self, message: Message) -> bytes:
        """The packet of a message. Raises EncodeError when a number does not fit."""
        kind = KINDS[type(message)]
        try:
            numbers = TO_WIRE[type(message)](message)
        except OutOfRange as error:
            raise EncodeError(f"{type(message).__name__}: {error}") from error
        payload = kind.unpacker.pack(*numbers).rstrip(b"\0") or b"\0"
        flags = _SIGNED if self._signed else 0
        header = bytes(
            (_MARKER[0], len(payload), flags, 0, self._sequence, self._system, COMPONENT_ID)
        )
        data = header + kind.id.to_bytes(3, "little") + payload
        data += _crc(data[1:], kind.crc_extra).to_bytes(_CRC, "little")
        self._sequence = (self._sequence + 1) % 256
        if isinstance(message, Ping):
            self._asked.append((message.nonce, message.sent_ns))
        if not self._signed:
            return data
        clock = self._stamp()
        stamp = max(self._newest, clock if clock <= LAST_STAMP else 0)
        self._newest = stamp + 1
        data += bytes((self._link_id,)) + stamp.to_bytes(_STAMP, "little")
        return data + self._hash(data)

    def authentic(self, data: bytes) -> bool:
        """Return whether a datagram is signed by the peer and not heard before, or nothing is
        signed here.

        In a few us.
        """
        if not self._signed:
            return True
        if len(data) < HEADER_LENGTH + _CRC + _SIGNATURE or not hmac.compare_digest(
            self._hash(data[:-_HASH]), data[-_HASH:]
        ):
            return False
        return _stamp_of(data) > self._streams.get(data[-_SIGNATURE], -1)

    def decode(self, data: bytes) -> Message | Drop:
        """The message in a datagram, or why it is not taken. Never raises."""
        fault = _shape(data) or self._origin(data)
        if fault is not None:
            return fault
        if not checksum_holds(data):
            return Drop.BAD_CRC
        if self._signed:
            fault = self._forged_or_old(data)
            if fault is not None:
                return fault
        kind = dialect.mavlink_map[int.from_bytes(data[7:HEADER_LENGTH], "little")]
        values = kind.unpacker.unpack(
            data[HEADER_LENGTH : HEADER_LENGTH + data[1]].ljust(kind.unpacker.size, b"\0")
        )
        try:
            message = FROM_WIRE[kind](NAMED[kind](values))
        except OutOfRange:
            return Drop.OUT_OF_RANGE
        if self._signed and data[-_SIGNATURE] not in self._proven:
            return self._introduced(data, message)
        return message

    def _hash(self, data: bytes) -> bytes:
        digest = self._keyed.copy()
        digest.update(data)
        return digest.digest()[:_HASH]

    def _forged_or_old(self, data: bytes) -> Drop | None:
        """The hash first, in constant time; only then is the stamp believed, and kept."""
        if not hmac.compare_digest(self._hash(data[:-_HASH]), data[-_HASH:]):
            return Drop.BAD_SIGNATURE
        stamp = _stamp_of(data)
        if stamp > LAST_STAMP:
            return Drop.CLOCK_AT_END
        self._newest = max(self._newest, stamp)
        newest = self._streams.get(data[-_SIGNATURE])
        if newest is not None and stamp <= newest:
            return Drop.REPLAYED
        self._streams[data[-_SIGNATURE]] = stamp
        return None

    def _introduced(self, data: bytes, message: Message) -> Message | Drop:
        """Return what is taken of a stream that is not proven; its answer proves it."""
        if isinstance(message, Pong) and (message.nonce, message.ping_sent_ns) in self._asked:
            self._proven.add(data[-_SIGNATURE])
            return message
        return message if isinstance(message, Ping) else Drop.UNPROVEN

    def _origin(self, data: bytes) -> Drop | None:
        """Return why a well-formed packet is none of ours, of the other role, rightly signed or
        unsigned.

        None when it is.
        """
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


def longest(kind: type[Message]) -> int:
    """Return the bytes of a signed packet of a kind at the most, as a serial radio carries it."""
    return HEADER_LENGTH + KINDS[kind].unpacker.size + _CRC + _SIGNATURE


PART_WIRE_BYTES = longest(KeyframePart) + UDP_IP_OVERHEAD
"""Of a part of a keyframe."""


def expected_length(header: bytes) -> int | None:
    """Length of the packet that begins with these bytes, at least ``HEADER_LENGTH``; None when it
    is none of ours.
    """
    kind = dialect.mavlink_map.get(int.from_bytes(header[7:HEADER_LENGTH], "little"))
    if (
        header[:1] != _MARKER
        or header[2] & ~_SIGNED
        or kind not in FROM_WIRE
        or header[1] > kind.unpacker.size
    ):
        return None
    return _whole_length(header)


def checksum_holds(packet: bytes) -> bool:
    """Return whether a packet of its ``expected_length`` is undamaged, as far as its checksum
    tells.
    """
    kind = dialect.mavlink_map[int.from_bytes(packet[7:HEADER_LENGTH], "little")]
    end = HEADER_LENGTH + packet[1]
    return _crc(packet[1:end], kind.crc_extra) == int.from_bytes(packet[end : end + _CRC], "little")


def introduce(one: Codec, other: Codec) -> None:
    """Let two ends in one process prove themselves to each other, as the first pings of a link
    do.
    """
    for asking, answering in ((one, other), (other, one)):
        ping = Ping(0, 0)
        answering.decode(asking.encode(ping))
        asking.decode(answering.encode(Pong(ping.nonce, ping.sent_ns, 0, 0)))


def _stamp_of(data: bytes) -> int:
    return int.from_bytes(data[1 - _SIGNATURE : -_HASH], "little")


def _crc(data: bytes, extra: int) -> int:
    """Return the checksum of everything after the marker, and a byte that stands for the message's
    layout.
    """
    return dialect.x25crc(data + bytes((extra,))).crc


def _whole_length(header: bytes) -> int:
    return HEADER_LENGTH + header[1] + _CRC + (_SIGNATURE if header[2] else 0)


def _shape(data: bytes) -> Drop | None:
    """Return why a datagram is not exactly one MAVLink 2 packet, as far as its header tells; None
    when it is.
    """
    size = len(data)
    if data[:1] != _MARKER or (size > 2 and data[2] & ~_SIGNED):
        return Drop.NOT_MAVLINK
    if size < HEADER_LENGTH + _CRC:
        return Drop.TRUNCATED
    expected = _whole_length(data)
    if size != expected:
        return Drop.TRUNCATED if size < expected else Drop.WRONG_LENGTH
    return None

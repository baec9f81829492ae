"""Packets out of a stream of bytes that a radio may have cut, damaged or filled with noise."""

from __future__ import annotations

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import HEADER_LENGTH, checksum_holds, expected_length

MARKER = dialect.PROTOCOL_MARKER_V2


class PacketFramer:
    """Cuts a stream into whole packets.

    A packet is taken only when its header can be one of ours and its checksum holds; otherwise a
    single byte is skipped and the search begins again, so that noise which looks like a beginning
    costs no true packet behind it.
    """

    def __init__(self) -> None:
        self._waiting = bytearray()
        self.skipped = 0  # bytes that were no packet

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes as they come; the packets that are complete with them, in order."""
        waiting = self._waiting
        waiting += data
        packets: list[bytes] = []
        begin = 0
        while True:
            found = waiting.find(MARKER, begin)
            if found < 0:
                self.skipped += len(waiting) - begin
                begin = len(waiting)
                break
            self.skipped += found - begin
            begin = found
            if len(waiting) - begin < HEADER_LENGTH:
                break
            length = expected_length(bytes(waiting[begin : begin + HEADER_LENGTH]))
            if length is None:
                self.skipped += 1
                begin += 1
                continue
            if len(waiting) - begin < length:
                break
            packet = bytes(waiting[begin : begin + length])
            if checksum_holds(packet):
                packets.append(packet)
                begin += length
            else:
                self.skipped += 1
                begin += 1
        del waiting[:begin]
        return packets

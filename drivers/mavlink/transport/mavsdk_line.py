"""MAVSDK's line to its vehicle over a port of ours, where anybody could send to MAVSDK's own.

MAVSDK believes whoever sends a heartbeat with its vehicle's number, answers there, and cannot sign.
So it has no port: a thread reads ours, hands on what the vehicle's own proven address said
(``source`` beside this), rightly signed where there is a key, and sends what MAVSDK wants sent
there and nowhere else.
"""

from __future__ import annotations

import select
import threading
import time
from collections.abc import Mapping
from typing import Any

import serial

from drivers.interfaces import VehicleError
from drivers.mavlink.transport.frames import HEARTBEAT, head_of, take_frames
from drivers.mavlink.transport.port import UNSIGNED, URL, Transport, extras, open_transport
from drivers.mavlink.transport.signing import SignatureCheck, Signer
from drivers.mavlink.transport.source import Address, VehicleSource

RAW = "raw://"
_WAIT_S = 0.1  # until the thread looks whether it is to end
_END_S = 2.0


def needs_line(url: str, key: bytes | None) -> bool:
    """Return whether MAVSDK is not to open a url by itself: others can send there, or what is said
    is to be signed.
    """
    return url.startswith("udpin://") or key is not None


class MavsdkLine:
    """One vehicle's frames to MAVSDK and back, from ``start`` to ``stop``.

    Raises VehicleError when it cannot be opened.

    Args:
        url: ``udpin://``, ``udpout://`` or ``serial://``; its lock is held by whoever opens this.
        sysid: the vehicle's; ``own``: system and component id that are sent from.
        key: of MAVLink 2's signatures, both ways.
    """

    def __init__(
        self,
        url: str,
        sysid: int,
        own: tuple[int, int],
        key: bytes | None = None,
    ) -> None:
        if URL.fullmatch(url) is None:
            raise VehicleError(
                f"{url} cannot be signed",
                "use udpin://, udpout:// or serial://, or leave out key_file",
            )
        try:
            self._transport: Transport = open_transport(url)
        except (OSError, serial.SerialException) as error:
            raise VehicleError(
                f"cannot open {url}: {error}", "check that the device or address exists"
            ) from error
        self._source = VehicleSource(sysid, own)
        self._check = None if key is None else SignatureCheck(key)
        self._signer = None if key is None else Signer(key, own[1], extras())
        self._waiting = bytearray()
        self._writing = threading.Lock()  # MAVSDK sends from threads of its own
        self._mavsdk: Any = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mavsdk-line", daemon=True)

    @property
    def ignored(self) -> Mapping[str, int]:
        """Everything that came as the vehicle's and was not believed, in words, and its count."""
        return dict(self._source.ignored)

    def start(self, mavsdk: Any) -> None:
        """Be the connection of a MAVSDK that has none."""
        self._mavsdk = mavsdk
        mavsdk.subscribe_raw_bytes_to_be_sent(self._send)
        mavsdk.add_any_connection_with_handle(RAW)
        self._thread.start()

    def stop(self) -> None:
        """Before MAVSDK is destroyed: nothing is handed on any more. Idempotent."""
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join(_END_S)

    def close(self) -> None:
        """After MAVSDK was destroyed. Idempotent."""
        self.stop()
        self._transport.close()

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                ready, _, _ = select.select((self._transport,), (), (), _WAIT_S)
            except (OSError, ValueError):  # the device is gone: the age of the heartbeat tells
                return
            if ready:
                self._take(*self._transport.read())

    def _take(self, data: bytes, source: Address | None) -> None:
        if not data:
            # a device that was unplugged is always ready, and has nothing
            self._ending.wait(_WAIT_S)
            return
        if source is not None:
            self._waiting.clear()  # what another one left unfinished does not hide what comes next
        self._waiting += data
        for frame in take_frames(self._waiting):
            if self._believes(frame, source) and not self._ending.is_set():
                self._mavsdk.pass_received_raw_bytes(frame)

    def _believes(self, frame: bytes, source: Address | None) -> bool:
        head = head_of(frame)
        now_ns = time.monotonic_ns()
        pinned = self._source.pinned
        # before there is a vehicle, a neighbour's heartbeat tells who is here
        if head.system != self._source.sysid:
            return source in (None, pinned) or (pinned is None and head.message == HEARTBEAT)
        if self._check is not None and not self._check.holds(frame):
            self._source.ignore(UNSIGNED)
            return False
        if source is None or self._source.believes(frame, source, now_ns):
            return True
        question = self._source.question(frame, source, now_ns)
        if question is not None:
            self._write(question, source)
        return False

    def _send(self, data: bytes) -> None:
        """Of MAVSDK's, from its threads."""
        waiting = bytearray(data)
        for frame in take_frames(waiting):
            self._write(frame, self._source.pinned)

    def _write(self, frame: bytes, to: Address | None) -> None:
        with self._writing:
            packet = frame if self._signer is None else self._signer.sign(frame)
            if packet is not None:
                self._transport.write(packet, to)

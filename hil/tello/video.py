"""The camera of an emulated Tello: an H.264 stream in UDP datagrams, as the real one sends it.

Annex B without time stamps, cut into datagrams of 1460 bytes; a key frame a second, with its
parameter sets.
"""

from __future__ import annotations

import contextlib
import random
import socket
import threading
from collections import deque
from fractions import Fraction
from typing import Any, Self

import av

from path.arrays import Image
from path.values import frozen

Address = tuple[str, int]

DATAGRAM = 1460
FPS = {"high": 30, "middle": 15, "low": 5}  # of ``setfps``
CORRUPT_SHARE = 0.25  # of the datagrams, while the video is corrupt
OLDEST_S = 1.0  # what has waited longer is not sent any more


@frozen
class TelloVideoConfig:
    """
    Attributes:
        rate_hz: frames a second that ``write`` is called with.
        latency_s: from a frame's exposure until its datagrams leave: the drone's own encoder and
            radio.
        bit_rate: of the stream, bits a second (the real one's automatic setting ends at 4 Mbit/s).
    """

    width: int
    height: int
    rate_hz: float = 30.0
    latency_s: float = 0.10
    bit_rate: int = 4_000_000


class TelloVideo:
    """``write`` (any one thread) takes frames, ``pump`` (the world's) sends what is due. Faults are
    plain attributes.

    Attributes:
        silent: nothing is sent.
        corrupt: datagrams are damaged or lost, a quarter of them.
        sent: frames whose datagrams were all sent, counted.
    """

    def __init__(self, config: TelloVideoConfig, seed: int = 0) -> None:
        self._config = config
        self._random = random.Random(seed)
        self._lock = threading.Lock()
        self._encoder: Any = None
        self._to: Address | None = None
        self._step = 1
        self._due: deque[tuple[float, bytes]] = deque()
        self._written = self._encoded = 0
        self._socket: socket.socket | None = None
        self.silent = False
        self.corrupt = False
        self.sent = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def rate_hz(self) -> float:
        """The rate at which ``write`` is to be called."""
        return self._config.rate_hz

    @property
    def wanted(self) -> bool:
        """Whether it streams: frames are of use."""
        return self._encoder is not None

    def start(self, host: str, to: Address) -> None:
        """Stream from an address of this computer to another, with a key frame first."""
        with self._lock:
            self._close()
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
            self._socket.bind((host, 0))
            config = self._config
            rate_hz = max(1, round(config.rate_hz / self._step))
            self._encoder = new_encoder(config.width, config.height, rate_hz, config.bit_rate)
            self._to = to
            self._encoded = 0

    def stop(self) -> None:
        with self._lock:
            self._close()

    def set_fps(self, name: str) -> bool:
        """Leave frames out, as ``setfps`` asks; False for what it does not know."""
        if name not in FPS:
            return False
        self._step = max(1, round(self._config.rate_hz / FPS[name]))
        return True

    def write(self, stamp_ns: int, color: Image) -> None:
        """One frame, (h, w, 3) BGR, exposed at a stamp of CLOCK_MONOTONIC."""
        self._written += 1
        with self._lock:
            if self._encoder is None or self._written % self._step:
                return
            frame = av.VideoFrame.from_ndarray(color, format="bgr24").reformat(format="yuv420p")
            frame.pts = self._encoded
            self._encoded += 1
            data = b"".join(bytes(packet) for packet in self._encoder.encode(frame))
            self._due.append((stamp_ns * 1e-9 + self._config.latency_s, data))

    def pump(self, monotonic_s: float) -> None:
        """Send all frames that are due."""
        while self._due and self._due[0][0] <= monotonic_s:
            due_s, data = self._due.popleft()
            if not self.silent and monotonic_s - due_s < OLDEST_S:
                self._send(data)

    def _send(self, data: bytes) -> None:
        out = self._socket
        to = self._to
        if out is None or to is None:
            return
        for start in range(0, len(data), DATAGRAM):
            piece = data[start : start + DATAGRAM]
            if self.corrupt and self._random.random() < CORRUPT_SHARE:
                if self._random.random() < 0.5:
                    continue
                piece = bytearray(piece)
                for _ in range(8):
                    piece[self._random.randrange(len(piece))] ^= self._random.randrange(1, 256)
            # nobody listens, or a full buffer: lost, as by a radio
            with contextlib.suppress(OSError):
                out.sendto(piece, to)
        self.sent += 1

    def _close(self) -> None:
        self._encoder = None
        self._to = None
        self._due.clear()
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def new_encoder(
    width: int,
    height: int,
    rate_hz: int,
    bit_rate: int,
) -> Any:
    """An H.264 encoder without look-ahead that repeats key frame and parameter sets once a
    second.
    """
    encoder: Any = av.CodecContext.create("libx264", "w")
    encoder.width = width
    encoder.height = height
    encoder.pix_fmt = "yuv420p"
    encoder.time_base, encoder.framerate = Fraction(1, rate_hz), Fraction(rate_hz, 1)
    encoder.bit_rate = bit_rate
    encoder.thread_count = 1  # the same bytes on every machine
    x264 = {
        "keyint": rate_hz, "min-keyint": rate_hz, "scenecut": 0, "repeat-headers": 1, "annexb": 1, "threads": 1,
        "vbv-maxrate": bit_rate // 1000, "vbv-bufsize": bit_rate // 2000,
    }  # fmt: skip
    encoder.options = {
        "preset": "ultrafast",
        "tune": "zerolatency",
        "profile": "main",
        "x264-params": ":".join(f"{name}={value}" for name, value in x264.items()),
    }
    return encoder

"""Intel RealSense D400 cameras (D415): colour with depth registered to it.

A device comes from this computer's USB, from a recording or from a factory that the rig names; all
that follows is the same for the three. See docs/cameras.md.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Self

from drivers.interfaces import CameraError, Frame
from drivers.perception.stamp_clock import Domain, StampConfig
from drivers.realsense.sdk import DeviceIdentity, Filter, Streams
from drivers.realsense.sources import DeviceSource, RecordingSource, UsbSource
from drivers.realsense.stream import PairStream, StreamConfig, StreamCounters
from drivers.rig.part_check import Finding
from drivers.rig.parts import PartContext, PartSpec, create
from drivers.wake import wake
from path.bounds import Bounds, check_bounds
from path.camera.model import CameraModel
from path.values import frozen

CLOSE_S = 5.0
WARM_UP_S = 300.0  # to compile what the first frame needs, where nobody has yet
MANY_USELESS = 0.05  # of the images


@frozen
class RealSenseConfig:
    """The size of the colour stream is that of the calibration.

    Attributes:
        serial: of the camera; may be left out while only one is connected.
        recording: play this file instead.
        source: or take the device that this part gives (a ``DeviceSource``).
        fps: of both streams.
        depth_size: width and height of the depth stream; by default that of the colour stream.
        min_depth_m, max_depth_m: nearer and farther there is no depth.
        filters: librealsense's, in this order; none by default: they smooth over the edges of
            things and fill holes with what is beside them, and the method counts on the noise of
            measured depth.
        emitter: the infrared pattern that gives plain surfaces texture.
        exposure_us: of the colour camera; 0 is automatic.
        latency_s: shortest time from the middle of an exposure to its arrival, for stamps of
            ``hardware_clock``.
        record: folder to write a recording into.
        silence_s, reopen_s: no frame for so long: open it again; for so long: give up.
        open_timeout_s: to the first frame, when there is nothing left to compile.
    """

    serial: str = ""
    recording: Path | None = None
    source: PartSpec | None = None
    fps: Annotated[int, Bounds(1, 300, "Hz")] = 30
    depth_size: Annotated[tuple[int, int] | None, Bounds(16, 16384, "px")] = None
    min_depth_m: Annotated[float, Bounds(0.0, 65.0)] = 0.3
    max_depth_m: Annotated[float, Bounds(0.05, 65.0)] = 6.0
    filters: tuple[Filter, ...] = ()
    emitter: bool = True
    exposure_us: Annotated[int, Bounds(0, 200_000)] = 0
    latency_s: Annotated[float, Bounds(0.0, 1.0)] = 0.0
    record: Path | None = None
    silence_s: Annotated[float, Bounds(0.05, 60.0)] = 1.0
    reopen_s: Annotated[float, Bounds(0.0, 600.0)] = 30.0
    open_timeout_s: Annotated[float, Bounds(0.1, 300.0)] = 10.0

    def __post_init__(self) -> None:
        if sum((bool(self.serial), self.recording is not None, self.source is not None)) > 1:
            raise ValueError("only one of serial, recording and source can be the camera")
        if not 0.0 <= self.min_depth_m < self.max_depth_m <= 65.0:
            raise ValueError(
                f"max_depth_m: {self.max_depth_m!r} is not above min_depth_m and at most 65 m"
            )
        if self.record is not None and self.recording is not None:
            raise ValueError("record: a recording is not recorded again")
        check_bounds(self)


class RealSense:
    """Implements ``drivers.interfaces.Camera``."""

    Config = RealSenseConfig

    def __init__(self, config: RealSenseConfig, context: PartContext) -> None:
        self._config = config
        self._model = context.camera
        self._clock = context.clock
        self.source = _source(config, context)
        self._stream: PairStream | None = None
        self._counters = StreamCounters()
        self._news = asyncio.Event()

    @property
    def model(self) -> CameraModel:
        return self._model

    @property
    def serial(self) -> str:
        """The serial number of the connected camera; "" of a recording or another source."""
        return self.source.serial if isinstance(self.source, UsbSource) else ""

    @property
    def counters(self) -> StreamCounters:
        """Counters since it was opened last."""
        return self._counters

    @property
    def rate_hz(self) -> float:
        return self._config.fps

    async def examine(self) -> Sequence[Finding]:
        """Return which device it is, whose clock stamps its frames, and how many images were of no
        use.
        """
        stream = self._stream
        counters = self._counters
        if stream is None or stream.identity is None or counters.domain is None:
            raise CameraError(
                f"{self.source.name} has given no frame yet", "open it, and wait for one"
            )
        return (*_device(stream.identity), _stamped(counters.domain), _paired(counters))

    async def __aenter__(self) -> Self:
        """Return with the first frame there. Raises CameraError."""
        loop = asyncio.get_running_loop()
        self._news = asyncio.Event()
        config = self._config
        size = (self._model.width, self._model.height)
        streams = Streams(
            size,
            config.depth_size or size,
            config.fps,
            config.filters,
            config.emitter,
            config.exposure_us,
        )
        stamps = StampConfig(latency_ns=round(config.latency_s * 1e9))
        limits_m = (config.min_depth_m, config.max_depth_m)
        settings = StreamConfig(
            streams,
            limits_m,
            stamps,
            config.record,
            config.silence_s,
            config.reopen_s,
        )
        self._stream = PairStream(
            self.source,
            settings,
            self._model,
            self._clock,
            lambda: wake(loop, self._news),
        )
        self._counters = self._stream.counters
        self._stream.start()
        try:
            await self._first(self._stream)
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close()

    async def read(self, timeout_s: float) -> Frame:
        """The newest frame not yet given.

        Raises:
            CameraError: none came in time (the camera is opened again meanwhile), or it was given
                up.
        """
        stream = self._stream
        if stream is None:
            raise CameraError(f"{self.source.name} is not open", "open it with `async with`")
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    ended = stream.ended  # asked first: its last frame may come just before it ends
                    frame = stream.take()
                    if frame is not None:
                        return frame
                    if ended:
                        raise self._lost(stream, "")
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            raise self._lost(stream, f" for {timeout_s:g} s") from None

    async def _first(self, stream: PairStream) -> None:
        try:
            async with asyncio.timeout(WARM_UP_S):
                while not (stream.warm or stream.ended):
                    self._news.clear()
                    await self._news.wait()
            async with asyncio.timeout(self._config.open_timeout_s):
                while not stream.counters.pairs:
                    if stream.trouble is not None:
                        raise stream.trouble
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            raise self._lost(stream, f" in the first {self._config.open_timeout_s:g} s") from None

    def _lost(self, stream: PairStream, how_long: str) -> CameraError:
        message = f"no frame from {self.source.name}{how_long}"
        trouble = stream.trouble
        if trouble is None:
            return CameraError(message, "see whether its cable and port carry USB 3")
        state = "given up" if stream.ended else "it is opened again meanwhile"
        return CameraError(f"{message}: {trouble} ({state})", trouble.remedy)

    async def _close(self) -> None:
        stream = self._stream
        self._stream = None
        if stream is None:
            return
        stream.end()
        try:
            async with asyncio.timeout(CLOSE_S):
                while not stream.ended:
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            raise CameraError(
                f"{self.source.name} does not close within {CLOSE_S:g} s",
                "unplug it, and end this program",
            ) from None
        stream.join()


def _device(identity: DeviceIdentity) -> Iterator[Finding]:
    detail = f"{identity.name}, serial {identity.serial or 'not said'}, firmware {identity.firmware or 'not said'}"
    if identity.recommended and identity.firmware != identity.recommended:
        fix = "librealsense's rs-fw-update sets it; measure its latency again afterwards"
        yield Finding(
            "note",
            "device",
            f"{detail}, librealsense recommends {identity.recommended}",
            fix,
        )
    else:
        yield Finding("ok", "device", detail)
    if identity.usb.startswith(("1", "2")):
        yield Finding(
            "note",
            "USB",
            f"{identity.usb}: large images do not fit",
            "another port, and a cable for USB 3",
        )
    elif identity.usb:
        yield Finding("ok", "USB", identity.usb)


def _stamped(domain: Domain) -> Finding:
    if domain is Domain.SYSTEM:
        fix = "librealsense's kernel patches or its user-space backend give the frames' metadata"
        return Finding("note", "stamped by", f"{domain.value}: the arrival, not the exposure", fix)
    return Finding("ok", "stamped by", domain.value)


def _paired(counters: StreamCounters) -> Finding:
    detail = f"{counters.pairs}; {counters.unpaired} images alone, {counters.old + counters.clock} with a useless stamp"
    if counters.unpaired + counters.old + counters.clock > MANY_USELESS * counters.pairs:
        fix = "a USB 3 port of its own, and the computer's clock left alone"
        return Finding("note", "pairs", detail, fix)
    return Finding("ok", "pairs", detail)


def _source(config: RealSenseConfig, context: PartContext) -> DeviceSource:
    if config.source is not None:
        return create(config.source, context)
    return (
        RecordingSource(config.recording)
        if config.recording is not None
        else UsbSource(config.serial)
    )

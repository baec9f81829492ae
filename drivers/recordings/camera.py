"""Any recording as a camera: a video file, a folder of images, or a log of PATH, paced by its own
stamps.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Literal, Self

from drivers.interfaces import CameraError, Frame
from drivers.recordings.recording import (
    Loaded,
    RecordedFrame,
    Recording,
    RecordingOptions,
    open_recording,
)
from drivers.rig.calibration_file import check_size
from drivers.rig.parts import PartContext
from path.bounds import Bounds, check_bounds
from path.camera.model import CameraModel
from path.values import frozen

LOOP_GAP_NS = 33_000_000  # from the last frame to the first one again, where there is only one


@frozen
class RecordedCameraConfig:
    """
    Attributes:
        file: video file, folder of images, or .mcap log; relative to the rig.
        pace: "real": a frame comes when its stamp says, and late ones are skipped, as of a camera;
            "fast": each frame, as soon as it is asked for.
        speed: of pace "real": 2 plays twice as fast, with stamps accordingly closer together.
        loop: begin again at the end.
        serial: serial number of the camera that it was recorded with, "" when it is not known.
        rate_hz, stamps, depth, topic: as in ``drivers.recordings.recording.RecordingOptions``.
    """

    file: Path
    pace: Literal["real", "fast"] = "real"
    speed: Annotated[float, Bounds(0.01, 100.0, "times")] = 1.0
    loop: bool = False
    serial: str = ""
    rate_hz: Annotated[float | None, Bounds(0.1, 1000.0)] = None
    stamps: Path | None = None
    depth: Path | None = None
    topic: str = ""

    def __post_init__(self) -> None:
        check_bounds(self)
        self.options()

    def options(self) -> RecordingOptions:
        return RecordingOptions(self.rate_hz, self.stamps, self.depth, self.topic)


@frozen
class _Ready:
    """A frame to give: ``at_ns`` after the first one of all."""

    number: int
    at_ns: int
    loaded: Loaded


class RecordedCamera:
    """Implements ``drivers.interfaces.Camera``.

    The first frame is due when the camera is opened; stamps are of the role's clock from then on,
    as far apart as they were recorded. A thread decodes the frame that comes next while the one
    before is looked at.
    """

    Config = RecordedCameraConfig

    def __init__(self, config: RecordedCameraConfig, context: PartContext) -> None:
        self._config = config
        self._model = context.camera
        self._clock = context.clock
        self._speed = config.speed if config.pace == "real" else 1.0
        self._frames: Iterator[_Frame] = iter(())
        self._peeked: _Frame | None = None
        self._thread: ThreadPoolExecutor | None = None
        self._coming: Future[_Ready | None] | None = None
        self._start_ns = 0
        self._start_s = 0.0
        self._given = 0
        self.serial = config.serial

    @property
    def model(self) -> CameraModel:
        return self._model

    @property
    def given(self) -> int:
        """Frames that were read."""
        return self._given

    async def __aenter__(self) -> Self:
        """Raise CameraError when the recording cannot be played, or is not of the calibration's
        size.
        """
        recording = open_recording(self._config.file, self._config.options())
        self._frames = _played(recording, self._config.loop)
        self._peeked = None
        self._given = 0
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recording")
        try:
            self._coming = self._thread.submit(self._fetch)
            self._coming.result()
        except BaseException:
            await self.__aexit__(None, None, None)
            raise
        self._start_ns, self._start_s = self._clock.now_ns(), asyncio.get_running_loop().time()
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._thread is not None:
            self._thread.shutdown(wait=True, cancel_futures=True)
            self._thread = None

    async def read(self, timeout_s: float) -> Frame:
        """The next frame ("fast"), or the newest that is due ("real").

        Raises:
            CameraError: there are no more, or the next frame is due later than that, or is damaged.
        """
        if self._thread is None or self._coming is None:
            raise CameraError("the recorded camera is not open", "open it with `async with`")
        ready = self._coming.result()
        if ready is None:
            raise CameraError(
                f"no frame from {self._config.file}: the recording ended after {self._given} frames",
                "loop = true plays it again and again",
            )
        if self._config.pace == "real":
            ready = await self._due(ready, timeout_s, self._thread)
        self._coming = self._thread.submit(self._fetch)
        self._given += 1
        return Frame(
            self._start_ns + round(ready.at_ns / self._speed),
            ready.number,
            ready.loaded.color,
            ready.loaded.depth_mm,
        )

    async def _due(
        self,
        ready: _Ready,
        timeout_s: float,
        thread: ThreadPoolExecutor,
    ) -> _Ready:
        """Wait until a frame is due; when it is overdue, the newest one that is due takes its
        place.
        """
        loop = asyncio.get_running_loop()
        elapsed_s = loop.time() - self._start_s
        wait_s = ready.at_ns / 1e9 / self._speed - elapsed_s
        if wait_s > timeout_s:
            await asyncio.sleep(max(timeout_s, 0.0))
            raise CameraError(
                f"no frame from {self._config.file} for {timeout_s:g} s; the next one comes after {wait_s:.3f} s",
                "the recording has a gap there",
            )
        if wait_s > 0.0:
            await asyncio.sleep(wait_s)
            return ready
        newer = thread.submit(self._fetch, round(1e9 * elapsed_s * self._speed)).result()
        return newer or ready

    def _fetch(self, until_ns: int | None = None) -> _Ready | None:
        """Return the next frame; or with ``until_ns`` the last one up to then, None when there is
        none.

        Runs in the thread.
        """
        found: _Frame | None = None
        while True:
            frame = self._peeked or next(self._frames, None)
            self._peeked = None
            if frame is None or (until_ns is not None and frame.at_ns > until_ns):
                self._peeked = frame
                break
            found = frame
            if until_ns is None:
                break
        if found is None:
            return None
        loaded = found.recorded.load()
        size = loaded.color.shape[1], loaded.color.shape[0]
        check_size(
            (self._model.width, self._model.height),
            size,
            f"{self._config.file}, {found.recorded.name}",
        )
        return _Ready(found.number, found.at_ns, loaded)


@frozen
class _Frame:
    recorded: RecordedFrame
    number: int
    at_ns: int


def _played(recording: Recording, loop: bool) -> Iterator[_Frame]:
    """Frames with times that increase from 0 on, over and over when asked; those with an old stamp
    are left out.
    """
    begin_ns = 0
    number = 0
    while True:
        first_ns: int | None = None
        last_ns = -1
        step_ns = LOOP_GAP_NS
        for frame in recording.frames():
            first_ns = frame.stamp_ns if first_ns is None else first_ns
            at_ns = frame.stamp_ns - first_ns
            if at_ns <= last_ns:
                continue
            if last_ns >= 0:
                step_ns = at_ns - last_ns
            last_ns = at_ns
            yield _Frame(frame, number, begin_ns + at_ns)
            number += 1
        if not loop or last_ns < 0:
            return
        begin_ns += last_ns + step_ns

"""The camera of a Tello: H.264 over UDP through djitellopy's reader. Newest frame only, no depth.

The stream carries no time. A frame's stamp is its arrival less the latency that was measured
(docs/tello.md), and no frame is given before the reader, which starts with what it buffered, has
caught up with the stream.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal, Self

import av.error
from djitellopy.tello import BackgroundFrameRead, TelloException  # type: ignore[import-untyped]

from drivers.interfaces import CameraError, Capability, Frame, VehicleError
from drivers.rig.part_check import Finding
from drivers.rig.parts import PartContext
from drivers.tello.address import TelloAddress
from drivers.tello.commands import TelloLink, link_to, said
from drivers.wake import wake
from path.arrays import Image
from path.bounds import Bounds
from path.camera.model import CameraModel
from path.values import frozen

FPS_NAMES: dict[int, str] = {30: "high", 15: "middle", 5: "low"}
# for djitellopy to recognise the stream, which takes some 40 frames; its own 5 s are too few at 5
# Hz
PROBE_S = 12.0
OPEN_S = PROBE_S + 3.0
COMMAND_S = 3.0
# silence for so long ends the reader's thread; long before, no frame is an error
STALL_US = 1_500_000
CLOSE_S = 3.0
PACE_S = 1.0
CAUGHT_UP = 1.3  # of the frames that a second should bring: more than that were buffered
CATCH_UP_S = 6.0
POLL_S = 0.02

Rate = Literal[5, 15, 30]


@frozen
class TelloCameraConfig(TelloAddress):
    """Options of the camera in a rig, besides the drone's address, which is that of its vehicle.

    Attributes:
        rate_hz: frames a second: 30 is what every Tello sends, 15 and 5 need ``setfps`` (SDK 3).
        latency_s: from exposure to the decoded frame, as measured.
        latency_sigma_s: how well that is known.
    """

    rate_hz: Rate = 30
    latency_s: Annotated[float, Bounds(0.0, 2.0)] = 0.16
    latency_sigma_s: Annotated[float, Bounds(0.0, 1.0)] = 0.03

    def __post_init__(self) -> None:
        TelloAddress.__post_init__(self)
        if not (0.0 <= self.latency_s < 2.0 and self.latency_sigma_s >= 0.0):
            raise ValueError("latency_s must be within 0..2, latency_sigma_s not negative")


class _Reader(BackgroundFrameRead):
    """djitellopy's reader with its loop replaced: arrival stamps, BGR, no damaged frames, a bounded
    end.
    """

    def __init__(self, tello: Any, address: str, take: Callable[[Image], None]) -> None:
        self._take = take
        self.damaged = 0
        self.failure: Exception | None = None
        super().__init__(tello, address)

    def update_frame(self) -> None:
        stream: Any = self.container.streams.video[0]
        waiting_for_key = False
        try:
            for packet in self.container.demux(stream):
                if self.stopped:
                    break
                try:
                    frames = packet.decode()
                except av.error.FFmpegError:
                    frames = []
                    waiting_for_key = True
                    self.damaged += 1
                for frame in frames:
                    if frame.is_corrupt:
                        self.damaged += 1
                        waiting_for_key = True
                    elif frame.key_frame or not waiting_for_key:
                        waiting_for_key = False
                        self._take(frame.to_ndarray(format="bgr24"))
        except Exception as error:
            self.failure = error  # told by whoever waits for a frame
        finally:
            self.container.close()


class TelloCamera:
    """Implements ``drivers.interfaces.Camera``.

    Attributes:
        skipped: frames replaced by a newer one before they were read.
    """

    Config = TelloCameraConfig
    lacks = frozenset({Capability.RANGE})

    def __init__(self, config: TelloCameraConfig, context: PartContext) -> None:
        self._config = config
        self._context = context
        self._link: TelloLink | None = None
        self._reader: _Reader | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wake = asyncio.Event()
        self._lock = threading.Lock()
        self._newest: tuple[int, int, Image] | None = None
        self._count = 0
        self._given = 0
        self._arrivals: deque[int] = deque(maxlen=128)
        self.skipped = 0

    @property
    def model(self) -> CameraModel:
        return self._context.camera

    @property
    def rate_hz(self) -> float:
        return self._config.rate_hz

    @property
    def damaged(self) -> int:
        """Frames not given because the decoder found them damaged."""
        return self._reader.damaged if self._reader is not None else 0

    async def examine(self) -> Sequence[Finding]:
        config = self._config
        damaged = self.damaged
        way = f"{config.latency_s:g} s, give or take {config.latency_sigma_s:g}, as the rig says: not measured here"
        if not damaged:
            return (Finding("ok", "latency", way), Finding("ok", "damaged", "no frame"))
        fix = "nearer to the drone, or another Wi-Fi channel"
        return (Finding("ok", "latency", way), Finding("note", "damaged", f"{damaged} frames", fix))

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        try:
            link = link_to(self._config, self._context.clock)
            await link.acquire()
            self._link = link
            await self._set_rate(link)
            await self._command("streamon")
            self._reader = await self._open_reader(link)
            self._reader.start()
            await self._until_caught_up()
        except VehicleError as error:
            await self._close()
            raise CameraError(str(error), error.remedy) from error
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close()

    async def read(self, timeout_s: float) -> Frame:
        """The newest frame not yet given.

        Raises:
            CameraError: none came within ``timeout_s``: the stream stopped, or all of it is
                damaged; or it is not open.
        """
        self._open_link().clock.follow()
        try:
            async with asyncio.timeout(timeout_s):
                while (frame := self._take_newest()) is None:
                    self._wake.clear()
                    await self._wake.wait()
                    self._open_link()
        except TimeoutError:
            raise self._silent(timeout_s) from None
        return frame

    # --- inside ---

    def _open_link(self) -> TelloLink:
        if self._link is None:
            raise CameraError("the Tello's camera is not open", "open it with `async with`")
        return self._link

    def _take_newest(self) -> Frame | None:
        with self._lock:
            newest = self._newest
            if newest is None or newest[0] <= self._given:
                return None
            number, arrival_ns, image = newest
            self.skipped += number - self._given - 1
            self._given = number
        return Frame(arrival_ns - round(self._config.latency_s * 1e9), number, image, None)

    def _silent(self, timeout_s: float) -> CameraError:
        return CameraError(
            f"no video frame from {self._config.host} for {timeout_s:g} s, {self._trouble()}",
            "is the drone near, and its Wi-Fi free of others? docs/tello.md",
        )

    def _trouble(self) -> str:
        reader = self._reader
        if reader is None:
            return "the camera is being opened"
        if reader.failure is not None:
            return f"the stream has ended: {reader.failure}"
        return f"{reader.damaged} damaged ones"

    def _on_frame(self, image: Image) -> None:
        """Take a frame on the reader's thread."""
        link = self._link
        loop = self._loop
        if link is None or loop is None:
            return
        arrival_ns = link.clock.now_ns()
        with self._lock:
            self._count += 1
            self._newest = (self._count, arrival_ns, image)
            self._arrivals.append(arrival_ns)
        wake(loop, self._wake)

    async def _until_caught_up(self) -> None:
        """Wait until frames come at the stream's own pace: then they are as old as the latency
        says.
        """
        end_s = time.monotonic() + CATCH_UP_S
        most = CAUGHT_UP * self._config.rate_hz * PACE_S
        while True:
            with self._lock:
                arrivals = list(self._arrivals)
            newest = arrivals[-1] if arrivals else 0
            lately = [each for each in arrivals if newest - each < PACE_S * 1e9]
            if len(lately) < len(arrivals) and len(lately) <= most:
                break
            if time.monotonic() > end_s:
                got = f"{self._count} frames" if self._count else "no frame"
                raise CameraError(
                    f"the video of {self._config.host} is not steady: {got} in {CATCH_UP_S:g} s, {self._trouble()}",
                    "is the drone near, and its Wi-Fi free of others? docs/tello.md",
                )
            await asyncio.sleep(POLL_S)
        with self._lock:
            self._given = self._count

    async def _set_rate(self, link: TelloLink) -> None:
        if self._config.rate_hz == 30:
            return
        name = FPS_NAMES[self._config.rate_hz]
        answer = await link.ask(f"setfps {name}", COMMAND_S)
        if answer is None or answer.lower() != "ok":
            raise CameraError(
                f"the drone does not send {self._config.rate_hz} frames a second: {said(answer)}",
                "only a firmware with SDK 3 does; set rate_hz = 30",
            )

    async def _command(self, command: str) -> None:
        assert self._link is not None
        answer = await self._link.ask(command, COMMAND_S)
        if answer is None or answer.lower() != "ok":
            raise CameraError(
                f"{command} to {self._config.host}: {said(answer)}", "restart the drone"
            )

    async def _open_reader(self, link: TelloLink) -> _Reader:
        """The library's constructor waits for the stream, so it runs in a thread, and that is
        waited for.
        """
        link.tello.__class__.FRAME_GRAB_TIMEOUT = PROBE_S
        address = f"{link.tello.get_udp_video_address()}?timeout={STALL_US}&overrun_nonfatal=1"
        opened: list[_Reader | BaseException] = []

        def open_it() -> None:
            try:
                opened.append(_Reader(link.tello, address, self._on_frame))
            except BaseException as error:
                opened.append(error)

        threading.Thread(target=open_it, name="tello-video-open", daemon=True).start()
        end_s = time.monotonic() + OPEN_S
        while not opened:
            if time.monotonic() > end_s:
                raise CameraError(
                    f"no video on UDP port {self._config.video_port} in {OPEN_S:g} s",
                    "see docs/tello.md",
                )
            await asyncio.sleep(POLL_S)
        result = opened[0]
        if isinstance(result, _Reader):
            return result
        if isinstance(result, (TelloException, av.error.FFmpegError)):
            raise CameraError(
                f"no video on UDP port {self._config.video_port}: {result}",
                "does a firewall keep it away, or another program take it? (docs/tello.md)",
            ) from result
        raise result

    async def _close(self) -> None:
        reader = self._reader
        link = self._link
        self._reader = self._link = None
        self._wake.set()  # whoever waits for a frame is told
        if reader is not None:
            reader.stop()
        try:
            if link is not None and reader is not None:
                await link.ask("streamoff", 1.0, urgent=True)
        except VehicleError:
            pass  # it is gone; so is its stream
        finally:
            if link is not None:
                await link.release()
        if reader is not None:
            end_s = time.monotonic() + CLOSE_S
            while time.monotonic() < end_s:
                if not reader.worker.is_alive():
                    return
                await asyncio.sleep(POLL_S)

"""The thread of a RealSense camera: device to frames, and again when the device comes back.

Colour and depth come as they are taken, each with a stamp of its own; two that were taken together
make a pair. Only the newest is kept, and it is made a frame when somebody takes it: what nobody
sees costs next to nothing. The thread ends when it is told to, when a device cannot come back, or
when it did not in time.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.clock import busy_ns, wall_offset_ns
from drivers.interfaces import CameraError, Clock, Frame
from drivers.perception.stamp_clock import Domain, StampClock, StampConfig, StampLine, StampRefused
from drivers.realsense.registration import DepthRegistration, warm_up
from drivers.realsense.sdk import (
    QUEUE_FRAMES,
    DeviceIdentity,
    Kind,
    RawImage,
    RealSenseDevice,
    Streams,
    identity_of,
)
from drivers.realsense.sources import DeviceSource
from path.camera.model import CameraModel
from path.values import frozen

POLL_S = 0.1  # how soon the thread sees that it should end
PLAYBACK_AGE_NS = 50_000_000  # of a recording's frames when they come


@frozen
class StreamConfig:
    """
    Attributes:
        limits_m: depth that is believed.
        record: folder for recordings; None records nothing.
        silence_s: without a frame for so long, the device is closed and opened again.
        reopen_s: for so long; then it is given up.
        reopen_every_s: pause between two attempts.
    """

    streams: Streams
    limits_m: tuple[float, float]
    stamps: StampConfig
    record: Path | None = None
    silence_s: float = 1.0
    reopen_s: float = 30.0
    reopen_every_s: float = 0.5


@dataclass(slots=True)
class StreamCounters:
    """Counters of a stream. ``*_ns`` are CPU time of the thread that did it: of the stream's, and
    of who takes frames.

    ``domain`` is whose clock stamps the frames, ``age_ns`` how old the newest pair was when it
    arrived.
    """

    domain: Domain | None = None
    age_ns: int = 0
    opened: int = 0
    pairs: int = 0
    frames: int = 0  # pairs that were taken
    replaced: int = 0  # by a newer one before anybody took them
    unpaired: int = 0  # images without their other half
    old: int = 0  # stamps that repeat or go back
    clock: int = 0  # stamps that are not of this computer's time
    stream_ns: int = 0
    copy_ns: int = 0
    register_ns: int = 0


@frozen
class ImagePair:
    """Two images that were taken together; ``stamp_ns`` is that of colour, role clock."""

    stamp_ns: int
    frame_id: int
    color: RawImage
    depth: RawImage
    registration: DepthRegistration


@frozen
class Taken:
    """An image, its stamp in its device's clock, growing with every image of its kind, and its
    arrival, role clock.
    """

    stamp_ns: int
    arrival_ns: int
    image: RawImage


class Pairing:
    """Finds colour and depth that were taken together. ``unpaired`` counts images that were passed
    over.
    """

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._waiting: dict[Kind, list[Taken]] = {"color": [], "depth": []}
        self.unpaired = 0

    def add(self, taken: Taken) -> tuple[Taken, Taken] | None:
        """Colour and depth; None while one of them is to come."""
        kind = taken.image.kind
        own = self._waiting[kind]
        others = self._waiting["depth" if kind == "color" else "color"]
        while others and others[0].stamp_ns < taken.stamp_ns - self._tolerance_ns:
            others.pop(0)
            self.unpaired += 1
        if not others or others[0].stamp_ns > taken.stamp_ns + self._tolerance_ns:
            own.append(taken)
            if len(own) > 2:
                own.pop(0)
                self.unpaired += 1
            return None
        self.unpaired += len(own)
        own.clear()
        other = others.pop(0)
        return (taken, other) if kind == "color" else (other, taken)


class PairStream(threading.Thread):
    """Runs until ``end``. ``on_news`` is called in this thread after every frame, every trouble and
    at the end.
    """

    def __init__(
        self,
        source: DeviceSource,
        config: StreamConfig,
        color: CameraModel,
        clock: Clock,
        on_news: Callable[[], None],
    ) -> None:
        super().__init__(name=source.name, daemon=True)
        self._source = source
        self._config = config
        self._color = color
        self._clock = clock
        self._on_news = on_news
        self._ending = threading.Event()
        self._lock = threading.Lock()
        self._newest: ImagePair | None = None
        self._last_id = -1
        self._started_ns = 0
        self._tolerance_ns = round(0.5e9 / config.streams.fps)
        self._stamps = config.stamps if source.live else StampConfig(PLAYBACK_AGE_NS, follow=False)
        self.counters = StreamCounters()
        self.trouble: CameraError | None = None
        self.warm = False  # what has to be compiled is
        self.ended = False
        self.identity: DeviceIdentity | None = None  # of the device that was opened last

    def take(self) -> Frame | None:
        """The newest frame not yet taken; to be called by one thread."""
        with self._lock:
            pair = self._newest
            self._newest = None
        if pair is None:
            return None
        counters = self.counters
        start = busy_ns()
        # the library will use its memory again
        color = np.array(pair.color.pixels, np.uint8, order="C")
        copied = busy_ns()
        depth_mm = pair.registration.register(np.asarray(pair.depth.pixels, np.uint16))
        counters.copy_ns += copied - start
        counters.register_ns += busy_ns() - copied
        counters.frames += 1
        return Frame(pair.stamp_ns, pair.frame_id, color, depth_mm)

    def end(self) -> None:
        self._ending.set()

    def run(self) -> None:
        try:
            warm_up()
            self.warm = True
            self._on_news()
            self._started_ns = busy_ns()
            self._run()
        except Exception as error:
            self.trouble = CameraError(
                f"{self._source.name}: {error!r}", "this is a fault of the program: report it"
            )
        finally:
            self.ended = True
            self._on_news()

    def _run(self) -> None:
        give_up_s = time.monotonic()
        while not self._ending.is_set():
            before = self.counters.pairs
            try:
                self._use_device()
            except CameraError as error:
                self.trouble = error
            # all that librealsense ever raises, such as on a device that was pulled out
            except RuntimeError as error:
                self.trouble = CameraError(
                    f"librealsense says: {error}", "plug it in again, or into another port"
                )
            if self._ending.is_set():
                return
            now_s = time.monotonic()
            if self.counters.pairs > before:
                give_up_s = now_s + self._config.reopen_s
            if not self._source.returns or now_s >= give_up_s:
                return
            self._on_news()
            self._ending.wait(self._config.reopen_every_s)

    def _use_device(self) -> None:
        """One opening of the device, until it falls silent."""
        config = self._config
        device = None
        try:
            opened = self._source.open()
            self.identity = identity_of(opened)
            device = RealSenseDevice(opened, config.streams, self._recording())
            self.counters.opened += 1
            self._watch(device)
        finally:
            if device is not None:
                device.close()
            self._source.close()

    def _recording(self) -> Path | None:
        folder = self._config.record
        if folder is None:
            return None
        stem = f"{time.strftime('%Y%m%d-%H%M%S')}-{re.sub('[^A-Za-z0-9]+', '-', self._source.name)}"
        taken = {file.name for file in folder.glob(f"{stem}*")}
        return folder / next(
            name for i in range(len(taken) + 1) if (name := f"{stem}-{i}.db3") not in taken
        )

    def _watch(self, device: RealSenseDevice) -> None:
        """Publish what comes. Raises CameraError when nothing does any more."""
        limit_s = self._config.silence_s
        registration = self._registration(device)
        lines: dict[Kind, StampLine] = {"color": StampLine(), "depth": StampLine()}
        clock = StampClock(self._stamps)
        pairing = Pairing(self._tolerance_ns)
        base = None
        heard_s = paired_s = time.monotonic()
        while not self._ending.is_set():
            newest = None
            # Asked before what waits is taken: a short recording may play from its beginning to its
            # end meanwhile.
            played_out = device.at_end
            for image in _waiting(device):
                heard_s = time.monotonic()
                pair = self._paired(image, lines[image.kind], pairing)
                self.counters.replaced += pair is not None and newest is not None
                newest = pair or newest
            stamp_ns = None if newest is None else self._mapped(newest[0], clock)
            if newest is not None and stamp_ns is not None:
                color, depth = (each.image for each in newest)
                # a device that was opened again may count from the beginning again
                if base is None:
                    base = max(self._last_id + 1 - color.number, 0)
                frame_id = max(base + color.number, self._last_id + 1)
                self._publish(ImagePair(stamp_ns, frame_id, color, depth, registration))
                paired_s = heard_s
            elif played_out or time.monotonic() - paired_s > limit_s:
                raise self._silent(time.monotonic() - paired_s, heard=heard_s > paired_s)
            self.counters.stream_ns = busy_ns() - self._started_ns

    def _registration(self, device: RealSenseDevice) -> DepthRegistration:
        limits_m = self._config.limits_m
        try:
            return DepthRegistration(
                device.depth, self._color, device.T_color_depth, device.unit_m, limits_m
            )
        except ValueError as error:
            raise CameraError(
                f"{self._source.name}: depth cannot be registered to colour: {error}",
                "see whether the calibration is of this camera, and choose another depth_size",
            ) from error

    def _paired(
        self, image: RawImage, line: StampLine, pairing: Pairing
    ) -> tuple[Taken, Taken] | None:
        arrival_ns = self._clock.now_ns()
        stamp_ns = line.next(image.stamp_ns, image.domain)
        if stamp_ns is None:
            self.counters.old += 1
            return None
        before = pairing.unpaired
        pair = pairing.add(Taken(stamp_ns, arrival_ns, image))
        self.counters.unpaired += pairing.unpaired - before
        return pair

    def _mapped(self, color: Taken, clock: StampClock) -> int | None:
        """The role's stamp of a pair; None, and counted, when there is none to be trusted."""
        wall_ns = wall_offset_ns(self._clock.now_ns)
        stamp_ns = clock.to_role(color.stamp_ns, color.image.domain, color.arrival_ns, wall_ns)
        if not isinstance(stamp_ns, StampRefused):
            self.counters.domain = color.image.domain
            self.counters.age_ns = color.arrival_ns - stamp_ns
            return stamp_ns
        if stamp_ns is StampRefused.OLD:
            self.counters.old += 1
        else:
            self.counters.clock += 1
        return None

    def _publish(self, pair: ImagePair) -> None:
        with self._lock:
            self.counters.replaced += self._newest is not None
            self._newest = pair
            self._last_id = pair.frame_id
            self.trouble = None
            self.counters.pairs += 1
        self._on_news()

    def _silent(self, silent_s: float, *, heard: bool) -> CameraError:
        counters = self.counters
        if (missing := self._source.missing()) is not None:
            return missing
        if heard:
            return CameraError(
                f"it gives images, but none that belong together for {silent_s:.1f} s ({counters.old} with old "
                f"stamps, {counters.clock} not of this computer's time, {counters.unpaired} without their other half)",
                "see whether the computer's clock was set, and whether both streams run",
            )
        return CameraError("it is there, but silent", "see whether its cable and port carry USB 3")


def _waiting(device: RealSenseDevice) -> Iterator[RawImage]:
    """All images that wait, or the first one to come; no more than the queue holds."""
    image = device.next(POLL_S)
    for _ in range(QUEUE_FRAMES):
        if image is None:
            return
        yield image
        image = device.next(0.0)

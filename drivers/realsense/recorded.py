"""A RealSense recording (``.db3``, ``.bag``) read to its end, frame by frame, as fast as they are
taken.

The driver plays a recording as the camera it was, in real time, and passes over what is late. Here
nothing is passed over: playback waits while a frame is not taken. Whoever recorded it need not have
known of PATH.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from drivers.interfaces import CameraError
from drivers.perception.stamp_clock import Domain
from drivers.realsense.formats import bgr_of
from drivers.realsense.sdk import (
    FORMATS,
    Kind,
    RawImage,
    by_sensor,
    extrinsics_of,
    intrinsics_of,
    load_recording,
    mid_exposure_ns,
    serial_of,
    stop,
    unit_of,
)
from drivers.realsense.sdk_import import import_realsense
from drivers.realsense.stream import Pairing, Taken
from path.arrays import Depths, Image
from path.camera.lenses import StandIn
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.values import frozen

WAITING = 8
SILENT_S = 60.0  # without a frame before the end: the file is damaged
POLL_S = 0.1


@frozen
class RecordedPair:
    """Colour (h, w, 3) BGR and depth (h, w) in the device's unit, taken together at ``stamp_ns`` of
    its ``domain``.
    """

    stamp_ns: int
    domain: Domain
    color: Image
    depth: Depths


class RealSenseRecording:
    """A recording that has both streams.

    Attributes:
        serial: of the camera; "" when it does not say.
        depth, T_color_depth, unit_m: as of ``RealSenseDevice``.
        color_size: (width, height) in px.
    """

    def __init__(self, file: Path) -> None:
        """Raise CameraError for a file that cannot be played, or has not both streams."""
        self._file = file
        self._device = load_recording(file)
        self._playback = self._device.as_playback()
        self._playback.set_real_time(False)
        self._depth, self._color_profile = self._streams()
        depth_sensor, depth = self._depth
        color = self._color_profile[1]
        self.serial = serial_of(self._device)
        self.unit_m = unit_of(depth_sensor, str(file))
        self.depth: CameraModel = intrinsics_of(depth.as_video_stream_profile(), "depth").camera
        self._color = color.as_video_stream_profile()
        self.color_size: tuple[int, int] = self._color.width(), self._color.height()
        self.T_color_depth: Pose = extrinsics_of(depth, color)
        self._color_format = color.format().name
        self._tolerance_ns = round(0.5e9 / color.fps())

    def _streams(self) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
        """Sensor and profile of depth and of colour. Raises CameraError where one is not there."""
        found: dict[tuple[str, str], tuple[Any, Any]] = {}
        for sensor in self._device.query_sensors():
            for profile in sensor.get_stream_profiles():
                found.setdefault(
                    (profile.stream_type().name, profile.format().name), (sensor, profile)
                )
        wanted: dict[Kind, list[tuple[Any, Any]]] = {
            kind: [found[kind, form] for form in FORMATS[kind] if (kind, form) in found]
            for kind in FORMATS
        }
        missing = [kind for kind in ("color", "depth") if not wanted[kind]]
        if missing:
            offered = ", ".join(sorted(" ".join(named) for named in found)) or "nothing"
            raise CameraError(
                f"{self._file} has no {' and no '.join(missing)} to be read; it has: {offered}",
                f"record depth (z16) and colour ({', '.join(FORMATS['color'])})",
            )
        return wanted["depth"][0], wanted["color"][0]

    def factory_color(self) -> StandIn:
        """The colour camera as its maker calibrated it. Raises CameraError for a lens that cannot
        be described.
        """
        return intrinsics_of(self._color, "color")

    def pairs(self) -> Iterator[RecordedPair]:
        """Yield all pairs from where it is to the end; images without their other half are left
        out.

        Raises CameraError when nothing comes and it has not ended.
        """
        rs = import_realsense()
        waiting = queue.Queue[RawImage](WAITING)
        ending = threading.Event()

        def take(frame: Any) -> None:
            """In librealsense's thread, which waits here while nobody takes what came."""
            domain = Domain(frame.get_frame_timestamp_domain().name)
            kind: Kind = "depth" if frame.is_depth_frame() else "color"
            stamp_ns = mid_exposure_ns(rs, frame, domain)
            data = frame.get_data()
            pixels = np.asanyarray(data) if kind == "depth" else bgr_of(data, self._color_format)
            image = RawImage(
                kind,
                frame.get_frame_number(),
                stamp_ns,
                domain,
                np.array(pixels, order="C"),
                None,
            )
            while not ending.is_set():
                try:
                    waiting.put(image, timeout=POLL_S)
                    return
                except queue.Full:
                    continue

        self._playback.pause()
        running: list[Any] = []
        beginning = ThreadPoolExecutor(1, "recording")
        try:
            for sensor, profiles in by_sensor([self._depth, self._color_profile]):
                sensor.open(profiles)
                running.append(sensor)
                sensor.start(take)
            # It may wait for images that have come to be taken, for ten seconds: they are taken
            # here meanwhile.
            begun = beginning.submit(self._playback.resume)
            yield from self._paired(waiting, begun)
        except RuntimeError as error:  # all that librealsense ever raises
            raise CameraError(
                f"{self._file} cannot be played: {error}", "is the file whole?"
            ) from error
        finally:
            ending.set()
            beginning.shutdown()
            stop(running, self._playback)

    def _paired(
        self, waiting: queue.Queue[RawImage], begun: Future[None]
    ) -> Iterator[RecordedPair]:
        pairing = Pairing(self._tolerance_ns)
        heard_s = time.monotonic()
        while True:
            try:
                image = waiting.get(timeout=POLL_S)
            except queue.Empty:
                if begun.done():
                    begun.result()  # raises what librealsense raised
                    if self._at_end and waiting.empty():
                        return
                if time.monotonic() - heard_s > SILENT_S:
                    raise CameraError(
                        f"{self._file}: nothing comes after {SILENT_S:g} s", "is the file whole?"
                    ) from None
                continue
            heard_s = time.monotonic()
            found = pairing.add(Taken(image.stamp_ns, 0, image))
            if found is not None:
                color, depth = (each.image for each in found)
                yield RecordedPair(
                    color.stamp_ns,
                    color.domain,
                    np.asarray(color.pixels, np.uint8),
                    np.asarray(depth.pixels, np.uint16),
                )

    @property
    def _at_end(self) -> bool:
        return self._playback.current_status() == import_realsense().playback_status.stopped

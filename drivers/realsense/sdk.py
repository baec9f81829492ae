"""The part of ``pyrealsense2`` that the driver uses, with types; nothing else here knows that
library.

Frames are taken from the sensors through one bounded queue, not from librealsense's pipeline: it
takes devices of the computer's USB only, and its syncer holds frames back.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers.interfaces import CameraError
from drivers.perception.stamp_clock import Domain
from drivers.realsense.formats import COLOR_FORMATS, bgr_of
from drivers.realsense.sdk_import import import_realsense
from drivers.recordings.ros_bag import refuse_ros
from drivers.rig.foreign_lens import realsense_lens
from path.arrays import Depths, Image
from path.camera.lenses import Lens, StandIn, as_brown_conrady
from path.geometry.transforms import Pose
from path.values import frozen

Kind = Literal["color", "depth"]
Filter = Literal["spatial", "temporal", "hole_filling"]
FORMATS: dict[Kind, tuple[str, ...]] = {"color": COLOR_FORMATS, "depth": ("z16",)}
QUEUE_FRAMES = 8  # four pairs; when nobody takes them, the oldest go
READOUT_LIMIT_US = 1_000_000
WRAP_US = 1 << 32


@frozen
class Streams:
    """The streams asked of a device.

    Sizes: (width, height) in px; ``exposure_us``: of the colour camera, 0 = its own.
    """

    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    fps: int
    filters: tuple[Filter, ...] = ()
    emitter: bool = True
    exposure_us: int = 0

    def size(self, kind: Kind) -> tuple[int, int]:
        return self.color_size if kind == "color" else self.depth_size


@frozen
class RawImage:
    """One image as the device gives it.

    Attributes:
        number: counted by the device.
        stamp_ns: middle of the exposure, clock of ``domain``.
        pixels: (h, w, 3) uint8 BGR or (h, w) uint16 of the device's depth unit; a view of
            ``frame``'s memory.
    """

    kind: Kind
    number: int
    stamp_ns: int
    domain: Domain
    pixels: Image | Depths
    frame: Any


class RealSenseDevice:
    """A device with both of its streams running, from construction to ``close``.

    Attributes:
        depth: intrinsics of the depth stream; T_color_depth: factory extrinsics; unit_m: metres of
            one depth step.
    """

    def __init__(self, device: Any, streams: Streams, record: Path | None = None) -> None:
        """
        Args:
            device: a ``pyrealsense2.device``.
            record: write all frames to this file (``.db3``).

        Raises:
            CameraError: it has no such streams, is in use, or the file cannot be written.
        """
        self._rs = import_realsense()
        self._device = device if record is None else _recorder(self._rs, device, record)
        self._playback = device.as_playback() if device.is_playback() else None
        self._queue = self._rs.frame_queue(QUEUE_FRAMES)
        self._filters = [getattr(self._rs, f"{name}_filter")() for name in streams.filters]
        self._running: list[Any] = []
        try:
            self._start(streams)
        except BaseException:
            self.close()
            raise

    def _start(self, streams: Streams) -> None:
        if self._playback is not None:
            self._playback.pause()  # else the first stream would run before the second is there
        kinds: tuple[Kind, ...] = ("depth", "color")
        found = {kind: _find(self._device, kind, streams) for kind in kinds}
        depth_sensor, depth = found["depth"]
        color_sensor, color = found["color"]
        self.unit_m = unit_of(depth_sensor, described(self._device))
        self.depth = intrinsics_of(depth, "depth").camera
        self._color_format = color.format().name
        self.T_color_depth = extrinsics_of(depth, color)
        if self._playback is None:
            _set_up(self._rs, depth_sensor, color_sensor, streams)
        for sensor, profiles in by_sensor([(depth_sensor, depth), (color_sensor, color)]):
            try:
                sensor.open(profiles)
                self._running.append(sensor)
                sensor.start(self._queue)
            except RuntimeError as error:
                raise CameraError(
                    f"{described(self._device)} does not start: {error}",
                    "end the other program that uses it, or plug it in again",
                ) from error
        if self._playback is not None:
            self._playback.resume()

    @property
    def at_end(self) -> bool:
        """A recording that was played to its end."""
        return (
            self._playback is not None
            and self._playback.current_status() == self._rs.playback_status.stopped
        )

    def next(self, timeout_s: float) -> RawImage | None:
        """The oldest image that waits, filtered if it is depth; None when none came in time."""
        there, frame = self._queue.try_wait_for_frame(max(round(timeout_s * 1000.0), 0))
        if not there:
            return None
        kind: Kind = "depth" if frame.is_depth_frame() else "color"
        if kind == "depth":
            for each in self._filters:
                frame = each.process(frame)
        domain = Domain(frame.get_frame_timestamp_domain().name)
        stamp_ns = mid_exposure_ns(self._rs, frame, domain)
        data = frame.get_data()
        pixels = np.asanyarray(data) if kind == "depth" else bgr_of(data, self._color_format)
        return RawImage(kind, frame.get_frame_number(), stamp_ns, domain, pixels, frame)

    def close(self) -> None:
        """Stop what runs. What the library says to that is of no use any more."""
        stop(self._running, self._playback)
        self._running = []
        self._device = self._playback = None  # a recording is complete when its recorder is gone


def stop(running: Sequence[Any], playback: Any | None) -> None:
    """Stop and close sensors, those of a recording once it stands still.

    librealsense's thread that plays could else give a frame to a sensor whose callback is gone,
    and take the program with it.
    """
    if playback is not None:
        with suppress(RuntimeError):
            playback.pause()
    for sensor in running:
        with suppress(RuntimeError):
            sensor.stop()
        with suppress(RuntimeError):
            sensor.close()


def described(device: Any) -> str:
    """``Intel RealSense D415 (serial 0123)``."""
    info = import_realsense().camera_info
    name, serial = (
        device.get_info(key) if device.supports(key) else "?"
        for key in (info.name, info.serial_number)
    )
    return f"{name} (serial {serial})"


@frozen
class DeviceIdentity:
    """A device's words about itself; "" for what it does not say. ``recommended``: firmware, by
    this librealsense.
    """

    name: str
    serial: str
    firmware: str
    recommended: str
    usb: str


def identity_of(device: Any) -> DeviceIdentity:
    info = import_realsense().camera_info
    keys = info.name, info.serial_number, info.firmware_version, info.recommended_firmware_version
    said = [
        str(device.get_info(key)) if device.supports(key) else ""
        for key in (*keys, info.usb_type_descriptor)
    ]
    return DeviceIdentity(*said)


def serial_of(device: Any) -> str:
    key = import_realsense().camera_info.serial_number
    return str(device.get_info(key)) if device.supports(key) else ""


def connected() -> list[Any]:
    """The cameras on this computer's USB."""
    return list(import_realsense().context().query_devices())


def load_recording(file: Path) -> Any:
    """A recording as a device. Raises CameraError when it cannot be read."""
    if not file.is_file():
        raise CameraError(
            f"{file}: there is no such file", "name a RealSense recording (.db3, .bag)"
        )
    refuse_ros(file)
    try:
        return import_realsense().context().load_device(str(file))
    except RuntimeError as error:
        raise CameraError(
            f"{file} cannot be played: {error}",
            "name a RealSense recording (.db3, or .bag of an older library)",
        ) from error


def _recorder(rs: Any, device: Any, file: Path) -> Any:
    try:
        return rs.recorder(str(file), device)
    except RuntimeError as error:
        raise CameraError(
            f"{file} cannot be recorded: {error}", "name a folder that can be written to"
        ) from error


def _find(device: Any, kind: Kind, streams: Streams) -> tuple[Any, Any]:
    """Sensor and profile of one stream, in the best of its formats. Raises CameraError listing what
    there is.
    """
    (width, height), offered = streams.size(kind), set[tuple[int, int, int]]()
    matching: dict[str, tuple[Any, Any]] = {}
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            form = profile.format().name
            if profile.stream_type().name != kind or form not in FORMATS[kind]:
                continue
            video = profile.as_video_stream_profile()
            if (video.width(), video.height(), video.fps()) == (width, height, streams.fps):
                matching.setdefault(form, (sensor, video))
            offered.add((video.width(), video.height(), video.fps()))
    for form in FORMATS[kind]:
        if form in matching:
            return matching[form]
    listed = ", ".join(f"{w}x{h} at {fps}" for w, h, fps in sorted(offered)) or "none"
    raise CameraError(
        f"{described(device)} has no {kind} stream of {width}x{height} px at {streams.fps} Hz; it has: {listed}",
        "choose one of these; a slow USB port hides the faster ones",
    )


def by_sensor(found: Sequence[tuple[Any, Any]]) -> list[tuple[Any, list[Any]]]:
    """Return each sensor once, with all of its profiles.

    A D405 has colour and depth on one sensor, and a sensor that runs is not opened again.
    """
    grouped: list[tuple[Any, list[Any]]] = []
    for sensor, profile in found:
        # librealsense wraps a sensor anew at every query: it is known by its profiles.
        same = [profiles for other, profiles in grouped if _profiles(other) == _profiles(sensor)]
        if same:
            same[0].append(profile)
        else:
            grouped.append((sensor, [profile]))
    return grouped


def _profiles(sensor: Any) -> list[int]:
    return sorted(profile.unique_id() for profile in sensor.get_stream_profiles())


def unit_of(depth_sensor: Any, whose: str) -> float:
    """Return metres of one step of depth. Raises CameraError where it is not said: it is never
    guessed.
    """
    option = import_realsense().option.depth_units
    try:
        return float(depth_sensor.get_option(option))
    except RuntimeError as error:
        raise CameraError(
            f"{whose} does not say how long one step of its depth is: {error}",
            "record it with `record` of PATH's driver, or with librealsense's viewer",
        ) from error


def intrinsics_of(profile: Any, kind: Kind) -> StandIn:
    """Of a stream, by the device. Raises CameraError for a lens that cannot be described."""
    it = profile.get_intrinsics()
    remedy = "calibrate the camera with `path-handoff calibrate camera`, and name that calibration"
    lens = realsense_lens(it.model.name, [float(k) for k in it.coeffs])
    if lens is None:
        raise CameraError(
            f"the {kind} stream has a lens of a kind that is not known: {it.model.name}", remedy
        )
    try:
        return as_brown_conrady(
            Lens(lens[0], it.width, it.height, it.fx, it.fy, it.ppx, it.ppy, lens[1])
        )
    except ValueError as error:
        raise CameraError(f"the {kind} stream: {error}", remedy) from error


def extrinsics_of(depth: Any, color: Any) -> Pose:
    """Maps points of the depth camera to the colour camera."""
    it = depth.get_extrinsics_to(color)
    R = np.array(it.rotation, float).reshape(3, 3).T  # column by column
    return Pose(R, np.array(it.translation, float))


def _set_up(rs: Any, depth_sensor: Any, color_sensor: Any, streams: Streams) -> None:
    """Options that the sensors have; a frame rate that sinks in the dark is switched off."""
    wanted = [
        (depth_sensor, rs.option.emitter_enabled, float(streams.emitter)),
        (color_sensor, rs.option.auto_exposure_priority, 0.0),
        (color_sensor, rs.option.enable_auto_exposure, float(streams.exposure_us == 0)),
    ]
    if streams.exposure_us:
        # in steps of 100 us
        wanted.append((color_sensor, rs.option.exposure, streams.exposure_us / 100.0))
    for sensor, option, value in wanted:
        if not sensor.supports(option):
            continue
        try:
            sensor.set_option(option, value)
        except RuntimeError as error:
            raise CameraError(
                f"{option.name} cannot be set to {value:g}: {error}", "leave that option out"
            ) from error


def mid_exposure_ns(rs: Any, frame: Any, domain: Domain) -> int:
    """The frame's stamp is taken when its transfer begins; where the metadata tell, go back to the
    exposure.
    """
    stamp_us = frame.get_timestamp() * 1000.0
    keys = rs.frame_metadata_value
    if frame.supports_frame_metadata(keys.frame_timestamp) and frame.supports_frame_metadata(
        keys.sensor_timestamp
    ):
        sent_us = frame.get_frame_metadata(keys.frame_timestamp)
        exposed_us = frame.get_frame_metadata(keys.sensor_timestamp)
        already = domain is Domain.HARDWARE and abs(stamp_us - exposed_us) < abs(stamp_us - sent_us)
        readout_us = (sent_us - exposed_us) % WRAP_US
        if not already and readout_us < READOUT_LIMIT_US:
            stamp_us -= readout_us
    return round(stamp_us * 1000.0)

"""Cameras of the D400 family other than a D415, in software: lenses, formats and sensors, and their
recordings.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.realsense.sdk_import import import_realsense

WIDTH, HEIGHT, FPS = 96, 72, 30
FOCAL_PX = 92.0
FRAMES = 12
PATIENCE_MS = 60_000
BEGIN_MS = 1_790_000_000_000.0
COLOR_BGR = (200, 120, 40)
BYTES = {"bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4, "yuyv": 2, "uyvy": 2}
ORDERS = {"bgr8": (0, 1, 2), "rgb8": (2, 1, 0), "bgra8": (0, 1, 2, 3), "rgba8": (2, 1, 0, 3)}


@dataclass(frozen=True, slots=True)
class CameraKind:
    """A camera. ``one_sensor``: colour is a stream of the depth sensor. ``unit_m``: None where it
    is not said.
    """

    name: str = "D435"
    lens: str = "inverse_brown_conrady"
    coefficients: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    form: str = "rgb8"
    one_sensor: bool = False
    unit_m: float | None = 0.001
    wall_m: float = 1.5
    apart_m: float = 0.015


class OtherCamera:
    """A camera of a kind. ``give`` makes a frame of each stream: colour is COLOR_BGR, depth a
    wall.
    """

    def __init__(self, kind: CameraKind) -> None:
        self._rs = rs = import_realsense()
        self._kind = kind
        self.device: Any = rs.software_device()
        self.device.register_info(rs.camera_info.name, f"Software {kind.name}")
        self.device.register_info(rs.camera_info.serial_number, "900000000001")
        self._stereo = self.device.add_sensor("Stereo Module")
        self._rgb = self._stereo if kind.one_sensor else self.device.add_sensor("RGB Camera")
        self._depth = self._stereo.add_video_stream(self._stream("depth"), True)
        self._color = self._rgb.add_video_stream(self._stream("color"), True)
        away = rs.extrinsics()
        away.rotation = np.eye(3).ravel().tolist()
        away.translation = [kind.apart_m, 0.0, 0.0]
        self._depth.register_extrinsics_to(self._color, away)
        if kind.unit_m is not None:
            self._stereo.add_read_only_option(rs.option.depth_units, kind.unit_m)

    def give(self, number: int) -> None:
        wall = np.full(
            (HEIGHT, WIDTH), round(self._kind.wall_m / (self._kind.unit_m or 0.001)), np.uint16
        )
        for sensor, profile, pixels, size in (
            (self._stereo, self._depth, wall, 2),
            (self._rgb, self._color, _coloured(self._kind.form), BYTES[self._kind.form]),
        ):
            frame = self._rs.software_video_frame()
            frame.pixels = pixels
            frame.bpp, frame.stride = size, WIDTH * size
            frame.timestamp = BEGIN_MS + 1000.0 * number / FPS
            frame.domain = self._rs.timestamp_domain.global_time
            frame.frame_number = number
            frame.profile = profile.as_video_stream_profile()
            if size == 2 and profile is self._depth:
                frame.depth_units = self._kind.unit_m or 0.001
            sensor.on_video_frame(frame)

    def record(self, file: Path, every_s: float = 0.0) -> Path:
        """Write FRAMES frames of each stream as librealsense's own recorder does, as fast as it
        goes or so far apart.

        Recordings are played at the rate they were written at.
        """
        recorder = self._rs.recorder(str(file), self.device)
        waiting = self._rs.frame_queue(50)
        sensors = list(recorder.query_sensors())
        for sensor in sensors:
            sensor.open(list(sensor.get_stream_profiles()))
            sensor.start(waiting)
        for number in range(1, FRAMES + 1):
            self.give(number)
            waiting.wait_for_frame(PATIENCE_MS)
            waiting.wait_for_frame(PATIENCE_MS)
            time.sleep(every_s)
        for sensor in sensors:
            sensor.stop()
            sensor.close()
        sensors.clear()  # before their recorder, which completes the file when it goes
        del waiting
        del recorder
        return file

    def _stream(self, kind: str) -> Any:
        rs = self._rs
        lens = rs.intrinsics()
        lens.width, lens.height = WIDTH, HEIGHT
        lens.fx = lens.fy = FOCAL_PX
        lens.ppx, lens.ppy = 47.5, 35.5
        named = self._kind.lens if kind == "color" else "brown_conrady"
        lens.model = getattr(rs.distortion, named)
        lens.coeffs = list(self._kind.coefficients) if kind == "color" else [0.0] * 5
        form = self._kind.form if kind == "color" else "z16"
        stream = rs.video_stream()
        stream.type, stream.fmt = getattr(rs.stream, kind), getattr(rs.format, form)
        stream.index, stream.uid = 0, 1 if kind == "depth" else 2
        stream.width, stream.height, stream.fps = WIDTH, HEIGHT, FPS
        stream.bpp, stream.intrinsics = BYTES.get(form, 2), lens
        return stream


def _coloured(form: str) -> NDArray[np.uint8]:
    """COLOR_BGR in a format, (h, w, bytes)."""
    if form in ORDERS:
        pixel = [(*COLOR_BGR, 255)[k] for k in ORDERS[form]]
    else:
        blue, green, red = COLOR_BGR
        luma = 0.299 * red + 0.587 * green + 0.114 * blue
        y = round(16 + 219 / 255 * luma)
        u = round(128 + 224 / 255 * (blue - luma) / 1.772)
        v = round(128 + 224 / 255 * (red - luma) / 1.402)
        pair = [y, u, y, v] if form == "yuyv" else [u, y, v, y]
        return np.tile(np.array(pair, np.uint8).reshape(1, 2, 2), (HEIGHT, WIDTH // 2, 1))
    return np.tile(np.array(pixel, np.uint8), (HEIGHT, WIDTH, 1))

"""A D415 in software: ``pyrealsense2``'s own device. Images are put in, and the driver takes them
out.
"""

from __future__ import annotations

import time
from typing import Any

from drivers.clock import wall_offset_ns
from drivers.perception.stamp_clock import WRAP_NS, Domain
from drivers.realsense.sdk import FORMATS, Kind
from drivers.realsense.sdk_import import import_realsense
from path.arrays import Depths, Image
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.values import frozen

BYTES: dict[Kind, int] = {"color": 3, "depth": 2}
SENSORS: dict[Kind, str] = {"depth": "Stereo Module", "color": "RGB Camera"}
DEPTH_UNIT_M = 0.001


@frozen
class DeviceClock:
    """The clock by which a device stamps its frames.

    Attributes:
        domain: whose clock; a real D415 gives ``global_time`` unless told otherwise.
        offset_ns: what the device's own clock shows at CLOCK_MONOTONIC's zero.
        drift_ppm: by how much that clock is too fast.
        readout_ns: from the middle of the exposure to the beginning of the transfer, which is what
            a D415 stamps; the frame's metadata tell both, as a D415's do.
    """

    domain: Domain = Domain.GLOBAL
    offset_ns: int = 7_000_000_000
    drift_ppm: float = 20.0
    readout_ns: int = 9_000_000

    def own_ns(self, monotonic_ns: int) -> int:
        return self.offset_ns + monotonic_ns + round(monotonic_ns * self.drift_ppm * 1e-6)


class SoftwareDevice:
    """One device with a colour and a depth sensor, each a camera of its own. Use it from one
    thread.

    ``device`` is what the driver is given.
    """

    def __init__(
        self,
        color: CameraModel,
        depth: CameraModel,
        T_color_depth: Pose,
        fps: int,
        clock: DeviceClock | None = None,
        serial: str = "000000000000",
    ) -> None:
        self._rs = rs = import_realsense()
        self._clock = clock or DeviceClock()
        self._wall_offset_ns = wall_offset_ns(time.monotonic_ns)
        self.device: Any = rs.software_device()
        self.device.register_info(rs.camera_info.name, "Software D415")
        self.device.register_info(rs.camera_info.serial_number, serial)
        self._sensors = {kind: self.device.add_sensor(name) for kind, name in SENSORS.items()}
        models: dict[Kind, CameraModel] = {"color": color, "depth": depth}
        self._profiles = {
            kind: self._sensors[kind].add_video_stream(_stream(rs, kind, model, fps), True)
            for kind, model in models.items()
        }
        extrinsics = rs.extrinsics()
        extrinsics.rotation = T_color_depth.R.T.ravel().tolist()  # column by column
        extrinsics.translation = T_color_depth.t.tolist()
        self._profiles["depth"].register_extrinsics_to(self._profiles["color"], extrinsics)
        self._sensors["depth"].add_read_only_option(rs.option.depth_units, DEPTH_UNIT_M)
        self._sensors["depth"].add_option(rs.option.emitter_enabled, _switch(rs), True)

    @property
    def readout_ns(self) -> int:
        return self._clock.readout_ns

    def image(
        self,
        kind: Kind,
        pixels: Image | Depths,
        stamp_ns: int,
        number: int,
    ) -> Any:
        """A copy of the pixels as an image that can be given out. ``stamp_ns``: mid-exposure,
        CLOCK_MONOTONIC.
        """
        frame = self._rs.software_video_frame()
        frame.pixels = pixels
        frame.bpp = BYTES[kind]
        frame.stride = pixels.shape[1] * BYTES[kind]
        frame.timestamp = self._stamp_ms(stamp_ns + self._clock.readout_ns)
        frame.domain = getattr(self._rs.timestamp_domain, self._clock.domain.value)
        frame.frame_number = number
        frame.profile = self._profiles[kind].as_video_stream_profile()
        if kind == "depth":
            frame.depth_units = DEPTH_UNIT_M
        return frame

    def give(
        self,
        kind: Kind,
        image: Any,
        stamp_ns: int,
    ) -> None:
        """Give out an image, with the metadata of its instant, as a device does."""
        sensor = self._sensors[kind]
        keys = self._rs.frame_metadata_value
        exposed_us, sent_us = (
            self._clock.own_ns(at_ns) % WRAP_NS // 1000
            for at_ns in (stamp_ns, stamp_ns + self._clock.readout_ns)
        )
        sensor.set_metadata(keys.sensor_timestamp, exposed_us)
        sensor.set_metadata(keys.frame_timestamp, sent_us)
        sensor.on_video_frame(image)

    def _stamp_ms(self, monotonic_ns: int) -> float:
        if self._clock.domain is Domain.HARDWARE:
            return self._clock.own_ns(monotonic_ns) % WRAP_NS / 1e6
        return (monotonic_ns + self._wall_offset_ns) / 1e6


def _stream(
    rs: Any,
    kind: Kind,
    model: CameraModel,
    fps: int,
) -> Any:
    lens = rs.intrinsics()
    lens.width = model.width
    lens.height = model.height
    lens.fx = model.fx
    lens.fy = model.fy
    lens.ppx = model.cx
    lens.ppy = model.cy
    lens.model = rs.distortion.brown_conrady
    lens.coeffs = list(model.distortion)
    stream = rs.video_stream()
    stream.type, stream.fmt = getattr(rs.stream, kind), getattr(rs.format, FORMATS[kind][0])
    stream.index, stream.uid = 0, list(SENSORS).index(kind) + 1
    stream.width = model.width
    stream.height = model.height
    stream.fps = fps
    stream.bpp = BYTES[kind]
    stream.intrinsics = lens
    return stream


def _switch(rs: Any) -> Any:
    limits = rs.option_range()
    limits.min = 0.0
    limits.max = 1.0
    limits.step = 1.0
    limits.default = 1.0
    return limits

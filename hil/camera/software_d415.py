"""The D415 of a role at level ``sitl``: a software device fed with what the world process renders.

The driver in the role process opens it as it would one on USB; what it does after that is the same.
"""

from __future__ import annotations

import os
import threading
import time
from typing import Annotated, Any, Literal

from drivers.interfaces import CameraError
from drivers.perception.stamp_clock import Domain
from drivers.rig.parts import PartContext
from hil.camera.d415 import T_COLOR_DEPTH, depth_camera
from hil.camera.shared import RUN_VARIABLE, SharedCameraReader
from hil.camera.software_device import DeviceClock, SoftwareDevice
from path.bounds import Bounds
from path.values import frozen

POLL_S = 0.1


@frozen
class SoftwareD415Config:
    """
    Attributes:
        clock: whose clock stamps the frames.
        run: names the run whose world writes the frames; by default the one in $PATH_HANDOFF_RUN.
        open_timeout_s: how long to wait for the world; less than the driver waits for its own end.
    """

    clock: Literal["global_time", "hardware_clock", "system_time"] = "global_time"
    run: str = ""
    open_timeout_s: Annotated[float, Bounds(0.1, 300.0)] = 4.0


class SoftwareD415:
    """Implements ``drivers.realsense.sources.DeviceSource``."""

    Config = SoftwareD415Config
    live = True
    returns = True

    def __init__(self, config: SoftwareD415Config, context: PartContext) -> None:
        run = config.run or os.environ.get(RUN_VARIABLE, "")
        if not run:
            raise CameraError(
                "no run is named whose camera frames to read",
                f"start through `path-handoff handoff`, or set `run` in the rig or ${RUN_VARIABLE}",
            )
        self._config = config
        self._context = context
        self._reader = SharedCameraReader(run, context.role, config.open_timeout_s)
        self._feeder: _Feeder | None = None

    @property
    def name(self) -> str:
        return f"the {self._context.role.value}'s software D415"

    def open(self) -> Any:
        color = self._context.camera
        self._reader.__enter__()
        try:
            layout = self._reader.layout
            if layout.color_size != (color.width, color.height):
                raise CameraError(
                    f"the calibration is for {color.width}x{color.height} px but the world draws "
                    f"{layout.color_size[0]}x{layout.color_size[1]} px",
                    "start the world and the roles with the same rig",
                )
            device = SoftwareDevice(
                color,
                depth_camera(*layout.depth_size),
                T_COLOR_DEPTH,
                layout.fps,
                DeviceClock(Domain(self._config.clock)),
                f"software-{self._context.role.value}",
            )
        except BaseException:
            self._reader.__exit__()
            raise
        self._feeder = _Feeder(self._reader, device)
        self._feeder.start()
        return device.device

    def missing(self) -> CameraError | None:
        if self._reader.writer_lives:
            return None
        return CameraError(
            "the world process that draws its frames is gone", "see why it ended in its log"
        )

    def close(self) -> None:
        if self._feeder is None:
            return
        self._feeder.ending.set()
        self._feeder.join()
        self._feeder = None
        self._reader.__exit__()


class _Feeder(threading.Thread):
    """Puts every frame of the world into the device; the newest when they come faster than it can.

    None is given out before a device would have read it out, by the frame's own stamp: a small
    picture is drawn within less, and a stamp that errs by some milliseconds would be of the future.
    """

    def __init__(self, reader: SharedCameraReader, device: SoftwareDevice) -> None:
        super().__init__(name="software-d415", daemon=True)
        self._reader = reader
        self._device = device
        self.ending = threading.Event()

    def run(self) -> None:
        reader = self._reader
        device = self._device
        while not self.ending.is_set():
            frame = reader.next(POLL_S)
            if frame is None:
                continue
            depth = device.image("depth", frame.depth_mm, frame.stamp_ns, frame.number)
            color = device.image("color", frame.color, frame.stamp_ns, frame.number)
            if not reader.is_whole(frame):
                continue
            self.ending.wait(
                max(0, frame.stamp_ns + device.readout_ns - time.monotonic_ns()) * 1e-9
            )
            device.give("depth", depth, frame.stamp_ns)
            device.give("color", color, frame.stamp_ns)

"""A small D415 in software, and what a test feeds it with."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import SystemClock
from drivers.interfaces import CameraError
from drivers.rig.parts import Mount, Origin, PartContext
from hil.camera.d415 import T_COLOR_DEPTH
from hil.camera.software_device import DeviceClock, SoftwareDevice
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from tests.repeating import repeating

COLOR = CameraModel(96, 72, 92.0, 92.0, 47.0, 36.0, (0.11, -0.23, 0.0, 0.0, 0.09))
DEPTH = CameraModel(96, 72, 100.0, 100.0, 47.5, 35.5)
LEVEL = Pose(np.eye(3), np.zeros(3))
FPS = 50
DEPTH_MM = 1500


def context(camera: CameraModel = COLOR) -> PartContext:
    here = PartContext(
        Role.SENDER, NO_CLOCK, camera, Mount(LEVEL, LEVEL), single_marker(), Origin(0.0, 0.0, 0.0)
    )
    return PartContext(
        here.role,
        SystemClock(SystemClock.Config(), here),
        here.camera,
        here.mount,
        here.layout,
        here.origin,
    )


NO_CLOCK: Any = None


class Feed:
    """A device on a bench, and a hand that feeds it: a ``DeviceSource`` whose cable can be pulled.

    Colour is filled with the frame's number, depth is a wall at DEPTH_MM.
    """

    live = True
    returns = True
    name = "bench D415"

    def __init__(self, clock: DeviceClock | None = None) -> None:
        self.clock = clock or DeviceClock()
        self.software: SoftwareDevice | None = None
        self.plugged = True
        self.opened = 0
        self.number = 0

    def open(self) -> Any:
        if not self.plugged:
            raise CameraError("nothing is plugged in", "plug it in")
        self.opened += 1
        self.software = SoftwareDevice(
            COLOR, DEPTH, T_COLOR_DEPTH, FPS, self.clock, f"bench-{self.opened}"
        )
        return self.software.device

    def missing(self) -> CameraError | None:
        return None if self.plugged else CameraError("its cable was pulled", "plug it in")

    def close(self) -> None:
        self.software = None

    def give(self, stamp_ns: int | None = None, *, color: bool = True, depth: bool = True) -> int:
        """One frame; returns its stamp."""
        software = self.software
        stamp_ns = time.monotonic_ns() if stamp_ns is None else stamp_ns
        if software is None or not self.plugged:
            return stamp_ns
        self.number += 1
        wall = np.full((DEPTH.height, DEPTH.width), DEPTH_MM, np.uint16)
        image = np.full((COLOR.height, COLOR.width, 3), self.number % 256, np.uint8)
        if depth:
            software.give("depth", software.image("depth", wall, stamp_ns, self.number), stamp_ns)
        if color:
            software.give("color", software.image("color", image, stamp_ns, self.number), stamp_ns)
        return stamp_ns

    @contextmanager
    def running(
        self, rate_hz: float = 200.0, give: Callable[[], object] | None = None
    ) -> Generator[None]:
        """Frames all the time, from a thread of its own."""
        with repeating(give or self.give, 1.0 / rate_hz):
            yield


def recordings(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.db3"))

"""The D415 driver for a long time: does its memory stay flat, and what does a frame cost?

    python -m tests.hil.camera.driver_soak [FRAMES] [WIDTHxHEIGHT]

Frames go through pyrealsense2's software device as fast as they are taken, nothing is drawn. Exit
code 1 when memory grew.
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import SystemClock, busy_ns
from drivers.interfaces import CameraError
from drivers.realsense.camera import RealSense, RealSenseConfig
from drivers.realsense.stream import StreamCounters
from drivers.rig.parts import Mount, Origin, PartContext, PartSpec
from hil.camera.d415 import T_COLOR_DEPTH, depth_camera
from hil.camera.software_device import SoftwareDevice
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.values import frozen

FPS = 50
SETTLE = 0.2  # of the frames; what is allocated once is allocated by then
FLAT_MIB = 2.0
READ_S = 5.0


@frozen
class SoakReport:
    """Memory in MiB when it had settled, at its highest after that, and at the end; times in ms of
    CPU a frame.
    """

    frames: int
    settled_mib: float
    peak_mib: float
    end_mib: float
    feed_ms: float
    stream_ms: float
    copy_ms: float
    register_ms: float

    @property
    def flat(self) -> bool:
        return self.peak_mib - self.settled_mib < FLAT_MIB


@frozen
class BenchDeviceConfig:
    """The options of the bench's device: there are none."""


class BenchDevice:
    """A ``DeviceSource`` that gives a frame whenever ``wanted`` is set: random colours, a wall with
    noise.
    """

    Config = BenchDeviceConfig
    live = True
    returns = True
    name = "software D415 on the bench"

    def __init__(self, config: BenchDeviceConfig, context: PartContext) -> None:
        del config
        color = context.camera
        rng = np.random.default_rng(0)
        self._camera = color
        self._color = rng.integers(0, 255, (color.height, color.width, 3), np.uint8)
        self._depth = rng.normal(1500.0, 8.0, (color.height, color.width)).astype(np.uint16)
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self.busy_ns = self.given = 0

    def open(self) -> Any:
        color = self._camera
        software = SoftwareDevice(
            color, depth_camera(color.width, color.height), T_COLOR_DEPTH, FPS
        )
        self._ending.clear()
        self._thread = threading.Thread(target=self._feed, args=(software,), daemon=True)
        self._thread.start()
        return software.device

    def missing(self) -> None:
        pass

    def close(self) -> None:
        if self._thread is not None:
            self._ending.set()
            self._thread.join()
            self._thread = None

    def _feed(self, software: SoftwareDevice) -> None:
        start = busy_ns()
        while not self._ending.wait(0.0005):
            self.given += 1
            stamp_ns = time.monotonic_ns()
            depth = software.image("depth", self._depth, stamp_ns, self.given)
            color = software.image("color", self._color, stamp_ns, self.given)
            software.give("depth", depth, stamp_ns)
            software.give("color", color, stamp_ns)
            self.busy_ns = busy_ns() - start


def resident_mib() -> float:
    """Return the memory that this process holds now, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


async def soak(frames: int, size: tuple[int, int]) -> SoakReport:
    """Take so many frames of this size. Raises CameraError when they stop."""
    driver, source = _driver(size)
    settled = peak = 0.0
    async with driver:
        for number in range(frames):
            await driver.read(READ_S)
            if number == int(SETTLE * frames):
                settled = peak = resident_mib()
            elif number % 100 == 0 and settled:
                peak = max(peak, resident_mib())
        end = resident_mib()
    return _report(driver.counters, source, (settled, max(peak, end), end))


def _driver(size: tuple[int, int]) -> tuple[RealSense, BenchDevice]:
    width, height = size
    focal = 1.28 * height
    lens = (0.112, -0.236, 0.0006, -0.0004, 0.095)
    camera = CameraModel(width, height, focal, focal, 0.5 * width + 1.0, 0.5 * height - 1.0, lens)
    level = Pose(np.eye(3), np.zeros(3))
    no_clock: Any = None
    context = PartContext(
        Role.SENDER, no_clock, camera, Mount(level, level), single_marker(), Origin(0.0, 0.0, 0.0)
    )
    context = replace(context, clock=SystemClock(SystemClock.Config(), context))
    spec = PartSpec("tests.hil.camera.driver_soak:BenchDevice", {}, "bench")
    driver = RealSense(RealSenseConfig(source=spec, fps=FPS), context)
    source: Any = driver.source
    return driver, source


def _report(
    counters: StreamCounters, source: BenchDevice, memory: tuple[float, float, float]
) -> SoakReport:
    def ms(total_ns: int, count: int) -> float:
        return total_ns / max(count, 1) / 1e6

    return SoakReport(
        counters.frames,
        *memory,
        ms(source.busy_ns, source.given),
        ms(counters.stream_ns, counters.pairs + counters.replaced),
        ms(counters.copy_ns, counters.frames),
        ms(counters.register_ns, counters.frames),
    )


def main(arguments: Sequence[str]) -> int:
    frames = int(arguments[0]) if arguments else 10_000
    width, _, height = (arguments[1] if len(arguments) > 1 else "640x480").partition("x")
    try:
        report = asyncio.run(soak(frames, (int(width), int(height))))
    except CameraError as error:
        sys.stderr.write(f"{error}\n{error.remedy}\n")
        return 1
    sys.stdout.write(
        f"{report.frames} frames of {width}x{height}\n"
        f"memory, MiB    settled {report.settled_mib:.1f}, highest {report.peak_mib:.1f}, end {report.end_mib:.1f}\n"
        f"CPU, ms/frame  feeding {report.feed_ms:.2f} (harness), stream {report.stream_ms:.2f}, "
        f"copy {report.copy_ms:.2f}, registration {report.register_ms:.2f}\n"
    )
    return 0 if report.flat else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

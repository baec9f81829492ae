"""What every Camera does, whatever is behind it: the rendered one, a D415 in software, a recording of it, images."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.interfaces import Camera, CameraError, Frame
from drivers.realsense import RealSense, RealSenseConfig
from drivers.recorded_camera import RecordedCamera, RecordedCameraConfig
from hil.capture import Freeze
from hil.rendered_camera import RenderedCamera, RenderedCameraConfig
from hil.snapshot import DroneTruth, Snapshot
from path.camera import CameraModel
from path.geometry import Pose
from path.messages import Role
from tests.drivers.software_d415 import COLOR, FPS, Feed, context, recordings

PATIENCE_S = 10.0
FRAMES = 8


@dataclass
class Stage:
    """A camera that gives frames while it is staged, and how to make them stop."""

    camera: Camera
    unplug: Callable[[], object]


@asynccontextmanager
async def rendered(folder: Path) -> AsyncGenerator[Stage]:
    del folder
    down = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.0]))
    drones = {role: DroneTruth(down, (0.0, 0.0, 0.0), 0.0, True) for role in Role}
    world = SimpleNamespace(snapshot=lambda: Snapshot(0.0, drones, ()))
    harness = SimpleNamespace(seed=1, world=world, frozen_cameras={})
    here = context()
    given = type(here)(here.role, here.clock, COLOR, here.mount, here.layout, here.origin, harness)
    camera = RenderedCamera(RenderedCameraConfig(rate_hz=FPS), given)
    yield Stage(camera, lambda: harness.frozen_cameras.update({Role.SENDER: Freeze.SILENT}))


@asynccontextmanager
async def realsense(folder: Path) -> AsyncGenerator[Stage]:
    del folder
    feed = Feed()
    camera = RealSense(RealSenseConfig(fps=FPS, silence_s=0.1), context())
    camera.source = feed
    with feed.running():
        yield Stage(camera, lambda: setattr(feed, "plugged", False))


@asynccontextmanager
async def recording(folder: Path) -> AsyncGenerator[Stage]:
    feed = Feed()
    recorder = RealSense(RealSenseConfig(fps=FPS, record=folder), context())
    recorder.source = feed
    with feed.running(rate_hz=FPS):
        async with recorder:
            for _ in range(3 * FRAMES):
                await recorder.read(PATIENCE_S)
    camera = RealSense(RealSenseConfig(fps=FPS, recording=recordings(folder)[0]), context())
    yield Stage(camera, lambda: None)  # it ends by itself


@asynccontextmanager
async def images(folder: Path) -> AsyncGenerator[Stage]:
    depth = folder / "depth"
    depth.mkdir()
    for number in range(3 * FRAMES):
        name = f"{10.0 + number / FPS:.6f}.png"
        cv2.imwrite(str(folder / name), np.full((COLOR.height, COLOR.width, 3), 9 * number, np.uint8))
        cv2.imwrite(str(depth / name), np.full((COLOR.height, COLOR.width), 1000 + number, np.uint16))
    camera = RecordedCamera(RecordedCameraConfig(folder, depth=depth), context())
    yield Stage(camera, lambda: None)  # it ends by itself


CAMERAS = pytest.mark.parametrize("stage_of", [rendered, realsense, recording, images])
StageOf = Callable[[Path], contextlib.AbstractAsyncContextManager[Stage]]


def run(stage_of: StageOf, folder: Path, test: Callable[[Stage], Any]) -> None:
    async def main() -> None:
        async with stage_of(folder) as stage:
            await test(stage)

    asyncio.run(main())


@CAMERAS
def test_stamps_and_ids_grow_and_sizes_are_the_calibration_s(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        async with stage.camera as camera:
            frames = [await camera.read(PATIENCE_S) for _ in range(FRAMES)]
            model: CameraModel = camera.model
        assert model == COLOR
        for frame in frames:
            assert (frame.color.shape, frame.color.dtype) == ((model.height, model.width, 3), np.uint8)
            assert frame.depth_mm is not None
            assert (frame.depth_mm.shape, frame.depth_mm.dtype) == ((model.height, model.width), np.uint16)
        for earlier, later in pairwise(frames):
            assert later.stamp_ns > earlier.stamp_ns
            assert later.frame_id > earlier.frame_id

    run(stage_of, tmp_path, test)


@CAMERAS
def test_a_frame_is_the_reader_s_own(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        async with stage.camera as camera:
            frame = await camera.read(PATIENCE_S)
            depth_mm = frame.depth_mm
            assert depth_mm is not None
            before = frame.color.copy(), depth_mm.copy()
            for _ in range(FRAMES):
                await camera.read(PATIENCE_S)
            np.testing.assert_array_equal(frame.color, before[0])
            np.testing.assert_array_equal(depth_mm, before[1])
            frame.color[:] = 0  # and may be drawn upon

    run(stage_of, tmp_path, test)


@CAMERAS
def test_frames_that_stop_are_an_error_in_time_with_what_to_do(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        loop = asyncio.get_running_loop()
        async with stage.camera as camera:
            await camera.read(PATIENCE_S)
            stage.unplug()
            error, start_s = None, loop.time()
            async with asyncio.timeout(PATIENCE_S):
                while error is None:  # what was under way may still come
                    start_s = loop.time()
                    error = await _error_of(camera, 0.15)
            assert loop.time() - start_s < 5.0  # of a read of 0.15 s, on a machine that may be busy
            assert "no frame from" in str(error)
            assert error.remedy

    run(stage_of, tmp_path, test)


async def _error_of(camera: Camera, timeout_s: float) -> CameraError | None:
    try:
        frame: Frame = await camera.read(timeout_s)
        del frame
    except CameraError as error:
        return error
    return None


@CAMERAS
def test_closing_twice_is_closing_once(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        camera = stage.camera
        async with camera:
            await camera.read(PATIENCE_S)
        await camera.__aexit__(None, None, None)

    run(stage_of, tmp_path, test)


@CAMERAS
def test_it_can_be_opened_again(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        for _ in range(2):
            async with stage.camera as camera:
                await camera.read(PATIENCE_S)

    run(stage_of, tmp_path, test)


@CAMERAS
def test_nobody_waits_for_a_frame_of_one_that_is_not_open(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        async def refused() -> None:
            start_s = asyncio.get_running_loop().time()
            with pytest.raises(CameraError, match="not open") as caught:
                await stage.camera.read(PATIENCE_S)
            assert caught.value.remedy
            assert asyncio.get_running_loop().time() - start_s < 1.0

        await refused()
        async with stage.camera as camera:
            await camera.read(PATIENCE_S)
        await refused()

    run(stage_of, tmp_path, test)


@CAMERAS
def test_closing_ends_a_wait(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        async with stage.camera as camera:
            await camera.read(PATIENCE_S)
            stage.unplug()
            while await _error_of(camera, 0.15) is None:
                pass
            waiting = asyncio.create_task(_error_of(camera, 1.0))
            await asyncio.sleep(0)
        async with asyncio.timeout(PATIENCE_S):
            assert await waiting is not None

    run(stage_of, tmp_path, test)

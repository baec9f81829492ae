"""The contract of every Camera, whatever is behind it.

The rendered one, a D415 in software (by itself, and fed by the world through shared memory), a
recording of it, images, a Tello's video.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
import uuid
from collections.abc import AsyncGenerator, Callable, Coroutine
from contextlib import asynccontextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.interfaces import Camera, CameraError, Capability, Frame, lacking
from drivers.realsense.camera import RealSense, RealSenseConfig
from drivers.recordings.camera import RecordedCamera, RecordedCameraConfig
from drivers.rig.parts import PartSpec
from drivers.tello.camera import TelloCamera, TelloCameraConfig
from hil.camera.capture import Freeze
from hil.camera.rendered import RenderedCamera, RenderedCameraConfig
from hil.camera.segment import folder as shared_memory
from hil.camera.shared import SharedCameraWriter
from hil.world.snapshot import DroneTruth, Snapshot
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.messages import Role
from tests.drivers.realsense.software_d415 import COLOR, FPS, Feed, context, recordings
from tests.drivers.tello import tello_stand
from tests.repeating import repeating

PATIENCE_S = 60.0
QUICK_S = 20.0  # of what takes no time, on a machine that may be busy
FRAMES = 8
RECORDED = 100  # frames: whoever is late gets the newest one, and enough are left
_recording: list[Path] = []  # made once


@dataclass
class Stage:
    """A camera that gives frames while it is staged, and how to make them stop.

    ``unplugged`` is what it says then.
    """

    camera: Camera
    unplug: Callable[[], object]
    model: CameraModel = COLOR
    unplugged: str = "no frame from"


@asynccontextmanager
async def rendered(folder: Path) -> AsyncGenerator[Stage]:
    del folder
    down = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.0]))
    drones = {role: DroneTruth(down, (0.0, 0.0, 0.0), 0.0, True) for role in Role}
    world = SimpleNamespace(snapshot=lambda: Snapshot(0.0, drones, ()))
    harness = SimpleNamespace(seed=1, world=world, frozen_cameras={}, built=None)
    here = context()
    given = type(here)(here.role, here.clock, COLOR, here.mount, here.layout, here.origin, harness)
    camera = RenderedCamera(RenderedCameraConfig(rate_hz=FPS), given)
    yield Stage(camera, lambda: harness.frozen_cameras.update({Role.SENDER: Freeze.SILENT}))


@asynccontextmanager
async def realsense(folder: Path) -> AsyncGenerator[Stage]:
    del folder
    feed = Feed()
    # It is not opened again meanwhile: a feed that a busy computer keeps waiting is no silence.
    camera = RealSense(RealSenseConfig(fps=FPS, silence_s=PATIENCE_S), context())
    camera.source = feed
    with feed.running():
        yield Stage(camera, lambda: setattr(feed, "plugged", False))


@asynccontextmanager
async def shared(folder: Path) -> AsyncGenerator[Stage]:
    """The camera of a role at level ``sitl``: the world writes into shared memory."""
    del folder
    run, plugged, numbers = f"test-{uuid.uuid4().hex[:12]}", [True], itertools.count(1)
    source = PartSpec("hil.camera.software_d415:SoftwareD415", {"run": run}, "test: source")
    size = COLOR.width, COLOR.height
    config = RealSenseConfig(source=source, fps=FPS, depth_size=size, silence_s=PATIENCE_S)
    with SharedCameraWriter(run, Role.SENDER, size, size, FPS) as world:

        def draw() -> None:
            number = next(numbers)
            if plugged:
                color = np.full((COLOR.height, COLOR.width, 3), number % 251, np.uint8)
                world.write(
                    time.monotonic_ns(),
                    color,
                    np.full((COLOR.height, COLOR.width), 1000 + number, np.uint16),
                )

        with repeating(draw, 1.0 / FPS):
            yield Stage(RealSense(config, context()), plugged.clear)
    assert not list(shared_memory().glob(f"*{run}*"))


@asynccontextmanager
async def tello(folder: Path) -> AsyncGenerator[Stage]:
    del folder
    with tello_stand.emulated(rate_hz=30.0) as stand:
        camera = TelloCamera(TelloCameraConfig(**stand.address), tello_stand.context())
        silence = partial(setattr, stand.video, "silent", True)
        yield Stage(camera, silence, tello_stand.CAMERA, "no video frame from")


@asynccontextmanager
async def recording(folder: Path) -> AsyncGenerator[Stage]:
    if not _recording:
        feed = Feed()
        recorder = RealSense(RealSenseConfig(fps=FPS, record=folder), context())
        recorder.source = feed
        with feed.running(rate_hz=FPS):
            async with recorder:
                for _ in range(RECORDED):
                    await recorder.read(PATIENCE_S)
        _recording.extend(recordings(folder))
    camera = RealSense(RealSenseConfig(fps=FPS, recording=_recording[0]), context())
    yield Stage(camera, lambda: None)  # it ends by itself


@asynccontextmanager
async def images(folder: Path) -> AsyncGenerator[Stage]:
    depth = folder / "depth"
    depth.mkdir()
    for number in range(RECORDED):
        name = f"{10.0 + number / FPS:.6f}.png"
        cv2.imwrite(
            str(folder / name), np.full((COLOR.height, COLOR.width, 3), 2 * number, np.uint8)
        )
        cv2.imwrite(
            str(depth / name), np.full((COLOR.height, COLOR.width), 1000 + number, np.uint16)
        )
    camera = RecordedCamera(RecordedCameraConfig(folder, depth=depth), context())
    yield Stage(camera, lambda: None)  # it ends by itself


CAMERAS = pytest.mark.parametrize("stage_of", [rendered, realsense, shared, recording, images])
StageOf = Callable[[Path], contextlib.AbstractAsyncContextManager[Stage]]
Check = Callable[[Stage], Coroutine[Any, Any, None]]


def run(stage_of: StageOf, folder: Path, test: Callable[[Stage], Any]) -> None:
    async def main() -> None:
        async with stage_of(folder) as stage:
            await test(stage)

    asyncio.run(main())


async def check_frames(stage: Stage) -> None:
    camera = stage.camera
    frames = [await camera.read(PATIENCE_S) for _ in range(FRAMES)]
    model = camera.model
    assert model == stage.model
    for frame in frames:
        assert (frame.color.shape, frame.color.dtype) == ((model.height, model.width, 3), np.uint8)
        assert (frame.depth_mm is None) == (Capability.RANGE in lacking(camera))
        if frame.depth_mm is not None:
            assert (frame.depth_mm.shape, frame.depth_mm.dtype) == (
                (model.height, model.width),
                np.uint16,
            )
    for earlier, later in pairwise(frames):
        assert later.stamp_ns > earlier.stamp_ns
        assert later.frame_id > earlier.frame_id


async def check_owner(stage: Stage) -> None:
    frame = await stage.camera.read(PATIENCE_S)
    before = deepcopy((frame.color, frame.depth_mm))
    for _ in range(FRAMES):
        await stage.camera.read(PATIENCE_S)
    np.testing.assert_array_equal(frame.color, before[0])
    assert (frame.depth_mm is None) == (before[1] is None)
    if frame.depth_mm is not None and before[1] is not None:
        np.testing.assert_array_equal(frame.depth_mm, before[1])
    frame.color[:] = 0  # and may be drawn upon


async def check_silence(stage: Stage) -> None:
    loop = asyncio.get_running_loop()
    await stage.camera.read(PATIENCE_S)
    stage.unplug()
    error, start_s = None, loop.time()
    async with asyncio.timeout(PATIENCE_S):
        while error is None:  # what was under way may still come
            start_s = loop.time()
            error = await _error_of(stage.camera, 0.15)
    assert loop.time() - start_s < QUICK_S  # of a read of 0.15 s
    assert stage.unplugged in str(error)
    assert error.remedy


async def check_closed(stage: Stage) -> None:
    start_s = asyncio.get_running_loop().time()
    with pytest.raises(CameraError, match="not open") as caught:
        await stage.camera.read(PATIENCE_S)
    assert caught.value.remedy
    assert asyncio.get_running_loop().time() - start_s < QUICK_S


async def _error_of(camera: Camera, timeout_s: float) -> CameraError | None:
    try:
        frame: Frame = await camera.read(timeout_s)
        del frame
    except CameraError as error:
        return error
    return None


@CAMERAS
@pytest.mark.parametrize(
    "check", [check_frames, check_owner, check_silence], ids=lambda check: check.__name__[6:]
)
def test_an_open_camera(stage_of: StageOf, check: Check, tmp_path: Path) -> None:
    """Stamps and ids grow and sizes are the calibration's; a frame is the reader's own.

    No more frames are an error in time with what to do.
    """

    async def test(stage: Stage) -> None:
        async with stage.camera:
            await check(stage)

    run(stage_of, tmp_path, test)


def test_all_of_it_for_a_tello_whose_video_takes_seconds_to_open(tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        await check_closed(stage)
        async with stage.camera as camera:
            await check_frames(stage)
        await check_closed(stage)
        await camera.__aexit__(None, None, None)  # closing twice is closing once
        async with camera:  # it can be opened again
            await check_owner(stage)
            await check_silence(stage)
            waiting = asyncio.create_task(_error_of(camera, 4.0 * PATIENCE_S))
            await asyncio.sleep(0)
        async with asyncio.timeout(PATIENCE_S):
            assert await waiting is not None  # closing ends a wait

    run(tello, tmp_path, test)


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
def test_nobody_waits_for_a_frame_of_one_that_is_not_open(
    stage_of: StageOf, tmp_path: Path
) -> None:
    async def test(stage: Stage) -> None:
        await check_closed(stage)
        async with stage.camera as camera:
            await camera.read(PATIENCE_S)
        await check_closed(stage)

    run(stage_of, tmp_path, test)


@CAMERAS
def test_closing_ends_a_wait(stage_of: StageOf, tmp_path: Path) -> None:
    async def test(stage: Stage) -> None:
        async with stage.camera as camera:
            await camera.read(PATIENCE_S)
            stage.unplug()
            while await _error_of(camera, 0.15) is None:
                pass
            waiting = asyncio.create_task(_error_of(camera, 4.0 * PATIENCE_S))
            await asyncio.sleep(0)
        async with asyncio.timeout(PATIENCE_S):
            assert await waiting is not None

    run(stage_of, tmp_path, test)

"""A recording as a camera: paced by its stamps, ends by saying so, and is held against the
calibration.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.interfaces import CameraError, Frame
from drivers.perception.pixels import PixelPerception, PixelPerceptionConfig
from drivers.recordings.camera import RecordedCamera, RecordedCameraConfig
from drivers.rig.calibration_file import CalibrationError
from drivers.rig.parts import Mount, Origin, PartContext
from drivers.rig.tables import RigError, decode_table
from hil.harness.virtual_time import run_virtual
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from tests.drivers.recordings.test_recording import (
    GREYS,
    HEIGHT,
    WIDTH,
    image,
    seen_level,
    write_images,
    write_log,
    write_video,
)

START_NS = 7_000_000_000
LEVEL = Pose(np.eye(3), np.zeros(3))


class LoopClock:
    """The loop's time, from a start of its own."""

    def now_ns(self) -> int:
        return START_NS + round(asyncio.get_running_loop().time() * 1e9)


def context(width: int = WIDTH, height: int = HEIGHT, serial: str = "") -> PartContext:
    camera, mount = (
        CameraModel(width, height, 60.0, 60.0, width / 2, height / 2),
        Mount(LEVEL, LEVEL),
    )
    origin = Origin(0.0, 0.0, 0.0)
    return PartContext(
        Role.SENDER, LoopClock(), camera, mount, single_marker(), origin, camera_serial=serial
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Five images at 0, 0.1, 0.2, 1.0 and 1.1 s."""
    return write_images(
        tmp_path / "images", ("10.0.png", "10.1.png", "10.2.png", "11.0.png", "11.1.png")
    )


def play(use: Callable[[RecordedCamera], Awaitable[Any]], file: Path, **options: Any) -> Any:
    async def main() -> Any:
        async with RecordedCamera(RecordedCameraConfig(file, **options), context()) as camera:
            return await use(camera)

    return run_virtual(main())


def taken(frames: list[Frame]) -> list[tuple[int, float, int]]:
    """Frame id, seconds since the start by its stamp, grey level."""
    return [
        (f.frame_id, round((f.stamp_ns - START_NS) / 1e9, 6), seen_level(f.color)) for f in frames
    ]


async def until_it_ends(camera: RecordedCamera, pause_s: float = 0.0) -> list[Frame]:
    frames: list[Frame] = []
    with pytest.raises(CameraError, match="the recording ended after"):
        while True:
            frames.append(await camera.read(5.0))
            await asyncio.sleep(pause_s)
    return frames


@pytest.mark.parametrize(("speed", "seconds"), [(1.0, 1.1), (2.0, 0.55), (0.5, 2.2)])
def test_frames_come_when_their_stamps_say(folder: Path, speed: float, seconds: float) -> None:
    async def use(camera: RecordedCamera) -> tuple[list[Frame], float]:
        return await until_it_ends(camera), asyncio.get_running_loop().time()

    frames, took_s = play(use, folder, speed=speed)
    due = [0.0, 0.1, 0.2, 1.0, 1.1]
    assert taken(frames) == [(k, round(due[k] / speed, 6), GREYS[k]) for k in range(5)]
    assert took_s == pytest.approx(seconds)


def test_who_is_late_gets_the_newest_frame_that_is_due(folder: Path) -> None:
    frames = play(lambda camera: until_it_ends(camera, pause_s=0.25), folder)
    assert taken(frames) == [(0, 0.0, 20), (2, 0.2, 100), (3, 1.0, 140), (4, 1.1, 180)]


def test_at_pace_fast_every_frame_comes_at_once(folder: Path) -> None:
    async def use(camera: RecordedCamera) -> tuple[list[Frame], float]:
        return await until_it_ends(camera), asyncio.get_running_loop().time()

    frames, took_s = play(use, folder, pace="fast")
    assert [one[1] for one in taken(frames)] == [0.0, 0.1, 0.2, 1.0, 1.1]
    assert took_s == 0.0


def test_it_is_played_again_only_when_asked(folder: Path) -> None:
    async def twelve(camera: RecordedCamera) -> list[Frame]:
        return [await camera.read(5.0) for _ in range(12)]

    frames = taken(play(twelve, folder, loop=True))
    assert [one[2] for one in frames] == [*GREYS, *GREYS, *GREYS[:2]]
    assert [one[1] for one in frames[4:7]] == [1.1, 1.2, 1.3]
    assert [one[0] for one in frames] == list(range(12))


def test_a_gap_longer_than_the_wait_is_no_frame(folder: Path) -> None:
    async def use(camera: RecordedCamera) -> None:
        for _ in range(3):
            await camera.read(0.5)
        begin = asyncio.get_running_loop().time()
        with pytest.raises(
            CameraError, match=r"no frame from .* for 0.5 s; the next one comes after 0.8"
        ):
            await camera.read(0.5)
        assert asyncio.get_running_loop().time() - begin == pytest.approx(0.5)
        assert taken([await camera.read(0.5)]) == [(3, 1.0, 140)]  # it comes all the same

    play(use, folder)


def test_the_wrong_size_is_refused_with_both_at_once(folder: Path) -> None:
    async def main() -> None:
        with pytest.raises(CalibrationError, match="for 640x480 px but the frames are 64x48 px"):
            async with RecordedCamera(RecordedCameraConfig(folder), context(640, 480)):
                pass

    run_virtual(main())


def test_a_frame_that_cannot_be_read_says_which(folder: Path) -> None:
    (folder / "11.0.png").write_bytes(b"damaged")

    async def use(camera: RecordedCamera) -> None:
        for _ in range(3):
            await camera.read(5.0)
        with pytest.raises(CameraError, match=r"11\.0\.png: this is no image"):
            await camera.read(5.0)

    play(use, folder, pace="fast")


def test_videos_and_logs_play_in_real_time_too(tmp_path: Path) -> None:
    """On a real loop, with the clock of a real role."""
    video, log = tmp_path / "film.mkv", tmp_path / "sender.mcap"
    write_video(video)
    write_log(log, ["/image"])

    async def frames_of(file: Path, pace: str) -> tuple[list[Frame], float]:
        ctx = context()
        clock = SystemClock(SystemClock.Config(), ctx)
        real = PartContext(ctx.role, clock, ctx.camera, ctx.mount, ctx.layout, ctx.origin)
        config = decode_table(
            {"file": str(file), "pace": pace}, RecordedCameraConfig, "rig.toml: camera"
        )
        async with RecordedCamera(config, real) as camera:
            begin = asyncio.get_running_loop().time()
            return await until_it_ends(camera), asyncio.get_running_loop().time() - begin

    frames, took_s = asyncio.run(frames_of(video, "real"))
    assert took_s >= 0.16
    assert seen_level(frames[-1].color) == GREYS[-1]  # the last one is never skipped
    assert frames[-1].stamp_ns - frames[0].stamp_ns == 160_000_000
    frames, _ = asyncio.run(frames_of(log, "fast"))
    assert [seen_level(frame.color) for frame in frames] == list(GREYS)


def perception(file: Path, serial: str) -> PixelPerception:
    camera = {
        "factory": "drivers.recordings.camera:RecordedCamera",
        "file": str(file),
        "pace": "fast",
        "serial": "0815",
    }
    detector = {"factory": "drivers.detectors.color:ColorDetector"}
    table = {"camera": camera, "detector": detector}
    return PixelPerception(
        decode_table(table, PixelPerceptionConfig, "rig.toml: sender.perception"),
        context(serial=serial),
    )


def test_a_sight_sees_a_recording_and_finds_what_is_in_it(folder: Path) -> None:
    shown = image(90)
    cv2.rectangle(shown, (20, 15), (43, 30), (24, 118, 245), -1)
    cv2.imwrite(str(folder / "10.1.png"), shown)

    async def main() -> None:
        async with perception(folder, "0815") as eye:
            assert (await eye.view(1.0)).targets(None) == []
            (found,) = (await eye.view(1.0)).targets(None)
            assert found.box.center == pytest.approx((31.5, 22.5), abs=1.0)

    run_virtual(main())


def test_a_camera_other_than_the_calibrations_is_refused_when_it_opens(folder: Path) -> None:
    async def main() -> None:
        with pytest.raises(CalibrationError, match="serial number 4711, this one is 0815"):
            async with perception(folder, "4711"):
                pass

    run_virtual(main())


def test_what_cannot_be_is_refused_by_name() -> None:
    table = {"file": "x.mp4", "speed": 0.0}
    with pytest.raises(RigError, match=r"speed: 0\.0 times is not within"):
        decode_table(table, RecordedCameraConfig, "rig.toml: sender.perception.camera")

    async def unopened() -> None:
        with pytest.raises(CameraError, match="not open"):
            await RecordedCamera(RecordedCameraConfig(Path("x.mp4")), context()).read(1.0)

    run_virtual(unopened())

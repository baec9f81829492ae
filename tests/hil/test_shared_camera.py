"""Frames through shared memory: whole, newest first, bounded waits, and nothing left behind by who was killed."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.interfaces import CameraError
from drivers.rig import Mount, Origin, PartContext
from hil.shared_camera import (
    RUN_VARIABLE,
    SharedCamera,
    SharedCameraConfig,
    SharedCameraWriter,
)
from hil.shared_segment import folder, remove_abandoned, segment_path
from path.camera import CameraModel
from path.geometry import Pose
from path.marker.layout import single_marker
from path.messages import Role

SMALL = CameraModel(64, 48, 60.0, 60.0, 31.5, 23.5)
LEVEL = Pose(np.eye(3), np.zeros(3))
PATIENCE_S = 10.0


class OffsetClock:
    """The monotonic clock, set apart."""

    def __init__(self, offset_ns: int = 0) -> None:
        self.offset_ns = offset_ns

    def now_ns(self) -> int:
        return time.monotonic_ns() + self.offset_ns


def context(offset_ns: int = 0, camera: CameraModel = SMALL) -> PartContext:
    return PartContext(
        Role.RECEIVER, OffsetClock(offset_ns), camera, Mount(LEVEL, LEVEL), single_marker(), Origin(0.0, 0.0, 0.0)
    )


@pytest.fixture
def run() -> Iterator[str]:
    name = f"test-{uuid.uuid4().hex[:12]}"
    yield name
    left = sorted(folder().glob(f"*{name}*"))
    for path in left:
        path.unlink()
    assert not left


def write(writer: SharedCameraWriter, value: int, stamp_ns: int | None = None, camera: CameraModel = SMALL) -> None:
    shape = (camera.height, camera.width)
    stamp_ns = time.monotonic_ns() if stamp_ns is None else stamp_ns
    writer.write(stamp_ns, np.full((*shape, 3), value % 251, np.uint8), np.full(shape, value % 251, np.uint16))


def write_all(writer: SharedCameraWriter, values: Iterable[int]) -> None:
    for value in values:
        write(writer, value)


def reader(run: str, offset_ns: int = 0, camera: CameraModel = SMALL, open_timeout_s: float = 5.0) -> SharedCamera:
    return SharedCamera(SharedCameraConfig(run=run, open_timeout_s=open_timeout_s), context(offset_ns, camera))


def test_a_frame_comes_through_with_its_stamp_in_the_role_s_clock(run: str) -> None:
    async def main() -> None:
        with SharedCameraWriter(run, Role.RECEIVER, SMALL) as writer:
            async with reader(run, offset_ns=7_000_000_000) as camera:
                stamp_ns = time.monotonic_ns() - 3_000_000
                write(writer, 42, stamp_ns)
                frame = await camera.read(PATIENCE_S)
        assert frame.color.shape == (48, 64, 3)
        assert frame.depth_mm is not None
        assert set(frame.color.ravel().tolist()) == set(frame.depth_mm.ravel().tolist()) == {42}
        assert frame.stamp_ns == pytest.approx(stamp_ns + 7_000_000_000, abs=200_000)

    asyncio.run(main())


def test_the_newest_wins_none_is_given_twice_and_what_was_passed_over_is_counted(run: str) -> None:
    async def main() -> None:
        with SharedCameraWriter(run, Role.RECEIVER, SMALL) as writer:
            write(writer, 1)  # before the reader came
            async with reader(run) as camera:
                write_all(writer, range(2, 13))
                frame = await camera.read(PATIENCE_S)
                assert frame.color[0, 0, 0] == 12
                assert camera.skipped == 10
                with pytest.raises(CameraError, match=r"no frame from .* for 0.02 s"):
                    await camera.read(0.02)
                write(writer, 13)
                second = await camera.read(PATIENCE_S)
                assert second.color[0, 0, 0] == 13
                assert second.frame_id == frame.frame_id + 1
                assert frame.color[0, 0, 0] == 12  # a copy: later frames leave it alone

    asyncio.run(main())


def test_a_waiting_reader_is_woken(run: str) -> None:
    async def main() -> None:
        with SharedCameraWriter(run, Role.RECEIVER, SMALL) as writer:
            async with reader(run) as camera:
                waiting = asyncio.create_task(camera.read(PATIENCE_S))
                await asyncio.sleep(0)
                write(writer, 5)
                assert (await waiting).color[0, 0, 0] == 5

    asyncio.run(main())


class Overtaken:
    """A slot's pixels that the writer comes back to while they are copied."""

    def __init__(self, pixels: NDArray[np.uint8], meanwhile: Callable[[], None]) -> None:
        self.pixels, self.meanwhile = pixels, meanwhile

    def copy(self) -> NDArray[np.uint8]:
        torn = self.pixels.copy()
        self.meanwhile()
        torn[24:] = self.pixels[24:]
        return torn


def overtake(camera: SharedCamera, slot: int, meanwhile: Callable[[], None]) -> None:
    assert camera._segment is not None
    slots: list[Any] = camera._segment.colors
    slots[slot] = Overtaken(slots[slot], meanwhile)


def test_a_reader_that_was_overtaken_while_copying_takes_a_newer_frame(run: str) -> None:
    async def main() -> None:
        with SharedCameraWriter(run, Role.RECEIVER, SMALL) as writer:
            async with reader(run) as camera:
                write(writer, 1)
                overtake(camera, 1, lambda: write_all(writer, range(2, 7)))
                frame = await camera.read(PATIENCE_S)
                assert frame.color.min() == frame.color.max() == 6

    asyncio.run(main())


def test_no_frame_is_torn_nor_out_of_order(run: str) -> None:
    camera_model = CameraModel(320, 240, 300.0, 300.0, 160.0, 120.0)
    ending = threading.Event()

    def keep_writing(writer: SharedCameraWriter) -> None:
        value = 0
        while not ending.is_set():
            value += 1
            write(writer, value, camera=camera_model)

    async def main() -> None:
        with SharedCameraWriter(run, Role.RECEIVER, camera_model) as writer:
            thread = threading.Thread(target=keep_writing, args=(writer,))
            async with reader(run, camera=camera_model) as camera:
                thread.start()
                try:
                    last_id, last_stamp = 0, 0
                    for _ in range(150):
                        frame = await camera.read(PATIENCE_S)
                        assert frame.depth_mm is not None
                        expected = frame.frame_id % 251
                        assert frame.color.min() == frame.color.max() == expected
                        assert frame.depth_mm.min() == frame.depth_mm.max() == expected
                        assert frame.frame_id > last_id
                        assert frame.stamp_ns > last_stamp
                        last_id, last_stamp = frame.frame_id, frame.stamp_ns
                finally:
                    ending.set()
                    thread.join()

    asyncio.run(main())


def test_a_calibration_of_another_size_is_refused_with_both_sizes(run: str) -> None:
    async def main() -> None:
        large = reader(run, camera=CameraModel(640, 480, 600.0, 600.0, 320.0, 240.0))
        refused = pytest.raises(CameraError, match=r"640x480 px .* 64x48 px")
        with SharedCameraWriter(run, Role.RECEIVER, SMALL), refused:
            await large.__aenter__()

    asyncio.run(main())


def test_a_world_that_never_comes_is_an_error_after_a_bounded_wait(run: str) -> None:
    async def main() -> None:
        with pytest.raises(CameraError, match="no camera frames are published"):
            async with reader(run, open_timeout_s=0.05):
                pass

    asyncio.run(main())


def test_two_writers_or_two_readers_of_one_name_are_refused(run: str) -> None:
    async def main() -> None:
        with SharedCameraWriter(run, Role.RECEIVER, SMALL) as writer:
            with pytest.raises(CameraError, match="already being written"):
                SharedCameraWriter(run, Role.RECEIVER, SMALL).__enter__()
            async with reader(run) as camera:
                with pytest.raises(CameraError, match="already has a reader"):
                    async with reader(run):
                        pass
                write(writer, 3)
                assert (await camera.read(PATIENCE_S)).color[0, 0, 0] == 3

    asyncio.run(main())


def test_without_a_run_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(RUN_VARIABLE, raising=False)
    with pytest.raises(CameraError, match="no run is named") as caught:
        SharedCamera(SharedCameraConfig(), context())
    assert RUN_VARIABLE in caught.value.remedy
    monkeypatch.setenv(RUN_VARIABLE, "somewhere")
    SharedCamera(SharedCameraConfig(), context())


WRITER = """
import sys
from hil.shared_camera import SharedCameraWriter
from path.camera import CameraModel
from path.messages import Role
with SharedCameraWriter(sys.argv[1], Role.RECEIVER, CameraModel(64, 48, 60.0, 60.0, 31.5, 23.5)):
    print("up", flush=True)
    sys.stdin.read()
"""

SOCKET = """
import socket, sys
reader = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
reader.bind(sys.argv[1])
print("up", flush=True)
sys.stdin.read()
"""


@contextlib.contextmanager
def process(script: str, argument: str) -> Generator[subprocess.Popen[bytes]]:
    """A child that said it is up; it is killed in the end."""
    child = subprocess.Popen([sys.executable, "-c", script, argument], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"up\n"
        yield child
    finally:
        child.kill()
        child.communicate()


def test_a_killed_world_is_noticed_and_cleaned_up_after(run: str) -> None:
    async def main() -> None:
        with process(WRITER, run) as world:
            async with reader(run) as camera:
                world.kill()
                world.communicate()
                with pytest.raises(CameraError, match="the world process that writes it is gone"):
                    await camera.read(0.02)

    asyncio.run(main())
    assert segment_path(run, Role.RECEIVER).exists()
    assert segment_path(run, Role.RECEIVER) in remove_abandoned()
    assert not segment_path(run, Role.RECEIVER).exists()


def test_what_a_living_world_writes_is_not_taken_for_abandoned(run: str) -> None:
    with process(WRITER, run) as world:
        remove_abandoned()
        assert segment_path(run, Role.RECEIVER).exists()
        world.communicate()  # end of its input: it leaves as it should
        assert not segment_path(run, Role.RECEIVER).exists()


def test_a_killed_reader_leaves_nothing_that_bars_the_next(run: str) -> None:
    socket_path = segment_path(run, Role.RECEIVER).with_name(f"{segment_path(run, Role.RECEIVER).name}.sock")

    async def main() -> None:
        with SharedCameraWriter(run, Role.RECEIVER, SMALL) as writer:
            with process(SOCKET, str(socket_path)), pytest.raises(CameraError, match="already has a reader"):
                await reader(run).__aenter__()
            assert socket_path.exists()
            write(writer, 1)
            async with reader(run) as camera:
                write(writer, 2)
                assert (await camera.read(PATIENCE_S)).color[0, 0, 0] == 2

    asyncio.run(main())


def test_too_few_slots_are_refused() -> None:
    with pytest.raises(ValueError, match="slots"):
        SharedCameraWriter("x", Role.SENDER, SMALL, slots=2)

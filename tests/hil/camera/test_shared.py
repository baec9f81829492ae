"""Frames through shared memory: whole, newest first, bounded waits, and nothing left behind by who
was killed.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from drivers.interfaces import CameraError
from hil.camera.segment import folder, remove_abandoned, segment_path
from hil.camera.shared import SharedCameraReader, SharedCameraWriter, SharedFrame
from path.messages import Role

SIZE, DEPTH_SIZE, FPS = (64, 48), (40, 30), 50
PATIENCE_S = 60.0


@pytest.fixture
def run() -> Iterator[str]:
    name = f"test-{uuid.uuid4().hex[:12]}"
    yield name
    left = sorted(folder().glob(f"*{name}*"))
    for path in left:
        path.unlink()
    assert not left


def writer(run: str, size: tuple[int, int] = SIZE) -> SharedCameraWriter:
    return SharedCameraWriter(run, Role.RECEIVER, size, DEPTH_SIZE, FPS)


def reader(run: str, open_timeout_s: float = PATIENCE_S) -> SharedCameraReader:
    return SharedCameraReader(run, Role.RECEIVER, open_timeout_s)


def write(
    world: SharedCameraWriter, value: int, stamp_ns: int = 0, size: tuple[int, int] = SIZE
) -> None:
    color = np.full((size[1], size[0], 3), value % 251, np.uint8)
    world.write(
        stamp_ns or time.monotonic_ns(), color, np.full(DEPTH_SIZE[::-1], value % 251, np.uint16)
    )


def write_all(world: SharedCameraWriter, values: Iterable[int]) -> None:
    for value in values:
        write(world, value)


def value_of(frame: SharedFrame | None) -> int:
    """Returns the number that was written, when all of it is there."""
    assert frame is not None
    values = set(frame.color.ravel().tolist()) | set(frame.depth_mm.ravel().tolist())
    assert len(values) == 1
    return values.pop()


def test_a_frame_comes_through_whole_with_its_stamp_and_sizes(run: str) -> None:
    with writer(run) as world, reader(run) as camera:
        assert (camera.layout.color_size, camera.layout.depth_size, camera.layout.fps) == (
            SIZE,
            DEPTH_SIZE,
            FPS,
        )
        write(world, 42, stamp_ns=123_456)
        frame = camera.next(PATIENCE_S)
        assert frame is not None
        assert (frame.color.shape, frame.depth_mm.shape) == ((48, 64, 3), (30, 40))
        assert (value_of(frame), frame.stamp_ns, camera.is_whole(frame)) == (42, 123_456, True)


def test_the_newest_wins_none_is_given_twice_and_what_was_passed_over_is_counted(run: str) -> None:
    with writer(run) as world:
        write(world, 1)  # before the reader came
        with reader(run) as camera:
            write_all(world, range(2, 13))
            first = camera.next(PATIENCE_S)
            assert (value_of(first), camera.skipped) == (12, 10)
            assert camera.next(0.02) is None
            write(world, 13)
            second = camera.next(PATIENCE_S)
            assert value_of(second) == 13
            assert first is not None and second is not None
            assert second.number == first.number + 1


def test_a_waiting_reader_is_woken(run: str) -> None:
    with writer(run) as world, reader(run) as camera, ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(camera.next, PATIENCE_S)
        write(world, 5)
        assert value_of(waiting.result(PATIENCE_S)) == 5


def test_a_reader_that_was_overtaken_is_told(run: str) -> None:
    with writer(run) as world, reader(run) as camera:
        write(world, 1)
        frame = camera.next(PATIENCE_S)
        assert frame is not None
        write_all(world, range(2, 5))
        assert camera.is_whole(frame)
        write_all(world, range(5, 7))
        assert not camera.is_whole(frame)
        assert value_of(camera.next(PATIENCE_S)) == 6


def test_no_frame_is_torn_nor_out_of_order(run: str) -> None:
    ending = threading.Event()

    def keep_writing(world: SharedCameraWriter) -> None:
        value = 0
        while not ending.is_set():
            value += 1
            write(world, value, size=(320, 240))

    with writer(run, (320, 240)) as world, reader(run) as camera:
        thread = threading.Thread(target=keep_writing, args=(world,))
        thread.start()
        try:
            last, whole = 0, 0
            while whole < 150:
                frame = camera.next(PATIENCE_S)
                assert frame is not None
                copy = frame.color.copy(), frame.depth_mm.copy()
                if camera.is_whole(frame):
                    whole += 1
                    assert (
                        {plane.min() for plane in copy}
                        == {plane.max() for plane in copy}
                        == {frame.number % 251}
                    )
                assert frame.number > last
                last = frame.number
        finally:
            ending.set()
            thread.join()


def test_a_world_that_never_comes_is_an_error_after_a_bounded_wait(run: str) -> None:
    with (
        pytest.raises(CameraError, match="no camera frames are published"),
        reader(run, open_timeout_s=0.05),
    ):
        pass


def test_two_writers_or_two_readers_of_one_name_are_refused(run: str) -> None:
    with writer(run) as world:
        with pytest.raises(CameraError, match="already being written"):
            writer(run).__enter__()
        with reader(run) as camera:
            with pytest.raises(CameraError, match="already has a reader"):
                reader(run).__enter__()
            write(world, 3)
            assert value_of(camera.next(PATIENCE_S)) == 3


WRITER = """
import sys
from hil.camera.shared import SharedCameraWriter
from path.messages import Role
with SharedCameraWriter(sys.argv[1], Role.RECEIVER, (64, 48), (40, 30), 50):
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
    child = subprocess.Popen(
        [sys.executable, "-c", script, argument], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"up\n"
        yield child
    finally:
        child.kill()
        child.communicate()


def test_a_killed_world_is_noticed_and_cleaned_up_after(run: str) -> None:
    with process(WRITER, run) as world, reader(run) as camera:
        assert camera.writer_lives
        world.kill()
        world.communicate()
        assert camera.next(0.02) is None
        assert not camera.writer_lives
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
    socket_path = segment_path(run, Role.RECEIVER).with_name(
        f"{segment_path(run, Role.RECEIVER).name}.sock"
    )

    with writer(run) as world:
        with (
            process(SOCKET, str(socket_path)),
            pytest.raises(CameraError, match="already has a reader"),
        ):
            reader(run).__enter__()
        assert socket_path.exists()
        write(world, 1)
        with reader(run) as camera:
            write(world, 2)
            assert value_of(camera.next(PATIENCE_S)) == 2


def test_too_few_slots_are_refused() -> None:
    with pytest.raises(ValueError, match="slots"):
        SharedCameraWriter("x", Role.SENDER, SIZE, DEPTH_SIZE, FPS, slots=2)

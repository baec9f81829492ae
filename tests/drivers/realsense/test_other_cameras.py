"""Cameras of the family that are no D415: their recordings are read by the driver as `export` reads
them.
"""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import CameraError, Frame
from drivers.realsense.camera import RealSense, RealSenseConfig
from drivers.realsense.recorded import RealSenseRecording
from drivers.realsense.sdk import RawImage, RealSenseDevice, Streams
from drivers.realsense.sources import RecordingSource
from drivers.realsense.stream import PairStream
from path.camera.lenses import Lens
from path.camera.model import CameraModel
from tests.drivers.realsense.other_cameras import (
    COLOR_BGR,
    FOCAL_PX,
    FPS,
    FRAMES,
    HEIGHT,
    WIDTH,
    CameraKind,
    OtherCamera,
)
from tests.drivers.realsense.software_d415 import context

D455 = CameraKind("D455", coefficients=(-0.055, 0.066, 0.0003, 0.0007, -0.0215))
D405 = CameraKind(
    "D405",
    coefficients=(-0.05, 0.06, 0.0, 0.0, -0.02),
    one_sensor=True,
    unit_m=0.0001,
    wall_m=0.4,
    apart_m=0.0,
)
STREAMS = Streams((WIDTH, HEIGHT), (WIDTH, HEIGHT), FPS)
MODEL = CameraModel(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, 47.5, 35.5)
PATIENCE_S = 60.0
PLAYS = 20
EVERY_S = 1.0 / FPS  # of what is played: as it was taken
FORMS = ("bgr8", "rgb8", "bgra8", "rgba8", "yuyv", "uyvy")


def played(file: Path) -> Frame:
    """The first frame of a recording, through the driver.

    librealsense plays it in real time, and drops what its own threads come too late for, all of it
    where they got no core: then it is played again.
    """

    async def first() -> Frame:
        config = RealSenseConfig(recording=file, fps=FPS)
        async with RealSense(config, context(MODEL)) as driver:
            return await driver.read(PATIENCE_S)

    for _ in range(PLAYS - 1):
        try:
            return asyncio.run(first())
        except CameraError as error:
            if str(error) != "it has ended":
                raise
    return asyncio.run(first())


def is_the_colour(pixels: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> bool:
    return bool(np.abs(pixels.reshape(-1, 3).astype(int) - COLOR_BGR).max() <= 3)  # of YUV: rounded


@pytest.mark.parametrize("form", FORMS)
def test_a_recording_is_read_in_whatever_format_its_colour_is(tmp_path: Path, form: str) -> None:
    file = OtherCamera(CameraKind(form=form)).record(tmp_path / "film.db3", EVERY_S)
    pairs = list(RealSenseRecording(file).pairs())
    assert len(pairs) == FRAMES
    assert is_the_colour(pairs[0].color)
    frame = played(file)
    assert is_the_colour(frame.color)
    assert frame.color.flags.c_contiguous
    assert frame.depth_mm is not None
    assert np.median(frame.depth_mm[frame.depth_mm > 0]) == pytest.approx(1500, abs=1)


def test_a_recording_is_read_while_librealsense_still_begins_to_play_it(tmp_path: Path) -> None:
    """Its ``resume`` may wait for images that have come to be taken: for ten seconds, and then it
    goes on without.
    """
    recording, taken = (
        RealSenseRecording(OtherCamera(CameraKind()).record(tmp_path / "film.db3")),
        threading.Event(),
    )

    class Waits:
        def __init__(self, playback: Any) -> None:
            self._playback = playback

        def __getattr__(self, name: str) -> Any:
            return getattr(self._playback, name)

        def resume(self) -> None:
            self._playback.resume()
            assert taken.wait(PATIENCE_S)

    recording._playback = Waits(recording._playback)
    pairs = recording.pairs()
    next(pairs)
    taken.set()
    assert len(list(pairs)) == FRAMES - 1


class Played(RecordingSource):
    """A recording whose images a test gives; ``ended``: it has played them all."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(Path("film.db3"))
        self.camera = OtherCamera(CameraKind())
        self.ended = False
        monkeypatch.setattr(RealSenseDevice, "at_end", property(lambda _: self.ended))

    def open(self) -> Any:
        return self.camera.device

    def driver(self) -> RealSense:
        driver = RealSense(RealSenseConfig(recording=Path(self.name), fps=FPS), context(MODEL))
        driver.source = self
        return driver


def test_what_waits_when_a_recording_is_found_at_its_end_is_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A few frames play in milliseconds, and a thread may be without a core for longer than
    that.
    """
    film, following = Played(monkeypatch), RealSenseDevice.next

    def nothing_came_and_then_all(device: RealSenseDevice, timeout_s: float) -> RawImage | None:
        if film.ended:
            return following(device, timeout_s)
        film.camera.give(1)
        film.ended = True
        return None

    async def play() -> Frame:
        async with film.driver() as driver:
            return await driver.read(PATIENCE_S)

    monkeypatch.setattr(RealSenseDevice, "next", nothing_came_and_then_all)
    assert is_the_colour(asyncio.run(play()).color)


def test_the_last_frame_of_a_recording_is_given_to_whoever_looked_just_before_it_came(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    film, take = Played(monkeypatch), PairStream.take

    def take_and_stand_still(stream: PairStream) -> Frame | None:
        frame = take(stream)
        if frame is None and not film.ended:
            film.camera.give(2)
            film.ended = True
            stream.join()
        return frame

    async def play() -> list[int]:
        numbers = list[int]()
        opening = asyncio.create_task(driver.__aenter__())
        while driver._stream is None or not driver._stream.counters.opened:  # noqa: ASYNC110 (another thread's)
            await asyncio.sleep(0.005)
        film.camera.give(1)
        await opening
        with pytest.raises(CameraError, match="it has ended"):
            while True:
                numbers.append((await driver.read(PATIENCE_S)).frame_id)
        await driver.__aexit__(None, None, None)
        return numbers

    driver = film.driver()
    monkeypatch.setattr(PairStream, "take", take_and_stand_still)
    assert asyncio.run(play()) == [1, 2]


@pytest.mark.parametrize("one_sensor", [False, True])
@pytest.mark.parametrize("form", ["bgr8", "rgb8"])
def test_a_camera_opens_whose_streams_are_of_one_sensor_or_of_two(
    form: str, one_sensor: bool
) -> None:
    camera = OtherCamera(CameraKind(form=form, one_sensor=one_sensor, unit_m=0.0001, wall_m=0.4))
    device = RealSenseDevice(camera.device, STREAMS)
    try:
        assert device.unit_m == pytest.approx(0.0001)
        for number in range(1, 4):
            camera.give(number)
            images = [device.next(PATIENCE_S), device.next(PATIENCE_S)]
            assert sorted(image.kind for image in images if image is not None) == ["color", "depth"]
            for image in images:
                assert image is not None and image.number == number
                assert image.kind == "depth" or is_the_colour(np.asarray(image.pixels, np.uint8))
    finally:
        device.close()


def test_a_recording_of_one_sensor_is_read_with_its_own_unit(tmp_path: Path) -> None:
    file = OtherCamera(D405).record(tmp_path / "film.db3", EVERY_S)
    recording = RealSenseRecording(file)
    assert recording.unit_m == pytest.approx(0.0001)
    assert len(list(recording.pairs())) == FRAMES
    frame = played(file)
    assert frame.depth_mm is not None
    assert np.median(frame.depth_mm[frame.depth_mm > 0]) == pytest.approx(400, abs=1)


@pytest.mark.parametrize("kind", [D455, D405], ids=lambda kind: kind.name)
def test_an_inverse_lens_is_read_as_the_brown_conrady_lens_that_looks_the_same_way(
    tmp_path: Path, kind: CameraKind
) -> None:
    lens = RealSenseRecording(OtherCamera(kind).record(tmp_path / "film.db3")).factory_color()
    own = Lens(
        "inverse_brown_conrady", WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, 47.5, 35.5, kind.coefficients
    )
    pixels = np.array(
        [(0.0, 0.0), (95.0, 0.0), (0.0, 71.0), (95.0, 71.0), (47.0, 35.0), (20.0, 60.0)]
    )
    assert lens.worst_px < 0.01
    assert np.abs(lens.camera.rays(pixels) - own.rays(pixels)).max() * FOCAL_PX < 0.01
    # Read as the forward lens of the same numbers, it would be off by pixels.
    k1, k2, p1, p2, k3 = kind.coefficients
    forward = CameraModel(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, 47.5, 35.5, (k1, k2, p1, p2, k3))
    assert np.abs(forward.rays(pixels) - own.rays(pixels)).max() * FOCAL_PX > 1.0


def test_a_lens_of_a_kind_that_is_not_known_is_named(tmp_path: Path) -> None:
    kind = CameraKind(lens="ftheta", coefficients=(0.1, 0.0, 0.0, 0.0, 0.0))
    recording = RealSenseRecording(OtherCamera(kind).record(tmp_path / "film.db3"))
    with pytest.raises(CameraError, match="a lens of a kind that is not known: ftheta") as caught:
        recording.factory_color()
    assert "calibrate camera" in caught.value.remedy


def test_depth_of_which_nobody_says_the_unit_is_refused(tmp_path: Path) -> None:
    file = OtherCamera(CameraKind(unit_m=None)).record(tmp_path / "film.db3")
    with pytest.raises(CameraError, match="does not say how long one step of its depth is"):
        RealSenseRecording(file)

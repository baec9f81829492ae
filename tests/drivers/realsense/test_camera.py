"""The D415 driver on pyrealsense2's software device: frames, clocks, filters, errors, coming back,
recording.
"""

from __future__ import annotations

import asyncio
import re
import threading
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import CameraError, Frame
from drivers.perception.stamp_clock import Domain
from drivers.realsense.camera import RealSense, RealSenseConfig
from drivers.realsense.sdk import RealSenseDevice, Streams, load_recording
from drivers.realsense.sources import RecordingSource, UsbSource
from drivers.rig.tables import RigError, decode_table
from hil.camera.software_device import DeviceClock, SoftwareDevice
from path.camera.model import CameraModel
from tests.drivers.realsense.software_d415 import (
    COLOR,
    DEPTH,
    DEPTH_MM,
    FPS,
    Feed,
    context,
    recordings,
)

PATIENCE_S = 60.0
AGAIN_S = 1.0  # the library has no room for an image while others wait in it
MS = 1_000_000
PLAYS = 20


def camera(source: Any, model: CameraModel = COLOR, **options: Any) -> RealSense:
    made = RealSense(
        decode_table({"fps": FPS, "silence_s": PATIENCE_S, **options}, RealSenseConfig, "test"),
        context(model),
    )
    made.source = source
    return made


def run(coroutine: Awaitable[Any]) -> None:
    """Run a test, and see that its threads are gone."""

    async def main() -> None:
        await coroutine

    before = set(threading.enumerate())
    asyncio.run(main())
    assert set(threading.enumerate()) <= before


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not condition():  # noqa: ASYNC110 (what is waited for happens in other threads)
            await asyncio.sleep(0.005)


async def newest(driver: RealSense, feed: Feed, within_s: float = PATIENCE_S) -> Frame:
    """The frame that was fed last."""
    while True:
        frame = await driver.read(within_s)
        if frame.color[0, 0, 0] == feed.number % 256:
            return frame


async def given(driver: RealSense, feed: Feed, late_s: float = 0.0) -> tuple[int, Frame]:
    """The stamp of a frame that is fed so long after it, and the frame; fed again, as another one,
    until it comes.
    """
    async with asyncio.timeout(PATIENCE_S):
        while True:
            stamp_ns = time.monotonic_ns()
            await asyncio.sleep(late_s)
            feed.give(stamp_ns)
            with suppress(CameraError):
                return stamp_ns, await newest(driver, feed, AGAIN_S)


async def refused(driver: RealSense, timeout_s: float, pattern: str) -> None:
    """Read until an error says this."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            try:
                await driver.read(timeout_s)
            except CameraError as error:
                if re.search(pattern, str(error)):
                    return


# --- frames


@pytest.mark.parametrize("domain", Domain)
def test_a_frame_has_its_own_stamp_in_the_role_s_clock(domain: Domain) -> None:
    async def main() -> None:
        feed = Feed(DeviceClock(domain))
        with feed.running():
            async with camera(feed, latency_s=0.0) as driver:
                last, ages_ns = await driver.read(PATIENCE_S), list[int]()
                for _ in range(20):
                    frame = await driver.read(PATIENCE_S)
                    assert frame.stamp_ns > last.stamp_ns
                    assert frame.frame_id > last.frame_id
                    ages_ns.append(time.monotonic_ns() - frame.stamp_ns)
                    last = frame
                # the others are older where this process stood still
                assert 0 <= min(ages_ns) < 500 * MS

    run(main())


def test_the_stamp_is_of_the_middle_of_the_exposure() -> None:
    """The device stamps the beginning of the transfer, 9 ms later, and tells both in its
    metadata.
    """

    async def main() -> None:
        feed = Feed(DeviceClock(Domain.GLOBAL, readout_ns=9 * MS))
        with feed.running():
            driver = camera(feed)
            await driver.__aenter__()
        stamp_ns, frame = await given(driver, feed, late_s=0.03)
        assert frame.stamp_ns == pytest.approx(stamp_ns, abs=0.5 * MS)
        assert driver.counters.domain is Domain.GLOBAL
        assert driver.counters.age_ns > 29 * MS
        await driver.__aexit__(None, None, None)

    run(main())


def test_colour_is_a_copy_and_depth_is_registered() -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            async with camera(feed) as driver:
                frame = await driver.read(PATIENCE_S)
                value = int(frame.color[0, 0, 0])
                for _ in range(5):
                    await driver.read(PATIENCE_S)
        assert frame.depth_mm is not None
        assert frame.color.shape == (COLOR.height, COLOR.width, 3)
        assert frame.depth_mm.shape == (COLOR.height, COLOR.width)
        assert set(frame.color.ravel().tolist()) == {value}
        middle = frame.depth_mm[10:-10, 10:-10]
        # the cameras are turned against each other
        assert np.abs(middle.astype(int) - DEPTH_MM).max() < 15
        # the colour camera sees more than the depth camera
        assert (frame.depth_mm[:4, :4] == 0).all()

    run(main())


def test_frames_without_their_other_half_are_not_given() -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            driver = camera(feed, silence_s=0.2)
            await driver.__aenter__()
        with feed.running(give=lambda: feed.give(depth=False)):
            await refused(driver, 0.5, "none that belong together")
            assert driver.counters.unpaired > 0
        await driver.__aexit__(None, None, None)

    run(main())


def test_old_stamps_are_counted_and_not_given() -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            driver = camera(feed)
            await driver.__aenter__()
        stamp_ns, frame = await given(driver, feed)
        assert frame.stamp_ns == pytest.approx(stamp_ns, abs=MS)
        before = driver.counters.old
        for back_ns in (0, 5 * MS):
            feed.give(stamp_ns - back_ns)
        await until(lambda: driver.counters.old == before + 4)
        with pytest.raises(CameraError, match=r"no frame from bench D415 for 0.05 s"):
            await driver.read(0.05)
        await driver.__aexit__(None, None, None)

    run(main())


def test_a_reader_that_is_slow_gets_the_newest() -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            driver = camera(feed)
            await driver.__aenter__()
        await until(lambda: feed.give() and driver.counters.replaced > 0)  # nobody reads meanwhile
        await given(driver, feed)
        await driver.__aexit__(None, None, None)

    run(main())


@pytest.mark.parametrize("name", ["spatial", "temporal", "hole_filling"])
def test_filters_are_applied(name: Any) -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            async with camera(feed, filters=[name]) as driver:
                frame = await driver.read(PATIENCE_S)
        assert frame.depth_mm is not None
        assert np.abs(frame.depth_mm[10:-10, 10:-10].astype(int) - DEPTH_MM).max() < 15

    run(main())


def test_nothing_is_measured_outside_the_limits() -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            async with camera(feed, min_depth_m=0.3, max_depth_m=1.4) as driver:
                frame = await driver.read(PATIENCE_S)
        assert frame.depth_mm is not None
        assert not frame.depth_mm.any()

    run(main())


def test_the_emitter_is_switched() -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            async with camera(feed, emitter=False):
                assert feed.software is not None
                rs = feed.software._rs
                assert feed.software._sensors["depth"].get_option(rs.option.emitter_enabled) == 0.0

    run(main())


# --- what goes wrong


def test_an_unplugged_camera_is_named_and_comes_back() -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            async with camera(feed, silence_s=0.1) as driver:
                last = await driver.read(PATIENCE_S)
                feed.plugged = False
                opened = driver.counters.opened
                await refused(driver, 0.4, r"bench D415.*(pulled|plugged).*opened again")
                feed.number, feed.plugged = 0, True  # it counts from the beginning again
                await until(lambda: driver.counters.opened > opened)
                after = await driver.read(PATIENCE_S)
                assert after.frame_id > last.frame_id
                assert after.stamp_ns > last.stamp_ns

    run(main())


def test_what_the_library_raises_while_the_camera_is_gone_does_not_end_the_driver() -> None:
    class Flaky(Feed):
        failures = 0

        def open(self) -> Any:
            if self.opened == 1 and self.failures < 2:
                self.failures += 1
                raise RuntimeError("failed to set power state")
            return super().open()

    async def main() -> None:
        feed = Flaky()
        with feed.running():
            async with camera(feed, silence_s=0.05) as driver:
                feed.plugged = False
                await refused(driver, 0.1, "its cable was pulled|failed to set power state")
                feed.plugged = True
                await until(lambda: driver.counters.opened > 1)
                await driver.read(PATIENCE_S)
        assert feed.failures == 2

    run(main())


def test_a_camera_that_does_not_come_back_is_given_up() -> None:
    async def main() -> None:
        feed = Feed()
        with feed.running():
            async with camera(feed, silence_s=0.05, reopen_s=0.1) as driver:
                feed.plugged = False
                await refused(driver, 0.1, "given up")
                start_s = time.monotonic()
                with pytest.raises(CameraError, match="given up"):
                    await driver.read(2.0 * PATIENCE_S)
                assert time.monotonic() - start_s < PATIENCE_S

    run(main())


def test_a_camera_that_is_not_there_is_refused_at_once() -> None:
    async def main() -> None:
        feed = Feed()
        feed.plugged = False
        with pytest.raises(CameraError, match="nothing is plugged in"):
            await camera(feed).__aenter__()

    run(main())


def test_a_silent_camera_is_refused_in_time() -> None:
    async def main() -> None:
        with pytest.raises(CameraError, match=r"no frame from bench D415 in the first 0.2 s"):
            await camera(Feed(), open_timeout_s=0.2).__aenter__()

    run(main())


def test_a_stream_that_the_device_does_not_have_is_refused_with_those_it_has() -> None:
    async def main() -> None:
        other = CameraModel(64, 48, 60.0, 60.0, 31.5, 23.5)
        with pytest.raises(
            CameraError, match=r"no color stream of 64x48 px at 50 Hz; it has: 96x72 at 50"
        ):
            await camera(Feed(), other, depth_size=[96, 72]).__aenter__()

    run(main())


def test_a_calibration_that_cannot_be_of_this_camera_is_refused() -> None:
    async def main() -> None:
        tele = CameraModel(COLOR.width, COLOR.height, 400.0, 400.0, COLOR.cx, COLOR.cy)
        with pytest.raises(CameraError, match="depth cannot be registered to colour"):
            await camera(Feed(), tele).__aenter__()

    run(main())


def test_reading_what_is_not_open_says_so() -> None:
    async def main() -> None:
        feed = Feed()
        driver = camera(feed)
        with pytest.raises(CameraError, match="is not open"):
            await driver.read(0.1)
        with feed.running():
            async with driver:
                pass
        await driver.__aexit__(None, None, None)  # twice is once
        with pytest.raises(CameraError, match="is not open"):
            await driver.read(0.1)

    run(main())


def device(serial: str) -> Any:
    return SoftwareDevice(COLOR, DEPTH, T_LEVEL, FPS, serial=serial).device


T_LEVEL = context().mount.T_b_c


def test_a_camera_is_found_by_its_serial() -> None:
    devices = [device("111"), device("222")]
    source = UsbSource("222", lambda: devices)
    assert source.open() is devices[1]
    assert source.missing() is None
    del devices[1]
    assert "no longer connected" in str(source.missing())
    assert UsbSource("", lambda: devices).open() is devices[0]


@pytest.mark.parametrize(
    ("serial", "connected", "message"),
    [
        ("", [], "no RealSense camera is connected"),
        (
            "333",
            ["111", "222"],
            "no RealSense cameras with serial 333 are connected; there are: 111, 222",
        ),
        ("", ["111", "222"], "2 RealSense cameras are connected: 111, 222"),
        ("111", ["111", "111"], "2 RealSense cameras with serial 111"),
    ],
)
def test_the_wrong_cameras_are_listed(serial: str, connected: list[str], message: str) -> None:
    devices = [device(each) for each in connected]
    with pytest.raises(CameraError, match=message) as caught:
        UsbSource(serial, lambda: devices).open()
    assert caught.value.remedy


def test_the_computer_s_own_usb_is_asked() -> None:
    with pytest.raises(
        CameraError, match=r"serial none-has-this-serial|no RealSense camera is connected"
    ):
        UsbSource("none-has-this-serial").open()


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"serial": "1", "source": {"factory": "a:B"}}, "only one of"),
        ({"min_depth_m": 2.0, "max_depth_m": 1.0}, "max_depth_m"),
        ({"filters": ["sharpen"]}, "spatial"),
        ({"fps": 0}, "fps"),
        ({"width": 640}, "unknown key"),
    ],
)
def test_options_that_cannot_be_are_refused(options: dict[str, Any], problem: str) -> None:
    with pytest.raises(RigError, match=problem):
        decode_table(options, RealSenseConfig, "rig.toml: sender.perception.camera")


# --- recording and playing back


def test_what_was_recorded_comes_back_through_the_same_driver(tmp_path: Path) -> None:
    async def record() -> dict[int, Frame]:
        feed, frames = Feed(), {}
        async with recording(feed, tmp_path) as driver:
            for _ in range(30):
                frame = await driver.read(PATIENCE_S)
                frames[frame.frame_id] = frame
        return frames

    async def play(file: Path) -> dict[int, Frame]:
        frames = {}
        driver = RealSense(RealSenseConfig(recording=file, fps=FPS), context())
        async with driver:
            with pytest.raises(CameraError, match=r"it has ended"):
                while True:
                    frame = await driver.read(PATIENCE_S)
                    frames[frame.frame_id] = frame
        return frames

    recorded = asyncio.run(record())
    (file,) = recordings(tmp_path)
    played, plays = asyncio.run(play(file)), 1
    # who is late gets the newest frame: few, if busy
    while len(set(recorded) & set(played)) < 20 and plays < PLAYS:
        played, plays = asyncio.run(play(file)), plays + 1
    both = sorted(set(recorded) & set(played))
    assert len(both) >= 20
    for number in both:
        np.testing.assert_array_equal(played[number].color, recorded[number].color)
        # The file keeps the rotation between the cameras as a rounded quaternion: half a millimetre
        # may fall elsewhere.
        depth_mm, before_mm = played[number].depth_mm, recorded[number].depth_mm
        assert depth_mm is not None and before_mm is not None
        np.testing.assert_allclose(depth_mm, before_mm, rtol=0.0, atol=1.0)
    steps = [[frames[n].stamp_ns for n in both] for frames in (played, recorded)]
    assert np.abs(np.diff(steps[0]) - np.diff(steps[1])).max() < 1 * MS


def recording(feed: Feed, folder: Path) -> Any:
    class Recording:
        async def __aenter__(self) -> RealSense:
            self._running = feed.running(rate_hz=FPS)
            self._running.__enter__()
            self._driver = camera(feed, record=str(folder))
            return await self._driver.__aenter__()

        async def __aexit__(self, *error: Any) -> None:
            await self._driver.__aexit__(*error)
            self._running.__exit__(*error)

    return Recording()


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "film.db3"
    file.write_bytes(b"not a recording")
    with pytest.raises(CameraError, match=r"film.db3 cannot be played"):
        RecordingSource(file).open()


class Told:
    """Stands before what a sensor or a recording is told, and keeps the order."""

    def __init__(self, inner: Any, name: str, told: list[str]) -> None:
        self._inner = inner
        self._name = name
        self._told = told

    def __getattr__(self, word: str) -> Any:
        self._told.append(f"{self._name} {word}")
        return getattr(self._inner, word)


def test_a_recording_stands_still_before_its_sensors_are_stopped(tmp_path: Path) -> None:
    """librealsense's thread would else give a frame to who is gone, and end the program."""

    async def record() -> None:
        async with recording(Feed(), tmp_path) as driver:
            await driver.read(PATIENCE_S)

    asyncio.run(record())
    (file,) = recordings(tmp_path)
    device = RealSenseDevice(
        load_recording(file), Streams((COLOR.width, COLOR.height), (DEPTH.width, DEPTH.height), FPS)
    )
    told: list[str] = []
    device._playback = Told(device._playback, "recording", told)
    device._running = [Told(sensor, "sensor", told) for sensor in device._running]
    device.close()
    assert told == ["recording pause", *["sensor stop", "sensor close"] * 2]

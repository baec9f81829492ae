"""The Tello's camera through djitellopy's reader, over real UDP: images that show when they were
taken.
"""

from __future__ import annotations

import asyncio
import math
import statistics
import threading
import time
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import CameraError, Capability, Frame
from drivers.tello.camera import TelloCamera, TelloCameraConfig
from drivers.tello.config import TelloVehicleConfig
from drivers.tello.vehicle import TelloVehicle
from tests.drivers.tello.tello_stand import (
    CAMERA,
    Stand,
    age_of,
    code_is_whole,
    context,
    emulated,
    time_code,
    until,
)
from tests.free_ports import free_port

RATE_HZ = 30.0
PATIENCE_S = 60.0
LATENCY_S = 0.25


def camera(stand: Stand, **options: Any) -> TelloCamera:
    return TelloCamera(
        TelloCameraConfig(**stand.address, latency_s=LATENCY_S, **options), context()
    )


def readers() -> list[str]:
    return [thread.name for thread in threading.enumerate() if "update_frame" in thread.name]


async def newest_only(seen: TelloCamera) -> None:
    age_s = math.inf
    async with asyncio.timeout(PATIENCE_S):
        # again where a busy machine was late: a queue would be late every time
        while age_s >= LATENCY_S + 0.15:
            skipped, come = seen.skipped, seen._count
            while seen._count < come + 10:  # noqa: ASYNC110 (a slow reader, and frames that come meanwhile)
                await asyncio.sleep(0.01)
            frame = await seen.read(PATIENCE_S)
            assert seen.skipped > skipped
            age_s = age_of(frame.color, time.monotonic_ns())


def test_frames_are_new_stamped_and_whole_and_their_end_is_told() -> None:
    async def film(stand: Stand) -> None:
        seen = camera(stand)
        with pytest.raises(CameraError, match="not open"):
            await seen.read(5.0)
        async with seen:
            assert Capability.RANGE in seen.lacks
            frames = [await seen.read(PATIENCE_S) for _ in range(30)]
            check_frames(frames)
            check_stamps(frames)
            await newest_only(seen)
            await damaged(stand, seen)
            await silent(stand, seen)
            waiting = asyncio.create_task(seen.read(10.0 * PATIENCE_S))
            await asyncio.sleep(0)
        with pytest.raises(CameraError, match="not open"):
            async with asyncio.timeout(PATIENCE_S):
                await waiting
        assert readers() == []
        assert stand.count("streamoff") == 1

    async def damaged(stand: Stand, seen: TelloCamera) -> None:
        """Frames that cannot be decoded are not given; one that is given may still be damaged, and
        most are not.
        """
        stand.video.corrupt = True
        end_s = time.monotonic() + PATIENCE_S
        while seen.damaged < 3:
            assert time.monotonic() < end_s, "no damage was ever found"
            try:
                await seen.read(0.2)
            except CameraError:
                continue
        stand.video.corrupt = False
        async with asyncio.timeout(PATIENCE_S):
            while not code_is_whole((await seen.read(PATIENCE_S)).color):
                pass

    async def silent(stand: Stand, seen: TelloCamera) -> None:
        stand.video.silent = True
        start_s = time.monotonic()
        with pytest.raises(
            CameraError, match=f"no video frame from {stand.address['host']} for 0.5 s"
        ):
            while time.monotonic() - start_s < PATIENCE_S:
                await seen.read(0.5)
        assert time.monotonic() - start_s < PATIENCE_S / 2.0

    with emulated(rate_hz=RATE_HZ) as stand:
        asyncio.run(film(stand))


def check_frames(frames: list[Frame]) -> None:
    assert all(frame.color.shape == (CAMERA.height, CAMERA.width, 3) for frame in frames)
    assert all(frame.depth_mm is None for frame in frames)
    assert all(b.frame_id > a.frame_id and b.stamp_ns > a.stamp_ns for a, b in pairwise(frames))
    assert all(code_is_whole(frame.color) for frame in frames)


def check_stamps(frames: list[Frame]) -> None:
    """By the code in the image: how far its stamp is off. The machine may be busy, but never
    early.
    """
    off_s = [age_of(frame.color, frame.stamp_ns + 4_000_000_000) - 4.0 for frame in frames]
    assert min(off_s) > -LATENCY_S
    assert statistics.median(off_s) < 0.5


def test_a_vehicle_joins_the_camera_s_connection_and_outlives_it() -> None:
    async def both(stand: Stand) -> None:
        async with TelloVehicle(TelloVehicleConfig(**stand.address), context()) as drone:
            async with camera(stand) as seen:
                await seen.read(PATIENCE_S)
            assert stand.count("command") == 1
            stamp_ns = drone.state.stamp_ns
            await until(lambda: drone.state.stamp_ns > stamp_ns)

    with emulated(rate_hz=RATE_HZ) as stand:
        asyncio.run(both(stand))


def test_no_video_at_all_is_told_within_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.tello.camera.PROBE_S", 0.5)

    async def film(stand: Stand) -> None:
        with pytest.raises(CameraError, match="no video on UDP port"):
            async with camera(stand):
                pass
        assert readers() == []

    with emulated() as stand:
        asyncio.run(film(stand))


def test_camera_and_vehicle_must_mean_the_same_ports() -> None:
    async def both(stand: Stand) -> None:
        other: dict[str, Any] = {**stand.address, "video_port": free_port()}
        async with TelloVehicle(TelloVehicleConfig(**stand.address), context()):
            with pytest.raises(CameraError, match="video_port"):
                async with TelloCamera(TelloCameraConfig(**other), context()):
                    pass

    with emulated() as stand:
        asyncio.run(both(stand))


def test_the_code_tells_its_age() -> None:
    image = time_code(5_000_000_000)
    assert age_of(image, 5_321_000_000) == pytest.approx(0.321)
    assert code_is_whole(image)
    assert not code_is_whole(np.full_like(image, 128))

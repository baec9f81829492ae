"""The rendered camera in virtual time: when frames come, that they are the world's, and that
nobody's are not drawn.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import CameraError, Frame
from drivers.rig.parts import Mount, Origin, PartContext
from flight.harness.renderer import Imaging
from hil.camera.capture import CaptureTiming, Freeze
from hil.camera.pending import Images
from hil.camera.rendered import RenderedCamera, RenderedCameraConfig
from hil.harness.virtual_time import run_virtual
from hil.render.renderer import Renderer
from hil.world.errors import Built
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role

CAMERA = CameraModel(96, 72, 90.0, 90.0, 47.5, 35.5)
LEVEL = Pose(np.eye(3), np.zeros(3))
LOOKING_DOWN = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.5]))
AWAY = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 9.0, 1.5]))
STILL = (0.0, 0.0, 0.0)


@dataclass
class DrivingWorld:
    """A car that drives east under the sender's camera at 0.5 m/s; ``looked`` are the instants it
    was looked at.
    """

    looked: list[float] = field(default_factory=list[float])

    def snapshot(self) -> Snapshot:
        now = asyncio.get_running_loop().time()
        self.looked.append(now)
        drones = {
            Role.SENDER: DroneTruth(LOOKING_DOWN, STILL, 0.0, True),
            Role.RECEIVER: DroneTruth(AWAY, STILL, 0.0, True),
        }
        return Snapshot(now, drones, (ObjectTruth(0, (-0.4 + 0.5 * now, 0.0, 0.0), 0.0, 0.5),))


@dataclass
class StubHarness:
    world: DrivingWorld = field(default_factory=DrivingWorld)
    seed: int = 3
    frozen_cameras: dict[Role, Freeze] = field(default_factory=dict[Role, Freeze])
    built: Built | None = None


class LoopClock:
    def now_ns(self) -> int:
        return round(asyncio.get_running_loop().time() * 1e9) + 1_000_000_000


def context(harness: object | None, role: Role = Role.SENDER) -> PartContext:
    mount = Mount(LEVEL, LEVEL)
    return PartContext(
        role, LoopClock(), CAMERA, mount, single_marker(), Origin(0.0, 0.0, 0.0), harness
    )


def with_camera(
    program: Callable[[RenderedCamera, StubHarness], Awaitable[None]],
    config: RenderedCameraConfig | None = None,
) -> StubHarness:
    harness = StubHarness()

    async def main() -> None:
        async with RenderedCamera(config or RenderedCameraConfig(), context(harness)) as camera:
            await program(camera, harness)

    run_virtual(main())
    return harness


def now() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.parametrize("latency_s", [0.0, 0.01, 0.05])
def test_frames_come_at_the_rate_with_stamps_of_their_capture(latency_s: float) -> None:
    async def program(camera: RenderedCamera, _: StubHarness) -> None:
        await asyncio.sleep(0.005)
        for k in range(1, 12):
            frame = await camera.read(1.0)
            assert frame.stamp_ns == pytest.approx(1_000_000_000 + k * 20_000_000, abs=2)
            assert now() == pytest.approx(0.02 * k + latency_s, abs=1e-6)
            assert frame.frame_id == k
        assert camera.skipped == 0

    with_camera(program, RenderedCameraConfig(rate_hz=50.0, latency_s=latency_s))


def test_the_picture_is_that_of_the_capture_not_of_the_delivery() -> None:
    async def program(camera: RenderedCamera, _: StubHarness) -> None:
        await asyncio.sleep(0.39)
        # taken at 0.4 s: x = -0.2 m; there at 0.9 s, when the car is at 0.05 m
        frame = await camera.read(1.0)
        assert now() == pytest.approx(0.9)
        orange = np.argwhere((frame.color[:, :, 2] > 120) & (frame.color[:, :, 0] < 80))
        along = -0.2 * 90.0 / 1.4  # body x (FRD, level and heading east) is camera x here
        assert abs(float(np.median(orange[:, 1])) - 47.5) == pytest.approx(abs(along), abs=3.0)
        assert frame.depth_mm is not None
        assert float(np.median(frame.depth_mm)) == pytest.approx(1500.0, abs=30.0)

    with_camera(program, RenderedCameraConfig(rate_hz=10.0, latency_s=0.5))


def test_frames_nobody_reads_are_neither_taken_nor_drawn() -> None:
    async def program(camera: RenderedCamera, _: StubHarness) -> None:
        await asyncio.sleep(10.0)
        for _k in range(3):
            await camera.read(1.0)
        await asyncio.sleep(10.0)
        frame = await camera.read(1.0)
        # not the one that lay there since 10 s ago
        assert now() - (frame.stamp_ns / 1e9 - 1.0) < 0.05

    harness = with_camera(program, RenderedCameraConfig(rate_hz=50.0, latency_s=0.03))
    assert len(harness.world.looked) <= 12


def test_what_is_read_and_not_looked_at_is_not_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[int] = []
    render = Renderer.render

    def counted(
        renderer: Renderer, snapshot: Snapshot, role: Role, frame_seed: int, *more: Any
    ) -> Images:
        drawn.append(frame_seed)
        return render(renderer, snapshot, role, frame_seed, *more)

    monkeypatch.setattr(Renderer, "render", counted)  # type: ignore[misc]
    looked: list[Frame] = []

    async def program(camera: RenderedCamera, _: StubHarness) -> None:
        frames = [await camera.read(1.0) for _k in range(30)]
        assert {frame.sizes["colour"] for frame in frames} == {(96, 72)}
        for frame in frames[::10]:
            assert frame.color.shape == (72, 96, 3)
        looked.extend(frames[::10])

    with_camera(program)
    assert {frame.frame_id for frame in looked} <= set(drawn)
    assert len(drawn) <= 6  # the first ones were drawn before anybody could look
    assert looked[0].color is looked[0].color


def test_a_slow_reader_gets_the_newest_and_the_rest_is_counted() -> None:
    async def program(camera: RenderedCamera, _: StubHarness) -> None:
        first = await camera.read(1.0)
        await asyncio.sleep(0.035)
        second = await camera.read(1.0)
        assert second.frame_id > first.frame_id
        assert now() - (second.stamp_ns / 1e9 - 1.0) <= 0.05
        assert camera.skipped <= second.frame_id - first.frame_id - 1

    with_camera(program, RenderedCameraConfig(rate_hz=50.0, latency_s=0.02))


def test_a_frozen_camera_is_an_error_after_the_bounded_wait() -> None:
    async def program(camera: RenderedCamera, harness: StubHarness) -> None:
        await camera.read(1.0)
        harness.frozen_cameras[Role.SENDER] = Freeze.SILENT
        start = now()
        with pytest.raises(
            CameraError, match=r"no frame from the sender.s rendered camera for 0\.5 s"
        ):
            for _ in range(3):  # what was under way still comes
                await camera.read(0.5)
        assert now() - start < 0.6
        del harness.frozen_cameras[Role.SENDER]
        await camera.read(0.5)

    with_camera(program)


def test_a_camera_stuck_on_its_last_frame_repeats_it() -> None:
    async def program(camera: RenderedCamera, harness: StubHarness) -> None:
        last = await camera.read(1.0)
        harness.frozen_cameras[Role.SENDER] = Freeze.REPEAT
        repeated = [await camera.read(1.0) for _ in range(4)]
        assert len({frame.stamp_ns for frame in repeated[1:]}) == 1
        assert repeated[-1].stamp_ns - last.stamp_ns <= 40_000_000

    with_camera(program)


def test_the_same_seed_draws_the_same_bytes() -> None:
    def frames() -> list[Frame]:
        taken: list[Frame] = []

        async def program(camera: RenderedCamera, _: StubHarness) -> None:
            taken.extend([await camera.read(1.0) for _ in range(3)])

        with_camera(program)
        return taken

    first, second = frames(), frames()
    for a, b in zip(first, second, strict=True):
        assert a.depth_mm is not None
        assert b.depth_mm is not None
        assert a.stamp_ns == b.stamp_ns
        assert a.color.tobytes() == b.color.tobytes()
        assert a.depth_mm.tobytes() == b.depth_mm.tobytes()
    assert first[0].color.tobytes() != first[1].color.tobytes()


def test_a_measured_cameras_imaging_makes_the_image_and_leaves_the_depth() -> None:
    def frame(imaging: Imaging | None) -> Frame:
        taken: list[Frame] = []

        async def program(camera: RenderedCamera, _: StubHarness) -> None:
            taken.append(await camera.read(1.0))

        with_camera(program, RenderedCameraConfig(imaging=imaging))
        return taken[0]

    plain, brighter = frame(None), frame(Imaging(gamma=2.2, sharpen=1.0, jpeg_quality=90))
    assert plain.depth_mm is not None and brighter.depth_mm is not None
    assert plain.depth_mm.tobytes() == brighter.depth_mm.tobytes()
    assert brighter.color.shape == plain.color.shape
    assert float(np.mean(brighter.color)) > 1.2 * float(np.mean(plain.color))
    assert (
        brighter.color.tobytes()
        == frame(Imaging(gamma=2.2, sharpen=1.0, jpeg_quality=90)).color.tobytes()
    )


def test_two_cameras_are_out_of_step_unless_told_otherwise() -> None:
    sender = RenderedCameraConfig(rate_hz=50.0).timing(context(None, Role.SENDER))
    receiver = RenderedCameraConfig(rate_hz=50.0).timing(context(None, Role.RECEIVER))
    assert math.remainder(sender.phase_s - receiver.phase_s, 0.02) != pytest.approx(0.0, abs=0.003)
    assert RenderedCameraConfig(phase_s=0.004).timing(context(None, Role.RECEIVER)).phase_s == 0.004


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(CameraError, match="simulated world"):
        RenderedCamera(RenderedCameraConfig(), context(None))
    with pytest.raises(ValueError, match="rate_hz"):
        RenderedCameraConfig(rate_hz=0.0)
    with pytest.raises(ValueError, match="latency_s"):
        CaptureTiming(latency_s=-0.1)

"""The contract of every Perception and its views.

On pixels with a depth stream and without, and on the world's geometry.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import numpy as np
import pytest

from drivers.interfaces import CameraError, Capability, Perception, lacking
from drivers.perception.pixels import PixelPerception, PixelPerceptionConfig
from drivers.rig.tables import decode_table
from hil.camera.capture import Freeze
from hil.harness.virtual_time import run_virtual
from path.messages import Role
from path.observations import Box, Region
from tests.hil.geometric.test_perception import (
    CAMERA,
    LoopClock,
    StubHarness,
    bounds,
    context,
    geometric_perception,
    moment,
    thing,
    values,
)


def pixel_perception(harness: StubHarness) -> Perception:
    table = {
        "camera": {
            "factory": "hil.camera.rendered:RenderedCamera",
            "rate_hz": 50.0,
            "latency_s": 0.0,
        },
        "detector": {"factory": "drivers.detectors.color:ColorDetector"},
    }
    return PixelPerception(
        decode_table(table, PixelPerceptionConfig, "rig.toml: sender.perception"), context(harness)
    )


def flat_perception(harness: StubHarness) -> Perception:
    """Its camera has no depth, as a Tello's."""
    table = {
        "camera": {"factory": "hil.tello.sim:SimTelloCamera", "rate_hz": 50.0, "latency_s": 0.0},
        "detector": {"factory": "drivers.detectors.color:ColorDetector"},
    }
    return PixelPerception(
        decode_table(table, PixelPerceptionConfig, "rig.toml: sender.perception"), context(harness)
    )


Make = Callable[[StubHarness], Perception]
SIGHTS = pytest.mark.parametrize("make", [geometric_perception, pixel_perception, flat_perception])


def with_perception(
    make: Make, program: Callable[[Perception, StubHarness], Awaitable[None]]
) -> None:
    harness = StubHarness()

    async def main() -> None:
        async with make(harness) as perception:
            await program(perception, harness)

    run_virtual(main())


@SIGHTS
def test_views_come_at_the_rate_with_increasing_stamps(make: Make) -> None:
    async def program(perception: Perception, _: StubHarness) -> None:
        views = [await perception.view(0.5) for _k in range(10)]
        stamps = [view.stamp_ns for view in views]
        assert np.diff(stamps).tolist() == pytest.approx([20_000_000] * 9, abs=2)
        assert np.diff([view.frame_id for view in views]).tolist() == [1] * 9
        assert perception.model is CAMERA

    with_perception(make, program)


@SIGHTS
def test_a_slow_reader_gets_a_view_no_older_than_a_frame(make: Make) -> None:
    async def program(perception: Perception, _: StubHarness) -> None:
        await perception.view(0.5)
        await asyncio.sleep(0.333)
        view = await perception.view(0.5)
        assert LoopClock().now_ns() - view.stamp_ns <= 20_000_000

    with_perception(make, program)


@SIGHTS
def test_a_silent_camera_is_an_error_in_the_time_given(make: Make) -> None:
    async def program(perception: Perception, harness: StubHarness) -> None:
        await perception.view(0.5)
        harness.frozen_cameras[Role.SENDER] = Freeze.SILENT
        start_ns = LoopClock().now_ns()
        with pytest.raises(CameraError, match=r"no frame from .* for 0\.5 s"):
            await perception.view(0.5)
        assert LoopClock().now_ns() - start_ns == pytest.approx(500_000_000, abs=1_000_000)
        harness.frozen_cameras.clear()
        await perception.view(0.5)

    with_perception(make, program)


@SIGHTS
def test_a_repeated_frame_is_never_given_twice(make: Make) -> None:
    async def program(perception: Perception, harness: StubHarness) -> None:
        await perception.view(0.5)
        harness.frozen_cameras[Role.SENDER] = Freeze.REPEAT
        with pytest.raises(CameraError):
            await perception.view(0.3)
        with pytest.raises(CameraError, match="no newer than the one before"):
            await perception.view(2.0)

    with_perception(make, program)


@SIGHTS
def test_a_view_answers_in_the_same_terms(make: Make) -> None:
    async def program(perception: Perception, _: StubHarness) -> None:
        view = await perception.view(0.5)
        (target,) = view.targets(None)
        assert values(target.box) == pytest.approx(
            bounds(moment(), Role.SENDER, thing(0, 0.1, 0.0)), abs=3.0
        )
        assert target.score > 0.6
        assert not view.markers(None)
        assert view.depth(Box(-50.0, -50.0, 10.0, 10.0)) is None  # not in the image
        assert not view.targets(Region(0.0, 0.0, 20.0, 20.0))
        image = view.image()
        assert image is None or image.shape == (480, 640, 3)

    with_perception(make, program)


@SIGHTS
def test_exactly_those_that_say_so_have_no_range(make: Make) -> None:
    async def program(perception: Perception, _: StubHarness) -> None:
        view = await perception.view(0.5)
        (target,) = view.targets(None)
        depth = view.depth(target.box)
        assert (depth is None) == (Capability.RANGE in lacking(perception))
        assert depth is None or depth.z_m == pytest.approx(2.0, abs=0.2)

    with_perception(make, program)


@SIGHTS
def test_a_view_answers_the_same_again_and_after_the_next_one_came(make: Make) -> None:
    async def program(perception: Perception, _: StubHarness) -> None:
        view = await perception.view(0.5)
        before = [values(each.box) for each in view.targets(None)], view.stamp_ns, view.frame_id
        for _k in range(3):
            await perception.view(0.5)
        assert (
            [values(each.box) for each in view.targets(None)],
            view.stamp_ns,
            view.frame_id,
        ) == before
        for region in (
            Region(-90.0, -90.0, -10.0, -10.0),
            Region(5.0, 5.0, 5.1, 5.1),
            Region(700.0, 500.0, 900.0, 600.0),
        ):
            assert not view.targets(region)
            assert not view.markers(region)

    with_perception(make, program)


@SIGHTS
def test_closing_twice_is_closing_once_and_it_opens_again(make: Make) -> None:
    async def main() -> None:
        perception = make(StubHarness())
        for _ in range(2):
            async with perception:
                await perception.view(0.5)
            await perception.__aexit__(None, None, None)

    run_virtual(main())


@SIGHTS
def test_nobody_waits_for_a_view_of_one_that_is_not_open(make: Make) -> None:
    async def main() -> None:
        perception = make(StubHarness())
        with pytest.raises(CameraError, match="not open") as caught:
            await perception.view(0.5)
        assert caught.value.remedy

    run_virtual(main())


@SIGHTS
def test_closing_ends_a_wait(make: Make) -> None:
    async def main() -> None:
        harness = StubHarness()
        async with make(harness) as perception:
            await perception.view(0.5)
            harness.frozen_cameras[Role.SENDER] = Freeze.SILENT
            waiting = asyncio.create_task(perception.view(2.0))
            await asyncio.sleep(0.1)
        with pytest.raises(CameraError):
            async with asyncio.timeout(3.0):
                await waiting

    run_virtual(main())

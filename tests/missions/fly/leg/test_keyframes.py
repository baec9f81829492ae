"""Keyframes from D1 to D2: sent in parts, matched with a frame of their instant, solved beside the
cycles.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import Frame
from drivers.rig.parts import Mount
from flight.config import MissionConfig
from flight.outcome import MissionEnd, Outcome
from flight.rendezvous.marker_view import MarkerView, VehicleMotions
from hil.harness.virtual_time import run_virtual
from missions.fly.leg.keyframes import STALE_S, CommonViews, KeyframesOut, check_depth
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import KeyframePart
from path.relative_pose.filter import Source
from tests.path.common_view.drawn import LENS, around, drawn, room

SECOND_NS = 1_000_000_000
METHOD = MethodConfig(common_view=True)
CONFIG = MissionConfig()
MOUNT = Mount(Pose(np.eye(3), np.zeros(3)), Pose(np.eye(3), np.array([0.0, 0.1, -0.2])))
ONE = around(0.0)
TWO = around(20.0)


class Bench:
    """Both drones in virtual time: nobody moves, and both look at one room."""

    def __init__(self) -> None:
        loop = asyncio.get_running_loop()
        camera = SimpleNamespace(camera=LENS, mount=MOUNT)
        self.sent: list[KeyframePart] = []
        self.records: list[dict[str, Any]] = []
        self.session: Any = SimpleNamespace(
            rig=SimpleNamespace(sender=camera, receiver=camera, method=METHOD),
            config=CONFIG,
            stages=None,
            link=SimpleNamespace(send=self.sent.append),
            log=SimpleNamespace(write=self._write),
            alignment=SimpleNamespace(ready=True, to_own_ns=int),
            now_ns=lambda: round(loop.time() * 1e9),
        )
        self.marker = MarkerView(single_marker(), LENS, MOUNT, METHOD, CONFIG)
        still = (0.0, 0.0, 0.0)
        for stamp_ns in (0, SECOND_NS):
            self.marker.note_motion(VehicleMotions(stamp_ns, still, stamp_ns, still, 0.0))
        self.marker.R_n_v = ONE[0] @ MOUNT.T_v_c.inverse().R
        self.views = CommonViews(self.session, self.marker)
        north, east, down = ONE[1].tolist()
        self.views.note_peer(SECOND_NS, (north, east, down), still)
        self.out = KeyframesOut(self.session)

    def _write(self, _topic: str, _stamp_ns: int, record: dict[str, Any]) -> None:
        self.records.append(record)

    def seen(self, by: tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]], stamp_ns: int) -> Any:
        grey, depth = drawn(room(1), *by, np.random.default_rng(stamp_ns % 97))
        color = np.repeat(grey[..., None], 3, axis=2)
        frame = Frame(stamp_ns, 1, color, np.asarray(1000.0 * depth, np.uint16))
        return Seen(frame)


class Seen:
    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self.stamp_ns = frame.stamp_ns


def played(main: Callable[[Bench], Coroutine[Any, Any, None]]) -> None:
    async def run() -> None:
        await main(Bench())

    run_virtual(run())


async def sent_by(bench: Bench, stamp_ns: int) -> list[KeyframePart]:
    """Return the parts of one keyframe of D1."""
    bench.sent.clear()
    sending = asyncio.create_task(bench.out.run())
    bench.out.offer(bench.seen(ONE, stamp_ns), ONE[0])
    await asyncio.sleep(2.5)
    sending.cancel()
    bench.out = KeyframesOut(bench.session)
    return list(bench.sent)


def test_two_common_views_are_a_pose_to_fly_by_and_say_that_they_carry_it() -> None:
    async def main(bench: Bench) -> None:
        solving = asyncio.create_task(bench.views.run())
        for part in await sent_by(bench, SECOND_NS):
            bench.views.hear(part)
        assert bench.records == []
        for tenths in (25, 26, 30):
            assert not bench.marker.found(3 * SECOND_NS)
            bench.views.look(bench.seen(TWO, tenths * SECOND_NS // 10), Pose(*TWO))
            await asyncio.sleep(0.2)
        solving.cancel()
        assert bench.marker.found(3 * SECOND_NS)
        assert [record["why"] for record in bench.records] == [None, None]
        assert [record["refused"] for record in bench.records] == [None, None]
        assert [record["age_s"] for record in bench.records] == [1.5, 2.0]
        fix = bench.marker.carried(3 * SECOND_NS, TWO[0])
        assert fix is not None
        assert fix.carried_by is Source.COMMON_VIEW
        true = Pose(*TWO).inverse() @ Pose(*ONE) @ MOUNT.T_v_c.inverse()
        assert np.linalg.norm(fix.T_c_v.t - true.t) < 0.05

    played(main)


def test_how_far_the_sender_has_flown_since_its_keyframe_is_added() -> None:
    async def main(bench: Bench) -> None:
        solving = asyncio.create_task(bench.views.run())
        for part in await sent_by(bench, SECOND_NS):
            bench.views.hear(part)
        north, east, down = ONE[1].tolist()
        bench.views.note_peer(3 * SECOND_NS, (north + 0.5, east - 0.2, down), (0.25, -0.1, 0.0))
        bench.views.look(bench.seen(TWO, 3 * SECOND_NS), Pose(*TWO))
        await asyncio.sleep(0.2)
        solving.cancel()
        (record,) = bench.records
        T_c_v = np.reshape(record["T_c_v"], (3, 4))
        flown = Pose(ONE[0], ONE[1] + np.array([0.5, -0.2, 0.0]))
        true = Pose(*TWO).inverse() @ flown @ MOUNT.T_v_c.inverse()
        assert np.linalg.norm(T_c_v[:, 3] - true.t) < 0.05

    played(main)


def test_parts_are_spread_evenly_and_a_frame_that_comes_too_early_is_left() -> None:
    async def main(bench: Bench) -> None:
        stamps: list[float] = []
        loop = asyncio.get_running_loop()

        def send(_: KeyframePart) -> None:
            stamps.append(loop.time())

        bench.session.link.send = send
        sending = asyncio.create_task(bench.out.run())
        bench.out.offer(bench.seen(ONE, 1), ONE[0])
        bench.out.offer(bench.seen(ONE, 2), ONE[0])
        await asyncio.sleep(5.0)
        sending.cancel()
        assert 150 <= len(stamps) <= 188
        assert np.diff(stamps).min() > 0.0108

    played(main)


def test_a_keyframe_that_is_stale_is_not_used_any_more() -> None:
    async def main(bench: Bench) -> None:
        solving = asyncio.create_task(bench.views.run())
        for part in await sent_by(bench, SECOND_NS):
            bench.views.hear(part)
        stamp_ns = SECOND_NS + round(STALE_S * 1e9) + 1
        bench.views.look(bench.seen(TWO, stamp_ns), Pose(*TWO))
        await asyncio.sleep(0.5)
        assert bench.records == []
        solving.cancel()

    played(main)


def test_what_is_left_of_a_keyframe_is_used_once_the_next_begins() -> None:
    async def main(bench: Bench) -> None:
        solving = asyncio.create_task(bench.views.run())
        for part in await sent_by(bench, SECOND_NS):
            if part.number % 4:
                bench.views.hear(part)
        bench.views.look(bench.seen(TWO, 2 * SECOND_NS), Pose(*TWO))
        await asyncio.sleep(0.5)
        assert bench.records == []
        bench.views.hear((await sent_by(bench, 2 * SECOND_NS))[0])
        bench.views.look(bench.seen(TWO, 2 * SECOND_NS), Pose(*TWO))
        await asyncio.sleep(0.5)
        assert [record["why"] for record in bench.records] == [None]
        solving.cancel()

    played(main)


def test_a_camera_without_depth_is_refused_before_take_off() -> None:
    session: Any = SimpleNamespace(
        rig=SimpleNamespace(method=METHOD), role=SimpleNamespace(value="receiver")
    )
    flat: Any = Seen(Frame(1, 1, np.zeros((4, 4, 3), np.uint8), None))
    views: list[Any] = [flat, SimpleNamespace(stamp_ns=1)]
    for view in views:
        with pytest.raises(MissionEnd, match="receiver's camera gives none") as caught:
            check_depth(session, view)
        assert caught.value.outcome is Outcome.UNFIT
    session.rig.method = MethodConfig()
    check_depth(session, flat)

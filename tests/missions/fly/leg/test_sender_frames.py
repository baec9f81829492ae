"""What D1 makes of one frame: found, followed, said, judged and logged; and where it flies for it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import VelocitySetpoint
from flight.camera_pose import CameraPose
from flight.config import GuardConfig, MissionConfig, TargetDesignation
from flight.guidance import Vec3, add, approach, from_heading, scale, spare_accel, subtract
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from flight.tracking.association import Sighting
from flight.tracking.ranging import Ground
from missions.fly.leg import sender as sender_file
from path.geometry.transforms import Matrix
from path.messages import Target
from path.observations import Box, Depth, Missed, MissReason
from tests.missions.fly.leg.session_bench import STATE, Bench, giving, noting
from tests.missions.fly.leg.test_receiver_frames import FakeView, Frames
from tests.missions.fly.leg.test_sender_alone import CONFIG, PEER, tracked, with_sender

MS = 1_000_000
LEVEL = np.eye(3)
SEEN = Sighting(Box(300.0, 200.0, 40.0, 30.0), Depth(2.0, 0.01))
MESSAGE = Target(1, 1, 1, 3, 5 * MS, (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 0.01)


def configured(sender: Any, **changes: Any) -> MissionConfig:
    """Have a sender fly by another mission."""
    config = replace(CONFIG, **changes)
    sender._config = sender._session.config = config
    sender._session.pilot.fence = config.fence
    return config


# --- which frames


def test_every_frame_is_a_look_until_there_is_a_target_and_a_cycle_from_then_on(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        session: Any = bench.session
        session.frames = Frames(session.now_ns, 4)
        session.frames.recorded = True
        session.phase = Phase.VERIFY
        done: list[tuple[str, int]] = []
        turned: list[float] = []

        def note(name: str) -> Callable[..., None]:
            def noted(view: FakeView, R_n_b: Matrix, *rest: object) -> None:
                assert R_n_b[0, 1] == view.stamp_ns
                assert rest in ((), ("a track",))
                done.append((name, view.frame_id))
                if name == "look" and view.frame_id == 2:
                    sender._track = "a track"

            return noted

        sender._log_view = note("log")
        sender._try_to_acquire = note("look")
        sender._cycle_once = note("cycle")
        sender._note_ground = lambda: done.append(("ground", 0))
        session.note_steps = lambda: done.append(("steps", 0))

        def tilt(R_n_b: Matrix) -> None:
            turned.append(R_n_b[0, 1])

        def R_n_b_at(stamp_ns: int) -> Matrix:
            return np.array([[0.0, stamp_ns]])

        sender._tilt = SimpleNamespace(note=tilt)
        sender._camera_pose = SimpleNamespace(R_n_b=R_n_b_at)
        watching = asyncio.create_task(sender._watch())
        await asyncio.sleep(0.2)
        watching.cancel()
        looks = [each for k in (1, 2) for each in (("log", k), ("look", k))]
        own = [each for each in done if each[1]]
        assert own == [*looks, ("cycle", 3), ("cycle", 4)]
        assert [name for name, _ in done[:4]] == ["ground", "steps", "log", "look"]
        assert len(turned) == 4
        assert session.frames.waits == [CONFIG.guard.frame_age_s] * 4

    with_sender(rig, main)


@pytest.mark.parametrize(
    ("peer_phase", "phase", "every"),
    [
        (None, Phase.FOLLOW, False),
        (Phase.STAND_OFF, Phase.FOLLOW, False),
        (Phase.SEARCH, Phase.FOLLOW, True),
        (Phase.STAND_OFF, Phase.VERIFY, True),
    ],
)
def test_while_the_receiver_is_far_some_frames_are_enough(
    rig: Any, peer_phase: Phase | None, phase: Phase, every: bool
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        session: Any = bench.session
        session.phase = phase
        session.frames = Frames(session.now_ns, 100)
        session.peer = None if peer_phase is None else replace(PEER, phase=int(peer_phase))
        sender._try_to_acquire = giving(None)
        sender._camera_pose = SimpleNamespace(R_n_b=giving(LEVEL))
        session.note_steps = sender._note_ground = lambda: None
        watching = asyncio.create_task(sender._watch())
        per_frame_s = 0.02 + (0.0 if every else 0.8 / CONFIG.follow_hz)
        await asyncio.sleep(5.5 * per_frame_s)
        assert len(session.frames.waits) in (5, 6)
        sender._watching = False
        await asyncio.sleep(2.0 * per_frame_s)
        assert watching.done()

    with_sender(rig, main)


@pytest.mark.parametrize(("known", "flies"), [(True, False), (False, False), (True, True)])
def test_the_ground_below_it_tells_how_far_away_is_what_stands_on_it(
    rig: Any, known: bool, flies: bool
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        session: Any = bench.session
        configured(sender, target=replace(CONFIG.target, flies=flies))
        noted: list[bool] = []
        session.note_ground = lambda: noted.append(True)
        ground = Ground(0.3, 0.1)
        session.ground = SimpleNamespace(ground=ground) if known else None
        before = sender._ranging.ground
        sender._note_ground()
        assert noted == [True]
        assert sender._ranging.ground == (ground if known and not flies else before)

    with_sender(rig, main)


def test_what_is_surely_the_target_is_followed_as_it_moves_and_from_where_it_was_seen(
    rig: Any,
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        looked: list[tuple[Any, Any]] = []
        taken: Any = None

        def look(view: object, T_n_c: object) -> Any:
            looked.append((view, T_n_c))
            return taken

        sender._designating = SimpleNamespace(look=look)
        session: Any = bench.session
        session.frames = Frames(session.now_ns, 0)
        view = FakeView(bench.session.now_ns())
        sender._try_to_acquire(view, LEVEL)
        assert sender._track is None
        taken = SimpleNamespace(position_n_m=(5.0, 4.0, -0.2), velocity_n_mps=(0.3, 0.1, 0.0))
        sender._look_round._round_rad = 0.1  # it has left its first heading
        sender._try_to_acquire(view, LEVEL)
        track: Any = sender._track
        assert (track.position_n_m, track.stamp_ns) == ((5.0, 4.0, -0.2), view.stamp_ns)
        assert track.velocity_n_mps == (0.3, 0.1, 0.0)
        assert track.ranging is sender._ranging and track.largest is sender._largest
        assert sender._heading_rad == pytest.approx(math.atan2(2.0, 4.0))
        pose = CameraPose(cast(Any, bench.session.vehicle), rig.sender.mount)
        np.testing.assert_array_equal(looked[0][1].t, pose.T_n_c(view.stamp_ns, LEVEL).t)
        assert looked[0][0] is view
        # whoever is asked which object is meant sees what D1 sees
        assert session.frames.logged == [view, view]

    with_sender(rig, main)


# --- one cycle


class Side:
    """An attempt of D1, and what it was asked."""

    def __init__(self) -> None:
        self.message: Any = MESSAGE
        self.pairs: list[str] = []
        self.complete = False
        self.observed: list[tuple[object, ...]] = []
        self.judged: list[int] = []

    @property
    def gate(self) -> Any:
        return SimpleNamespace(complete=self.complete)

    def observe(self, *args: object) -> Any:
        self.observed.append(args)
        return SimpleNamespace(message=self.message)

    def judge(self, now_ns: int) -> list[str]:
        self.judged.append(now_ns)
        return self.pairs


class Cycling:
    """A sender that follows what it is told that it sees."""

    def __init__(self, bench: Bench, sender: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sender = sender
        self.seen: Any = SEEN
        self.followed: list[tuple[Any, ...]] = []
        self.noted: list[tuple[object, ...]] = []
        self.kept: list[tuple[object, bool]] = []
        self.agreed: list[int] = []
        self.track = sender._track = tracked()
        self.view = FakeView(self.track.stamp_ns + 20 * MS)
        sender._handover = SimpleNamespace(
            handed_over=False, released=False, agreed=self.agreed.append
        )
        sender._note_pair = noting(self.noted)
        cast(Any, bench.session.frames).log_image = self._keep
        monkeypatch.setattr(sender_file, "follow", self._follow)
        monkeypatch.setattr(sender_file, "target_record", self._record)

    def _record(self, _frame: object, now_ns: int) -> dict[str, int]:
        return {"at": now_ns}

    def _keep(self, view: object, wanted: bool = False) -> None:
        self.kept.append((view, wanted))

    def _follow(self, *args: Any) -> Any:
        self.followed.append(args)
        return self.seen

    def once(self) -> None:
        self.sender._cycle_once(self.view, LEVEL, self.track)


def test_before_there_is_an_attempt_a_frame_is_followed_and_logged(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        cycle = Cycling(bench, sender, monkeypatch)
        cycle.once()
        view, T_n_c, camera, track = cycle.followed[0]
        assert (view, camera, track) == (cycle.view, rig.sender.camera, cycle.track)
        pose = CameraPose(cast(Any, bench.session.vehicle), rig.sender.mount)
        np.testing.assert_array_equal(T_n_c.t, pose.T_n_c(cycle.view.stamp_ns, LEVEL).t)
        topics = [(topic, stamp_ns) for topic, stamp_ns, _ in bench.log.entries]
        assert topics == [("/frame", cycle.view.stamp_ns), ("/track", cycle.view.stamp_ns)]
        assert bench.log.of("/track")[0]["box"] == [300.0, 200.0, 40.0, 30.0]
        assert bench.link.sent == [] and cycle.kept == []

    with_sender(rig, main)


def test_in_an_attempt_a_frame_is_said_and_the_answers_are_judged(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        cycle = Cycling(bench, sender, monkeypatch)
        side = sender._side = Side()
        side.pairs = ["one", "other"]
        cycle.once()
        now_ns = bench.session.now_ns()
        gravity_v = sender._camera_pose.gravity_v(LEVEL)
        assert side.observed == [(3, cycle.view.stamp_ns, SEEN, gravity_v)]
        assert [message for _, message in bench.link.sent] == [MESSAGE]
        assert side.judged == [now_ns] and cycle.noted == [("one", side), ("other", side)]
        topics = [(topic, stamp_ns) for topic, stamp_ns, _ in bench.log.entries]
        assert topics == [("/frame", cycle.view.stamp_ns), ("/target", cycle.view.stamp_ns)]
        assert bench.log.of("/target") == [{"at": now_ns}]
        assert cycle.kept == [(cycle.view, False)] and cycle.agreed == []
        side.message = Missed(MissReason.NO_TARGET)
        cycle.once()
        assert len(bench.link.sent) == 1

    with_sender(rig, main)


@pytest.mark.parametrize(("complete", "released"), [(True, False), (True, True), (False, False)])
def test_what_agreed_long_enough_is_handed_over_once_with_its_picture(
    rig: Any, complete: bool, released: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        cycle = Cycling(bench, sender, monkeypatch)
        sender._side = Side()
        sender._side.complete = complete
        sender._handover.released = released
        cycle.once()
        agrees = complete and not released
        assert cycle.agreed == [CONFIG.target_id] * agrees
        assert ((cycle.view, True) in cycle.kept) is agrees

    with_sender(rig, main)


@pytest.mark.parametrize("handed_over", [False, True])
def test_a_target_that_is_unseen_for_longer_than_can_be_borne_is_lost_until_it_is_given_away(
    rig: Any, handed_over: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        cycle = Cycling(bench, sender, monkeypatch)
        sender._handover.handed_over = handed_over
        bearable_s = CONFIG.deadlines.target_coast_s + CONFIG.deadlines.target_regain_s
        cycle.view.stamp_ns = cycle.track.stamp_ns + round(bearable_s * 1e9)
        cycle.once()
        cycle.view.stamp_ns += MS
        if handed_over:
            cycle.once()
            return
        with pytest.raises(MissionEnd) as caught:
            cycle.once()
        end = caught.value
        assert end.outcome is Outcome.TARGET_LOST
        assert end.detail == f"target not seen for {bearable_s:.1f} s"

    with_sender(rig, main)


@pytest.mark.parametrize(("level", "sees"), [(True, True), (True, False), (False, True)])
def test_on_level_ground_the_target_tells_how_high_the_drone_is(
    rig: Any, level: bool, sees: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        configured(sender, level_ground=level)
        cycle = Cycling(bench, sender, monkeypatch)
        cycle.seen = SEEN if sees else MissReason.NO_TARGET
        off_m = cycle.track.position_n_m[2] + CONFIG.target.height_m
        cycle.once()
        told = level and sees
        assert bench.session.off_n_m[2] == (pytest.approx(off_m) if told else 0.0)
        assert off_m != 0.0

    with_sender(rig, main)


@pytest.mark.parametrize("recorded", [False, True])
def test_a_frame_s_record_has_the_camera_s_pose_where_frames_are_recorded(
    rig: Any, recorded: bool
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        session: Any = bench.session
        session.frames = SimpleNamespace(recorded=recorded)
        sender._ranging.ground = Ground(0.3, 0.1)
        view = FakeView(session.now_ns() - 3 * MS)
        sender._log_view(view, LEVEL)
        (record,) = bench.log.of("/frame")
        assert (record["frame_id"], record["age_ns"]) == (3, 3 * MS)
        assert record["ground_down_m"] == 0.3
        assert ("T_n_c" in record) is recorded

    with_sender(rig, main)


def test_a_verdict_is_logged_and_shown(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        asked: list[tuple[object, ...]] = []

        def count(*args: object) -> tuple[int, str]:
            asked.append(args)
            return 7, "evidence"

        monkeypatch.setattr(sender_file, "counted", count)
        pair = SimpleNamespace(verdict=SimpleNamespace(iou=0.8))
        side = SimpleNamespace(gate="a gate", record=giving({"number": 3}))
        sender._note_pair(pair, side)
        shown: Any = bench.session.shown
        assert (shown.count, shown.evidence, shown.iou) == (7, "evidence", 0.8)
        assert asked == [(pair, "a gate")]
        assert bench.log.of("/agreement") == [{"number": 3}]
        assert bench.log.entries[-1][1] == bench.session.now_ns()

    with_sender(rig, main)


# --- where it flies


def behind(target: Vec3, heading_rad: float, wider: float = 1.0) -> Vec3:
    below_m = CONFIG.follow.height_m - CONFIG.target.height_m
    back = from_heading((-CONFIG.follow.behind_m, 0.0, -below_m), heading_rad)
    return add(target, scale(back, wider))


@pytest.mark.parametrize(
    ("wider", "regains", "times"),
    [(1.0, False, 1.0), (1.2, False, 1.2), (1.0, True, 1.4), (2.0, True, 2.0)],
)
def test_it_looks_at_its_target_from_behind_and_above_and_from_farther_off_to_see_it_again(
    rig: Any, wider: float, regains: bool, times: float
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        configured(sender, guard=replace(CONFIG.guard, fence_height_m=50.0))
        sender._regaining = giving(regains)
        sender._heading_rad = 0.7
        place = sender._view_of((6.0, 2.0, -0.1), wider)
        assert place == pytest.approx(behind((6.0, 2.0, -0.1), 0.7, times))

    with_sender(rig, main)


def test_a_drone_that_the_wind_tilts_stands_aside(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        asked: list[tuple[object, ...]] = []

        def aim(*args: object) -> Vec3:
            asked.append(args)
            return 0.1, -0.2, 0.0

        sender._tilt = SimpleNamespace(aim=aim)
        sender._heading_rad = 0.7
        place = sender._view_of((6.0, 2.0, 0.0))
        expected = add(behind((6.0, 2.0, 0.0), 0.7), (0.1, -0.2, 0.0))
        assert place == pytest.approx(expected)
        below_m = CONFIG.follow.height_m - CONFIG.target.height_m
        axis = tuple(rig.sender.mount.T_b_c.R[:, 2].tolist())
        assert asked == [(axis, 0.7, pytest.approx(below_m))]

    with_sender(rig, main)


def test_it_stays_within_the_edges_of_its_site(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        corners = ((0.0, -2.0), (3.0, -2.0), (3.0, 2.0), (0.0, 2.0))
        config = configured(sender, guard=GuardConfig(corners_m=corners))
        target = (9.0, 0.0, 0.0)
        sender._heading_rad = 0.0
        free = behind(target, 0.0)
        assert sender._view_of(target) == config.fence.nearest(free) != free

    with_sender(rig, main)


def test_it_comes_to_rest_where_it_goes_with_what_its_target_leaves_it(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        sender._heading_rad = 0.7
        place, moves = (4.0, 1.0, -2.0), (0.5, 0.2, 0.0)
        follow = CONFIG.follow
        spare_mps2 = spare_accel(
            CONFIG.max_accel_mps2, math.hypot(*moves), follow.target_accel_mps2, follow.response_s
        )
        error = subtract(place, STATE.position_n_m)
        velocity = approach(error, STATE.velocity_n_mps, moves, follow.answer(spare_mps2))
        assert sender._approach(place, moves, STATE) == VelocitySetpoint(velocity, 0.7)

    with_sender(rig, main)


@pytest.mark.parametrize("found", [False, True])
def test_until_there_is_a_target_it_goes_to_where_it_can_be_seen_and_round_it(
    rig: Any, found: bool
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        there = (5.0, 1.0, 0.0)
        asked: list[int] = []

        def where(now_ns: int) -> tuple[Vec3, float]:
            asked.append(now_ns)
            return there, 1.5

        def moves(now_ns: int) -> Vec3:
            asked.append(now_ns)
            return 0.1, 0.0, 0.0

        steps: list[tuple[Any, ...]] = []

        def yaw(*at: object) -> object:
            return at

        round_ = SimpleNamespace(
            going=False, heading_rad=0.9, velocity_n_mps=(0.0, 0.3, 0.0), yaw_rad=yaw
        )

        def step(*args: Any) -> None:
            steps.append(args)
            round_.going = True

        round_.step = step
        sender._look_round = round_
        sender._designating = SimpleNamespace(where=where, moves=moves)
        sender._track = tracked() if found else None
        sender._regaining = giving(False)
        before_rad = sender._heading_rad
        first = sender._view_of(there, 1.5)
        setpoint = sender._to_first_place(STATE)
        now_ns = bench.session.now_ns()
        assert asked == [now_ns, now_ns]
        if found:
            assert steps == [] and sender._heading_rad == before_rad
        else:
            off_m = math.dist(first, STATE.position_n_m)
            assert steps == [(now_ns, pytest.approx(off_m), there)]
            assert sender._heading_rad == 0.9
        place = sender._view_of(there, 1.5)
        expected = sender._approach(place, (0.1, 0.3, 0.0), STATE)
        assert setpoint.velocity_n_mps == expected.velocity_n_mps
        assert setpoint.yaw_rad == (STATE.position_n_m, there)
        told = [] if found else [{"note": "nothing was found from here: looks from other sides"}]
        assert bench.log.of("/note") == told
        sender._to_first_place(STATE)  # it is told once
        assert bench.log.of("/note") == told

    with_sender(rig, main)


@pytest.mark.parametrize("flies", [False, True])
def test_what_it_follows_is_settled_by_how_far_off_and_how_fast_beside_it_it_is(
    rig: Any, flies: bool
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        configured(sender, target=replace(TargetDesignation(), flies=flies))
        sender._track = tracked()
        settled: list[tuple[float, float]] = []
        sender._look_round = SimpleNamespace(settle=noting(settled), yaw_rad=giving(0.4))
        target, (north, east, down) = sender._track.believed(bench.session.now_ns())
        moves = (north, east, down if flies else 0.0)
        place = sender._view_of(target)
        setpoint = sender._follow_target(STATE)
        off_m = math.dist(place, STATE.position_n_m)
        assert settled == [(off_m, math.dist(STATE.velocity_n_mps, moves))]
        assert setpoint.velocity_n_mps == sender._approach(place, moves, STATE).velocity_n_mps
        assert down != 0.0 and setpoint.yaw_rad == 0.4

    with_sender(rig, main)


# --- the whole course


def test_the_course_is_flown_step_by_step_from_its_home(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        done: list[tuple[object, ...]] = []

        def step(*name: object) -> Any:
            async def do(*args: object) -> None:
                done.append((*name, *args))

            return do

        session = bench.session
        monkeypatch.setattr(sender_file, "preflight", step("preflight"))
        monkeypatch.setattr(sender_file, "take_off", step("take off"))
        sender._handover = SimpleNamespace(resume=step("resume"), until_free=step("free"))
        sender.acquire, sender.hand_over = step("acquire"), step("hand over")
        home: list[object] = []
        cast(Any, session).note_home = home.append
        await sender.course()
        height_m = CONFIG.take_off_height_m
        assert done == [
            ("resume",),
            ("preflight", session),
            ("free",),
            ("take off", session, height_m),
            ("acquire",),
            ("hand over",),
        ]
        assert home == [CONFIG.target.home_m]

    with_sender(rig, main)


def test_whatever_ends_it_the_hand_over_hears_of_it_first_and_is_finished_last(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        done: list[object] = []
        end = MissionEnd(Outcome.TARGET_LOST, "x")

        async def come_down(*args: object) -> bool:
            done.append(args)
            return True

        async def finish() -> None:
            done.append("finished")

        sender._come_down = come_down
        sender._handover = SimpleNamespace(end=done.append, finish=finish)
        assert await sender.recover(end)
        assert done == [end, (end, sender._leave()), "finished"]
        assert sender._leaving

    with_sender(rig, main)

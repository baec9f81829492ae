"""What D2 makes of one frame: which cycle, what is looked at, sent and logged, and when it is over."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from flight.camera_pose import CameraPose
from flight.config import MissionConfig
from flight.guidance import subtract
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from flight.rendezvous.viewpoint import NoViewpoint
from flight.tracking.places import place
from missions.fly.leg import receiver as receiver_file
from path.geometry.transforms import Matrix, Pose
from path.messages import Candidate
from path.observations import Box, Depth, Missed, MissReason
from tests.missions.fly.leg.session_bench import STATE, Bench, giving, noting
from tests.missions.fly.leg.test_receiver_alone import CONFIG, PEER, TARGET, tracked, with_receiver

MS = 1_000_000
BOX = Box(300.0, 200.0, 40.0, 30.0)
LEVEL = np.eye(3)


@dataclass
class FakeView:
    stamp_ns: int = 5 * MS
    frame_id: int = 3
    pixels: Any = None
    asked: list[object] = field(default_factory=list[object])

    def image(self) -> Any:
        return self.pixels

    def depth(self, box: Box) -> Depth:
        self.asked.append(box)
        return Depth(2.0, 0.01)


class Frames:
    """Frames that come one after the other; what was logged of them."""

    def __init__(self, clock: Any, count: int = 3) -> None:
        self._clock = clock
        self.left = count
        self.waits: list[float] = []
        self.logged: list[FakeView] = []
        self.recorded = False

    async def view(self, timeout_s: float) -> FakeView:
        await asyncio.sleep(0.02)
        if not self.left:
            await asyncio.sleep(1e6)
        self.left -= 1
        self.waits.append(timeout_s)
        return FakeView(self._clock() - 4 * MS, frame_id=len(self.waits))

    def log_image(self, view: Any, wanted: bool = False) -> None:
        self.logged.append(view)


@pytest.mark.parametrize("holds", [False, True])
def test_frames_are_cycled_until_the_target_is_held_and_followed_from_then_on(
    rig: Any, holds: bool
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        session: Any = bench.session
        session.frames = Frames(session.now_ns)
        cycled: list[tuple[int, float]] = []
        followed: list[tuple[int, float]] = []
        tilts: list[Matrix] = []

        def note(into: list[tuple[int, float]]) -> Any:
            def noted(view: FakeView, R_n_b: Matrix) -> None:
                into.append((view.frame_id, R_n_b[0, 1]))

            return noted

        def R_n_b(stamp_ns: int) -> Matrix:
            return np.array([[0.0, stamp_ns, 0.0]])

        receiver._cycle_once = note(cycled)
        receiver._follow_once = note(followed)
        receiver._camera_pose = SimpleNamespace(R_n_b=R_n_b)
        receiver._rendezvous = SimpleNamespace(tilt=SimpleNamespace(note=tilts.append))
        receiver._handover = SimpleNamespace(holds=holds)
        watching = asyncio.create_task(receiver._watch())
        await asyncio.sleep(0.2)
        watching.cancel()
        records = bench.log.of("/frame")
        assert [record["frame_id"] for record in records] == [1, 2, 3]
        assert [record["age_ns"] for record in records] == [4 * MS] * 3
        stamps = [stamp_ns for topic, stamp_ns, _ in bench.log.entries if topic == "/frame"]
        assert [number for number, _ in (followed if holds else cycled)] == [1, 2, 3]
        assert [stamp_ns for _, stamp_ns in (followed if holds else cycled)] == stamps
        assert (cycled if holds else followed) == []
        assert [turned[0, 1] for turned in tilts] == stamps
        assert [view.frame_id for view in session.frames.logged] == [1, 2, 3]
        assert receiver._seen is session.frames.logged[-1]
        assert session.frames.waits == [CONFIG.guard.frame_age_s] * 3

    with_receiver(rig, main)


@pytest.mark.parametrize(("phase", "frames"), [(Phase.FOLLOW, 4), (Phase.VERIFY, 20)])
def test_once_the_target_is_followed_some_frames_are_enough(
    rig: Any, phase: Phase, frames: int
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        session: Any = bench.session
        session.phase = phase
        session.frames = Frames(session.now_ns, 20)
        receiver._cycle_once = receiver._follow_once = giving(None)
        receiver._camera_pose = SimpleNamespace(R_n_b=giving(LEVEL))
        watching = asyncio.create_task(receiver._watch())
        per_frame_s = 0.02 + (0.8 / CONFIG.follow_hz if phase is Phase.FOLLOW else 0.0)
        await asyncio.sleep((frames - 0.5) * per_frame_s)
        assert len(session.frames.waits) in (frames - 1, frames)
        receiver._watching = False
        await asyncio.sleep(2.0 * per_frame_s)
        assert watching.done()

    with_receiver(rig, main)


class Side:
    """An attempt of D2 in which each answer can be set."""

    def __init__(self) -> None:
        self.expects: Any = Missed(MissReason.NO_MARKER)
        self.answers: Any = None
        self.asked: list[tuple[object, ...]] = []

    def gravity_v(self, stamp_ns: int) -> object:
        return ("gravity", stamp_ns)

    def prior(self, fix: object, stamp_ns: int) -> Any:
        self.asked.append((fix, stamp_ns))
        return self.expects

    def look(self, view: object, prior: object) -> Any:
        self.asked.append((view, prior))
        return self.answers


ANSWER = Candidate(1, 1, 1, 3, 1, 5 * MS, BOX, None, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.01)


class Cycling:
    """A receiver with such an attempt, on a marker that gives what it is told to."""

    def __init__(self, bench: Bench, receiver: Any) -> None:
        self.bench = bench
        self.receiver = receiver
        self.side = receiver._side = Side()
        self.motions: list[object] = []
        self.targets: list[object] = []
        self.judged: list[int] = []
        self.looks: list[tuple[object, ...]] = []
        self.fix: Any = Missed(MissReason.NO_MARKER, cause="another id")
        receiver._marker = SimpleNamespace(
            note_motion=self.motions.append, R_n_v=None, note_target=self._note_target
        )
        receiver._judge_marker = self.judged.append
        receiver._look = self._look
        receiver._camera_pose = SimpleNamespace(T_n_c=self._pose)

    def _pose(self, stamp_ns: int, R_n_b: Matrix) -> Pose:
        return Pose(R_n_b, np.array([0.0, 0.0, stamp_ns]))

    def _note_target(self, prior: object, R_n_c: Matrix) -> None:
        self.targets.append((prior, R_n_c.tolist()))

    def _look(self, view: object, R_n_c: Matrix, gravity_v: object) -> Any:
        self.looks.append((view, R_n_c.tolist(), gravity_v))
        return self.fix


def test_before_an_attempt_a_frame_is_nothing(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        receiver._look = None
        receiver._cycle_once(FakeView(), LEVEL)
        assert bench.log.entries == []

    with_receiver(rig, main)


def test_without_the_marker_a_frame_says_why_and_is_answered_with_it_while_they_verify(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        cycle = Cycling(bench, receiver)
        view = FakeView()
        receiver._cycle_once(view, LEVEL)
        assert cycle.looks == [(view, LEVEL.tolist(), ("gravity", 5 * MS))]
        assert cycle.motions == [receiver._motion()] and cycle.judged == [5 * MS]
        assert cycle.side.asked == [(cycle.fix, 5 * MS)] and cycle.targets == []
        topics = [(topic, stamp_ns) for topic, stamp_ns, _ in bench.log.entries]
        assert ("/marker", 5 * MS) in topics and ("/motion", 5 * MS) in topics
        assert bench.log.of("/marker")[0]["reason"] == MissReason.NO_MARKER.value
        assert bench.log.of("/note") == [{"note": "the sender's marker: another id"}]
        assert bench.link.sent == []
        bench.session.phase = Phase.VERIFY
        receiver._cycle_once(view, LEVEL)  # the frame was answered already
        assert bench.link.sent == [] and cycle.side.asked[-1] == (view, cycle.side.expects)
        missed = cast(Any, SimpleNamespace(box=None))
        cycle.side.answers = SimpleNamespace(candidate=missed)
        monkeypatch.setattr(receiver_file, "candidate_record", vars)
        receiver._note_found = None
        receiver._cycle_once(view, LEVEL)
        assert [message for _, message in bench.link.sent] == [missed]
        assert bench.log.entries[-1][:2] == ("/candidate", 5 * MS)

    with_receiver(rig, main)


@pytest.mark.parametrize("box", [BOX, None])
def test_what_is_found_where_the_marker_puts_the_target_is_located_too(
    rig: Any, box: Box | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    @dataclass
    class Prior:
        pass

    @dataclass
    class Fix:
        pass

    async def main(bench: Bench, receiver: Any) -> None:
        monkeypatch.setattr(receiver_file, "Prior", Prior)
        monkeypatch.setattr(receiver_file, "MarkerFix", Fix)
        for name in ("marker_record", "motion_record", "candidate_record"):
            monkeypatch.setattr(receiver_file, name, giving({}))
        cycle = Cycling(bench, receiver)
        cycle.fix, cycle.side.expects = Fix(), Prior()
        answer = SimpleNamespace(box=box)
        cycle.side.answers = SimpleNamespace(candidate=answer)
        checked: list[tuple[object, ...]] = []
        found: list[tuple[Any, ...]] = []
        receiver._check_size = noting(checked)
        receiver._note_found = noting(found)
        bench.session.phase = Phase.VERIFY
        view = FakeView()
        receiver._cycle_once(view, LEVEL)
        assert checked == [(view, cycle.fix)] and bench.log.of("/note") == []
        assert cycle.targets == [(cycle.side.expects, LEVEL.tolist())]
        assert cycle.side.asked == [(cycle.fix, 5 * MS), (view, cycle.side.expects)]
        assert [message for _, message in bench.link.sent] == [answer]
        if box is None:
            assert found == []
            return
        ((seen, T_n_c, candidate, prior, fix),) = found
        assert (seen, candidate, prior, fix) == (view, answer, cycle.side.expects, cycle.fix)
        assert T_n_c.t.tolist() == [0.0, 0.0, 5 * MS]

    with_receiver(rig, main)


def test_its_own_track_begins_with_the_first_place_and_goes_on_with_the_next(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        asked: list[tuple[Any, ...]] = []
        both = SimpleNamespace(depth=Depth(2.0, 0.01))

        def by_both(*args: Any) -> Any:
            asked.append(args)
            return both

        monkeypatch.setattr(receiver_file, "both_record", giving({}))
        receiver._by_both = SimpleNamespace(place=by_both)
        receiver._newest = TARGET
        view, prior = FakeView(bench.session.now_ns()), object()
        fix: Any = SimpleNamespace(covariance="covariance")
        # it looks 30 degrees down
        T_n_c = Pose(
            np.array([[0.0, -0.5, 0.866], [1.0, 0.0, 0.0], [0.0, 0.866, 0.5]]),
            np.array([1.0, 2.0, -3.0]),
        )
        receiver._note_found(view, T_n_c, ANSWER, prior, fix)
        expected = place(BOX, both.depth, receiver._camera, T_n_c, -CONFIG.target.height_m)
        assert receiver._track.position_n_m == expected
        assert receiver._track.stamp_ns == view.stamp_ns
        assert asked == [
            (prior, TARGET.sigma_m, "covariance", (0.0, 0.866, 0.5), BOX, Depth(2.0, 0.01))
        ]
        assert view.asked == [BOX]
        assert bench.log.entries[-1][:2] == ("/both_views", view.stamp_ns)
        track = receiver._track
        both.depth = Depth(2.2, 0.01)
        later = FakeView(view.stamp_ns + 20 * MS)
        receiver._note_found(later, T_n_c, ANSWER, prior, fix)
        assert receiver._track is track and track.stamp_ns == later.stamp_ns
        assert track.position_n_m != expected

    with_receiver(rig, main)


@pytest.mark.parametrize("contradicts", [False, True])
def test_a_marker_whose_size_depth_contradicts_ends_the_flight(rig: Any, contradicts: bool) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        looks: list[tuple[object, ...]] = []
        receiver._size = SimpleNamespace(
            look=noting(looks),
            contradiction=giving("40 mm by depth" if contradicts else None),
        )
        view = FakeView()
        fix: Any = SimpleNamespace(T_c_v="pose", covariance="covariance", detections="corners")
        if contradicts:
            with pytest.raises(MissionEnd) as caught:
                receiver._check_size(view, fix)
            end = caught.value
            assert (end.outcome, end.detail) == (Outcome.MARKER_SIZE, "40 mm by depth")
        else:
            receiver._check_size(view, fix)
        assert looks == [("pose", "covariance", "corners", view.depth)]

    with_receiver(rig, main)


@pytest.mark.parametrize(
    ("searched", "pixels", "instead", "told"),
    [
        (False, True, "a marker of another id", False),
        (True, False, "a marker of another id", False),
        (True, True, None, False),
        (True, True, "a marker of another id", True),
    ],
)
def test_on_the_ground_it_says_what_was_seen_in_place_of_the_marker(
    rig: Any,
    searched: bool,
    pixels: bool,
    instead: str | None,
    told: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        looked: list[tuple[object, ...]] = []

        def seen_instead(image: Any, layout: object) -> str | None:
            looked.append((image.shape, layout))
            return instead

        monkeypatch.setattr(receiver_file, "seen_instead", seen_instead)
        image = np.zeros((4, 6, 3), np.uint8) if pixels else None
        receiver._searched = FakeView(7 * MS, pixels=image) if searched else None
        receiver._say_instead()
        assert looked == ([((4, 6), rig.layout)] if searched and pixels else [])
        said = bench.log.of("/note")
        assert said == ([{"note": "the sender's marker: a marker of another id"}] if told else [])
        marked = [(topic, stamp_ns) for topic, stamp_ns, _ in bench.log.entries]
        assert (("/marker", 7 * MS) in marked) is told
        if told:
            assert bench.log.of("/marker")[0]["cause"] == instead

    with_receiver(rig, main)


@pytest.mark.parametrize(
    ("outcome", "landed", "says"),
    [
        (Outcome.MARKER_NOT_FOUND, True, True),
        (Outcome.MARKER_NOT_FOUND, False, False),
        (Outcome.MARKER_LOST, True, False),
        (None, True, False),
    ],
)
def test_what_was_seen_instead_is_looked_for_once_it_is_down(
    rig: Any, outcome: Outcome | None, landed: bool, says: bool
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        done: list[str] = []

        async def come_down(*_: object) -> bool:
            done.append("down")
            return landed

        async def finish() -> None:
            done.append("finished")

        receiver._come_down = come_down

        def hear(_end: object) -> None:
            done.append("end")

        receiver._handover = SimpleNamespace(end=hear, finish=finish)
        receiver._say_instead = lambda: done.append("instead")
        end = None if outcome is None else MissionEnd(outcome, "x")
        assert await receiver.recover(end) is landed
        assert done == ["end", "down", "finished", *["instead"] * says]

    with_receiver(rig, main)


# --- following


@pytest.mark.parametrize(
    ("phase", "controls", "begins"),
    [(Phase.FOLLOW, True, True), (Phase.FOLLOW, False, False), (Phase.VERIFY, True, False)],
)
def test_it_follows_from_where_it_was_when_it_had_the_target_and_the_vehicle(
    rig: Any, phase: Phase, controls: bool, begins: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        followed: list[tuple[object, ...]] = []

        def follow(*args: object) -> MissReason:
            followed.append(args)
            return MissReason.NO_TARGET

        monkeypatch.setattr(receiver_file, "follow", follow)
        track = receiver._track = tracked()
        before = bench.session.pilot.guidance
        bench.session.phase, bench.session.pilot.in_control = phase, controls
        view = FakeView(bench.session.now_ns())
        receiver._follow_once(view, LEVEL)
        assert bench.session.pilot.guidance == (receiver._follow_target if begins else before)
        if begins:
            kept = subtract(STATE.position_n_m, track.position_n_m)
            assert receiver._keep_n_m == kept
            track.position_n_m = (0.0, 0.0, 0.0)
            bench.session.pilot.guidance = before
            receiver._follow_once(view, LEVEL)  # from where it was then, however the target goes
            assert receiver._keep_n_m == kept and bench.session.pilot.guidance == before
        seen, T_n_c, camera, own = followed[0]
        assert (seen, camera, own) == (view, receiver._camera, track)
        pose = CameraPose(cast(Any, bench.session.vehicle), rig.receiver.mount)
        expected = pose.T_n_c(view.stamp_ns, LEVEL)
        np.testing.assert_array_equal(cast(Any, T_n_c).t, expected.t)
        assert bench.log.entries[-1][:2] == ("/track", view.stamp_ns)

    with_receiver(rig, main)


@pytest.mark.parametrize("phase", [Phase.FOLLOW, Phase.VERIFY])
def test_a_target_that_is_not_seen_for_as_long_as_can_be_borne_is_lost_once_it_is_followed(
    rig: Any, phase: Phase, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        monkeypatch.setattr(receiver_file, "follow", giving(MissReason.NO_TARGET))
        track = receiver._track = tracked()
        bench.session.phase = phase
        bearable_s = CONFIG.deadlines.target_coast_s + CONFIG.deadlines.target_regain_s
        receiver._follow_once(FakeView(track.stamp_ns + round(bearable_s * 1e9)), LEVEL)
        later = FakeView(track.stamp_ns + round(bearable_s * 1e9) + MS)
        if phase is not Phase.FOLLOW:
            receiver._follow_once(later, LEVEL)
            return
        with pytest.raises(MissionEnd) as caught:
            receiver._follow_once(later, LEVEL)
        end = caught.value
        assert end.outcome is Outcome.TARGET_LOST
        assert end.detail == f"target not seen for {bearable_s:.1f} s"

    with_receiver(rig, main)


# --- the plan


def test_it_plans_until_there_is_a_viewpoint_and_says_which(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        plans: list[Any] = [NoViewpoint({"too near": 3})] * 2
        plans.append(SimpleNamespace(camera_h_m=(1.0, -0.5, 0.25), marker_px=47.6, margin_px=12.4))
        asked: list[object] = []

        def plan(newest: object) -> Any:
            asked.append(newest)
            return plans.pop(0)

        receiver._newest, receiver._rendezvous = TARGET, SimpleNamespace(plan=plan)
        await receiver._until_planned(5.0)
        assert asked == [TARGET] * 3
        assert asyncio.get_running_loop().time() == pytest.approx(1.0, abs=0.1)
        note = "viewpoint (+1.00, -0.50, +0.25) m from the marker, 48 px, margin 12 px"
        assert bench.log.of("/note") == [{"note": note}]

    with_receiver(rig, main)


def test_a_viewpoint_that_is_never_found_ends_it(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        receiver._newest = TARGET
        nowhere = NoViewpoint({"too near": 3})
        receiver._rendezvous = SimpleNamespace(plan=giving(nowhere))
        with pytest.raises(MissionEnd) as caught:
            await receiver._until_planned(5.0)
        assert (caught.value.outcome, caught.value.detail) == (Outcome.NO_VIEWPOINT, str(nowhere))
        assert asyncio.get_running_loop().time() == pytest.approx(5.5, abs=0.1)

    with_receiver(rig, main)


def test_it_rises_from_its_home_to_the_height_where_the_rendezvous_begins(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        rose: list[tuple[object, ...]] = []

        async def take_off(*args: object) -> None:
            rose.append(args)

        monkeypatch.setattr(receiver_file, "take_off", take_off)
        await receiver._rise()
        assert rose == [(bench.session, MissionConfig().receiver_take_off_height_m)]
        assert len(bench.log.of("/home")) == 1

    with_receiver(rig, main)


def test_the_sender_is_where_it_would_be_in_the_receiver_s_own_frame(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        bench.session.off_n_m = (1.0, -2.0, 0.5)
        assert receiver._peer().position_n_m == pytest.approx((4.0, 0.0, -1.0))
        assert receiver._peer().velocity_n_mps == PEER.velocity_n_mps

    with_receiver(rig, main)

"""The end of a session: what ends a mission decides its outcome, and the recovery always runs.

Whatever fails in the recovery is told, not raised.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from drivers.interfaces import CameraError, LinkError, PartError, VehicleError
from flight.harness.flights import RoleResult
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from missions.fly.leg.session import as_end
from missions.fly.leg.steps import hear_peer
from path.messages import Role, Status
from path.protocol.values import TakeResponsibility
from tests.missions.fly.leg.session_bench import STATE, Bench, for_ever, virtual

STATUS = Status(Role.RECEIVER, 1, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), 0.0, 0, False, False, 0.8)


async def good() -> None:
    await asyncio.sleep(2.0)


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (CameraError("no frame for 0.8 s"), Outcome.CAMERA_LOST),
        (VehicleError("arming denied"), Outcome.VEHICLE_REFUSED),
        (LinkError("socket closed"), Outcome.PEER_LOST),
        (MissionEnd(Outcome.TARGET_LOST, "gone"), Outcome.TARGET_LOST),
    ],
)
def test_every_error_of_a_part_is_a_named_end(error: Exception, outcome: Outcome) -> None:
    end = as_end(error)
    assert end.outcome is outcome
    assert str(error) in (end.detail, str(end))


@pytest.mark.parametrize(
    "error", [KeyError("x"), AssertionError(), ZeroDivisionError("division by zero")]
)
def test_an_error_nobody_foresaw_is_a_crash_and_printed(
    error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    end = as_end(error)
    assert end.outcome is Outcome.CRASHED
    assert type(error).__name__ in end.detail
    assert type(error).__name__ in capsys.readouterr().err


def test_a_course_that_comes_to_its_end_is_committed_and_recovered(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.session.set_claim(TakeResponsibility())
        assert await bench.fly(good) == RoleResult(Role.SENDER, Outcome.COMMITTED, "", True, True)
        assert bench.recovered == [None]
        assert bench.log.of("/outcome") == [
            {"outcome": "committed", "detail": "", "responsible": True, "landed": True}
        ]
        assert bench.session.phase is Phase.DONE

    virtual(main())


@pytest.mark.parametrize(
    "error", [MissionEnd(Outcome.MARKER_LOST, "not seen"), CameraError("no frame")]
)
def test_a_course_that_fails_is_recovered_from_by_its_end(rig: Any, error: Exception) -> None:
    async def main() -> None:
        async def course() -> None:
            await asyncio.sleep(1.0)
            raise error

        bench = Bench(rig)
        result = await bench.fly(course)
        assert result.outcome is as_end(error).outcome
        assert result.landed
        assert [end.outcome for end in bench.recovered if end] == [result.outcome]
        assert bench.log.of("/note")[0] == {"note": str(as_end(error))}

    virtual(main())


def test_what_fails_beside_the_course_ends_it(rig: Any) -> None:
    cancelled: list[bool] = []

    async def main() -> None:
        bench = Bench(rig)

        async def watch() -> None:
            await asyncio.sleep(0.5)
            raise MissionEnd(Outcome.TARGET_LOST, "gone")

        async def course() -> None:
            bench.session.spawn(watch())
            try:
                await asyncio.sleep(1e6)
            except asyncio.CancelledError:
                cancelled.append(True)
                raise

        result = await bench.fly(course)
        assert (result.outcome, result.detail) == (Outcome.TARGET_LOST, "gone")

    virtual(main())
    assert cancelled == [True]


def test_the_first_failure_is_the_cause_later_ones_are_not(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)

        async def fail(after_s: float, outcome: Outcome) -> None:
            await asyncio.sleep(after_s)
            raise MissionEnd(outcome, "seen")

        bench.session.spawn(fail(1.0, Outcome.GUARD))
        bench.session.spawn(fail(1.5, Outcome.CAMERA_LOST))  # while it is brought down
        bench.session.spawn(fail(0.6, Outcome.MARKER_LOST))
        assert (await bench.fly(for_ever)).outcome is Outcome.MARKER_LOST
        assert len(bench.recovered) == 1

    virtual(main())


def test_being_told_to_stop_lands(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        asyncio.get_running_loop().call_later(3.0, bench.stop.set)
        result = await bench.fly(for_ever)
        assert result.outcome is Outcome.INTERRUPTED
        assert result.landed
        assert [end.outcome for end in bench.recovered if end] == [Outcome.INTERRUPTED]

    virtual(main())


def test_a_broken_link_ends_the_mission(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.link.waiting.put_nowait(LinkError("socket closed"))
        assert (await bench.fly(for_ever)).outcome is Outcome.PEER_LOST

    virtual(main())


@pytest.mark.parametrize(
    "failure",
    [VehicleError("landing not confirmed"), MissionEnd(Outcome.GUARD, "fence"), PartError("gone")],
)
@pytest.mark.parametrize("course", [good, for_ever])
def test_a_failure_in_the_recovery_is_told_not_raised(
    rig: Any, failure: Exception, course: Callable[[], Awaitable[None]]
) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.fails = failure
        asyncio.get_running_loop().call_later(3.0, bench.stop.set)
        result = await bench.fly(course)
        assert result.outcome is (Outcome.COMMITTED if course is good else Outcome.INTERRUPTED)
        assert not result.landed
        assert f"not landed by the script: {failure}" in [
            record["note"] for record in bench.log.of("/note")
        ]
        assert bench.log.of("/outcome")[0]["landed"] is False

    virtual(main())


def test_statuses_go_on_until_the_vehicle_is_down(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.fly(good)
        times = [time_s for time_s, message in bench.link.sent if isinstance(message, Status)]
        assert times[-1] >= 2.9 - 0.1  # the course took 2 s, the recovery one more

    virtual(main())


def test_what_a_position_is_off_at_home_is_in_nothing_that_is_told_and_in_all_that_is_heard(
    rig: Any,
) -> None:
    """Two drones that stand 2 m apart, and take themselves to be elsewhere."""

    async def main() -> None:
        benches = [Bench(rig) for _ in range(2)]
        for bench, at_m, home_m in zip(
            benches, ((0.4, -0.7), (3.0, 0.5)), ((0.0, 0.0), (2.0, 0.0)), strict=True
        ):
            bench.vehicle.state = replace(STATE, position_n_m=(*at_m, -1.5))
            bench.session.note_home(home_m)
            bench.session.spawn(bench.session.report())
        await asyncio.sleep(0.5)
        one, other = (bench.link.of(Status)[-1] for bench in benches)
        assert one.position_n_m == pytest.approx((0.0, 0.0, -1.5), abs=2e-3)
        assert other.position_n_m == pytest.approx((2.0, 0.0, -1.5), abs=2e-3)
        assert benches[1].session.here(one).position_n_m == pytest.approx(
            (1.0, 0.5, -1.5), abs=2e-3
        )
        assert benches[0].log.of("/home") == [{"off_m": (0.4, -0.7)}]
        benches[0].session.note_home(())
        assert benches[0].session.here(other) == other
        for bench in benches:
            await bench.session.cancel_spawned()

    virtual(main())


def test_a_drone_that_will_not_fly_says_why_before_it_leaves(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)

        async def course() -> None:
            raise VehicleError("not set for this flight")

        await bench.fly(course)
        told = [status.ended for status in bench.link.of(Status)]
        assert told[-5:] == [Outcome.VEHICLE_REFUSED.exit_code] * 5

    virtual(main())


@pytest.mark.parametrize("outcome", [Outcome.VEHICLE_REFUSED, Outcome.UNFIT, Outcome.CAMERA_LOST])
def test_who_waits_for_a_drone_that_will_not_fly_is_told_why(rig: Any, outcome: Outcome) -> None:
    async def main() -> None:
        bench = Bench(rig)

        async def course() -> None:
            alike = replace(bench.session._status(), role=Role.RECEIVER)  # pyright: ignore[reportPrivateUsage]
            await bench.link.waiting.put(replace(alike, ended=outcome.exit_code))
            await hear_peer(bench.session)

        result = await bench.fly(course)
        assert result.outcome is Outcome.PEER_ABORTED
        assert outcome.label in result.detail
        assert asyncio.get_running_loop().time() < 5.0  # long before the wait for a clock is over

    virtual(main())


@pytest.mark.parametrize("outcome", [each for each in Outcome if each.exit_code])
def test_every_end_of_the_other_drone_ends_this_flight_by_its_name(
    rig: Any, outcome: Outcome
) -> None:
    async def main() -> None:
        bench = Bench(rig)

        async def course() -> None:
            await bench.link.waiting.put(replace(STATUS, ended=outcome.exit_code))
            await asyncio.sleep(1.0)
            bench.session.require_peer()

        result = await bench.fly(course)
        assert result.outcome is Outcome.PEER_ABORTED
        assert result.detail == f"the other drone: its flight has ended: {outcome.label}"
        notes = [record["note"] for record in bench.log.of("/note")]
        assert notes[0] == f"the other drone: its flight has ended: {outcome.label}"

    virtual(main())


@pytest.mark.parametrize("had", [False, True])
def test_both_consoles_say_that_nobody_follows_the_target_that_a_drone_had(
    rig: Any, had: bool
) -> None:
    async def main() -> None:
        bench = Bench(rig)
        session = bench.session
        session.set_claim(TakeResponsibility() if had else None)
        session.say_if_unfollowed(None)
        notes = bench.log.of("/note")
        assert notes == []
        session.say_if_unfollowed(MissionEnd(Outcome.PILOT_OVERRIDE, "sticks"))
        assert any("nobody does" in note["note"] for note in bench.log.of("/note")) is had

        async def course() -> None:
            for outcome in (Outcome.NO_AGREEMENT, Outcome.PILOT_OVERRIDE, Outcome.PILOT_OVERRIDE):
                status = replace(STATUS, ended=outcome.exit_code, responsible=had)
                await bench.link.waiting.put(status)
            await asyncio.sleep(1.0)

        await bench.fly(course)
        left = [
            note["note"]
            for note in bench.log.of("/note")
            if note["note"].startswith("the other drone: its flight has ended")
        ]
        assert ["no_agreement" in left[0], "pilot_override" in left[1]] == [True, True]
        assert len(left) == 2  # each end once
        assert all(("follows it no more" in note) is had for note in left)

    virtual(main())

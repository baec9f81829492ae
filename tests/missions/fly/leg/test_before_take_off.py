"""What is told and agreed on the ground: the autopilot's fence, and what both drones must have
alike.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.interfaces import LinkCounters
from drivers.mavlink.preflight.geofence import Geofence
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from missions.fly.leg import steps
from path.messages import Pong, Role, Status
from tests.missions.fly.leg.session_bench import Bench, giving, virtual

PEER = Status(Role.RECEIVER, 1, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), 0.0, 0, False, False, 0.8)


@pytest.mark.parametrize("written", [{"GF_MAX_HOR_DIST": 25.0}, {}])
@pytest.mark.parametrize("can", ["it can", "it has no geofence", "nobody asks it"])
def test_the_autopilot_s_own_fence_is_said_and_logged_when_it_was_given_one(
    rig: Any, written: dict[str, float], can: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        bench = Bench(rig)
        session: Any = bench.session
        asked: list[Geofence] = []

        async def keep(fence: Geofence) -> dict[str, float]:
            asked.append(fence)
            return written

        lacks = {steps.Capability.GEOFENCE} if can == "it has no geofence" else set[object]()
        monkeypatch.setattr(steps, "lacking", giving(lacks))
        own = {} if can == "nobody asks it" else {"keep_geofence": keep}
        session.vehicle = SimpleNamespace(**own)
        await steps.keep_geofence(session)
        guard = session.config.guard
        kept = can == "it can"
        assert asked == [Geofence(guard.fence_radius_m, guard.fence_height_m)] * kept
        told = kept and bool(written)
        assert bench.log.of("/geofence") == [{"set": {"GF_MAX_HOR_DIST": 25.0}}] * told
        note = "the autopilot was given its fence: GF_MAX_HOR_DIST 25"
        assert bench.log.of("/note") == [{"note": note}] * told

    virtual(main())


def test_a_drone_that_was_not_heard_is_told_with_what_came_in_its_place() -> None:
    nothing = LinkCounters()
    assert steps._unheard(nothing) == "the other drone was not heard"
    others = LinkCounters()
    others.dropped = cast(Any, Counter({"crc": 3, "key": 9, "short": 1, "other": 2}))
    said = steps._unheard(others)
    assert "9 as key, 3 as crc, 2 as other:" in said and "short" not in said


@pytest.mark.parametrize("answered", [False, True])
def test_clocks_that_are_not_known_are_told_with_what_would_be_needed(
    rig: Any, answered: bool
) -> None:
    async def main() -> None:
        session = Bench(rig).session
        if answered:
            session.alignment.on_pong(Pong(1, 0, 10**9, 10**9), 2 * 10**9)
        said = steps._unaligned(session)
        if answered:
            known_s = session.alignment.uncertainty_ns * 1e-9
            needed_s = session.config.clock_uncertainty_s
            assert f"known to {known_s:.3f} s by 1 pings" in said
            assert f"clock_uncertainty_s = {needed_s:g} s" in said
        else:
            assert said == "the clocks were not aligned: no ping was answered"

    virtual(main())


@pytest.mark.parametrize(
    ("alike", "phase", "differs"),
    [("same", 0, False), ("other", 0, True), (None, int(Phase.VERIFY), False), (None, 0, True)],
)
def test_drones_that_must_be_alike_and_are_not_both_say_so_before_they_end(
    rig: Any, alike: str | None, phase: int, differs: bool
) -> None:
    async def main() -> None:
        bench = Bench(rig)
        session = bench.session
        own = session.alike
        changed = replace(own, origin=own.origin % 1000 + 1)
        session.peer = replace(PEER, phase=phase)
        session.peer_alike = {None: None, "same": own, "other": changed}[alike]
        if not differs:
            await steps.check_alike(session)
            assert bench.log.of("/alike") == [{"differing": ""}]
            assert bench.log.of("/note") == []
            return
        with pytest.raises(MissionEnd) as caught:
            await steps.check_alike(session)
        assert caught.value.outcome is Outcome.RIGS_DIFFER
        # the other drone has heard of it by then
        assert asyncio.get_running_loop().time() == pytest.approx(3.0)
        (record,) = bench.log.of("/alike")
        assert record["differing"] and record["differing"] in caught.value.detail
        assert bench.log.of("/note") == [{"note": caught.value.detail}]

    virtual(main())


def test_a_drone_that_said_that_it_does_not_fly_is_not_waited_for(rig: Any) -> None:
    async def main() -> None:
        session = Bench(rig).session
        session.peer = PEER
        assert not steps._aligned(session)
        session.peer = replace(PEER, ended=Outcome.RIGS_DIFFER.exit_code)
        with pytest.raises(MissionEnd) as caught:
            steps._aligned(session)
        assert caught.value.outcome is Outcome.PEER_ABORTED
        assert session.peer_left in caught.value.detail

    virtual(main())

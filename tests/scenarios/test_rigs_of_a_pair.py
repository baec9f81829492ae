"""The two drones of a flight have rigs that differ: refused on both consoles, before anything
moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.rig.parts import Rig
from flight.harness.flights import ProgramContext, RoleResult
from missions.fly.handoff.flight import HANDOFF, fly_once
from missions.fly.leg.process import fly_role
from missions.ground import rig_library
from missions.look.report.records import load_run
from path.marker.layout import MarkerLayout
from path.messages import Role


def with_side(rig: Rig, side_m: float) -> Rig:
    markers = tuple(replace(marker, side_m=side_m) for marker in rig.layout.markers)
    return replace(rig, layout=MarkerLayout(markers, rig.layout.dictionary))


OTHERS: dict[str, Callable[[Rig], Rig]] = {
    "side_m": lambda rig: with_side(rig, 0.064),
    "[method]": lambda rig: replace(rig, method=replace(rig.method, tau_min=0.26)),
}


@pytest.mark.parametrize("said", OTHERS)
@pytest.mark.parametrize("changed", list(Role))
def test_rigs_that_differ_are_refused_by_both_drones_before_anything_moves(
    tmp_path: Path, said: str, changed: Role
) -> None:
    async def main(rig: Rig, role: Role, given: ProgramContext) -> RoleResult:
        return await fly_role(OTHERS[said](rig) if role is changed else rig, role, given)

    programs = replace(HANDOFF, main=main)
    facts = fly_once(rig_library.load("sim"), 3, (), tmp_path, lambda _: None, programs)
    assert (facts.outcome, facts.exit_code, facts.violations) == ("rigs_differ", 37, {}), (
        facts.detail
    )
    run = load_run(tmp_path)
    for role in Role:
        end = run.role(role)["/outcome"][-1].record
        assert end["outcome"] == "rigs_differ" and said in end["detail"], end
        assert not any(state.record["armed"] for state in run.role(role)["/state"])
    here, there = ("40.0", "64.0") if changed is Role.RECEIVER else ("64.0", "40.0")
    if said == "side_m":
        assert f"({here} mm here, {there} mm there)" in run.sender["/outcome"][-1].record["detail"]

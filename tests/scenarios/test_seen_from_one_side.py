"""A target that its detector knows from one side only: D1 goes round, and it is handed over in the
heading found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.interfaces import Detection
from hil.geometric.perception import GeometricView
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.report.records import load_run
from missions.look.report.summary import summarize
from path.messages import Role
from path.observations import Region


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["from the east", "from the west"])
def test_it_is_found_and_handed_over(
    side: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, east_of_it = GeometricView.targets, [False]

    def from_one_side(view: GeometricView, region: Region | None) -> Sequence[Detection]:
        """D1, who came from the south, is shown nothing before it has been nearer to the east (or
        west) of it.
        """
        snapshot, sensor = view._snapshot, view._sensor  # pyright: ignore[reportPrivateUsage]
        way = snapshot.drones[Role.SENDER].T_w_b.t - snapshot.objects[0].position_w_m
        east_of_it[0] = east_of_it[0] or side * float(way[0]) > abs(float(way[1]))
        return found(view, region) if east_of_it[0] or sensor.setup.role is Role.RECEIVER else ()

    monkeypatch.setattr(GeometricView, "targets", from_one_side)
    rig = rig_library.load("sim-person")
    # for long enough to go round to the second side
    stands = {**rig.mission["target"], "holds_s": 70.0}
    deadlines = {**rig.mission.get("deadlines", {}), "acquire_s": 55.0}
    rig = replace(rig, mission={**rig.mission, "target": stands, "deadlines": deadlines})
    rig = replace(rig, world={**rig.world, "target": {**rig.world["target"], "start_time_s": 70.0}})
    facts = fly_once(rig, 3, (), tmp_path, lambda _: None)
    assert facts.outcome == "committed", facts.detail
    assert not facts.violations
    run = load_run(tmp_path)
    assert summarize(run)["object_handed_over"] == 0
    follow_ns = next(r.stamp_ns for r in run.sender["/phase"] if r.record["phase"] == "follow")
    yaws = [
        r.record["yaw_rad"] for r in run.sender["/setpoint"] if 0 < r.stamp_ns - follow_ns < 1e9
    ]
    assert math.sin(yaws[-1]) * side < -0.6  # it looks west from the east

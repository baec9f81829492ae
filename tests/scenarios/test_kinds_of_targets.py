"""Whole hand-overs of what is not a car: a micro-UAV that flies up and down, and a person."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.report.records import load_run
from missions.look.report.summary import summarize


@pytest.mark.parametrize("kind", ["drone", "person"])
def test_it_is_handed_over(kind: str, tmp_path: Path) -> None:
    facts = fly_once(rig_library.load(f"sim-{kind}"), 2, (), tmp_path, lambda _: None)
    assert facts.outcome == "committed", facts.detail
    assert not facts.violations
    run = load_run(tmp_path)
    assert summarize(run)["object_handed_over"] == 0
    assert run.world["/scene"][0].record["kind"] == kind


def test_the_follower_climbs_with_what_it_follows(tmp_path: Path) -> None:
    rig = rig_library.load("sim-drone")
    # by count both verify for long enough to see it climb, and then no longer
    deadlines = {**rig.mission.get("deadlines", {}), "verify_s": 8.0}
    mission = {**rig.mission, "follow_after_s": 0.5, "deadlines": deadlines}
    rig = replace(rig, method=replace(rig.method, gate="count"), mission=mission)
    fly_once(rig, 2, (), tmp_path, lambda _: None)
    run = load_run(tmp_path)
    verify = [r.stamp_ns for r in run.sender["/phase"] if r.record["phase"] == "verify"]
    assert verify
    beginning = run.world["/truth"][0].stamp_ns
    told = [
        (
            r.record["sender"]["t"][2] - r.record["objects"][0]["t"][2],
            r.record["objects"][0]["t"][2],
        )
        for r in run.world["/truth"]
        if 24.0 < (r.stamp_ns - beginning) * 1e-9 < 32.0
    ]
    ended = [r.stamp_ns for r in run.sender["/phase"] if r.record["phase"] == "depart"]
    assert ended[0] - run.sender["/phase"][0].stamp_ns > 32e9
    above, height = np.array(told).T
    assert np.ptp(height) > 0.8
    assert above == pytest.approx(np.full(len(above), 1.4), abs=0.35)

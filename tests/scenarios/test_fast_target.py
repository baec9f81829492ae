"""A target at 1.5 m/s that turns: kept in both views until it is handed over."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.report.records import load_run
from missions.look.report.summary import summarize


def test_a_target_at_a_metre_and_a_half_per_second_is_handed_over(tmp_path: Path) -> None:
    rig = rig_library.load("sim-fast")
    assert rig.world["target"]["speed_mps"] == 1.5
    facts = fly_once(rig, 1, (), tmp_path, lambda _: None)
    assert facts.outcome == "committed", facts.detail
    assert not facts.violations
    summary = summarize(load_run(tmp_path))
    assert summary["object_handed_over"] == 0
    assert summary["min_separation_m"] > 0.9


def test_without_the_acceleration_for_its_turns_it_is_lost_and_that_is_said(tmp_path: Path) -> None:
    rig = rig_library.load("sim-fast")
    slow = replace(rig, mission={**rig.mission, "max_accel_mps2": 0.5})
    facts = fly_once(slow, 1, (), tmp_path, lambda _: None)
    assert facts.outcome == "target_lost", facts.detail
    assert not facts.violations

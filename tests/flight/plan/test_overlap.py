"""How strongly boxes of one target agree, foreseen, and which blocks follow from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flight.plan.facts import Facts, facts_of
from flight.plan.geometry import Layout, apparent, flown_layout
from flight.plan.overlap import agreeing_share, strengths
from missions.ground import rig_library
from missions.ground.rig_library import mission_of
from tests.docs.systems import FOLDER


def seen(name: str, **changes: float) -> tuple[float, float]:
    """Return the median strength, and the share in which the usual blocks agree."""
    facts, placed = laid_out(name, **changes)
    return float(np.median(strengths(facts, placed))), agreeing_share(facts, placed, 0.35)


def laid_out(name: str, **changes: float) -> tuple[Facts, Layout]:
    rig = rig_library.load_unchecked(name)
    mission = mission_of(rig)
    facts = facts_of(rig, mission)
    return replace(facts, method=replace(facts.method, **changes)), flown_layout(facts, mission)


def test_a_cars_boxes_agree_strongly_and_a_micro_uavs_weakly() -> None:
    car, nearly_all = seen("sim")
    drone, some = seen("sim-drone")
    # sim: flown with a median overlap of 0.73 where 0.37 are asked for; sim-drone: 0.5 to 0.6
    assert 0.5 < car < 0.7
    assert 0.2 < drone < 0.45
    assert nearly_all > 0.95
    assert some < 0.85


def test_larger_errors_that_last_leave_fewer_hand_overs_that_agree() -> None:
    shares = [seen("sim", mount_sigma_deg=angle)[1] for angle in (0.2, 2.0, 4.0)]
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] < shares[0]


def test_weak_boxes_are_given_weaker_blocks_with_the_rates_that_were_measured_of_them() -> None:
    usual = rig_library.load_unchecked("sim").method.evidence
    assert (usual.strength, usual.patient_block_s) == (0.35, 0.0)
    for name in ("sim-drone", str(FOLDER / "micro-uav.toml")):
        weak = rig_library.load_unchecked(name).method.evidence
        assert (weak.strength, weak.first_rate, weak.next_rate) == (0.25, 0.04, 0.45)
        assert weak.patient_block_s == 1.0


def test_of_what_flies_on_rotors_the_box_is_of_its_body() -> None:
    facts, placed = laid_out(str(FOLDER / "micro-uav.toml"))
    box = apparent(facts, 1.93)
    # of a stated 0.31 x 0.31 x 0.10 m the detector's boxes are 62 x 54 px from there
    assert 45.0 < box.width_px < 80.0
    assert 45.0 < box.height_px < 80.0
    assert placed.range_m > 1.0

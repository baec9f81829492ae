"""Whole handoffs in virtual time: how they end with and without faults, and that a seed gives one
run.
"""

from __future__ import annotations

import gc
import json
import math
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.rig.parts import with_errors
from hil.world import errors
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.report.records import RunFacts, load_facts, load_run
from missions.look.report.summary import summarize
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.messages import Role
from tests.flown import flown_once

NEAR = 987277702  # a seed of which both positions are off towards each other
LOGS = ("sender.mcap", "receiver.mcap", "world.mcap")
IMPATIENT = ("[mission.target]", "[mission.deadlines]\nverify_s = 6.0\n\n[mission.target]")


class Flown:
    """A flight's end, and its logs, read once."""

    def __init__(self, facts: RunFacts, out: Path) -> None:
        self.facts = facts
        self.out = out
        self.run = load_run(out)

    @cached_property
    def summary(self) -> dict[str, Any]:
        return summarize(self.run)

    def last_outcome(self, role: Role) -> dict[str, Any]:
        return self.run.role(role)["/outcome"][-1].record

    def responsible_at_the_end(self, role: Role) -> bool:
        records = self.run.role(role).get("/responsibility", ())
        return bool(records and records[-1].record["responsible"])


def fly(rig: str, out: Path, seed: int = 1, *faults: str, errors: str | None = None) -> Flown:
    out.mkdir(exist_ok=True)
    return Flown(
        fly_once(with_errors(rig_library.load(rig), errors), seed, faults, out, lambda _: None), out
    )


def shared(factory: pytest.TempPathFactory, seed: int, *faults: str) -> Flown:
    """A flight of the rig ``sim`` that other rooms look at too."""
    out = flown_once(factory, seed, *faults)
    facts = load_facts(out)
    assert facts is not None
    return Flown(facts, out)


def rig_with(folder: Path, change: tuple[str, str]) -> str:
    """The rig ``sim`` with something else in its file."""
    text = rig_library.whole("sim")
    assert text.count(change[0]) == 1
    (folder / "rig.toml").write_text(text.replace(*change), "utf-8")
    return str(folder / "rig.toml")


def test_flights_in_one_process_leave_nothing_that_is_never_collected(tmp_path: Path) -> None:
    before = gc.get_freeze_count()
    fly("sim", tmp_path, 1, "kill_receiver@preflight")
    # what tests before this one froze may have ended meanwhile
    assert gc.get_freeze_count() <= before


def test_two_seeds_commit_and_break_no_rule_and_one_of_them_again_gives_the_same_bytes(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    flights = (
        shared(tmp_path_factory, 2),
        fly("sim", tmp_path / "again", 2),
        shared(tmp_path_factory, NEAR),
    )
    for flown in flights:
        commits_and_breaks_no_rule(flown)
    for log in LOGS:
        first, again, other = ((flown.out / log).read_bytes() for flown in flights)
        assert first == again, log
        assert first != other, log


def commits_and_breaks_no_rule(flown: Flown) -> None:
    assert (flown.facts.outcome, flown.facts.exit_code) == ("committed", 0), flown.facts.detail
    assert flown.facts.violations == {}
    assert flown.summary["wrong_handover"] is False
    assert flown.summary["gate"] == "evidence"
    assert flown.summary["estimator_steps"] == {"sender": 0, "receiver": 0}
    assert flown.summary["evidence_max"] > 3.3
    assert 1.5 < flown.summary["agreement_s"] < 3.0
    assert flown.summary["min_separation_m"] > 0.7
    assert flown.summary["d2_error_m"] < 0.05
    assert flown.summary["target_error_m"] < 0.05
    assert not flown.responsible_at_the_end(Role.SENDER)
    assert flown.responsible_at_the_end(Role.RECEIVER)


def test_positions_that_put_the_stand_off_too_near_are_found_out_by_the_marker(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Both estimates err towards each other: the stand-off they make is 0.7 m from the sender."""
    flown = shared(tmp_path_factory, NEAR)
    assert flown.facts.outcome == "committed", flown.facts.detail
    assert flown.facts.violations == {}
    assert flown.summary["min_separation_m"] > 0.9


def test_the_gate_that_goes_by_evidence_needs_no_more_time_on_a_link_that_loses_a_third(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    flown = shared(tmp_path_factory, 8, "link_loss=0.3")
    assert flown.facts.outcome == "committed", flown.facts.detail
    assert flown.facts.violations == {}
    assert flown.summary["wrong_handover"] is False
    assert 1.5 < flown.summary["agreement_s"] < 3.0


def test_the_papers_gate_counts_350_pairs_in_seven_seconds(tmp_path: Path) -> None:
    flown = fly(rig_with(tmp_path, ("[method]", '[method]\ngate = "count"')), tmp_path / "run", 1)
    assert flown.facts.outcome == "committed", flown.facts.detail
    assert flown.facts.violations == {}
    assert flown.summary["gate"] == "count"
    assert flown.summary["count_max"] >= 350
    assert flown.summary["agreement_s"] > 6.9


def test_rendered_frames_through_the_whole_perception_commit(tmp_path: Path) -> None:
    flown = fly("sim-rendered", tmp_path, 7)
    assert flown.facts.outcome == "committed", flown.facts.detail
    assert flown.facts.violations == {}
    assert flown.summary["wrong_handover"] is False
    assert flown.summary["d2_error_m"] < 0.008
    assert len(flown.run.receiver["/image"]) > 0


@pytest.mark.parametrize(
    ("fault", "outcome"),
    [
        ("marker_hidden", "marker_lost"),
        ("depth_holes", "no_agreement"),
        ("camera_freeze", "camera_lost"),
        ("kill_receiver", "crashed"),
        ("kill_sender", "crashed"),
        ("fc_link_loss", "vehicle_lost"),
        ("pilot_takeover", "pilot_override"),
        ("pilot_takeover@take-off+2", "pilot_override"),
        ("motor_kill", "pilot_override"),
        ("rc_mode_receiver", "pilot_override"),
        ("rc_sticks_sender", "pilot_override"),
        ("rc_kill_sender", "pilot_override"),
        ("rc_lost_receiver", "pilot_override"),
        ("battery_sag", "guard"),
        ("battery_sag=0", "guard"),  # the autopilot lands by itself, and is not taken for a pilot
    ],
)
def test_a_fault_ends_in_its_outcome_and_the_sender_keeps_the_target(
    tmp_path: Path, fault: str, outcome: str
) -> None:
    out = tmp_path / "run"
    flown = fly(
        rig_with(tmp_path, IMPATIENT) if outcome == "no_agreement" else "sim", out, 1, fault
    )
    assert flown.facts.outcome == outcome, flown.facts.detail
    assert flown.facts.exit_code != 0
    assert flown.facts.violations == {}
    assert flown.summary["wrong_handover"] is not True
    assert not flown.run.sender.get("/commit")
    assert not flown.responsible_at_the_end(Role.RECEIVER)
    if fault != "kill_sender":
        assert flown.responsible_at_the_end(Role.SENDER)
    if fault == "kill_receiver":  # the other drone lands by itself when one program dies
        told = {"outcome": "peer_lost", "detail": "", "responsible": True, "landed": True}
        assert flown.last_outcome(Role.SENDER) | {"detail": ""} == told
    last = flown.run.world["/truth"][-1].record
    # a pilot who took over keeps the vehicle
    if not fault.startswith(("pilot_takeover", "rc_mode", "rc_sticks")):
        assert not last["sender"]["in_air"]
        assert not last["receiver"]["in_air"]


def test_a_marker_that_is_lost_for_ten_seconds_of_the_agreement_costs_time_and_no_hand_over(
    tmp_path: Path,
) -> None:
    flown = fly("sim", tmp_path, 601, "marker_hidden=10@verify+0.5")
    assert flown.facts.outcome == "committed", flown.facts.detail
    assert flown.facts.violations == {}
    assert flown.summary["wrong_handover"] is False
    assert flown.summary["min_separation_m"] > 1.0
    assert 11.0 < flown.summary["agreement_s"] < 25.0


def test_going_around_takes_until_the_drone_is_within_its_bounds_again(tmp_path: Path) -> None:
    """Its pilot stops the motors in the approach; it falls, and is told only with a heartbeat a
    second.
    """
    (tmp_path / "rig.toml").write_text(
        'name = "slow-beat"\nlike = "sim"\n[world.autopilot]\nheartbeat_hz = 1.0\n'
        "[sender.vehicle]\nheartbeat_timeout_s = 2.5\n[receiver.vehicle]\nheartbeat_timeout_s = 2.5\n"
    )
    # of seed 2, in which D2 has the marker in view while it falls
    flown = fly(str(tmp_path / "rig.toml"), tmp_path / "run", 2, "rc_kill_receiver@approach+1")
    notes = [note.record["note"] for note in flown.run.receiver["/note"]]
    assert sum(note.startswith("goes around: closing in") for note in notes) == 1
    assert flown.facts.outcome == "pilot_override"
    assert "approach_failed" not in flown.facts.detail


def test_loss_and_look_alikes_delay_a_handoff_but_never_mislead_it(tmp_path: Path) -> None:
    flown = fly("sim", tmp_path, 2, "link_loss=0.2", "lookalike")
    assert flown.facts.outcome in ("committed", "no_agreement"), flown.facts.detail
    assert flown.facts.violations == {}
    assert flown.summary["wrong_handover"] is not True


def test_nothing_is_agreed_on_a_link_that_loses_nearly_everything(tmp_path: Path) -> None:
    flown = fly("sim", tmp_path, 1, "link_loss=0.97")
    assert flown.facts.outcome not in ("committed", "monitor_violated", "harness_failed")
    assert flown.facts.violations == {}


@pytest.mark.parametrize(
    ("fault", "outcome", "holder"),
    [
        ("kill_sender=1@preflight", "committed", Role.RECEIVER),
        ("kill_receiver=1@waiting", "committed", Role.RECEIVER),
        ("kill_sender=1@verify+1", "restarted", Role.SENDER),
        # taken back by then, or accepted: both are right
        ("kill_sender=0.3@released", "restarted", None),
        ("kill_receiver=0.3@provisional", "restarted", None),
        ("kill_sender=0.3@handed_over", "restarted", Role.RECEIVER),
        ("kill_receiver=2@follow+1", "restarted", Role.RECEIVER),
    ],
)
def test_a_program_that_is_killed_and_started_again_goes_by_what_it_wrote_down(
    tmp_path_factory: pytest.TempPathFactory, fault: str, outcome: str, holder: Role | None
) -> None:
    flown = shared(tmp_path_factory, 1, fault)
    assert flown.facts.outcome == outcome, flown.facts.detail
    assert flown.facts.violations == {}
    assert flown.summary["wrong_handover"] is not True
    logs = [len(list(flown.out.glob(f"{role.value}*.mcap"))) for role in Role]
    assert logs.count(2) == 1
    responsible = [role for role in Role if flown.responsible_at_the_end(role)]
    assert responsible == [holder] if holder else len(responsible) == 1
    last = flown.run.world["/truth"][-1].record
    assert not last["sender"]["in_air"] and not last["receiver"]["in_air"]


# the receiver is right, left of it by then
@pytest.mark.parametrize("seed", [0, 3])
def test_a_sender_leaves_away_from_a_receiver_that_died_on_its_way_to_it(
    tmp_path: Path, seed: int
) -> None:
    # the side is part of the seed
    flown = fly("sim", tmp_path, seed, "kill_receiver@approach+1", errors="exact")
    (fault,) = flown.run.world["/fault"]
    # once it has heard nothing for ``peer_silence_s``, and followed so long
    leaves_ns = fault.stamp_ns + round(2.8e9)
    after = [record.record for record in flown.run.world["/truth"] if record.stamp_ns >= leaves_ns]
    places = [(each["sender"]["t"], each["receiver"]["t"]) for each in after]
    (began, other), (ended, _) = places[0], places[-1]
    # east is to the right of the heading
    to_receiver_m, flown_m = other[0] - began[0], ended[0] - began[0]
    # straight behind, as both positions are known, no side is the other one
    assert abs(to_receiver_m) > 0.25
    assert abs(flown_m) > 1.5 and flown_m * to_receiver_m < 0.0
    assert flown.facts.violations == {}


def test_a_sender_that_handed_over_leaves_even_when_nothing_more_is_heard_of_the_receiver(
    tmp_path: Path,
) -> None:
    """The target leads it towards where a receiver that died hangs in the air."""
    flown = fly("sim", tmp_path, 1, "link_out=4@handed_over+0.1", "kill_receiver=20@holding+0.1")
    assert flown.facts.violations == {}
    world = flown.run.world
    killed_ns = next(
        each.stamp_ns for each in world["/fault"] if each.record["fault"] == "kill_receiver"
    )
    later = [each.record for each in world["/truth"] if 2.0e9 < each.stamp_ns - killed_ns < 2.5e9]
    assert later
    assert all(math.dist(each["sender"]["t"], each["receiver"]["t"]) > 1.5 for each in later)


def test_what_a_link_does_to_packets_is_survived_together(tmp_path: Path) -> None:
    faults = (
        "link_loss=0.1",
        "link_duplicate=0.3",
        "link_corrupt=0.1",
        "link_reorder=0.2",
        "link_jitter=0.02",
    )
    flown = fly("sim", tmp_path, 5, *faults, "link_out=0.3@verify+1")
    assert flown.facts.violations == {}
    assert flown.facts.outcome == "committed", flown.facts.detail
    assert flown.summary["link_dropped"]["sender"]["bad_crc"] > 10


def test_a_plate_that_is_upside_down_is_never_flown_by_and_said_by_its_cause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a tag that was printed from AprilRobotics' own pictures, which OpenCV has turned by
    half a turn.
    """
    rig = rig_with(
        tmp_path, ("[mission.target]", "[mission.deadlines]\nsearch_s = 8.0\n\n[mission.target]")
    )
    as_said, usual = rig_library.load(rig).sender.mount.T_b_v, errors.other_mount
    upside_down = Pose(exp(math.pi * np.array([0.0, 0.0, 1.0])), np.zeros(3))

    def glued_on(mount: Pose, *given: Any) -> Pose:
        return usual(mount @ upside_down if np.array_equal(mount.R, as_said.R) else mount, *given)

    monkeypatch.setattr(errors, "other_mount", glued_on)
    flown = fly(rig, tmp_path / "out")
    assert flown.facts.outcome == "marker_not_found"
    assert "is the plate the right way up" in flown.last_outcome(Role.RECEIVER)["detail"]
    assert any("is the plate the right way up" in note for note in flown.summary["notes"])
    (told,) = {r.record["reason"] for r in flown.run.receiver["/marker"] if r.record["cause"]}
    assert told == "marker_turned"
    notes = [r.record["note"] for r in flown.run.receiver["/note"]]
    assert sum(note.startswith("the sender's marker: gravity contradicts") for note in notes) == 1


@pytest.mark.parametrize(("true_mm", "seed"), [(25.0, 511), (44.0, 513)])
def test_a_marker_whose_size_contradicts_depth_ends_the_flight_before_any_hand_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, true_mm: float, seed: int
) -> None:
    """25 mm of 40 is as 40 mm of 64, with which D2 would come 0.65 m near."""
    usual = errors.other_print

    def printed(layout: MarkerLayout, *given: Any) -> MarkerLayout:
        built = usual(layout, *given)
        markers = tuple(
            replace(each, side_m=each.side_m * true_mm / 40.0) for each in built.markers
        )
        return replace(built, markers=markers)

    monkeypatch.setattr(errors, "other_print", printed)
    flown = fly("sim", tmp_path / "out", seed)
    assert (flown.facts.outcome, flown.facts.violations) == ("marker_size", {}), flown.facts.detail
    assert "/commit" not in flown.run.sender
    said = flown.facts.detail.partition("40.0 mm by the rig and ")[2].partition(" mm by depth")[0]
    side, sigma = (float(part) for part in said.split(" +- "))
    assert abs(side - true_mm) < 3.0 * sigma < 0.1 * true_mm
    notes = [r.record["note"] for r in flown.run.sender["/note"]]
    assert "the other drone: its flight has ended: marker_size" in notes


IN_VERIFY_S = 33.5  # of seed 7: the loop's time


@pytest.mark.parametrize(
    ("who", "step_s", "at_s"),
    [
        ("receiver", -5.0, 25.0),
        ("sender", 5.0, IN_VERIFY_S),
        ("sender", -0.05, IN_VERIFY_S),
        ("receiver", 0.05, IN_VERIFY_S),
    ],
)
def test_a_drone_whose_own_clock_is_set_in_flight_says_so_and_comes_down(
    tmp_path: Path, who: str, step_s: float, at_s: float
) -> None:
    clock = {
        "factory": "tests.stepping_clock:SteppingClock",
        "offset_s": 100.0,
        "step_s": step_s,
        "at_s": at_s,
    }
    lines = [f"{key} = {json.dumps(value)}" for key, value in clock.items()]
    rig = tmp_path / "set.toml"
    rig.write_text(
        "\n".join(['name = "set"', 'like = "sim"', 'level = "sim"', f"[{who}.clock]", *lines]),
        "utf-8",
    )
    flown = fly(str(rig), tmp_path / "run", 7)
    assert flown.facts.outcome == "clock_fault", flown.facts.detail
    said = f"this drone's own clock was set by {step_s:+.3g} s"
    assert flown.facts.detail == f"{who}: {said}"
    assert flown.last_outcome(Role(who))["detail"] == said
    assert flown.facts.violations == {}
    # nothing looked old that was not: its script brought it down itself
    assert flown.last_outcome(Role.SENDER)["landed"] and flown.last_outcome(Role.RECEIVER)["landed"]
    if at_s == IN_VERIFY_S:
        assert "verify" in [r.record["phase"] for r in flown.run.role(Role(who))["/phase"]]


def test_a_marker_of_another_id_is_said_by_its_id(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In rendered frames: what was there instead is looked for on the ground, in the last that was
    searched.
    """
    usual = errors.other_print

    def printed(layout: MarkerLayout, *given: Any) -> MarkerLayout:
        built = usual(layout, *given)
        return replace(
            built, markers=tuple(replace(each, id=each.id + 7) for each in built.markers)
        )

    monkeypatch.setattr(errors, "other_print", printed)
    text = rig_library.whole("sim-rendered")
    assert text.count("[mission.target]") == 1
    impatient = text.replace(
        "[mission.target]", "[mission.deadlines]\nsearch_s = 4.0\n\n[mission.target]"
    )
    slower = impatient.replace("rate_hz = 50.0", "rate_hz = 20.0")
    assert slower != impatient
    (tmp_path / "rig.toml").write_text(slower, "utf-8")
    flown = fly(str(tmp_path / "rig.toml"), tmp_path / "out")
    assert flown.facts.outcome == "marker_not_found"
    told = "marker 7 of DICT_4X4_50 is there: asked for is marker 0 of DICT_4X4_50"
    assert any(told in note for note in flown.summary["notes"])
    assert any(told in r.record["note"] for r in flown.run.receiver["/note"])

"""The name of a whole run: the cause, not what followed from it; and what is written down of it."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import missions.fly.handoff.command
import missions.fly.handoff.flight
from drivers.interfaces import PartError
from drivers.rig.parts import Rig, with_slow
from flight.harness.flights import FlightReport, FlightRequest, RoleResult
from flight.outcome import Outcome
from hil.world.check import check_world
from missions.fly.handoff.flight import fly_once, harness_of, judge
from missions.ground import rig_library
from missions.ground.options.flights import HandoffOptions
from missions.ground.pace import Pace, Stage
from missions.ground.run_folder import new_folder
from missions.look.report.records import FACTS
from path.messages import Role

BOTH_DOWN = dict.fromkeys(Role, True)


def result(role: Role, outcome: Outcome, detail: str = "seen") -> RoleResult:
    return RoleResult(role, outcome, detail, responsible=False, landed=True)


def report(sender: Outcome | None, receiver: Outcome | None, **changes: Any) -> FlightReport:
    """``None``: the program died."""
    ends = {Role.SENDER: sender, Role.RECEIVER: receiver}
    results = {role: None if end is None else result(role, end) for role, end in ends.items()}
    fields: dict[str, Any] = {
        "results": results, "landed": BOTH_DOWN, "violations": {}, "simulated_s": 60.0, "wall_s": 1.0
    }  # fmt: skip
    return FlightReport(**{**fields, **changes})


def test_both_committed_and_down_is_committed() -> None:
    assert judge(report(Outcome.COMMITTED, Outcome.COMMITTED)) == (Outcome.COMMITTED, "")


@pytest.mark.parametrize(
    ("sender", "receiver", "cause", "whose"),
    [
        (Outcome.PEER_ABORTED, Outcome.MARKER_LOST, Outcome.MARKER_LOST, "receiver"),
        (Outcome.TARGET_LOST, Outcome.PEER_ABORTED, Outcome.TARGET_LOST, "sender"),
        (Outcome.PEER_LOST, Outcome.CAMERA_LOST, Outcome.CAMERA_LOST, "receiver"),
        (Outcome.PEER_LOST, None, Outcome.CRASHED, "receiver"),
        (None, Outcome.PEER_LOST, Outcome.CRASHED, "sender"),
        (Outcome.GUARD, Outcome.COMMITTED, Outcome.GUARD, "sender"),
        (Outcome.COMMITTED, Outcome.TARGET_LOST, Outcome.TARGET_LOST, "receiver"),
        (Outcome.COMMITTED, None, Outcome.CRASHED, "receiver"),
        (Outcome.ORPHANED, Outcome.ORPHANED, Outcome.ORPHANED, "sender"),
        (Outcome.NO_AGREEMENT, Outcome.PEER_ABORTED, Outcome.NO_AGREEMENT, "sender"),
    ],
)
def test_the_cause_is_the_end_that_nothing_else_explains(
    sender: Outcome | None, receiver: Outcome | None, cause: Outcome, whose: str
) -> None:
    outcome, detail = judge(report(sender, receiver))
    assert outcome is cause
    assert detail.startswith(f"{whose}: ")


@pytest.mark.parametrize(
    ("sender", "receiver"),
    list(itertools.product((Outcome.PEER_LOST, Outcome.PEER_ABORTED), repeat=2)),
)
def test_when_each_blames_the_other_one_of_them_is_named(
    sender: Outcome, receiver: Outcome
) -> None:
    outcome, detail = judge(report(sender, receiver))
    assert outcome is sender
    assert detail == "sender: seen"


@pytest.mark.parametrize(
    ("sender_s", "receiver_s", "whose"), [(20.0, 19.5, "receiver"), (19.5, 20.0, "sender")]
)
def test_of_two_causes_the_one_is_named_that_came_first(
    sender_s: float, receiver_s: float, whose: str
) -> None:
    ends = {
        Role.SENDER: replace(result(Role.SENDER, Outcome.NO_AGREEMENT), ended_s=sender_s),
        Role.RECEIVER: replace(result(Role.RECEIVER, Outcome.CLOCK_FAULT), ended_s=receiver_s),
    }
    outcome, detail = judge(report(None, None, results=ends))
    assert (outcome, detail) == (ends[Role(whose)].outcome, f"{whose}: seen")


def test_a_run_is_committed_only_when_both_are() -> None:
    for sender, receiver in itertools.product([None, *Outcome], repeat=2):
        outcome, _ = judge(report(sender, receiver))
        assert (outcome is Outcome.COMMITTED) == (sender is receiver is Outcome.COMMITTED), (
            sender,
            receiver,
        )


@pytest.mark.parametrize("up", Role)
def test_a_hand_over_that_leaves_a_vehicle_in_the_air_is_no_success(up: Role) -> None:
    outcome, detail = judge(
        report(Outcome.COMMITTED, Outcome.COMMITTED, landed={**BOTH_DOWN, up: False})
    )
    assert outcome is Outcome.VEHICLE_REFUSED
    assert detail == "a vehicle did not land"


def test_a_violated_monitor_beats_every_end() -> None:
    for ends in ((Outcome.COMMITTED, Outcome.COMMITTED), (None, Outcome.GUARD)):
        judged = judge(
            report(*ends, violations={"S9": 1}, notes=("S9 at 3.00 s: near",), interrupted=True)
        )
        assert judged == (Outcome.MONITOR_VIOLATED, "S9 at 3.00 s: near")


@pytest.mark.parametrize(
    "other", [Outcome.NOT_STARTED, Outcome.PEER_LOST, Outcome.TARGET_NOT_FOUND, None]
)
def test_that_nobody_started_a_program_is_named_before_what_came_of_it(
    other: Outcome | None,
) -> None:
    late = {
        "failure": "the run did not end within 360 s",
        "interrupted": True,
        "overload": "its pictures were late",
    }
    for changes in ({}, late):
        outcome, detail = judge(report(other, Outcome.NOT_STARTED, **changes))
        assert outcome is Outcome.NOT_STARTED
        assert "receiver: seen. Serve the world again" in detail
        assert detail.startswith("sender: seen; ") == (other is Outcome.NOT_STARTED)


def test_a_violated_monitor_is_not_explained_by_a_program_that_nobody_started() -> None:
    judged = judge(
        report(
            Outcome.GUARD, Outcome.NOT_STARTED, violations={"S9": 1}, notes=("S9 at 3.00 s: near",)
        )
    )
    assert judged == (Outcome.MONITOR_VIOLATED, "S9 at 3.00 s: near")


def test_another_object_has_an_end_of_its_own_and_beats_the_commit() -> None:
    judged = judge(
        report(
            Outcome.COMMITTED, Outcome.COMMITTED, violations={"S12": 1}, notes=("S12 at 3.00 s: 1",)
        )
    )
    assert judged == (Outcome.WRONG_OBJECT, "S12 at 3.00 s: 1")


def test_a_computer_that_is_too_slow_is_named_instead_of_the_flight() -> None:
    late = "the sender's pictures: 300 of 400 were not rendered in time"
    lost = report(Outcome.TARGET_LOST, Outcome.PEER_ABORTED, overload=late)
    assert judge(lost) == (Outcome.OVERLOADED, f"{late} (and so target_lost: sender: seen)")
    other = report(
        Outcome.COMMITTED, Outcome.COMMITTED, overload=late, violations={"S12": 1}, notes=("S12",)
    )
    assert judge(other)[0] is Outcome.OVERLOADED
    assert (
        judge(report(None, None, overload=late, failure="the world did not end"))[0]
        is Outcome.OVERLOADED
    )


def test_a_slow_computer_excuses_neither_two_responsible_nor_a_pilot_and_spoils_no_commit() -> None:
    late = "the sender's program: 200 of 500 frames were late"
    good = (Outcome.COMMITTED, Outcome.COMMITTED)
    assert judge(report(*good, overload=late)) == (Outcome.COMMITTED, "")
    explained: dict[str, Any] = {"overload": late, "explained": ("S8",)}
    assert (
        judge(report(*good, **explained, violations={"S1": 1, "S8": 4}))[0]
        is Outcome.MONITOR_VIOLATED
    )
    assert judge(report(*good, overload=late, violations={"S9": 1}))[0] is Outcome.MONITOR_VIOLATED
    assert (
        judge(report(Outcome.PILOT_OVERRIDE, Outcome.PEER_LOST, overload=late))[0]
        is Outcome.PILOT_OVERRIDE
    )
    assert judge(report(None, Outcome.PEER_LOST, overload=late))[0] is Outcome.CRASHED


def test_setpoints_that_stopped_are_excused_by_what_the_computer_did_just_then_and_by_nothing_else() -> (
    None
):
    late = "sender's program had no core for 0.19 s of the 0.24 s without a setpoint at 12.00 s"
    good = (Outcome.COMMITTED, Outcome.COMMITTED)
    assert (
        judge(report(*good, overload=late, explained=("S8",), violations={"S8": 1}))[0]
        is Outcome.OVERLOADED
    )
    pictures = "the sender's pictures: 300 of 400 were not rendered in time"
    assert (
        judge(report(*good, overload=pictures, violations={"S8": 1}))[0] is Outcome.MONITOR_VIOLATED
    )
    assert (
        judge(report(*good, overload=pictures, violations={"S8": 1, "S7": 1}))[0]
        is Outcome.MONITOR_VIOLATED
    )


def test_a_failed_harness_proves_nothing_about_the_mission() -> None:
    judged = judge(report(None, None, violations={"S1": 1}, failure="the world's process ended"))
    assert judged == (Outcome.HARNESS_FAILED, "the world's process ended")


def test_an_interrupted_run_is_called_so() -> None:
    outcome, _ = judge(report(Outcome.INTERRUPTED, Outcome.PEER_LOST, interrupted=True))
    assert outcome is Outcome.INTERRUPTED


# --- the run folder


@pytest.mark.parametrize(
    ("ends", "violations", "code"),
    [
        ((Outcome.COMMITTED, Outcome.COMMITTED), {}, 0),
        ((Outcome.NO_AGREEMENT, Outcome.PEER_ABORTED), {}, 10),
        ((Outcome.COMMITTED, Outcome.COMMITTED), {"S9": 2}, 40),
    ],
)
def test_a_run_leaves_its_facts(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    ends: tuple[Outcome, Outcome],
    violations: Mapping[str, int],
    code: int,
) -> None:
    asked: list[FlightRequest] = []

    class FakeHarness:
        def fly(self, request: FlightRequest) -> FlightReport:
            asked.append(request)
            return report(*ends, violations=violations, notes=("one", "two"))

    def fake_harness_of(rig: Rig) -> FakeHarness:
        return FakeHarness()

    monkeypatch.setattr(missions.fly.handoff.flight, "harness_of", fake_harness_of)
    rig = rig_library.load("sim")
    facts = fly_once(rig, 7, ["lookalike"], tmp_path, lambda _: None)
    assert facts.exit_code == code
    written = json.loads((tmp_path / FACTS).read_bytes())
    assert (written["exit_code"], written["outcome"], written["seed"]) == (code, facts.outcome, 7)
    assert written["faults"] == ["lookalike"]
    assert written["violations"] == violations
    assert written["notes"] == ["one", "two"]
    (request,) = asked
    assert (request.seed, tuple(request.faults), request.out) == (7, ("lookalike",), tmp_path)
    command = list(request.role_command(Role.RECEIVER))
    assert command[1:4] == ["-m", "missions.cli", "receiver"]
    assert command[command.index("--rig") + 1] == str(rig.file)
    assert command[command.index("--out") + 1] == str(tmp_path)
    assert command[command.index("--console") + 1] == "events"


def test_a_rig_of_real_drones_has_no_harness() -> None:
    rig = rig_library.load("sim")
    assert callable(harness_of(rig).fly)
    with pytest.raises(PartError) as caught:
        harness_of(replace(rig, harness=None))
    assert "path-handoff sender --rig sim" in caught.value.remedy
    assert "path-handoff receiver --rig sim" in caught.value.remedy


def test_a_folder_is_made_with_all_above_it(tmp_path: Path) -> None:
    assert new_folder(tmp_path / "a" / "b").is_dir()
    assert new_folder(tmp_path / "a" / "b").is_dir()  # again


def test_without_a_name_the_folder_is_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = new_folder(None)
    assert folder.parent == Path("runs")
    assert (tmp_path / folder).is_dir()


def test_a_folder_that_cannot_be_made_names_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PartError) as caught:
        new_folder(tmp_path / "file" / "run")
    assert "--out" in caught.value.remedy


@pytest.mark.parametrize("rig", ["sim", "sim-rendered"])
def test_programs_that_are_no_processes_of_their_own_cannot_be_slowed_down(
    rig: str, tmp_path: Path
) -> None:
    with pytest.raises(PartError, match=r"world\.slow"):
        missions.fly.handoff.command.run(HandoffOptions(rig, slow=0.2, out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_a_share_that_flies_nothing_is_refused_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = Pace((640, 480), {"link": Stage(1.0, 1.0)}, Stage(50.0, 50.0))
    monkeypatch.setattr("missions.ground.computer.pace_of", lambda *_, own_only: [slow])  # type: ignore[misc]
    with pytest.raises(PartError, match="too little for the sender"):
        missions.fly.handoff.command.run(HandoffOptions("sitl", slow=0.1, out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_a_share_of_a_core_is_asked_for_by_the_option_or_the_rig() -> None:
    rig = with_slow(rig_library.load("sitl"), 0.2)
    check_world(rig)
    assert rig.world["slow"] == 0.2
    assert with_slow(rig, None).world["slow"] == 0.2
    with pytest.raises(PartError, match="no harness"):
        with_slow(replace(rig, harness=None), 0.2)

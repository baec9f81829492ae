"""What is reported of a run in real time: of its logs, its programs, its world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from drivers.log.mcap_log import McapLog, new_part
from flight.harness.flights import FlightReport
from hil.harness import sitl
from hil.harness.realtime import children
from hil.harness.realtime.run import Ending, RealTimeRun
from path.messages import Role
from tests.hil.harness.programs_on_stage import (
    Stage,
    result,
    saying,
)

FOUND = {"landed": {"sender": True, "receiver": True}, "violations": {}, "details": []}


def report(
    stage: Stage, finished: Mapping[str, Any] = FOUND, failure: str = "", dead: Sequence[Role] = ()
) -> FlightReport:
    run = RealTimeRun(sitl.orders_of(stage.request, {}), sitl.ENDS, {})
    for role in Role:
        run.drones[role.value].result = None if role in dead else result(role)
    return sitl.report_of(stage.request, run, Ending(finished, failure, "", 50.0, 0.0))


def log_responsibility(
    stage: Stage, role: Role, *changes: tuple[int, bool], ended: bool = True
) -> None:
    with McapLog(new_part(stage.out, role.value)) as log:
        for stamp_ns, responsible in changes:
            log.write("/responsibility", stamp_ns, {"responsible": responsible, "until_ns": None})
        if ended:
            log.write("/outcome", changes[-1][0] + 1, {"outcome": "committed"})


def test_a_good_run_reports_no_violation(stage: Stage) -> None:
    log_responsibility(stage, Role.SENDER, (10, True), (20, False))
    log_responsibility(stage, Role.RECEIVER, (30, True))
    good = report(stage)
    assert (good.violations, good.failure, list(good.notes)) == ({}, "", [])
    assert good.landed == dict.fromkeys(Role, True)
    assert good.results == {role: result(role) for role in Role}


def test_the_logs_of_both_roles_are_judged_in_the_order_of_time(stage: Stage) -> None:
    """The receiver's log is read after the sender's; what counts is when it was written."""
    log_responsibility(stage, Role.SENDER, (10, True), (30, False))
    log_responsibility(stage, Role.RECEIVER, (20, True))
    assert report(stage).violations == {"S1": 1}


def test_the_logs_of_a_role_s_programs_are_judged_one_after_another(stage: Stage) -> None:
    """A dead program is responsible for nothing; one that was started again is what it says."""
    log_responsibility(stage, Role.SENDER, (10, True), ended=False)
    log_responsibility(stage, Role.RECEIVER, (20, True))
    assert report(stage).violations == {}
    log_responsibility(stage, Role.SENDER, (30, True))
    assert report(stage).violations == {"S1": 1}


def test_what_the_world_saw_is_added(stage: Stage) -> None:
    log_responsibility(stage, Role.SENDER, (10, True))
    log_responsibility(stage, Role.RECEIVER, (20, True))
    finished = {
        "landed": {"sender": True, "receiver": False},
        "violations": {"S1": 1, "S9": 2},
        "details": ["S9 at 3.00 s: near"],
    }
    bad = report(stage, finished=finished)
    assert bad.violations == {"S1": 2, "S9": 2}
    assert bad.landed == {Role.SENDER: True, Role.RECEIVER: False}
    assert "S9 at 3.00 s: near" in bad.notes


def test_a_dead_program_is_named_with_its_last_words(stage: Stage) -> None:
    (stage.out / "receiver.stderr.txt").write_text("Traceback\n  ...\nValueError: no such camera\n")
    dead = report(stage, dead=[Role.RECEIVER])
    assert dead.results[Role.RECEIVER] is None
    (note,) = dead.notes
    assert note.startswith("the receiver's program died") and note.endswith(
        "ValueError: no such camera"
    )


def test_a_world_without_findings_is_a_failure(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(children, "FINDINGS_S", 0.2)
    stage.fly({role: saying(result(role)) for role in Role}, world="import sys; sys.stdin.read()")
    assert stage.ending.failure == "the world did not end"
    silent = report(stage, finished={}, failure=stage.ending.failure)
    assert silent.landed == dict.fromkeys(Role, False)


START_NS = 7_000_000_000
WITH_A_GAP = {
    **FOUND,
    "violations": {"S8": 1},
    "details": ["S8 at 12.00 s: sender: 0.244 s between setpoints, until 12.24 s"],
    "gaps": [{"who": "sender", "from_s": 12.0, "to_s": 12.244}],
    "stalls": [[12.1, 12.5]],
    "start_ns": START_NS,
}


def log_lateness(stage: Stage, role: Role, until_s: float, waited_s: float) -> None:
    with McapLog(new_part(stage.out, role.value)) as log:
        stamp_ns = START_NS + round(until_s * 1e9)
        own = {"since_ns": 230_000_000, "loop_ns": 190_000_000, "waited_ns": round(waited_s * 1e9)}
        log.write("/late", stamp_ns, {**own, "beside_ns": 0, "stolen_ns": 0, "disk_ns": 0})
        log.write("/outcome", stamp_ns + 1, {"outcome": "committed"})


def test_a_gap_while_its_own_program_had_no_core_is_the_computers_and_is_told_with_that(
    stage: Stage,
) -> None:
    log_lateness(stage, Role.SENDER, 12.24, 0.18)
    late = report(stage, WITH_A_GAP)
    assert (late.violations, late.explained) == ({"S8": 1}, ("S8",))
    assert (
        late.overload
        == "sender's program had no core for 0.18 s of the 0.24 s without a setpoint at 12.00 s"
    )
    said = "then its program's loop was 0.19 s late and had no core for 0.18 s, the world stood still for 0.40 s"
    assert list(late.notes) == [
        f"S8 at 12.00 s: sender: 0.244 s between setpoints, until 12.24 s; {said}"
    ]


@pytest.mark.parametrize(
    ("role", "until_s", "waited_s"),
    [
        pytest.param(Role.SENDER, 12.24, 0.0, id="its loop was late by its own doing"),
        pytest.param(Role.SENDER, 30.0, 0.18, id="at another time"),
        pytest.param(Role.RECEIVER, 12.24, 0.18, id="the other drone's program"),
    ],
)
def test_a_gap_that_nothing_explains_stays_a_violation(
    stage: Stage, role: Role, until_s: float, waited_s: float
) -> None:
    log_lateness(stage, role, until_s, waited_s)
    late = report(stage, WITH_A_GAP)
    assert (late.violations, late.explained, late.overload) == ({"S8": 1}, (), "")


def test_a_failsafe_that_did_not_come_is_not_explained_by_a_gap_that_is(stage: Stage) -> None:
    log_lateness(stage, Role.SENDER, 12.24, 0.18)
    assert report(stage, {**WITH_A_GAP, "violations": {"S8": 2}}).explained == ()

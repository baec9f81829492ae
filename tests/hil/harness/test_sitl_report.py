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


def log_responsibility(stage: Stage, role: Role, *changes: tuple[int, bool], ended: bool = True) -> None:
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
    assert note.startswith("the receiver's program died") and note.endswith("ValueError: no such camera")


def test_a_world_without_findings_is_a_failure(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(children, "FINDINGS_S", 0.2)
    stage.fly({role: saying(result(role)) for role in Role}, world="import sys; sys.stdin.read()")
    assert stage.ending.failure == "the world did not end"
    silent = report(stage, finished={}, failure=stage.ending.failure)
    assert silent.landed == dict.fromkeys(Role, False)

"""Another object than was designated has its own outcome and exit code in every command that knows
the truth.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import missions.fly.handoff.command
import missions.fly.handoff.flight
import missions.proofs.campaign.role_runs
from flight.outcome import exit_code_of_runs
from missions.fly.handoff.right_object import watch_object
from missions.ground.options.flights import HandoffOptions
from missions.ground.options.proofs import CampaignOptions
from missions.look.report.records import FACTS, WORLD_LOG
from missions.proofs.campaign import run as campaign
from missions.proofs.campaign.results import RunLine
from missions.trials.run import exit_code
from missions.trials.shared.trial import TrialResult
from tests.missions.replayed import REPORT, Replayed

MakeRun = Callable[..., Path]


def test_the_right_object_is_no_violation(make_run: MakeRun) -> None:
    assert watch_object(REPORT, make_run()) is REPORT


def test_the_wrong_object_is_one_and_says_which(make_run: MakeRun) -> None:
    seen = watch_object(REPORT, make_run(followed_id=1))
    assert seen.violations == {"S12": 1}
    assert seen.notes == (
        "windy",
        "S12 at 27.05 s: object 1 was handed over, object 0 was designated",
    )


def test_without_a_commit_nothing_was_handed_over(make_run: MakeRun) -> None:
    assert watch_object(REPORT, make_run(followed_id=1, committed=False)) is REPORT


def test_without_truth_nothing_is_known(make_run: MakeRun, tmp_path: Path) -> None:
    assert watch_object(REPORT, make_run(followed_id=1, world=False)) is REPORT
    assert watch_object(REPORT, tmp_path / "nothing") is REPORT


@pytest.fixture
def other_object(make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_run(followed_id=1)

    def harness_of(_: Any) -> Replayed:
        return Replayed(folder)

    monkeypatch.setattr(missions.fly.handoff.flight, "harness_of", harness_of)
    monkeypatch.setattr(missions.proofs.campaign.role_runs, "harness_of", harness_of)


@pytest.mark.usefixtures("other_object")
def test_a_single_handoff_says_it_and_does_not_end_with_0(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = missions.fly.handoff.command.run(
        HandoffOptions("sim", out=tmp_path / "flown", picture=False)
    )
    facts = json.loads((tmp_path / "flown" / FACTS).read_bytes())
    summary = json.loads((tmp_path / "flown" / "summary.json").read_bytes())
    assert (code, facts["outcome"], facts["exit_code"]) == (42, "wrong_object", 42)
    assert (summary["outcome"], summary["monitors"], summary["wrong_handover"]) == (
        "wrong_object",
        {"S12": 1},
        True,
    )
    assert "object 1 was handed over, object 0 was designated" in capsys.readouterr().out
    assert (tmp_path / "flown" / WORLD_LOG).exists()


@pytest.mark.usefixtures("other_object")
def test_runs_of_a_campaign_count_it(tmp_path: Path) -> None:
    order = campaign.RunOrder("sim", 0, (("none", 0),))
    (line,) = missions.proofs.campaign.role_runs.fly(order)
    assert [what.partition(" ")[0] for what in line.violations] == ["S12"]
    options = CampaignOptions("roles", runs=1, out=tmp_path)
    kept = RunLine(0, "none", "commit", line.violations, (), {})
    assert campaign.report(options, tmp_path, [kept]) == 42


def test_many_runs_end_with_it() -> None:
    assert exit_code_of_runs({"S9": 1, "S12": 2}) == 42
    assert exit_code_of_runs({"S9": 1}) == 40
    assert exit_code_of_runs({}) == 0


def test_a_trial_ends_with_it() -> None:
    assert exit_code([TrialResult({}, (), violations={"S12": 1})]) == 42
    assert exit_code([TrialResult({}, ()), TrialResult({}, (), violations={"S8": 3})]) == 40
    assert exit_code([None, TrialResult({}, ())]) == 7
    assert exit_code([TrialResult({}, ())]) == 0

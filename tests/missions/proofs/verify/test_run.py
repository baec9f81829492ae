from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import PartError
from missions.ground.options.proofs import VerifyOptions
from missions.proofs.verify import run
from missions.proofs.verify.explore import explore
from missions.proofs.verify.model import Scope
from missions.proofs.verify.mutants import MUTANTS, SMALL, Mutant, wrong

TINY = (
    run.Job("tiny", replace(SMALL, lease=3, offer=3, handoff=4)),
    run.Job("tiny, covered", replace(SMALL, lease=3, offer=3, handoff=4, aborts=1), exact=False),
)
COMMITS_FIRST = next(
    mutant for mutant in MUTANTS if mutant.rule == "the sender says COMMIT, and then releases"
)


def verified(
    out: Path, monkeypatch: pytest.MonkeyPatch, mutants: Sequence[Mutant] = MUTANTS[:2]
) -> tuple[int, dict[str, Any]]:
    monkeypatch.setattr(run, "QUICK", TINY)
    monkeypatch.setattr(run, "MUTANTS", tuple(mutants))
    code = run.run(VerifyOptions(out=out, quick=True, jobs=1))
    return code, json.loads((out / "summary.json").read_text())


def test_all_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, summary = verified(tmp_path / "new", monkeypatch)
    assert code == 0 and summary["holds"]
    assert summary["violations"] == 0 and summary["violations_of"] == dict.fromkeys(
        run.INVARIANTS, 0
    )
    assert summary["mutants"] == summary["mutants_caught"] == 2
    tiny, covered = summary["scopes"]
    assert summary["states"] == tiny["states"] + covered["states"] > 1000
    assert tiny["method"] == "exact" and covered["method"] == "covering"
    assert tiny["complete"] and tiny["depth"] > 10 and tiny["in_flight"] >= 4
    assert [one["rule"] for one in summary["caught"]] == [mutant.rule for mutant in MUTANTS[:2]]
    shown = capsys.readouterr().out
    assert (
        f"{tiny['states']:,}" in shown
        and "mutants caught: 2 of 2" in shown
        and "VIOLATED" not in shown
    )


def test_a_violation_is_shown_step_by_step_and_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with wrong(COMMITS_FIRST):
        code, summary = verified(tmp_path, monkeypatch)
    assert code == run.EXIT_BROKEN and not summary["holds"]
    assert (
        summary["violations_of"]["S4"] > 0
        and summary["violations"] >= summary["violations_of"]["S4"]
    )
    shown = capsys.readouterr().out
    assert "VIOLATED: tiny" in shown
    assert "1. the sender offers the target" in shown
    assert "the agreement is complete: breaks S4" in shown


def test_a_mutant_that_is_not_caught_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    harmless = Mutant("nothing is skipped", ("S1",), [], TINY[0].scope)
    code, summary = verified(tmp_path, monkeypatch, [MUTANTS[0], harmless])
    assert code == run.EXIT_BROKEN
    assert (summary["mutants"], summary["mutants_caught"]) == (2, 1)
    assert "nothing is skipped: NOT CAUGHT" in capsys.readouterr().out


def test_what_was_not_explored_to_its_end_does_not_hold() -> None:
    cut = explore(TINY[0].scope, limit=100)
    summary = run.summarize([run.Explored(TINY[0], cut, 1.0)], [], 1.0)
    assert summary["violations"] == 0 and not summary["holds"]


def test_the_results_do_not_depend_on_the_number_of_processes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(run, "MUTANTS", MUTANTS[:2])
    with run.open_work(1) as one, run.open_work(2) as two:
        alone, shared = (run.verify(work, TINY) for work in (one, two))
    assert [done.found for done in alone[0]] == [done.found for done in shared[0]]
    assert [(done.rule, done.broke, done.states) for done in alone[1]] == [
        (done.rule, done.broke, done.states) for done in shared[1]
    ]


def test_the_full_set_has_what_is_asked_of_it() -> None:
    scopes: list[Scope] = [job.scope for job in run.FULL]
    assert max(scope.crashes for scope in scopes) >= 2
    assert (
        max(scope.attempts for scope in scopes) >= 2 and max(scope.aborts for scope in scopes) >= 2
    )
    assert all(scope.guard and scope.uncertainty for scope in scopes)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PartError, match="cannot make"):
        run.run(VerifyOptions(out=tmp_path / "file" / "sub"))


def test_the_wire_is_fuzzed_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run.run(VerifyOptions(out=tmp_path, wire=2_000, seed=4, jobs=1)) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["holds"] and summary["seed"] == 4 and summary["packets"] >= 2_000
    shown = capsys.readouterr().out
    assert "sent once more" in shown and "bad_signature" in shown
    assert "0 taken or raised" in shown and "0 lost" in shown

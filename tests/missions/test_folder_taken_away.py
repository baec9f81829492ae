"""``--out`` is taken away while something flies: the end says so, and never "refused before
anything moved".
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import missions.fly.handoff.flight
import missions.proofs.verify.run
from drivers.log.mcap_log import McapLog
from flight.harness.flights import FlightReport, FlightRequest
from flight.outcome import Outcome
from missions import cli
from tests.missions.replayed import REPORT, Replayed

MakeRun = Callable[..., Path]
GONE = "it was taken away while it was written to"


class Removed(Replayed):
    """A flight whose folder somebody removes; ``again`` makes an empty one in its place."""

    def __init__(self, folder: Path, again: bool) -> None:
        super().__init__(folder)
        self._again = again

    def fly(self, request: FlightRequest) -> FlightReport:
        super().fly(request)
        shutil.rmtree(request.out)
        if self._again:
            request.out.mkdir()
        return REPORT


def ended(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    assert isinstance(end.value.code, int)
    said = capsys.readouterr()
    return end.value.code, said.out + said.err


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("command", ["handoff --rig sim", "fly tests/missions/fly/own/search.py"])
def test_a_flight_whose_folder_was_removed_is_not_called_refused(
    make_run: MakeRun, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    command: str, again: bool,
) -> None:  # fmt: skip
    harness = Removed(make_run(), again)

    def harness_of(_: Any) -> Removed:
        return harness

    monkeypatch.setattr(missions.fly.handoff.flight, "harness_of", harness_of)
    out = tmp_path / "out"
    code, said = ended(capsys, *command.split(), "--out", str(out))
    assert code == Outcome.LOG_FAILED.exit_code, said
    assert str(out) in said and "Traceback" not in said and "refused" not in said


def test_another_command_whose_folder_was_removed_names_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"

    def work(*_: Any) -> Any:
        shutil.rmtree(out)
        return [], []

    def summarized(*_: Any) -> dict[str, bool]:
        return {"holds": True}

    monkeypatch.setattr(missions.proofs.verify.run, "verify", work)
    monkeypatch.setattr(missions.proofs.verify.run, "summarize", summarized)
    code, said = ended(capsys, "verify", "--quick", "--out", str(out))
    assert (code, f"{out}: {GONE}" in said) == (6, True), said


@pytest.mark.parametrize("buffered", [False, True])
def test_a_log_that_was_taken_away_has_failed(tmp_path: Path, buffered: bool) -> None:
    (tmp_path / "out").mkdir()
    with McapLog(tmp_path / "out" / "sender.mcap", "sender", buffered=buffered) as log:
        log.write("/phase", 1, {"phase": "land"})
        shutil.rmtree(tmp_path / "out")
    assert log.failed is not None and "taken away" in log.failed and "sender.mcap" in log.failed

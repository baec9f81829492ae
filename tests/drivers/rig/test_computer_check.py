"""The findings about the computer itself."""

from __future__ import annotations

import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.rig import computer_check
from drivers.rig.computer_check import clock_finding, write_finding


def test_a_folder_is_written_to_and_left_empty(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(computer_check, "WRITE_S", 0.05)
    monkeypatch.setattr(computer_check, "SLOW_MB_S", 0.0)
    finding = write_finding(tmp_path / "runs")
    assert finding.state == "ok"
    assert " MB/s into " in finding.detail
    assert list((tmp_path / "runs").iterdir()) == []
    monkeypatch.setattr(computer_check, "SLOW_MB_S", 1e9)
    assert write_finding(tmp_path / "runs").state == "note"


def test_a_folder_that_cannot_be_written_to_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("no folder")
    assert write_finding(tmp_path / "runs").state == "fault"


@pytest.mark.parametrize(
    ("said", "state", "words"), [("yes\n", "ok", "set by NTP"), ("no\n", "note", "not set by NTP")]
)
def test_the_wall_clock_is_told(
    monkeypatch: pytest.MonkeyPatch, said: str, state: str, words: str
) -> None:
    def answer(*_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace(stdout=said)

    monkeypatch.setattr(subprocess, "run", answer)
    finding = clock_finding()
    assert finding.state == state
    assert words in finding.detail


def test_without_anybody_to_ask_it_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object, **__: object) -> None:
        raise FileNotFoundError("timedatectl")

    monkeypatch.setattr(subprocess, "run", missing)
    assert "not known" in clock_finding().detail

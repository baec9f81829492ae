"""A flight's end is told by its exit code, whatever becomes of the disk and of whoever reads the
output.
"""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import missions.fly.handoff.command
import missions.fly.handoff.flight
from flight.command_end import CommandEnd
from missions import cli
from missions.ground.options.flights import HandoffOptions
from tests.missions.replayed import Replayed

MakeRun = Callable[..., Path]
FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "summary.json")


def fail(*_: Any) -> None:
    raise FULL


@pytest.fixture
def flown(make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Makes ``handoff`` replay a run."""

    def replay(**run: Any) -> None:
        folder = make_run(**run)

        def harness_of(_: Any) -> Replayed:
            return Replayed(folder)

        monkeypatch.setattr(missions.fly.handoff.flight, "harness_of", harness_of)

    return replay


@pytest.mark.parametrize("what", ["write_facts", "make_report"])
@pytest.mark.parametrize(("followed", "code"), [(0, 35), (1, 42)])
def test_a_full_disk_at_the_end(
    flown: Callable[..., None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    what: str, followed: int, code: int,
) -> None:  # fmt: skip
    flown(followed_id=followed)
    where = missions.fly.handoff.flight if what == "write_facts" else missions.fly.handoff.command
    monkeypatch.setattr(where, what, fail)
    assert (
        missions.fly.handoff.command.run(
            HandoffOptions("sim", out=tmp_path / "flown", picture=False)
        )
        == code
    )
    said = capsys.readouterr()
    assert "No space left on device" in said.out + said.err
    assert "Traceback" not in said.err


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EDQUOT])
def test_a_command_that_cannot_write_names_the_file_and_the_fix(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: int
) -> None:
    def run(_: object) -> int:
        raise OSError(error, os.strerror(error), "table.csv")

    monkeypatch.setattr(cli, "run", run)
    with pytest.raises(SystemExit) as ended:
        cli.main(["rigs"])
    assert ended.value.code == CommandEnd.OUTPUT_FAILED.exit_code
    said = capsys.readouterr().err
    assert f"error: table.csv: {os.strerror(error)}\n  fix: " in said


def test_other_errors_of_the_system_are_not_dressed_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(_: object) -> int:
        raise ConnectionRefusedError

    monkeypatch.setattr(cli, "run", run)
    with pytest.raises(ConnectionRefusedError):
        cli.main(["rigs"])


@pytest.mark.parametrize(
    ("shell", "code"),
    [
        ("{} rigs >/dev/full", 6),
        ("{} rigs --check nope >/dev/full 2>/dev/full", 3),
        ("{} rigs >&-", 0),
        ("{} rigs >&- 2>&-", 0),
        ("{} rigs --check nope 2>&-", 3),
    ],
)
def test_a_closed_or_full_output_ends_no_command_in_a_traceback(shell: str, code: int) -> None:
    command = shell.format(f"{sys.executable} -m missions.cli")
    ran = subprocess.run(["/bin/sh", "-c", command], capture_output=True, text=True, check=False)
    assert (ran.returncode, "Traceback" in ran.stderr, "Exception ignored" in ran.stderr) == (
        code,
        False,
        False,
    )

"""Two programs with one --out: the second is refused, names the first, and the first's files are as
it left them.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from missions import cli
from missions.ground.held import held_file, held_folder
from missions.ground.run_folder import claimed, new_folder, unless_refused
from missions.look.report.records import RUN
from tests.missions.ground.test_run_folder import COMMANDS

HOLD = """
import sys, time
from pathlib import Path
from missions.ground.held import held_file, held_folder
what, path, beside = sys.argv[1:4]
with held_file(Path(path)) if what == "file" else held_folder(Path(path), beside=beside == "beside"):
    print("held", flush=True)
    time.sleep(600.0)
"""


@contextmanager
def another_program(
    what: str, path: Path, beside: str = ""
) -> Generator[subprocess.Popen[str], None, None]:
    command = [sys.executable, "-c", HOLD, what, str(path), beside]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


def refused(line: str) -> tuple[int, str]:
    """Exit code and error of a command line in a process of its own."""
    ran = subprocess.run(
        [sys.executable, "-m", "missions.cli", *line.split()],
        capture_output=True,
        text=True,
        check=False,
        timeout=120.0,
    )
    return ran.returncode, ran.stderr


def test_the_second_of_two_flights_into_a_folder_is_refused_and_the_first_is_what_it_would_have_been(
    tmp_path: Path,
) -> None:
    out = tmp_path / "run"
    first = [
        sys.executable,
        "-m",
        "missions.cli",
        "handoff",
        "--rig",
        "sim",
        "--seed",
        "7",
        "--out",
        str(out),
    ]
    with subprocess.Popen(first, stdout=subprocess.DEVNULL, start_new_session=True) as process:
        try:
            end_s = time.monotonic() + 120.0
            while not (out / "run.json").exists() and time.monotonic() < end_s:
                time.sleep(0.02)
            os.kill(process.pid, signal.SIGSTOP)
            code, said = refused(f"handoff --rig sim --seed 8 --out {out}")
            os.kill(process.pid, signal.SIGCONT)
            assert code == 3, said
            assert (
                f"{out} is being written to by process {process.pid} (" in said and "fix: " in said
            )
            assert process.wait(timeout=300.0) == 0
        finally:
            process.kill()
    summary = json.loads((out / "summary.json").read_bytes())
    assert (summary["seed"], summary["outcome"]) == (7, "committed")


FOLDERS = {
    "handoff": "handoff --rig sim", "many handoffs": "handoff --rig sim --seeds 2", "relay": "relay", "team": "team",
    "fly": "fly tests/missions/fly/own/search.py", "verify": "verify --quick", "campaign": "campaign --runs 1",
    "trial": "trial sensitivity", "all trials": "trial all --quick", "guard --measure": "guard --rig sim --measure",
    "conformance": "conformance --no-fly",
}  # fmt: skip


@pytest.mark.parametrize("beside", ["", "beside"])
@pytest.mark.parametrize("name", FOLDERS)
def test_no_command_writes_into_a_folder_that_another_program_writes_into(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str, beside: str
) -> None:
    with another_program("folder", tmp_path, beside) as process, pytest.raises(SystemExit) as ended:
        cli.main([*FOLDERS[name].split(), "--out", str(tmp_path)])
    said = capsys.readouterr().err
    assert ended.value.code == 3, said
    assert f"is being written to by process {process.pid} (" in said and "--out" in said
    assert list(tmp_path.iterdir()) == []


FILES = {name: COMMANDS[name][1] for name in ("calibrate camera", "calibrate mount")}


@pytest.mark.parametrize("name", FILES)
def test_no_command_writes_a_file_that_another_program_writes(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    file = COMMANDS[name][0]
    with another_program("file", folder / file) as process, pytest.raises(PartError) as told:
        FILES[name](folder)
    assert str(told.value) == f"{folder / file} is being written by process {process.pid}"


def test_programs_of_one_run_write_beside_each_other_and_a_new_run_waits_for_the_last_of_them(
    tmp_path: Path,
) -> None:
    with another_program("folder", tmp_path, "beside") as sender:
        with another_program("folder", tmp_path, "beside"):
            pass
        with pytest.raises(PartError, match=str(sender.pid)), held_folder(tmp_path):
            pass
    with held_folder(tmp_path):
        pass


def test_a_lock_ends_with_its_program_whatever_ended_it(tmp_path: Path) -> None:
    file = tmp_path / "d1.camera.toml"
    with another_program("folder", tmp_path) as folder, another_program("file", file) as other:
        os.kill(folder.pid, signal.SIGKILL)
        os.kill(other.pid, signal.SIGKILL)
        folder.wait()
        other.wait()
        with held_folder(tmp_path), held_file(file):
            pass
    assert list(tmp_path.iterdir()) == []


def test_what_a_program_does_inside_its_own_folder_needs_no_further_lock(tmp_path: Path) -> None:
    with unless_refused(tmp_path) as folder, claimed(folder, RUN), held_folder(folder, beside=True):
        pass
    with another_program("folder", tmp_path):
        pass


def test_a_folder_that_goes_by_another_name_is_the_same_folder(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with (
        another_program("folder", tmp_path / "real"),
        pytest.raises(PartError),
        held_folder(tmp_path / "link"),
    ):
        pass


def test_where_a_file_cannot_be_locked_it_is_written_all_the_same(tmp_path: Path) -> None:
    with held_file(tmp_path / "none" / "d1.camera.toml"):
        pass


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_runs_that_begin_in_the_same_second_have_folders_of_their_own(here: Path) -> None:
    folders = {new_folder(None) for _ in range(3)}
    assert len(folders) == 3
    assert all(folder.is_dir() for folder in folders)
    assert {folder.parent.resolve() for folder in folders} == {here / "runs"}


def test_a_role_whose_record_another_program_keeps_is_refused(here: Path) -> None:
    del here
    state = Path("sender.state.json")
    with another_program("file", state) as process:
        code, said = refused(f"sender --rig sitl --guard none --state {state} --out run")
    assert (code, f"sender.state.json is being written by process {process.pid}" in said) == (
        3,
        True,
    ), said
    assert not Path("run").exists()

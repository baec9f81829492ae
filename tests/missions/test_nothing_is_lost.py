"""Whatever is named for what a command writes: nothing of anybody's is written over, and what is no
file is told.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drivers.log.mcap_log import McapLog
from missions import cli
from missions.ground import kernel_cache
from missions.ground.kernel_cache import have_kernel_cache, have_temporary_folder, usual_folders
from tests.missions.conftest import MakeRun

REFUSED = 3


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "mine.mcap").write_text("mine")
    (tmp_path / "cut.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(20))
    with McapLog(tmp_path / "sender.mcap") as log:
        log.write("/note", 1, {"note": "taking off"})
    return tmp_path


def tree(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }


def ended(capsys: pytest.CaptureFixture[str], line: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as end:
        cli.main(line.split())
    assert isinstance(end.value.code, int)
    said = capsys.readouterr()
    return end.value.code, " ".join((said.out + said.err).split())


WRITES = {
    "merge sender.mcap --out sender.mcap": "sender.mcap is one of the logs: it is not written over",
    "merge sender.mcap --out ./folder/../sender.mcap": "is one of the logs",
    "merge sender.mcap --out mine.mcap": "mine.mcap is there, and is no earlier result",
    "merge sender.mcap --out folder": "folder is a folder",
    "merge sender.mcap --out /proc/merged.mcap": "cannot write /proc/merged.mcap",
    "merge cut.mcap": "cut.mcap: nothing can be read of it",
    "view sender.mcap --save sender.mcap": "sender.mcap is there, and is no earlier result",
    "view sender.mcap --save mine.mcap": "mine.mcap is there, and is no earlier result",
    "view sender.mcap --save folder": "folder is a folder",
    "view cut.mcap --save run.rrd": "cut.mcap: nothing can be read of it",
    "view --layout mine.mcap": "mine.mcap is there, and is no earlier result",
    "view --layout folder": "folder is a folder",
    "calibrate marker --out folder": "folder is a folder",
    "calibrate marker --out /proc/marker.svg": "cannot write /proc/marker.svg",
    "calibrate board --out folder": "folder is a folder",
    "calibrate board --out board.doc": "board.doc: a picture of this kind is not written",
    "calibrate board --out board": "board: a picture of this kind is not written",
    "calibrate board --out /proc/board.png": "cannot write /proc/board.png",
    "calibrate camera --images folder --out folder": "folder is a folder",
    "calibrate camera --images folder --out /proc/c.toml": "cannot write /proc/c.toml",
    "calibrate camera --images folder --out mine.mcap": "mine.mcap is there, and is no earlier result",
    "calibrate mount --rig sim --images folder --dictionary DICT_5X5_100 --out folder": "folder is a folder",
}  # fmt: skip


@pytest.mark.parametrize("line", WRITES)
def test_what_is_there_is_not_written_over_and_what_is_no_file_is_told(
    here: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    before = tree(here)
    code, said = ended(capsys, line)
    assert (code, WRITES[line] in said) == (REFUSED, True), said
    assert "fix: " in said
    assert tree(here) == before


def test_an_earlier_result_is_written_again(
    here: Path, capsys: pytest.CaptureFixture[str], make_run: MakeRun
) -> None:
    run = make_run()
    for _ in range(2):
        assert ended(capsys, f"merge {run} --out all.mcap")[0] == 0
        assert ended(capsys, "view --layout layout.json")[0] == 0


# --- the account and its folders


@pytest.mark.parametrize("variable", ["TMPDIR", "TEMP", "TMP"])
@pytest.mark.parametrize("folder", ["/proc", "/nowhere/at/all", "/dev/null", "mine.mcap"])
def test_a_folder_for_temporary_files_that_is_none_is_named(
    here: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    variable: str,
    folder: str,
) -> None:
    for other in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(variable, folder)
    code, said = ended(capsys, "rigs --check sim")
    assert code == REFUSED
    assert f"{variable} = {folder} cannot be written to: temporary files have no place" in said
    assert f"fix: set {variable} to a folder" in said


def test_a_computer_without_any_place_for_temporary_files_says_so(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def none() -> str:
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp', '/var/tmp']")

    for variable in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", none)
    code, said = ended(capsys, "rigs --check sim")
    assert code == REFUSED
    assert "/var/tmp" in said and "free some disk, or set TMPDIR" in said


def test_an_account_without_a_home_is_flown_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a container's, which is named by a number alone."""

    def nobody(_: int) -> object:
        raise KeyError("getpwuid(): uid not found")

    monkeypatch.setattr("pwd.getpwuid", nobody)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert usual_folders() == (kernel_cache.INSTALLED / "path",)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr(kernel_cache, "INSTALLED", Path("/proc/install"))
    have_kernel_cache(temporary=tmp_path)
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / f"path-handoff-kernels-{os.getuid()}")
    assert ended(capsys, "rigs --check sim")[0] == 0


@pytest.mark.parametrize("home", ["/proc/1", "/nowhere", "/dev/null", ""])
def test_a_home_that_is_another_s_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    monkeypatch.setenv("HOME", home)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr(kernel_cache, "INSTALLED", Path("/proc/install"))

    def only_here(folder: Path) -> bool:
        return folder.is_relative_to(tmp_path)

    monkeypatch.setattr(kernel_cache, "can_write", only_here)
    have_kernel_cache(temporary=tmp_path)
    assert os.environ["NUMBA_CACHE_DIR"].startswith(str(tmp_path))


def test_a_temporary_folder_that_works_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    have_temporary_folder()

"""A read-only install and an unwritable home have their named end, or none at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from missions.ground.kernel_cache import VARIABLE, can_write, have_kernel_cache

NOWHERE = (Path("/proc/kernels"), Path("/dev/null/kernels"))
"""A folder in which nobody can write, not even root."""


@pytest.fixture(autouse=True)
def unset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "")


def test_where_a_usual_folder_can_be_written_to_nothing_is_changed(tmp_path: Path) -> None:
    have_kernel_cache((*NOWHERE, tmp_path / "to be made"), tmp_path)
    assert os.environ[VARIABLE] == ""
    assert list(tmp_path.iterdir()) == []


def test_else_a_folder_of_our_own_is_made_and_told_to_every_program_that_is_started(
    tmp_path: Path,
) -> None:
    have_kernel_cache(NOWHERE, tmp_path)
    own = Path(os.environ[VARIABLE])
    assert own.parent == tmp_path
    assert own.stat().st_mode & 0o777 == 0o700
    os.environ[VARIABLE] = ""
    have_kernel_cache(NOWHERE, tmp_path)  # again
    assert Path(os.environ[VARIABLE]) == own


def test_a_folder_in_which_others_can_write_is_not_used(tmp_path: Path) -> None:
    have_kernel_cache(NOWHERE, tmp_path)
    own = Path(os.environ[VARIABLE])
    own.chmod(0o777)
    os.environ[VARIABLE] = ""
    with pytest.raises(PartError, match="belongs to somebody else") as refused:
        have_kernel_cache(NOWHERE, tmp_path)
    assert VARIABLE in refused.value.remedy


def test_a_link_to_somewhere_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    (tmp_path / f"path-handoff-kernels-{os.getuid()}").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(PartError, match="belongs to somebody else"):
        have_kernel_cache(NOWHERE, tmp_path)


def test_where_nothing_can_be_written_the_folders_and_the_fix_are_named() -> None:
    with pytest.raises(PartError, match="/proc/kernels, /dev/null/kernels, /proc/") as refused:
        have_kernel_cache(NOWHERE, Path("/proc"))
    assert VARIABLE in refused.value.remedy


def test_a_named_folder_that_cannot_be_written_to_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(VARIABLE, "/proc/mine")
    with pytest.raises(PartError, match="/proc/mine cannot be written to"):
        have_kernel_cache((tmp_path,), tmp_path)


def test_a_home_of_another_user_into_which_nobody_may_look_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked = Path.exists

    def exists(path: Path) -> bool:
        if "theirs" in path.parts:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return looked(path)

    monkeypatch.setattr(Path, "exists", exists)
    assert not can_write(Path("/theirs/.cache"))
    have_kernel_cache((Path("/theirs/.cache"),), tmp_path)
    assert Path(os.environ[VARIABLE]).parent == tmp_path


def test_what_can_be_written_to(tmp_path: Path) -> None:
    assert can_write(tmp_path)
    assert can_write(tmp_path / "a" / "b")
    (tmp_path / "file").write_text("")
    assert not can_write(tmp_path / "file" / "b")
    assert not any(can_write(folder) for folder in NOWHERE)

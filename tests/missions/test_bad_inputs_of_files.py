"""Pipes, devices, names that are too long, seeds that run out, Ctrl-C while things are loaded: each
is told.
"""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.interfaces import StateError
from drivers.log.state_file import StateFile
from drivers.rig.tables import read_toml
from drivers.text_file import MOST_BYTES, read_file
from missions import cli
from path.messages import Role

NAME = "a" * 300
REFUSED, NOT_FIT = 3, 4


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("p", "p.toml", "p.mp4", "p.mcap", "p.py", "p.onnx", "p.db3", "p.json", "p.key"):
        os.mkfifo(tmp_path / name)
    return tmp_path


def ended(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    assert isinstance(end.value.code, int)
    said = capsys.readouterr()
    return end.value.code, " ".join((said.out + said.err).split())


PIPES = (
    "rigs --check p.toml", "handoff --rig p.toml", "doctor --rig p.toml", "fly p.py", "detect p.mp4", "detect p",
    "detect frames --model p.onnx", "merge p.mcap", "view p.mcap --save x.rrd", "view p --save x.rrd", "export p.db3",
    "export p --csv", "report p", "replay p", "replay p.toml", "calibrate camera --video p.mp4 --out c.toml",
    "calibrate camera --images p --out c.toml", "calibrate mount --rig sim --measured p.toml --out m.toml",
    "calibrate mount --rig sim --measured /dev/zero --out m.toml", "handoff --rig sim-rendered-person --model p.onnx",
    "handoff --rig sim-rendered-person --model /dev/zero", "handoff --rig sim --px4 p", "trial real --set p.toml",
    "trial ambiguity --xfeat p.onnx", "calibrate camera --video /dev/zero --out c.toml", "detect /dev/zero",
    "merge /dev/urandom", "sender --rig p.toml", "guard --rig /dev/zero", "handoff --rig sim --out p",
)  # fmt: skip


@pytest.mark.parametrize("line", PIPES)
def test_a_pipe_or_a_device_is_told_and_not_waited_for(
    here: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    (here / "frames").mkdir()
    code, said = ended(capsys, *line.split())
    assert code == (NOT_FIT if line.startswith("doctor") else REFUSED), said
    assert ("p" in said or "/dev/" in said) and "Traceback" not in said
    assert line.startswith("doctor") or "fix: " in said


LONG = (
    "handoff --rig {}", "handoff --rig {}.toml", "handoff --rig sim --out {}", "fly {}.py", "report {}", "replay {}",
    "detect {}.mp4", "rigs --new {}", "rigs --check {}", "merge {}", "export {} --csv", "view {} --save x.rrd",
    "calibrate camera --images . --out {}.toml", "calibrate mount --rig sim --measured {} --out m.toml",
    "sender --rig {}", "trial static --out {}", "verify --quick --out {}", "trial real --set {}",
)  # fmt: skip


@pytest.mark.parametrize("line", LONG)
def test_a_name_that_is_too_long_is_told(
    here: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    before = sorted(here.iterdir())
    code, said = ended(capsys, *line.format(NAME).split())
    assert code == REFUSED, said
    assert "aaaa" in said and "fix: " in said and "Traceback" not in said
    assert sorted(here.iterdir()) == before


@pytest.mark.parametrize("seed", [2**32 - 1, 2**32 - 2])
def test_seeds_that_run_out_are_told_before_anything_flies(
    here: Path, capsys: pytest.CaptureFixture[str], seed: int
) -> None:
    code, said = ended(
        capsys, "handoff", "--rig", "sim", "--seed", str(seed), "--seeds", "3", "--out", "run"
    )
    assert code == REFUSED and f"the last seed would be {seed + 2}" in said, said
    assert not (here / "run").exists()


@pytest.mark.parametrize("table", ["sender.camera", "sender.mount.marker"])
@pytest.mark.parametrize("file", ["p.toml", "/dev/zero", ".", "none.toml"])
def test_a_calibration_that_is_no_file_is_named(
    here: Path, capsys: pytest.CaptureFixture[str], table: str, file: str
) -> None:
    (here / "rig.toml").write_text(f'like = "sim"\n[{table}]\ncalibration = "{file}"\n')
    code, said = ended(capsys, "handoff", "--rig", "rig.toml", "--out", "run")
    assert code == REFUSED and f"{table}.calibration" in said and "fix: " in said, said
    assert not (here / "run").exists()


def test_a_state_file_that_is_a_pipe_is_told(here: Path) -> None:
    with pytest.raises(StateError, match=r"p\.json: it is not a regular file"):
        StateFile(here / "p.json", Role.SENDER).load()


def test_a_file_without_an_end_is_not_read_to_it(here: Path) -> None:
    with (here / "large.toml").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(OSError, match="more than 16 MiB"):
        read_toml(here / "large.toml")
    with pytest.raises(OSError, match="not a regular file"):
        read_file(Path("/dev/zero"))


INTERRUPTED = """
import os, signal, sys
from importlib.abc import MetaPathFinder
from missions import cli

class Stop(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Stop())
assert sys.argv[1] not in sys.modules
cli.main(sys.argv[2:])
"""


@pytest.mark.parametrize(
    "module",
    ["tyro", "missions.ground.options.field", "missions.field.rig_list", "tomllib", "numpy"],
)
def test_ctrl_c_while_a_command_is_loaded_ends_it_in_silence(module: str) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, module, "rigs", "--check", "sim"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (130, "")


def test_a_locale_without_the_letters_of_a_name_gets_an_escape_of_them(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = here / "said"
    with written.open("w", encoding="ascii") as out:
        monkeypatch.setattr(sys, "stdout", out)
        monkeypatch.setattr(sys, "stderr", out)
        with pytest.raises(SystemExit) as end:
            cli.main(("rigs", "--check", "h\u0435ading.toml"))
    assert end.value.code == REFUSED
    assert r"error: h\u0435ading.toml: no such rig file" in written.read_text("ascii")


def test_help_in_a_terminal_of_one_column_ends(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "1")
    assert ended(capsys, "rigs", "--help")[0] == 0


@pytest.mark.parametrize("line", ["rigs --check {}/r.toml", "detect {}/film.mp4", "fly {}/m.py"])
def test_a_folder_that_another_user_keeps_to_himself_is_named(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    looked = os.stat

    def stat(path: object, *rest: object, **more: object) -> os.stat_result:
        if "/theirs/" in str(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return looked(path, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "stat", stat)
    code, said = ended(capsys, *line.format(here / "theirs").split())
    assert code == REFUSED, said
    assert "Permission denied" in said and "free some space" not in said

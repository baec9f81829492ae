"""Bad input of every kind: nothing flies, nothing ends in a traceback, each is named with its fix,
nothing is left.

The tables are data: a row is what is given and what the user is told.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import missions.fly.fleet.command
import missions.fly.handoff.command
from drivers.interfaces import PartError, StateError
from drivers.link.wire import KEY_LENGTH, Codec, Drop
from drivers.log.state_file import StateFile
from flight.harness.flights import decode_event
from flight.outcome import Outcome
from missions import cli
from missions.look.report.records import load_facts
from path.messages import Ping, Role
from tests.missions.bad_rigs import RIGS

Said = Callable[..., tuple[int, str]]
"""Exit code and everything that was said by a command line."""


def tree(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }


@pytest.fixture
def said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Said:
    """Carries out a command line in this process, in an empty folder of its own, and fails when
    anything would fly.
    """
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")

    def fly(*_: object) -> None:
        raise AssertionError("it flies")

    monkeypatch.setattr(missions.fly.handoff.command, "fly_once", fly)
    monkeypatch.setattr(missions.fly.fleet.command, "fly", fly)

    def run(*arguments: str) -> tuple[int, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main(arguments)
        out, err = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, " ".join((out + err).split())

    return run


def rig_like_sim(folder: Path, text: str) -> str:
    head = "" if text.startswith(("like", "\x00", "][", "a = ")) else 'like = "sim"\n'
    (folder / "rig.toml").write_text(head + text, "utf-8")
    return str(folder / "rig.toml")


@pytest.mark.parametrize(
    ("text", "expected"), RIGS, ids=[f"{k}-{expected[:50]}" for k, (_, expected) in enumerate(RIGS)]
)
def test_a_bad_rig_is_refused_by_name_before_anything_moves(
    said: Said, tmp_path: Path, text: str, expected: str
) -> None:
    rig = rig_like_sim(tmp_path, text)
    before = tree(tmp_path)
    code, words = said("handoff", "--rig", rig, "--out", str(tmp_path / "out"))
    assert code == 3, words
    assert expected in words
    assert "rig.toml" in words and "fix: " in words
    assert tree(tmp_path) == before
    assert not (tmp_path / "out").exists()


# --- the command line

LINES: tuple[tuple[str, int, str], ...] = (
    ("handoff --rig sim --seed -1", 3, "--seed: -1 is not within 0..4294967295"),
    (
        "handoff --rig sim --seed 99999999999999999999",
        3,
        "--seed: 99999999999999999999 is not within",
    ),
    ("handoff --rig sim --seeds 0", 3, "--seeds: 0 runs is not within 1..1000000 runs"),
    (
        "handoff --rig sim --seeds -7",
        3,
        "--seeds: -7 runs is not within 1..1000000 runs: a sign too many?",
    ),
    (
        "handoff --rig sim --seeds 2 --jobs -3",
        3,
        "--jobs: -3 processes is not within 0..1024 processes",
    ),
    ("handoff --rig stil", 3, "no rig named 'stil' (did you mean 'sitl'?)"),
    ("handoff --rig none.toml", 3, "none.toml: no such rig file"),
    ("handoff --rig .", 3, "no rig named '.'"),
    ("handoff --rig /etc/passwd", 3, "passwd: "),
    ("handoff --rig sim --px4 /none", 3, "/none: no such file"),
    ("handoff --rig /usr/lib", 3, "/usr/lib: a folder, and no rig file"),
    ("handoff --out=", 3, "--out=: its value is empty fix: give one, or leave it out"),
    ("handoff \u2014rig sim", 2, "\u2014rig"),
    ("handoff --seed 1e3", 2, "seed"),
    ("handoff --rig sim --rig sitl --seed -4", 3, "--seed: -4 is not within"),
    ("handoff --seed one", 2, "seed"),
    ("handoff --rgi sim", 2, "--rig"),
    ("fli", 2, "fli"),
    ("fly none.py", 3, "none.py"),
    ("fly none.py --seed -1", 3, "--seed: -1 is not within"),
    ("relay --drones 1", 3, "--drones: 1 drones is not within 2..100 drones"),
    ("relay --drones 9", 3, "rig relay names 5"),
    ("relay --hours -1", 3, "--hours: -1.0 h is not above 0 and at most 1000 h: a sign too many?"),
    ("relay --hours nan", 3, "--hours: nan h is not above 0"),
    ("relay --hours 28800", 3, "--hours: 28800.0 h is not above 0 and at most 1000 h: minutes?"),
    ("relay --rig sim", 3, "rig sim has no [relay]"),
    ("relay --seed -1", 3, "--seed: -1 is not within"),
    (
        "verify --wire -5",
        3,
        "--wire: -5 packets is not within 0..10000000000 packets: a sign too many?",
    ),
    ("verify --jobs -1", 3, "--jobs: -1 processes is not within"),
    ("verify --seed -1", 3, "--seed: -1 is not within"),
    ("campaign --runs 0", 3, "--runs: 0 runs is not within"),
    ("campaign --runs -5 --jobs -1", 3, "--jobs: -1 processes"),
    ("campaign --faults lossyy", 2, "lossyy"),
    ("campaign --only 3", 3, "--only shows one run: of which level?"),
    ("campaign --only -3 --faults lossy", 3, "--only: -3 is not within"),
    ("campaign --rig none", 3, "no rig named 'none'"),
    ("trial statics", 2, "statics"),
    ("trial static --seed -1", 3, "--seed: -1 is not within"),
    ("trial static --rig sim", 3, "sim.toml: trials: missing key 'renderer'"),
    (
        "trial dynamic --quick --rig dynamic-sim",
        3,
        "dynamic-sim.toml: trials: missing key 'estimator'",
    ),
    ("trial all --xfeat none.onnx", 3, "--xfeat none.onnx: no such file"),
    ("trial real --set none.toml", 3, "--set none.toml: no such file"),
    ("trial soak --seconds -1", 3, "--seconds: -1.0 s is not within"),
    ("report nowhere", 3, "nowhere is not the folder of a run"),
    ("report .", 3, "is not the folder of a run"),
    ("doctor --set-parameters", 3, "whose parameters?"),
    ("rigs --check none.toml", 3, "none.toml: no such rig file"),
    ("guard --rig none", 3, "no rig named 'none'"),
    ("sender --rig none", 3, "no rig named 'none'"),
    ("receiver --rig none.toml", 3, "none.toml: no such rig file"),
    ("sender", 2, "--rig"),
    ("detect none.mp4", 3, "none.mp4"),
    ("calibrate camera --images none --out c.toml", 3, "none"),
    (
        "calibrate board --square-m 30",
        3,
        "--square-m: 30.0 m is not within 0.002..1 m: millimetres?",
    ),
    ("calibrate board --dpi 0", 3, "--dpi: 0 dots per inch is not within"),
)


@pytest.mark.parametrize(("line", "code", "expected"), LINES, ids=[line for line, _, _ in LINES])
def test_a_bad_command_line_is_refused_with_its_fix(
    said: Said, tmp_path: Path, line: str, code: int, expected: str
) -> None:
    ended, words = said(*line.split())
    assert (ended, expected in words) == (code, True), words
    assert code == 2 or "fix: " in words
    assert tree(tmp_path) == {}
    assert list((tmp_path / "here").iterdir()) == []


# --- folders and files

OUTS = (
    "sender.mcap",
    "receiver.guard.mcap",
    "world.stderr.txt",
    "sender.state.json",
    "summary.json",
    "run.png",
)


@pytest.mark.parametrize("name", OUTS)
@pytest.mark.parametrize("seeds", ["1", "2"])
def test_a_folder_with_somebody_elses_files_is_refused_and_left_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    name: str,
    seeds: str,
) -> None:
    folder = tmp_path if seeds == "1" else tmp_path / "seed-0000"
    folder.mkdir(exist_ok=True)
    (folder / name).write_text("mine")
    (tmp_path / "notes.mcap").write_text("mine, too")
    before = tree(tmp_path)
    with pytest.raises(SystemExit) as ended:
        cli.main(
            ["handoff", "--rig", "sim", "--out", str(tmp_path), "--seeds", seeds, "--jobs", "1"]
        )
    assert ended.value.code == 3
    assert name in capsys.readouterr().err
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    "command", ["handoff --rig sim", "relay", "sender --rig sim", "verify", "trial static"]
)
def test_a_folder_that_cannot_be_made_is_refused(said: Said, command: str) -> None:
    code, words = said(*command.split(), "--out", "/proc/nowhere/run")
    assert code == 3
    assert "/proc/nowhere" in words and "--out" in words


def test_a_rig_with_a_byte_order_mark_is_read(tmp_path: Path, said: Said) -> None:
    (tmp_path / "rig.toml").write_bytes(b'\xef\xbb\xbflike = "sim"\n')
    assert said("rigs", "--check", str(tmp_path / "rig.toml"))[0] == 0


@pytest.mark.parametrize("content", [b"\xff\xfe[\x00", b"\x80\x81", b""])
def test_bytes_that_are_no_rig(tmp_path: Path, said: Said, content: bytes) -> None:
    (tmp_path / "rig.toml").write_bytes(content)
    code, words = said("rigs", "--check", str(tmp_path / "rig.toml"))
    assert code == 4
    assert "rig.toml: " in words


RECORDS = (
    b"",
    b"{",
    b"null",
    b"[]",
    b'{"record": 3}',
    b"\xff\xff",
    b'{"record": {"duty": "king"}}',
    b"0" * 100_000,
)


@pytest.mark.parametrize("content", RECORDS, ids=range(len(RECORDS)))
@pytest.mark.parametrize("role", Role)
def test_a_record_that_cannot_be_read_is_an_error_with_a_name(
    tmp_path: Path, role: Role, content: bytes
) -> None:
    (tmp_path / "state.json").write_bytes(content)
    with pytest.raises((StateError, PartError), match=r"state\.json"):
        StateFile(tmp_path / "state.json", role).load()
    assert (tmp_path / "state.json").read_bytes() == content


# --- the environment


@pytest.mark.parametrize("folder", ["/proc/kernels", "/dev/null/kernels"])
def test_kernels_without_a_place(said: Said, monkeypatch: pytest.MonkeyPatch, folder: str) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", folder)
    code, words = said("handoff", "--rig", "sim")
    assert code == 3
    assert f"NUMBA_CACHE_DIR = {folder} cannot be written to" in words
    assert "fix: set NUMBA_CACHE_DIR" in words


@pytest.mark.parametrize(
    ("variable", "rig"), [("PATH_PX4", "sitl-px4"), ("PATH_ARDUPILOT", "sitl-ardupilot")]
)
def test_a_simulator_that_is_not_there(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, variable: str, rig: str
) -> None:
    monkeypatch.setenv(variable, "/none/bin")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        cli.main(["handoff", "--rig", rig, "--out", "out"])
    assert ended.value.code == 3
    assert list(tmp_path.iterdir()) == []


# --- signals, to real processes


def test_a_signal_lands_a_flight_and_ends_it_by_name(tmp_path: Path) -> None:
    """SIGTERM, in virtual time. Ctrl-C and a terminal that goes away in real time are in
    ``scenarios``, and which signals land in ``drivers/test_stop_signals``.
    """
    command = [sys.executable, "-m", "missions.cli", "handoff", "--rig", "sim", "--no-picture"]
    with subprocess.Popen(
        [*command, "--out", "run"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        try:
            if any("take-off" in line for line in process.stdout):
                process.send_signal(signal.SIGTERM)
            _, errors = process.communicate(timeout=300.0)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    assert (process.returncode, errors) == (Outcome.INTERRUPTED.exit_code, "")
    facts = load_facts(tmp_path / "run")
    assert facts is not None and (facts.outcome, facts.violations) == ("interrupted", {})


# --- packets, and lines of programs


def packets() -> dict[str, bytes]:
    key = bytes(KEY_LENGTH)
    good = Codec(Role.SENDER, key).encode(Ping(1, time.monotonic_ns()))
    other = Codec(Role.SENDER, bytes([1] * KEY_LENGTH)).encode(Ping(1, 1))
    own = Codec(Role.RECEIVER, key).encode(Ping(1, 1))
    flips = {f"bit {k} of each byte": bytes(byte ^ (1 << k) for byte in good) for k in range(8)}
    single = {
        f"byte {k} turned": good[:k] + bytes([good[k] ^ 0xFF]) + good[k + 1 :]
        for k in range(len(good))
    }
    cuts = {f"the first {k} bytes": good[:k] for k in range(len(good))}
    return {
        "one byte more": good + b"\0", "twice": good + good, "another key": other, "an own one come back": own,
        "zeros": bytes(128), "ones": b"\xff" * 128, "text": b"GET / HTTP/1.1\r\n\r\n", "long": bytes(65_507),
        **flips, **single, **cuts,
    }  # fmt: skip


@pytest.mark.parametrize(("name", "packet"), packets().items(), ids=packets().keys())
def test_a_bad_packet_is_dropped_by_a_reason(name: str, packet: bytes) -> None:
    dropped = Codec(Role.RECEIVER, bytes(KEY_LENGTH)).decode(packet)
    assert isinstance(dropped, Drop), name


LINES_OF_PROGRAMS = (
    b"", b"\n", b"{", b"[]", b"null", b"3", b'"progress"', b'{"event": "progress"}', b'{"event": "result"}',
    b'{"event": "result", "role": "sender", "outcome": "fine"}', b'{"event": "progress", "role": "cook"}',
    b"\xff\xfe", b"[" * 10_000, b'{"event": 3, "role": "sender"}',
    b'{"event": "progress", "role": "sender", "evidence": 3}',
)  # fmt: skip


@pytest.mark.parametrize("line", LINES_OF_PROGRAMS, ids=range(len(LINES_OF_PROGRAMS)))
def test_what_a_program_says_beside_its_events_is_none(line: bytes) -> None:
    assert decode_event(line) is None


def test_there_are_enough_of_them() -> None:
    assert len(RIGS) + len(LINES) + len(OUTS) + len(RECORDS) + len(LINES_OF_PROGRAMS) >= 150


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("sender --rig sim", "rig sim has a guard that needs the simulated world"),
        ("receiver --rig sim", "path-handoff handoff --rig sim"),
        ("guard --rig sim", "needs the simulated world"),
    ],
)
def test_a_simulated_rig_is_not_flown_from_a_drone(
    said: Said, tmp_path: Path, command: str, expected: str
) -> None:
    before = tree(tmp_path)
    code, words = said(*command.split())
    assert code == 3 and expected in words and "fix: " in words, words
    assert tree(tmp_path) == before and list((tmp_path / "here").iterdir()) == []


@pytest.mark.parametrize("harness", ["json:loads", "os:getcwdb", "builtins:int"])
def test_a_harness_that_is_none(said: Said, tmp_path: Path, harness: str) -> None:
    rig = rig_like_sim(tmp_path, f'harness = "{harness}"\n')
    code, words = said("handoff", "--rig", rig, "--out", str(tmp_path / "out"))
    assert code == 3 and "harness" in words and "fix: " in words, words
    assert not (tmp_path / "out").exists()


STRANGE = {
    "another encoding": 'like = "sim"\n'.encode("utf-16"),
    "latin-1": '# \xe9\nlike = "sim"\n'.encode("latin-1"),
    "a list": b'like = ["sim"]\n',
    "no table": b'like = "sim"\nmission = 5\n',
    "a date": b'like = "sim"\n[mission]\ntake_off_height_m = 2020-01-01\n',
    "yes": b'like = "sim"\n[mission]\ntake_off_height_m = true\n',
    "in words": b'like = "sim"\n[mission]\ntake_off_height_m = "1.5"\n',
    "five thousand digits": b'like = "sim"\n[mission]\nhandoff_id = ' + 5000 * b"9" + b"\n",
    "three thousand brackets": b"a = " + 3000 * b"[" + 3000 * b"]",
    "said twice": b'like = "sim"\nlike = "sitl"\n',
    "like itself": b'like = "rig.toml"\n',
    "two of three": b'like = "sim"\n[sender.mount.camera]\nposition_b_m = [0.1, 0.2]\n',
    "a function": b'like = "sim"\n[sender.vehicle]\nfactory = "os:system"\n',
    "a module": b'like = "sim"\n[sender.vehicle]\nfactory = "os.path"\n',
    "a signed cable by TCP": b'like = "sitl"\n[sender.vehicle]\nurl = "tcpout://1.2.3.4:5"\nkey_file = "a.key"\n',
    "every byte": bytes(range(256)),
}


@pytest.mark.parametrize("name", STRANGE)
def test_a_strange_file_is_refused_by_its_name(said: Said, tmp_path: Path, name: str) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_bytes(STRANGE[name])
    code, words = said("handoff", "--rig", str(rig), "--out", str(tmp_path / "out"))
    assert code == 3 and "rig.toml" in words and "fix: " in words, words
    assert not (tmp_path / "out").exists() and rig.read_bytes() == STRANGE[name]

"""The command line: what is said to whom, with which exit code, and that nothing heavy is loaded to
say it.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from missions import cli
from missions.ground import rig_library
from missions.ground.options.field import (
    DoctorOptions,
    PrepareOptions,
    ReceiverOptions,
    RigsOptions,
    SenderOptions,
)
from missions.ground.options.flights import HandoffOptions
from missions.ground.options.proofs import TrialOptions
from missions.ground.options.runs import ReportOptions
from missions.ground.rigs import tables

HEAVY = ("numpy", "cv2", "numba", "mavsdk", "pymavlink", "matplotlib", "scipy")


def parsed(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    """Returns the command that a command line asks for, without doing it."""
    commands: list[object] = []

    def keep(command: object) -> int:
        commands.append(command)
        return 0

    monkeypatch.setattr(cli, "run", keep)
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 0
    return commands[0]


def test_the_defaults_fly_the_sitl_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    assert parsed(monkeypatch, "handoff") == HandoffOptions(
        rig="sitl", seed=0, seeds=1, fault=(), out=None
    )


def test_all_options_of_a_handoff(monkeypatch: pytest.MonkeyPatch) -> None:
    faults = ("--fault", "lookalike", "--fault", "link_loss=0.3")
    command = parsed(
        monkeypatch,
        "handoff",
        "--rig",
        "sim",
        "--seed",
        "7",
        "--seeds",
        "100",
        *faults,
        "--errors",
        "exact",
        "--scene",
        "dusk",
        "--out",
        "a/b",
    )
    assert command == HandoffOptions(
        "sim", 7, 100, 0, ("lookalike", "link_loss=0.3"), "exact", "dusk", Path("a/b")
    )


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("sender", "--rig", "r.toml"), SenderOptions("r.toml")),
        (
            ("receiver", "--rig", "r.toml", "--out", "o", "--console", "events"),
            ReceiverOptions("r.toml", Path("o"), "events"),
        ),
        (("doctor",), DoctorOptions("sitl")),
        (("rigs",), RigsOptions()),
        (("prepare", "--rig", "sim"), PrepareOptions("sim")),
        (("report", "runs/x", "--no-picture"), ReportOptions(Path("runs/x"), False)),
        (
            ("trial", "all", "--quick", "--xfeat", "x.onnx"),
            TrialOptions("all", quick=True, xfeat=Path("x.onnx")),
        ),
    ],
)
def test_the_other_commands(
    monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], expected: object
) -> None:
    command = parsed(monkeypatch, *arguments)
    assert command == expected
    assert type(command) is type(expected)


def test_every_command_has_a_module_that_runs_it() -> None:
    for _, module in cli.COMMANDS.values():
        assert importlib.util.find_spec(f"missions.{module}") is not None, module


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["handoff", "--seed", "x"], ["Error parsing --seed", "path-handoff --help"]),
        (
            ["handoff", "--sed", "3"],
            ["Unrecognized options: --sed, 3", "in path-handoff campaign --help"],
        ),
        (["calibrate", "camra"], ["Available subcommands: camera,"]),
        (["hand", "--seed", "3"], ["Available subcommands: handoff, rehearse"]),
    ],
)
def test_what_is_not_understood_is_told_once_by_all_commands(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    error = capsys.readouterr().err
    assert ended.value.code == 2
    assert [error.count(word) for word in words] == [1] * len(words)


def test_help_of_a_command_is_of_all_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["relay", "--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    assert shown.startswith("usage: path-handoff relay")
    assert all(f"--{option}" in shown for option in ("rig", "drones", "hours", "seed", "fault"))


def test_a_command_that_is_named_brings_only_its_own_options() -> None:
    program = (
        "import sys\nfrom missions import cli\ncli.run = lambda command: 0\n"
        "try:\n    cli.main(['rigs'])\n"
        "except SystemExit:\n    print(sorted(m for m in sys.modules if m.startswith('missions.ground.options.')))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ran.stdout == "['missions.ground.options.field', 'missions.ground.options.words']\n"


def test_a_refusal_names_problem_and_fix_and_has_its_own_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(command: object) -> int:
        raise PartError("one thing\nanother thing", "do this")

    monkeypatch.setattr(cli, "run", refuse)
    with pytest.raises(SystemExit) as ended:
        cli.main(["rigs"])
    assert ended.value.code == cli.EXIT_REFUSED
    assert capsys.readouterr().err == "error: one thing\n       another thing\n  fix: do this\n"


def test_an_unforeseen_error_is_not_dressed_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(command: object) -> int:
        raise ZeroDivisionError

    monkeypatch.setattr(cli, "run", fail)
    with pytest.raises(ZeroDivisionError):
        cli.main(["rigs"])


def test_a_reader_that_has_seen_enough_gets_no_traceback() -> None:
    command = [sys.executable, "-m", "missions.cli", "--help"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(300.0) == cli.EXIT_BROKEN_PIPE


def test_an_unknown_rig_lists_the_rigs(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["sender", "--rig", "stil"])
    assert ended.value.code == cli.EXIT_REFUSED
    error = capsys.readouterr().err
    assert "no rig named 'stil' (did you mean 'sitl'?)" in error
    assert all(rig in error for rig in tables())


def test_the_rigs_are_listed_with_what_they_are_for(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["rigs"])
    shown = capsys.readouterr().out
    for rig, table in tables().items():
        assert f"{rig:<13} {table['description']}\n" in shown
    assert "    --level sitl --autopilot embedded|px4|ardupilot|mixed, --light\n" in shown
    assert len(tables()) <= 18


@pytest.mark.parametrize("arguments", [["--help"], ["handoff", "--help"], ["rigs"]])
def test_what_does_not_fly_loads_nothing_heavy(arguments: list[str]) -> None:
    program = (
        "import sys\nfrom missions.cli import main\n"
        f"try:\n    main({arguments})\n"
        f"except SystemExit:\n    print('loaded:', [m for m in {HEAVY} if m in sys.modules])"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ran.stdout.splitlines()[-1] == "loaded: []"


def test_a_drones_program_brings_no_harness_and_no_renderer() -> None:
    program = (
        "import sys\nfrom missions.ground.rig_library import load\n"
        "load('sitl', world=False)\n"
        "print(sorted(m for m in sys.modules if m.startswith(('hil.harness', 'hil.render', 'hil.world'))))\n"
        "load('sitl')\n"
        "print('hil.harness.sitl' in sys.modules)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ran.stdout.splitlines() == ["[]", "True"]


def test_switching_level_changes_parts_and_nothing_else() -> None:
    levels = [tomllib.loads(rig_library.whole(level)) for level in ("sim", "sim-rendered", "sitl")]
    for table in levels:
        # as PX4 was measured where time is real, shortened where it is virtual
        for own in ("autopilot", "airframe"):
            table["world"].pop(own, None)
    for table in levels[1:]:
        for key in ("origin", "method", "mission", "world", "markers"):
            assert table.get(key) == levels[0].get(key), key
        for role in ("sender", "receiver"):
            for key in ("camera", "mount"):
                assert table[role][key] == levels[0][role][key], (role, key)

"""--level, --autopilot and --light beside --rig, and the names that say the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from missions import cli
from missions.fly.handoff import command as handoff
from missions.ground import rig_library
from missions.ground.options.flights import HandoffOptions

OLD = """dynamic dynamic-sim hitl relay-sim relay-sitl sim sim-drone sim-fast sim-field sim-person
sim-person-indoor sim-px4 sim-rendered sim-rendered-drone sim-rendered-person sim-tello sitl
sitl-ardupilot sitl-ardupilot-field sitl-ardupilot-field-light sitl-ardupilot-indoor
sitl-ardupilot-light sitl-drone sitl-field sitl-light sitl-mixed sitl-mixed-field
sitl-mixed-field-light sitl-person sitl-px4 sitl-px4-field sitl-px4-field-light sitl-px4-indoor
sitl-px4-indoor-light sitl-px4-light sitl-tello team-sim team-sitl"""


@pytest.mark.parametrize("name", OLD.split())
def test_a_name_of_before_is_the_same_rig_under_its_own_name(name: str) -> None:
    rig = rig_library.load_unchecked(name)
    assert (rig.name, rig.file.stem) == (name, name)
    assert rig.level == ("sim-rendered" if name == "sim-tello" else rig.level)
    assert rig_library.name_of(rig) == name


@pytest.mark.parametrize(
    ("words", "flown", "told"),
    [
        ("", "sitl", ""),
        ("--rig sim", "sim", ""),
        ("--rig car", "car", ""),
        ("--level sim", "sim", ""),
        ("--rig car --level sim", "sim", ""),
        ("--rig person --level sim-rendered", "sim-rendered-person", ""),
        ("--rig field --level sitl --autopilot px4 --light", "sitl-px4-field-light", ""),
        ("--autopilot mixed", "sitl-mixed", ""),
        ("--rig sitl-px4 --autopilot embedded", "sitl", ""),
        ("--rig sim-person", "sim-person", "rig sim-person: it is called --rig person --level sim now\n"),
        ("--rig sim-tello", "sim-tello", "rig sim-tello: it is called --rig tello --level sim-rendered now\n"),
    ],
)  # fmt: skip
def test_options_and_name_make_one_rig(
    words: str,
    flown: str,
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked: list[HandoffOptions] = []

    def keep(options: HandoffOptions) -> int:
        asked.append(options)
        return 0

    monkeypatch.setattr(handoff, "run", keep)
    with pytest.raises(SystemExit):
        cli.main(["handoff", *words.split()])
    assert asked == [replace(HandoffOptions(), rig=flown)]
    assert capsys.readouterr().err == told


def test_options_beside_a_rigs_file_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.toml").write_text('like = "sim"\n', "utf-8")
    with pytest.raises(SystemExit) as ended:
        cli.main(["plan", str(tmp_path / "mine.toml"), "--level", "sitl"])
    assert ended.value.code == cli.EXIT_REFUSED
    told = capsys.readouterr().err
    assert "mine.toml says its level, its autopilot and its pictures itself" in told
    assert "rehearse" in told


def test_a_rig_is_shown_whole(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["rigs", "--show", "sitl-px4-light"])
    assert ended.value.code == 0
    (tmp_path / "mine.toml").write_text(capsys.readouterr().out, "utf-8")
    mine = rig_library.load(str(tmp_path / "mine.toml"))
    theirs = rig_library.load("sitl-px4-light")
    assert (mine.mission, mine.world, mine.method) == (theirs.mission, theirs.world, theirs.method)
    assert mine.sender.vehicle.options == theirs.sender.vehicle.options

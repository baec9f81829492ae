"""What a rig's file says, laid over what it is like: keys left out, both drones at once, options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.rig.choice import Choice
from drivers.rig.read import find_rig, read_rig
from drivers.rig.tables import RigError

BENCH = """
[options]
sitl = ["embedded", "px4", "mixed"]
sim = ["embedded"]
light = ["sitl"]

[world]
wind = { speed_mps = 1.5, gust_mps = 0.4 }

[both.vehicle]
factory = "a:Vehicle"
rate_hz = 10

[receiver.vehicle]
rate_hz = 5

[when.sim.world]
steps = 3

[when."sitl px4, mixed"]
drop = ["world.wind.gust_mps"]
both.vehicle.autopilot = "px4"

[when."light embedded"]
like = "wind"
world.light = true
"""
WIND = 'name = "wind"\n[world]\nstorm = true\nwind = { gust_mps = 9.0 }\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "car.toml").write_text(BENCH, "utf-8")
    (tmp_path / "wind.toml").write_text(WIND, "utf-8")
    (tmp_path / "van.toml").write_text(
        'like = "car"\n[options]\nsitl = ["px4"]\n[world]\nvan = true\n', "utf-8"
    )
    return tmp_path


def read(folder: Path, name: str) -> dict[str, Any]:
    return read_rig(find_rig(name, [folder]), [folder])


@pytest.mark.parametrize(
    ("name", "choice", "shortest"),
    [
        ("sim", Choice("car", "sim"), "sim"),
        ("car", Choice("car"), "car"),
        ("sim-rendered-person", Choice("person", "sim-rendered"), "sim-rendered-person"),
        ("person-indoor", Choice("person-indoor"), "person-indoor"),
        ("sitl-px4-field-light", Choice("field", "sitl", "px4", True), "sitl-px4-field-light"),
        ("relay-sim", Choice("relay", "sim"), "sim-relay"),
        ("sim-tello", Choice("tello", "sim-rendered"), "sim-rendered-tello"),
        ("sitl-embedded", Choice("car", "sitl", "embedded"), "sitl"),
    ],
)
def test_a_name_says_which_rig_at_which_level_by_which_autopilot(
    name: str, choice: Choice, shortest: str
) -> None:
    assert Choice.of(name) == choice
    assert choice.name == shortest
    assert Choice.of(shortest).name == shortest


def test_a_rig_is_what_its_name_says_and_what_its_options_name_first(folder: Path) -> None:
    plain = read(folder, "car")
    assert (plain["name"], plain["level"]) == ("car", "sitl")
    assert plain["sender"]["vehicle"] == {"factory": "a:Vehicle", "rate_hz": 10}
    assert plain["receiver"]["vehicle"] == {"factory": "a:Vehicle", "rate_hz": 5}
    assert plain["world"] == {"wind": {"speed_mps": 1.5, "gust_mps": 0.4}}
    assert read(folder, "sim")["world"]["steps"] == 3


@pytest.mark.parametrize("name", ["sitl-px4", "px4-sitl", "sitl-mixed", "px4"])
def test_what_is_said_of_an_option_holds_where_any_of_its_conditions_does(
    folder: Path, name: str
) -> None:
    table = read(folder, name)
    assert table["name"] == name
    assert table["world"] == {"wind": {"speed_mps": 1.5}}
    assert [table[role]["vehicle"]["autopilot"] for role in ("sender", "receiver")] == ["px4"] * 2


def test_an_option_may_change_what_the_rig_is_like(folder: Path) -> None:
    world = read(folder, "sitl-light")["world"]
    assert world == {
        "storm": True,
        "wind": {"speed_mps": 1.5, "gust_mps": 0.4},
        "light": True,
    }


def test_a_rig_is_like_another_one_as_that_is_with_its_own_options(folder: Path) -> None:
    table = read(folder, "van")
    assert (table["level"], table["world"]["van"]) == ("sitl", True)
    assert table["sender"]["vehicle"]["autopilot"] == "px4"


def test_ones_own_rig_is_like_a_name_and_leaves_out_what_it_drops(folder: Path) -> None:
    own = folder / "own" / "mine.toml"
    own.parent.mkdir()
    own.write_text(
        'name = "mine"\nlike = "sitl-px4"\ndrop = ["world.wind", "receiver.vehicle.rate_hz"]\n'
        "[both.vehicle]\nurl = 1\n",
        "utf-8",
    )
    table = read_rig(own, [folder])
    assert (table["name"], table["level"], table["world"]) == ("mine", "sitl", {})
    assert table["receiver"]["vehicle"] == {"factory": "a:Vehicle", "autopilot": "px4", "url": 1}


@pytest.mark.parametrize(
    ("name", "problem", "fix"),
    [
        ("sim-px4", "sim-px4.toml: the rig does not come as --rig car --level sim --autopilot px4", "--level sitl"),
        ("sim-light", "does not come as --rig car --level sim --light", "--level sitl"),
        ("sitl-van", "does not come as --rig van --level sitl --autopilot mixed", "px4"),
        ("sitl-wind", "sitl-wind.toml: no such rig file", ""),
        ("stil", r"no rig named 'stil' \(did you mean 'sitl'\?\)", "name one of these"),
    ],
)  # fmt: skip
def test_what_a_rig_does_not_come_as_is_refused_with_what_it_comes_as(
    folder: Path, name: str, problem: str, fix: str
) -> None:
    asked = name.replace("sitl-van", "sitl-mixed-van")
    with pytest.raises(RigError, match=problem) as caught:
        read(folder, asked)
    assert fix in caught.value.remedy


@pytest.mark.parametrize("drop", ["world.wnd", "wrld.wind", "world.wind.speed_mps.x", "name.x"])
def test_a_key_that_is_not_there_cannot_be_dropped(folder: Path, drop: str) -> None:
    own = folder / "mine.toml"
    own.write_text(f'name = "mine"\nlike = "sitl"\ndrop = ["{drop}"]\n', "utf-8")
    with pytest.raises(RigError, match=r"mine\.toml: drop: the other rig has no"):
        read_rig(own, [folder])

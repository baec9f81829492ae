"""A rig of the field, flown in the harness as it is: only its hardware is another."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.interfaces import PartError
from flight.outcome import Outcome
from missions.fly import rehearse
from missions.ground import rig_library
from missions.ground.options.flights import RehearseOptions
from missions.ground.rig_library import mission_of

CAMERA = """width = 640
height = 480
fx = 600.0
fy = 600.0
cx = 320.0
cy = 240.0
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
"""
FIELD = f"""name = "ours"
like = "sitl"
level = "field"
harness = "none"
[mission]
heading_deg = 30.0
[mission.target]
north_m = 5.0
east_m = 2.0
home_m = [0.5, 0.5]
[mission.rendezvous]
home_m = [-3.0, 1.0]
[site]
wind_mps = 2.5
gust_mps = 0.5
[target]
length_m = 0.7
width_m = 0.4
height_m = 0.3
max_speed_mps = 0.5
[[markers]]
id = 4
side_m = 0.06
[sender.camera]
{CAMERA}
"""


@pytest.fixture
def field_rig(tmp_path: Path) -> Path:
    """A rig without a harness, as a crew has it."""
    file = tmp_path / "ours.toml"
    base = tmp_path / "base.toml"
    shipped = rig_library.whole("sitl")
    lines = [line for line in shipped.splitlines() if not line.startswith("harness")]
    base.write_text("\n".join(lines), "utf-8")
    own = FIELD.replace('like = "sitl"', 'like = "base.toml"').replace('harness = "none"\n', "")
    file.write_text(own, "utf-8")
    return file


@pytest.mark.parametrize("level", ["sim", "sim-rendered", "sitl"])
def test_all_that_is_no_hardware_stays_as_it_is(
    field_rig: Path, tmp_path: Path, level: str
) -> None:
    rig = rig_library.load_unchecked(str(field_rig))
    made = tmp_path / "made.toml"
    made.write_text(rehearse.toml_text(rehearse.rehearsed(rig, level)), "utf-8")
    flown = rig_library.load(str(made))
    assert flown.harness is not None
    assert flown.layout.markers[0].id == 4
    assert flown.sender.camera == rig.sender.camera
    assert flown.method == rig.method
    assert mission_of(flown) == mission_of(rig)
    for part in ("vehicle", "link", "perception"):
        stand_in = rig_library.load(level)
        assert getattr(flown.sender, part).factory == getattr(stand_in.sender, part).factory


def test_the_world_is_where_and_as_the_rig_says(field_rig: Path) -> None:
    rig = rig_library.load_unchecked(str(field_rig))
    world = rehearse.rehearsed(rig, "sim")["world"]
    assert world["target"]["start_m"] == [2.0, 5.0]
    assert world["target"]["size_m"] == [0.7, 0.4, 0.3]
    assert world["sender_home"]["position_m"] == [0.5, 0.5]
    assert world["receiver_home"]["position_m"] == [1.0, -3.0]
    assert world["wind"]["speed_mps"] == 2.5


def test_a_rig_that_flies_in_the_harness_already_is_told_how() -> None:
    with pytest.raises(PartError, match="in the harness already") as refused:
        rehearse.run(RehearseOptions(rig="sim"))
    assert "handoff --rig sim" in refused.value.remedy


def test_a_rehearsal_is_flown_and_the_rig_that_was_is_kept(field_rig: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    code = rehearse.run(RehearseOptions(rig=str(field_rig), seed=2, out=out))
    assert code == Outcome.COMMITTED.exit_code
    assert (tmp_path / "run.rig.toml").exists()
    assert (out / "summary.json").exists()

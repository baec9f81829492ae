"""``path-handoff plan``: what it shows, writes, and refuses."""

from __future__ import annotations

import io
import json
from pathlib import Path

import cv2
import pytest

from drivers.interfaces import PartError
from flight.command_end import CommandEnd
from missions.field.plan.command import run
from missions.ground.options.field import PlanOptions

PERSON = """name = "walker"
like = "sim"
level = "sim"
[target]
length_m = 0.6
width_m = 0.5
height_m = 1.75
max_speed_mps = 0.3
[world.target]
kind = "person"
"""


@pytest.fixture
def walker(tmp_path: Path) -> Path:
    file = tmp_path / "walker.toml"
    file.write_text(PERSON)
    return file


def test_each_value_is_shown_with_what_it_follows_from(walker: Path) -> None:
    said = io.StringIO()
    assert run(PlanOptions(rig=str(walker)), said) == CommandEnd.DONE.exit_code
    text = said.getvalue()
    for word in (
        "mission.follow.height_m",
        "the target fits the image",
        "time to agreement",
        "wind that can be borne",
    ):
        assert word in text
    assert "nothing stands against it" in text


def test_a_rig_that_cannot_be_flown_is_told_with_the_smallest_change(tmp_path: Path) -> None:
    file = tmp_path / "windy.toml"
    file.write_text('name = "windy"\nlike = "sim"\nlevel = "sim"\n[site]\nwind_mps = 14.0\n')
    said = io.StringIO()
    assert run(PlanOptions(rig=str(file)), said) == CommandEnd.NOT_FIT.exit_code
    assert "site.wind_mps" in said.getvalue()
    assert "can be borne" in said.getvalue()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("[sender.mount.camera]\nyaw_deg = 180\n", "does not see the target"),
        ("[mission.follow]\nheight_m = 6.5\n", "mission.guard.fence_height_m is 6 m"),
        ("[mission.deadlines]\nland_s = 2\n", "takes 2.2 s at least"),
    ],
)
def test_what_no_flight_would_begin_with_stands_against_the_plan(
    tmp_path: Path, change: str, said: str
) -> None:
    file = tmp_path / "unfit.toml"
    file.write_text(f'name = "unfit"\nlike = "sim"\nlevel = "sim"\n{change}')
    shown = io.StringIO()
    assert run(PlanOptions(rig=str(file)), shown) == CommandEnd.NOT_FIT.exit_code
    assert said in shown.getvalue()
    assert "nothing stands against it" not in shown.getvalue()


def test_the_plan_is_drawn_and_kept_as_numbers(walker: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "plan"
    run(PlanOptions(rig=str(walker), out=out), io.StringIO())
    record = json.loads((out / "plan.json").read_text())
    assert record["derived"]["mission.follow.height_m"] > 2.0
    assert record["problems"] == []
    picture = cv2.imread(str(out / "plan.png"))
    assert picture is not None
    orange = (picture[..., 2] > 180) & (picture[..., 0] < 90)
    assert orange.sum() > 500  # the target is in it


def test_a_folder_that_cannot_be_written_is_named(walker: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PartError, match="--out"):
        run(PlanOptions(rig=str(walker), out=tmp_path / "file" / "plan"), io.StringIO())

"""What the plan expects D1's range to be worth, and what it is by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.rig.facts import HeightFacts
from drivers.rig.tables import RigError
from flight.plan.facts import Facts, facts_of
from flight.plan.ranging import range_of
from missions.ground.rig_library import load, load_unchecked, mission_of
from path.observations import RangeSource

PERSON = """
name = "person"
like = "sim"
level = "sim"

[target]
length_m = 0.6
width_m = 0.5
height_m = 1.75

[depth]
max_m = 6.0

[[markers]]
id = 0
side_m = 0.08
side_sigma_m = 0.0001

[mission.follow]
behind_m = 5.7
height_m = 6.5

[mission.guard]
fence_height_m = 12.0
fence_radius_m = 40.0
"""
DOG = PERSON.replace("height_m = 1.75", "height_m = 0.6")
HEIGHT = "\n[height]\nrangefinder_max_m = 12.0\n"


def written(folder: Path, text: str) -> str:
    file = folder / "person.toml"
    file.write_text(text)
    return str(file)


def facts(folder: Path, height: HeightFacts | None) -> Facts:
    rig = load_unchecked(written(folder, PERSON + HEIGHT))
    return replace(facts_of(rig, mission_of(rig)), height=height)


def test_what_is_out_of_depths_reach_is_ranged_by_a_rangefinder(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="a rangefinder would do"):
        load(written(tmp_path, DOG))
    rig = load(written(tmp_path, DOG + HEIGHT))
    assert rig.world["rangefinder"] == {"max_m": 12.0, "min_m": 0.1}


def test_who_stands_behind_a_person_is_in_its_box_and_nothing_but_depth_tells_them_apart(
    tmp_path: Path,
) -> None:
    """Among others a person was lost in each of nine flights, detector perfect or not; alone it
    was handed over.
    """
    with pytest.raises(RigError) as refused:
        load(written(tmp_path, PERSON + HEIGHT))
    said = str(refused.value)
    assert "up to 1.8 m behind" in said
    assert "6.0 m, or [depth] max_m = 7.9 would do" in said


def test_the_ground_by_a_rangefinder_is_better_than_by_the_drones_own_height_and_size_has_its_say(
    tmp_path: Path,
) -> None:
    by_finder = range_of(facts(tmp_path, HeightFacts(rangefinder_max_m=12.0)), 8.0)
    by_height = range_of(facts(tmp_path, HeightFacts()), 8.0)
    too_high = range_of(facts(tmp_path, HeightFacts(rangefinder_max_m=4.0)), 8.0)
    assert by_finder is not None and by_height is not None and too_high is not None
    assert by_finder.by == (RangeSource.RANGEFINDER, RangeSource.SIZE)
    assert set(by_height.by) == {RangeSource.GROUND, RangeSource.SIZE} == set(too_high.by)
    assert 0.05 < by_finder.depth.sigma_m < 0.2 < by_height.depth.sigma_m < 0.6


def test_within_depths_reach_a_rig_without_heights_is_as_it_was(tmp_path: Path) -> None:
    found = range_of(facts(tmp_path, None), 3.0)
    assert found is not None and found.by == (RangeSource.DEPTH,)
    assert range_of(facts(tmp_path, None), 8.0) is None


@pytest.mark.parametrize(
    ("text", "said"), [("rangefinder_max_m = 0.05", "rangefinder_min_m"), ("drift = 1", "drift_m")]
)
def test_heights_that_cannot_be_are_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(RigError, match=said):
        load(written(tmp_path, f"{PERSON}\n[height]\n{text}\n"))

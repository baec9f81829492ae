"""What a rig may name in [mission] and [method], and what it is told of the rest."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from drivers.rig.tables import RigError
from flight.config import MissionConfig
from flight.plan.settings import SETTINGS, STATED_ELSEWHERE, fields_of
from missions.ground.rig_library import load, load_unchecked, mission_of
from path.config import MethodConfig


def known() -> set[str]:
    return {*fields_of(MissionConfig, "mission."), *fields_of(MethodConfig, "method.")}


def rig(folder: Path, text: str) -> str:
    file = folder / "my-rig.toml"
    file.write_text(f'name = "mine"\nlike = "sim"\n{text}', "utf-8")
    return str(file)


def test_a_rig_may_name_sixty_settings_at_most_and_each_is_one() -> None:
    assert len(SETTINGS) <= 60
    assert known() >= SETTINGS
    assert known() - SETTINGS >= set(STATED_ELSEWHERE)


def test_a_rig_that_names_what_is_the_programs_own_is_refused(tmp_path: Path) -> None:
    text = "[mission.guard_process]\npatience_s = 1.0\n"
    for read in (load, load_unchecked):
        with pytest.raises(RigError, match=r"patience_s: .*knows it by itself"):
            read(rig(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "[mission.rendezvous]\nstand_off_m = 2.0\n",
        "[method.evidence]\napart_m = 0.3\n",
        "[method]\nmax_depth_m = 8.0\n",
        "[mission.target]\nradius_m = 0.9\n",
    ],
)
def test_what_is_derived_and_what_another_table_says_may_be_named_and_holds(
    tmp_path: Path, text: str
) -> None:
    ((table, values),) = tomllib.loads(text).items()
    read = load(rig(tmp_path, text))
    named = mission_of(read) if table == "mission" else read.method
    while isinstance(values, dict):
        ((key, values),) = values.items()
        named = getattr(named, key)
    assert named == values


def test_all_that_are_no_settings_are_told_at_once(tmp_path: Path) -> None:
    text = "[mission]\ncontrol_hz = 10.0\n[method]\nmax_gap_s = 0.3\n"
    with pytest.raises(RigError) as refused:
        load(rig(tmp_path, text))
    assert len(refused.value.problems) == 2


def test_what_is_misspelt_is_still_told_what_was_meant(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="did you mean 'take_off_height_m'"):
        load(rig(tmp_path, "[mission]\ntake_off_heigth_m = 1.5\n"))

"""Faults of a team's rig that are refused before anything moves: by file, key and fix."""

from __future__ import annotations

import io
import math
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from missions.field.rig_list import check
from missions.ground import rig_library
from missions.ground.team_config import fenced, team_of

WHOLE = rig_library.whole("team-sim")
FAULTS = [
    (WHOLE.replace("[0.0, -9.0]", "[-17.0, -9.0]"), "drones[1].home_m", "give each a home of its own"),
    (WHOLE.replace("home_m = [0.0, -9.0]", "home_m = [0.0, -900.0]"), "drones[1].home_m", "outside of"),
    (WHOLE.replace('name = "D2"', 'name = "D1"'), "drones", "a name of its own"),
    (WHOLE.replace('name = "B"\n', 'name = "B"\ndrones = ["D2"]\n'), "targets[1].drones", "name two at least"),
    (WHOLE.replace('name = "B"\n', 'name = "B"\ndrones = ["D2", "D9"]\n'), "targets[1].drones", "no drone D9"),
    (WHOLE.replace("return_height_m = 6.5", "return_height_m = 5.0"), "team.return_height_m", "give more height"),
    (WHOLE.replace("out_height_m = 4.5", "out_height_m = 2.5"), "team.out_height_m", "give more height"),
    (WHOLE.replace("swap_s = 240.0", "swap_s = -1.0"), "team.swap_s", "a sign too many"),
    (WHOLE.replace("swap_s = 240.0", "swop_s = 240.0"), "team", "did you mean 'swap_s'"),
    (WHOLE.replace("home_m = [5.0, -9.0]", "home = [5.0, -9.0]"), "drones[4]", "unknown key 'home'"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "key", "said"), FAULTS)
def test_a_bad_team_is_refused_by_file_key_and_fix(
    tmp_path: Path, text: str, key: str, said: str
) -> None:
    file, out = tmp_path / "mine.toml", io.StringIO()
    file.write_text(text, "utf-8")
    assert text != WHOLE
    assert check(str(file), out) != 0
    assert f"mine.toml: {key}" in out.getvalue() and said in out.getvalue()


@pytest.mark.parametrize(
    ("part", "same", "key"),
    [
        ("vehicle", 'url = "udpin://127.0.0.1:15842"', "url"),
        ("vehicle", "sysid = 2", "sysid"),
        ("link", 'bind = "127.0.0.1:15802"', "bind"),
        ("link", 'key_file = "team.key"', "key_file"),
    ],
)
def test_two_drones_that_are_the_same_on_the_wire_are_refused(
    tmp_path: Path, part: str, same: str, key: str
) -> None:
    rig = rig_library.load("team-sim")
    factory = (
        "hil.vehicle.sim_vehicle:SimVehicle" if part == "vehicle" else "hil.link.faulty:MemoryLink"
    )
    line = f'{part} = {{ factory = "{factory}", {same} }}\n'
    parts = WHOLE.split("[[drones]]\n")
    assert len(parts) == 1 + len(rig.drones)
    parts[1], parts[3] = line + parts[1], line + parts[3]
    file, out = tmp_path / "mine.toml", io.StringIO()
    file.write_text("[[drones]]\n".join(parts), "utf-8")
    assert check(str(file), out) != 0
    assert (
        f"mine.toml: drones[2].{part}.{key}" in out.getvalue()
        and "each needs its own" in out.getvalue()
    )


def test_more_targets_than_drones_are_refused(tmp_path: Path) -> None:
    text = WHOLE.split("[[drones]]\n")
    file, out = tmp_path / "mine.toml", io.StringIO()
    file.write_text("[[drones]]\n".join(text[:3]), "utf-8")
    assert check(str(file), out) != 0
    assert "mine.toml: targets: 3 targets for 2 drones" in out.getvalue()
    with pytest.raises(PartError, match="more than the 4 drones"):
        team_of(rig_library.load("team-sim"), 4, 9)


def test_a_rig_without_a_team_is_refused() -> None:
    with pytest.raises(PartError, match=r"no \[team\]"):
        team_of(rig_library.load("sim"))


@pytest.mark.parametrize(("drones", "targets"), [(2, 1), (40, 20), (200, 60)])
def test_a_field_is_laid_out_for_any_number(drones: int, targets: int) -> None:
    rig = rig_library.load("team-sim")
    config = team_of(rig, drones, targets)
    assert (len(config.drones), len(config.targets)) == (drones, targets)
    homes = [drone.home_m for drone in config.drones]
    places = [target.place_m for target in config.targets]
    assert min(math.dist(a, b) for i, a in enumerate(homes) for b in homes[:i]) >= 3.0
    assert min(math.dist(home, place) for home in homes for place in places) > 10.0
    fence_m = fenced(rig, config).mission["guard"]["fence_radius_m"]
    assert all(math.hypot(*place) + 10.0 < fence_m for place in (*homes, *places))

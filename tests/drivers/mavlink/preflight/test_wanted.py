"""Every parameter that the pages name, with values a rig may want and values that are refused
before anything moves.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from drivers.mavlink.preflight.wanted import BY_NAME, COMPANION, refused, wrong
from drivers.mavlink.vehicle import MavsdkVehicleConfig
from drivers.rig.check import check_rig
from drivers.rig.tables import RigError
from missions.ground import rig_library

DOCS = Path(rig_library.__file__).parents[2] / "docs"
PAGES = ("autopilots.md", "field.md")
OURS = 245

# what may be wanted, and what may not
BOTH_WAYS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "COM_RC_IN_MODE": ((0, 5, 7), (1, 2, 3, 4, 6, 8, -1)),
    "COM_RC_OVERRIDE": ((2, 3), (0, 1)),
    "COM_RCL_EXCEPT": ((0, 1, 3), (4, 6, 7)),
    "NAV_RCL_ACT": ((1, 2, 3), (0, 4, 5, 6)),
    "COM_OF_LOSS_T": ((0.2, 0.5, 1.0, 2.0), (0.0, -1.0, 10.1, 50.0, math.nan)),
    "COM_OBL_RC_ACT": ((3, 4), (-1, 0, 1, 2, 5, 6, 7)),
    "NAV_DLL_ACT": ((0, 1, 2, 3), (-1, 4, 5, 6)),
    "COM_LOW_BAT_ACT": ((1, 2, 3), (0, 4)),
    "GF_ACTION": ((2, 3, 5), (0, 1, 4, 4.2, 2.4, math.nan, math.inf)),
    "GF_MAX_HOR_DIST": ((0.5, 28, 33.5), (0, -1)),
    "GF_MAX_VER_DIST": ((0.5, 9), (0, -1)),
    "RC_MAP_FLTMODE": ((1, 5), (0,)),
    "RC_MAP_KILL_SW": ((1, 7), (0,)),
    "FS_THR_ENABLE": ((1, 3, 4, 5, 6, 7), (0, 2, 8)),
    "FS_OPTIONS": ((0, 16, 17), (4, 20)),
    "FENCE_OPTIONS": ((0, 2), (1, 3)),
    "FENCE_ACTION": ((1, 2, 3, 4, 5), (0, -1, 6)),
    "FENCE_ENABLE": ((1,), (0, 2)),
    "FENCE_TYPE": ((3, 7), (0, 1, 2, 4, 5)),
    "FENCE_RADIUS": ((0.5, 28), (0,)),
    "FENCE_ALT_MAX": ((0.5, 9), (0,)),
    "FS_GCS_ENABLE": ((1, 3, 4, 5, 6, 7), (0, 2, 8)),
    "FS_GCS_TIMEOUT": ((0.5, 2, 5), (0, 5.1, 60, 120)),
    "MAV_GCS_SYSID": ((245,), (255, 1, 246)),
    "SYSID_MYGCS": ((245,), (255,)),
    "RTL_ALT": ((0, 100, 300, 1500, 12000), (3, 99, 12001, 30000, -300)),
    "LAND_REPOSITION": ((0, 1), (-1, 2)),
    "RC_OPTIONS": ((0, 32), (1, 33)),
    "FLTMODE_CH": ((1, 5), (0,)),
}
ONLY_WITH_RADIO = {
    "COM_RC_OVERRIDE", "COM_RCL_EXCEPT", "RC_MAP_FLTMODE", "RC_MAP_KILL_SW", "FS_THR_ENABLE", "FS_OPTIONS",
    "FLTMODE_CH",
}  # fmt: skip
NOT_JUDGED = {  # named on the pages for other reasons: no value of theirs is unsafe by itself
    "COM_FAIL_ACT_T", "PILOT_THR_BHV", "RC_CHANNELS_OVERRIDE", "FENCE_MARGIN", "RC7_OPTION", "RCN_OPTION",
}  # fmt: skip
_SAFETY = re.compile(
    r"`((?:COM|NAV|GF|RC|FS|FENCE|RTL|LAND|FLTMODE|MAV_GCS|SYSID)_?[A-Z0-9_]*)`?(?= |`|,)"
)


@pytest.mark.parametrize("name", BOTH_WAYS)
def test_each_parameter_of_the_pages_both_ways(name: str) -> None:
    good, bad = BOTH_WAYS[name]
    for value in good:
        assert refused({name: float(value)}, radio=True, companion_id=OURS) == [], value
        MavsdkVehicleConfig("udpin://127.0.0.1:14540", parameters={name: float(value)})
    for value in bad:
        (told,) = refused({name: float(value)}, radio=True, companion_id=OURS)
        assert told.startswith(f"{name} = "), value
        if math.isfinite(value):
            with pytest.raises(ValueError, match=f"parameters: {name} = "):
                MavsdkVehicleConfig("udpin://127.0.0.1:14540", parameters={name: float(value)})
        assert bool(refused({name: float(value)}, radio=False, companion_id=OURS)) is (
            name not in ONLY_WITH_RADIO
        )


def test_the_table_and_its_test_name_the_same() -> None:
    assert {*BY_NAME, *COMPANION} == set(BOTH_WAYS)


def test_every_safety_parameter_of_the_pages_is_in_the_table() -> None:
    named = {
        name
        for page in PAGES
        for name in _SAFETY.findall((DOCS / page).read_text("utf-8"))
        if "_" in name
    }
    assert len(named) > 20
    assert named - NOT_JUDGED <= set(BOTH_WAYS)


def test_what_nothing_is_known_of_is_not_judged() -> None:
    assert wrong("EKF2_HGT_REF", 3.0) == ""


@pytest.mark.parametrize(
    ("rig", "told"),
    [
        ("GF_ACTION = 4", "GF_ACTION = 4"),
        ("COM_OF_LOSS_T = 50", "COM_OF_LOSS_T = 50"),
        ("NAV_DLL_ACT = 6", "motors"),
    ],
)
def test_a_rig_that_wants_an_unsafe_value_is_refused_when_it_is_checked(
    tmp_path: Path, rig: str, told: str
) -> None:
    own = tmp_path / "mine.toml"
    name = rig.split(" ", maxsplit=1)[0]
    own.write_text(
        f'name = "mine"\nlike = "sitl-px4"\nlevel = "sitl"\n\n[receiver.vehicle.parameters]\n{rig}\n',
        "utf-8",
    )
    with pytest.raises(RigError, match=told) as caught:
        check_rig(rig_library.load_unchecked(str(own)), harness=False)
    assert name in str(caught.value)


def test_a_simulator_that_no_pilot_can_take_may_wait_so_that_the_guard_is_measured_before_it() -> (
    None
):
    assert not refused({"COM_OF_LOSS_T": 5.0}, radio=False, companion_id=245)
    for value in (2.1, 5.0, 10.0):
        assert refused({"COM_OF_LOSS_T": value}, radio=True, companion_id=245)
    assert refused({"COM_OF_LOSS_T": 50.0}, radio=False, companion_id=245)


@pytest.mark.parametrize(
    ("url", "with_key", "fits"),
    [
        ("udpin://127.0.0.1:14540", True, True),
        ("tcpout://127.0.0.1:5760", True, False),  # nothing of ours signs there
        ("tcpout://127.0.0.1:5760", False, True),
    ],
)
def test_a_key_is_for_links_that_this_program_signs_itself(
    url: str, with_key: bool, fits: bool, tmp_path: Path
) -> None:
    key = tmp_path / "key" if with_key else None
    if fits:
        assert MavsdkVehicleConfig(url, key_file=key).key_file == key
    else:
        with pytest.raises(ValueError, match="key_file"):
            MavsdkVehicleConfig(url, key_file=key)

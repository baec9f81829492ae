"""The doctor against stand-ins: every row that hardware will be asked for, without hardware."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from missions.field.doctor import command as doctor
from missions.field.doctor import rehearse
from missions.ground import rig_library
from missions.ground.options.field import DoctorOptions
from missions.ground.rigs import FOLDER
from tests.missions.field.test_new_rig import fill_in, rigs

ROWS = (
    "detector loads", "vehicle connects", "vehicle parameters", "vehicle pilot", "vehicle fence", "guard hears",
    "perception rate", "perception size", "perception stamps", "link round trip", "link clocks",
)  # fmt: skip
SLOW = ("perception rate", "perception stamps")
"""What a computer that is busy with other tests may be too slow for."""


def test_a_field_rig_goes_through_all_rows_of_both_roles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rigs(new="mine")
    fill_in(tmp_path / "mine.toml")
    found = {each.name: each for each in rehearse.rehearsal("mine.toml", lambda _: None)}
    for role in ("sender", "receiver"):
        assert [row for row in ROWS if f"{role} {row}" not in found] == []
    assert not [each for each in found.values() if each.untested]
    faults = [each for each in found.values() if each.state == "fault"]
    assert [each for each in faults if not each.name.endswith(SLOW)] == []
    assert not list(tmp_path.glob("runs"))


def test_what_has_no_parts_of_its_own_is_refused() -> None:
    with pytest.raises(PartError, match="no parts that could be tested at level sim") as refused:
        list(rehearse.rehearsal("sim", lambda _: None))
    assert "--level sitl" in refused.value.remedy
    with pytest.raises(PartError, match="both roles"):
        doctor.run(DoctorOptions("sitl", role="sender", rehearse=True), io.StringIO())


def test_stand_ins_that_do_not_start_say_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearse, "WORLD", "no.such.world")
    with pytest.raises(PartError, match=r"did not start: .*No module named 'no'"):
        list(rehearse.rehearsal("sitl", lambda _: None))


def test_its_stand_ins_are_of_a_rig_with_radios_and_fences() -> None:
    rig = rig_library.load(rehearse.STAND_INS)
    assert rig.file.parent == FOLDER
    assert rig.sender.vehicle.options["rc"] == "required"
    assert rig.sender.guard is not None

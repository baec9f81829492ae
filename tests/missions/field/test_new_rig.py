"""A rig that one command writes: refused until it is filled in, and then as good as one that comes
with PATH.
"""

from __future__ import annotations

import re
from io import StringIO
from pathlib import Path
from typing import Literal

import pytest

from drivers.interfaces import PartError
from flight.command_end import CommandEnd
from missions.field.rig_list import run
from missions.ground.options.field import RigsOptions

CAMERA = """width = 640
height = 480
fx = 615.2
fy = 615.9
cx = 322.1
cy = 241.3
distortion = [0.112, -0.236, 0.0006, -0.0004, 0.095]"""
MEASURED = {
    "latitude_deg": "47.4",
    "longitude_deg": "8.5",
    "altitude_m": "488.0",
    "north_m": "4.0",
    "east_m": "0.0",
    "side_m": "0.0401",
    "length_m": "0.32",
    "width_m": "0.22",
    "height_m": "0.16",
    "max_speed_mps": "0.5",
    "diameter_m": "0.6",
    "wind_mps": "3.0",
    "position_m": "0.5",
}


def rigs(**options: str) -> tuple[int, str]:
    out = StringIO()
    return run(RigsOptions(**options), out), out.getvalue()  # type: ignore[arg-type]


def fill_in(rig: Path) -> None:
    text = rig.read_text()
    for name, value in MEASURED.items():
        text, count = re.subn(
            rf'^{name} = "MEASURE"', f"{name} = {value}", text, flags=re.MULTILINE
        )
        assert count == 1, name
    text = text.replace('["MEASURE", "MEASURE", "MEASURE"]', "[0.1, 0.0, 0.02]", 1)
    text = text.replace('["MEASURE", "MEASURE", "MEASURE"]', "[-0.18, 0.0, -0.06]", 1)
    text = text.replace('["MEASURE", "MEASURE", "MEASURE"]', "[0.1, 0.0, 0.02]", 1)
    rig.write_text(re.sub(r'^calibration = "d\d.camera.toml"', CAMERA, text, flags=re.MULTILINE))


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_new_rig_is_refused_until_it_is_measured_and_then_has_nothing_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, autopilot: Literal["px4", "ardupilot"]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, said = rigs(new="my-rig", autopilot=autopilot)
    assert code == 0
    assert "until `path-handoff rigs --check my-rig.toml` finds nothing" in said
    code, said = rigs(check="my-rig.toml")
    assert code == CommandEnd.NOT_FIT.exit_code
    assert 'origin.latitude_deg: expected a finite number, found "MEASURE"' in said
    fill_in(tmp_path / "my-rig.toml")
    assert rigs(check="my-rig.toml") == (0, "my-rig.toml: level field, nothing wrong with it\n")


RADIO = """factory = "drivers.link.serial_radio:SerialLink"
port = "/dev/radio"
baud = {baud}
key_file = "rig.key"
"""
A_KEY = b"k" * 32
UDP = re.compile(r'factory = "drivers.link.udp:UdpLink"\n.*\n.*\n.*\n')


@pytest.mark.parametrize(
    ("key", "mode", "baud", "said"),
    [
        (A_KEY, 0o600, 115_200, ""),
        (A_KEY, 0o600, 57_600, ""),
        (b"k" * 8, 0o600, 115_200, "key_file: key file rig.key has 8 bytes, not 32"),
        (b"", 0o600, 115_200, "has 0 bytes, not 32"),
        (A_KEY + b"\n", 0o600, 115_200, "has more than 32 bytes, not 32"),
        (A_KEY, 0o644, 115_200, "has mode 0644: others can read it: chmod 600 rig.key"),
        (A_KEY, 0o640, 115_200, "has mode 0640"),
        (A_KEY, 0o600, 9_600, "sender.link: baud: 9600 is less than the "),
        (A_KEY, 0o600, 38_400, "57600 would do"),
    ],
)
def test_keys_that_protect_nothing_and_radios_that_carry_too_little_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: bytes, mode: int, baud: int, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    rigs(new="rig")
    rig = tmp_path / "rig.toml"
    fill_in(rig)
    text, count = UDP.subn(lambda _: RADIO.format(baud=baud), rig.read_text())
    assert count == 2
    rig.write_text(text.replace("/dev/radio", "/dev/radio-1", 1))
    (tmp_path / "rig.key").write_bytes(key)
    (tmp_path / "rig.key").chmod(mode)
    code, words = rigs(check="rig.toml")
    assert (code == 0) == (not said)
    assert said in words


def test_its_key_is_its_owners_alone_and_new_each_time(tmp_path: Path) -> None:
    for name in ("a", "b"):
        rigs(new=str(tmp_path / name))
    keys = [(tmp_path / f"{name}.key") for name in ("a", "b")]
    assert [key.stat().st_mode & 0o777 for key in keys] == [0o600, 0o600]
    assert len({key.read_bytes() for key in keys}) == 2
    assert [len(key.read_bytes()) for key in keys] == [32, 32]


def test_nothing_is_written_over(tmp_path: Path) -> None:
    rig = tmp_path / "mine.toml"
    (tmp_path / "mine.key").write_bytes(b"k" * 32)
    rigs(new=str(rig))
    assert (tmp_path / "mine.key").read_bytes() == b"k" * 32  # the pair's
    rig.write_text("mine")
    with pytest.raises(PartError, match="is there already"):
        rigs(new=str(rig))
    assert rig.read_text() == "mine"


@pytest.mark.parametrize("name", ["a b", "-x", 'a"b'])
def test_what_is_no_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PartError, match="no name for a rig"):
        rigs(new=str(tmp_path / name))
    assert list(tmp_path.iterdir()) == []


def test_the_name_of_a_rig_that_comes_with_path_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PartError, match="a rig that comes with PATH is called field"):
        rigs(new=str(tmp_path / "field"))
    assert list(tmp_path.iterdir()) == []

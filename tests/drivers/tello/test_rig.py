"""The rig of two Tellos: what may be shared by the parts of one drone, and by none of the
other's.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.rig.check import check_rig, local_ports
from drivers.rig.file import load_rig
from drivers.rig.tables import RigError
from missions.ground import rig_library
from path.messages import Role

TEXT = rig_library.whole("sitl-tello")


def rig_with(folder: Path, *changes: tuple[str, str]) -> Path:
    text = TEXT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "tellos.toml"
    path.write_text(text, "utf-8")
    return path


def test_it_loads_and_its_ports_are_known() -> None:
    ports = local_ports(rig_library.load("sitl-tello"))
    assert {8890, 8892, 11111, 11112} <= set(ports)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (('"127.0.0.3"', '"127.0.0.2"'), "'127.0.0.2' is already used by sender.vehicle.host"),
        (
            ("state_port = 8892", "state_port = 8890"),
            "8890 is already used by sender.vehicle.state_port",
        ),
        (
            ("video_port = 11112", "video_port = 11111"),
            "11111 is already used by sender.vehicle.video_port",
        ),
        (("video_port = 11112", "video_port = 14621"), "14621 is already used by sender.link.bind"),
    ],
)
def test_two_drones_on_one_address_or_port_are_refused(
    tmp_path: Path, change: tuple[str, str], problem: str
) -> None:
    with pytest.raises(RigError) as caught:
        check_rig(load_rig(rig_with(tmp_path, change)))
    assert any(problem in line for line in caught.value.problems)


def test_in_a_namespace_each_they_share_the_stock_address_and_ports(tmp_path: Path) -> None:
    path = rig_with(
        tmp_path,
        ('host = "127.0.0.2"', 'host = "192.168.10.1"\nnamespace = "tello-1"'),
        ('host = "127.0.0.3"', 'host = "192.168.10.1"\nnamespace = "tello-2"'),
        ("state_port = 8892", "state_port = 8890"),
        ("video_port = 11112", "video_port = 11111"),
    )
    check_rig(load_rig(path))


def test_one_namespace_for_both_is_refused(tmp_path: Path) -> None:
    path = rig_with(
        tmp_path,
        ('host = "127.0.0.2"', 'host = "192.168.10.1"\nnamespace = "tello-1"'),
        ('host = "127.0.0.3"', 'host = "192.168.10.1"\nnamespace = "tello-1"'),
    )
    with pytest.raises(RigError, match="'tello-1' is already used by sender"):
        check_rig(load_rig(path))


def test_both_rigs_of_tellos_fly_the_same_mission_with_the_same_eyes() -> None:
    real, virtual = rig_library.load("sitl-tello"), rig_library.load("sim-tello")
    assert virtual.method == real.method
    assert virtual.mission == real.mission
    assert [(m.id, m.side_m) for m in virtual.layout.markers] == [
        (m.id, m.side_m) for m in real.layout.markers
    ]
    for role in Role:
        assert virtual.role(role).camera == real.role(role).camera
        for table in ("target", "detector"):
            assert (
                virtual.role(role).perception.options[table]
                == real.role(role).perception.options[table]
            )
        for name in ("north_m", "east_m", "heading_deg"):
            assert virtual.role(role).vehicle.options.get(name) == real.role(
                role
            ).vehicle.options.get(name)

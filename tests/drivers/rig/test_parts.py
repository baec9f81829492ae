"""Rigs: decoded strictly, checked whole, every problem named with file, table, key and what is
allowed.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Literal

import numpy as np
import pytest

from drivers.rig.check import check_rig, local_ports
from drivers.rig.file import load_rig
from drivers.rig.parts import PartContext, PartSpec, create, part_context
from drivers.rig.read import find_rig
from drivers.rig.tables import RigError, decode_table, suggestion
from path.messages import Role

# --- tables


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Wind:
    speed_mps: float
    gusts: bool = False


@dataclass(frozen=True)
class Settings:
    height_m: float = 1.0
    count: int = 1
    colour: Colour = Colour.RED
    kind: Literal["a", "b"] = "a"
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    names: tuple[str, ...] = ()
    wind: Wind | None = None
    winds: tuple[Wind, ...] = ()
    by_name: dict[str, Wind] = dataclasses.field(default_factory=dict[str, Wind])
    file: Path = Path()

    def __post_init__(self) -> None:
        if self.height_m < 0:
            raise ValueError("height_m must not be negative")


def refused(table: dict[str, Any], kind: type[Any] = Settings) -> tuple[str, ...]:
    with pytest.raises(RigError) as caught:
        decode_table(table, kind, "r.toml: mission")
    return caught.value.problems


def test_a_table_decodes_with_everything_in_it() -> None:
    table = {
        "height_m": 2,
        "colour": "blue",
        "kind": "b",
        "position": [1, 2.5, 3],
        "names": ["x", "y"],
        "wind": {"speed_mps": 3},
        "winds": [{"speed_mps": 1}, {"speed_mps": 2, "gusts": True}],
        "by_name": {"n": {"speed_mps": 4}},
        "file": "a/b",
    }
    assert decode_table(table, Settings, "r.toml: mission", Path("/base")) == Settings(
        2.0,
        1,
        Colour.BLUE,
        "b",
        (1.0, 2.5, 3.0),
        ("x", "y"),
        Wind(3.0),
        (Wind(1.0), Wind(2.0, True)),
        {"n": Wind(4.0)},
        Path("/base/a/b"),
    )


@pytest.mark.parametrize("key", ["height", "height_cm", "hieght_m"])
def test_an_unknown_key_names_file_table_key_allowed_and_the_likely_one(key: str) -> None:
    (problem,) = refused({key: 1.0})
    assert problem.startswith(
        f"r.toml: mission: unknown key '{key}' (did you mean 'height_m'?); allowed: height_m, count"
    )


def test_the_same_word_in_another_unit_beats_the_spelling() -> None:
    assert suggestion("w", ["width_m", "w_radps"]) == " (did you mean 'w_radps'?)"


def test_an_old_name_of_a_key_leads_to_the_new_one() -> None:
    assert suggestion("sight", ["vehicle", "perception"]) == " (called 'perception' now)"
    assert suggestion("sight", ["vehicle"]) == ""


def test_an_unlikely_key_gets_no_suggestion() -> None:
    (problem,) = refused({"zzz": 1.0})
    assert "did you mean" not in problem


def test_unknown_keys_are_found_at_any_depth() -> None:
    assert refused({"winds": [{"speed_mps": 1}, {"speed": 1}]})[0].startswith(
        "r.toml: mission.winds[1]: unknown key 'speed' (did you mean 'speed_mps'?)"
    )
    assert refused({"wind": {"speed_mps": 1, "gust": True}})[0].startswith(
        "r.toml: mission.wind: unknown key 'gust'"
    )
    assert refused({"by_name": {"n": {}}}) == (
        "r.toml: mission.by_name.n: missing key 'speed_mps' (a finite number)",
    )


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"height_m": "2"}, 'mission.height_m: expected a finite number, found "2"'),
        ({"height_m": math.nan}, "mission.height_m: expected a finite number, found nan"),
        ({"height_m": True}, "mission.height_m: expected a finite number, found true"),
        ({"count": 1.0}, "mission.count: expected a whole number, found 1.0"),
        ({"count": True}, "mission.count: expected a whole number, found true"),
        ({"colour": "green"}, 'mission.colour: expected one of "red", "blue", found "green"'),
        ({"kind": "c"}, 'mission.kind: expected one of "a", "b", found "c"'),
        (
            {"position": [1, 2]},
            "mission.position: expected a list of 3: a finite number, a finite",
        ),
        ({"position": [1, 2, "x"]}, 'mission.position[2]: expected a finite number, found "x"'),
        ({"names": [1]}, "mission.names[0]: expected a string, found 1"),
        ({"wind": 3}, "mission.wind: expected a table, found 3"),
        ({"height_m": -1}, "mission: height_m must not be negative"),
    ],
)
def test_a_wrong_value_names_what_was_expected(table: dict[str, Any], expected: str) -> None:
    (problem,) = refused(table)
    assert expected in problem


def test_all_problems_are_shown_at_once() -> None:
    assert len(refused({"height": 1, "count": "x", "winds": [{"speed_mps": "x"}, {}]})) == 4


# --- rigs


class Fake:
    """A part that keeps what it was given."""

    @dataclass(frozen=True)
    class Config:
        url: str = ""
        bind: str = ""
        peer: str = ""
        sysid: int | None = None
        interface: str = ""
        inner: PartSpec | None = None
        key_file: Path | None = None

    def __init__(self, config: Config, context: PartContext) -> None:
        self.config = config
        self.context = context

    def now_ns(self) -> int:
        return 17


class PickyHarness:
    refuses: ClassVar[str] = ""

    @staticmethod
    def check_rig(rig: Any) -> None:
        if PickyHarness.refuses:
            raise RigError([f"{rig.where('world')}: {PickyHarness.refuses}"])


@pytest.fixture(autouse=True)
def fake_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("fake_parts")
    module.Fake = Fake  # type: ignore[attr-defined]
    module.PickyHarness = PickyHarness  # type: ignore[attr-defined]
    module.NoPart = object  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "fake_parts", module)


def role(name: str, own: int, other: int) -> str:
    marker = (
        "[sender.mount.marker]\nposition_b_m = [-0.18, 0, -0.06]\ntilt_up_deg = 45\n"
        if name == "sender"
        else ""
    )
    return f"""
[{name}.vehicle]
factory = "fake_parts:Fake"
url = "udpin://127.0.0.1:{14540 + own}"
sysid = {own}
[{name}.perception]
factory = "fake_parts:Fake"
[{name}.perception.inner]
factory = "fake_parts:Fake"
interface = "eth{own}"
[{name}.link]
factory = "fake_parts:Fake"
bind = "127.0.0.1:{14600 + own}"
peer = "127.0.0.1:{14600 + other}"
[{name}.clock]
factory = "fake_parts:Fake"
[{name}.camera]
width = 640
height = 480
fx = 615
fy = 616
cx = 320.5
cy = 240.5
distortion = [0.1, -0.2, 0, 0, 0]
[{name}.mount.camera]
position_b_m = [0.1, 0, 0]
pitch_down_deg = 45
{marker}"""


TOP = """
name = "bench"
level = "hitl"
[origin]
latitude_deg = 47.4
longitude_deg = 8.5
altitude_m = 488
[[markers]]
id = 0
side_m = 0.04
"""

RIG = TOP + role("sender", 1, 2) + role("receiver", 2, 1)

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def to_file(text: str) -> Path:
        path = tmp_path / "bench.toml"
        path.write_text(text)
        return path

    return to_file


def problems_of(path: Path) -> tuple[str, ...]:
    with pytest.raises(RigError) as caught:
        check_rig(load_rig(path))
    return caught.value.problems


def test_a_rig_decodes_and_passes_its_check(write: Write) -> None:
    rig = load_rig(write(RIG))
    check_rig(rig)
    assert rig.name == "bench"
    assert rig.role(Role.RECEIVER) is rig.receiver
    assert rig.sender.camera.fy == 616.0
    assert rig.layout.markers[0].side_m == 0.04
    assert rig.sender.vehicle.options["sysid"] == 1


def test_mounts_follow_the_frame_conventions(write: Write) -> None:
    mount = load_rig(write(RIG)).sender.mount
    c = math.sqrt(0.5)
    np.testing.assert_allclose(mount.T_b_c.R.T, [[0, 1, 0], [-c, 0, c], [c, 0, c]], atol=1e-15)
    np.testing.assert_allclose(mount.T_b_v.R.T, [[0, 1, 0], [c, 0, -c], [-c, 0, -c]], atol=1e-15)
    camera_b, marker_b = np.array([0.1, 0, 0]), np.array([-0.18, 0, -0.06])
    np.testing.assert_allclose(mount.T_v_c.t, mount.T_b_v.R.T @ (camera_b - marker_b), atol=1e-15)


def test_both_roles_know_the_senders_marker(write: Write) -> None:
    rig = load_rig(write(RIG))
    np.testing.assert_array_equal(rig.receiver.mount.T_b_v.t, rig.sender.mount.T_b_v.t)


def test_a_part_is_made_with_its_options_and_context(write: Write) -> None:
    rig = load_rig(write(RIG))
    context = part_context(rig, Role.SENDER, harness="world")
    part = create(rig.sender.vehicle, context)
    assert part.config.sysid == 1
    assert part.context.role is Role.SENDER
    assert part.context.clock.now_ns() == 17
    assert part.context.harness == "world"
    assert part.context.camera is rig.sender.camera


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "sysid = 2",
            "sysid = 1",
            "receiver.vehicle.sysid: 1 is already used by sender.vehicle.sysid",
        ),
        (
            ":14542",
            ":14541",
            "receiver.vehicle.url: 'udpin://127.0.0.1:14541' is already used by sender.vehicle.url",
        ),
        (
            ":14542",
            ":14601",
            "receiver.vehicle.url: 'udpin://127.0.0.1:14601' is already used by sender.link.bind",
        ),
        (
            "eth2",
            "eth1",
            "receiver.perception.inner.interface: 'eth1' is already used by sender.perception.inner.interface",
        ),
        (
            'peer = "127.0.0.1:14602"',
            'peer = "127.0.0.1:9"',
            "sender.link.peer: '127.0.0.1:9' is not where the other",
        ),
        ("sysid = 1", "sysid_ = 1", "sender.vehicle: unknown key 'sysid_' (did you mean 'sysid'?)"),
        ("fx = 615", "", "sender.camera: missing key 'fx'"),
        (
            "[sender.camera]\nwidth = 640",
            "[sender.camera]\nwidth = 320",
            "principal point (320.5, 240.5) is outside 320x480",
        ),
        ("height = 480", "height = 0", "sender.camera.height: 0 px is not within 16..8191 px"),
        ('level = "hitl"', 'level = "hil"', 'level: expected one of "sim", "sim-rendered"'),
        ("side_m = 0.04", "side_m = 0", "side_m"),
        (
            "pitch_down_deg = 45\n[sender.mount.marker]",
            "pitch_deg = 45\n[sender.mount.marker]",
            "unknown key 'pitch_deg'",
        ),
        ('name = "bench"', 'name = "bench', "bench.toml: "),
    ],
)
def test_a_bad_rig_is_refused_by_name(write: Write, old: str, new: str, expected: str) -> None:
    assert old in RIG
    problems = problems_of(write(RIG.replace(old, new, 1)))
    assert any(expected in p for p in problems), problems
    assert all(p.startswith("bench.toml: ") for p in problems)


@pytest.mark.parametrize(
    ("factory", "expected"),
    [
        ("fake_parts", "sender.vehicle.factory: 'fake_parts' is not module:Class"),
        ("fake:parts:Fake", "sender.vehicle.factory: 'fake:parts:Fake' is not module:Class"),
        (
            "fake_parts:Fakee",
            "sender.vehicle.factory: fake_parts has no Fakee (did you mean 'Fake'?)",
        ),
        (
            "drivers.detectors.tracked:TrackedDetector",
            "TrackedDetector is no longer offered: it cost more than the",
        ),
        ("no_such_module:Fake", "sender.vehicle.factory: cannot import no_such_module"),
        ("fake_parts:NoPart", "sender.vehicle.factory: fake_parts:NoPart is no part"),
    ],
)
def test_a_factory_must_be_a_part(write: Write, factory: str, expected: str) -> None:
    text = RIG.replace('factory = "fake_parts:Fake"', f'factory = "{factory}"', 1)
    assert any(expected in p for p in problems_of(write(text)))


def test_the_harness_is_asked_too(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(RIG.replace("level =", 'harness = "fake_parts:PickyHarness"\nlevel =', 1))
    check_rig(load_rig(path))
    monkeypatch.setattr(PickyHarness, "refuses", "no such wind")
    assert problems_of(path) == ("bench.toml: world: no such wind",)


def test_the_ports_a_rig_listens_on_are_known(write: Write) -> None:
    assert local_ports(load_rig(write(RIG))) == {
        14541: "sender.vehicle.url",
        14542: "receiver.vehicle.url",
        14601: "sender.link.bind",
        14602: "receiver.link.bind",
    }


def test_files_are_looked_for_beside_the_rig(write: Write, tmp_path: Path) -> None:
    path = write(RIG.replace("interface =", 'key_file = "keys/pair.key"\ninterface =', 1))
    assert problems_of(path) == (
        f"bench.toml: sender.perception.inner.key_file: {tmp_path}/keys/pair.key: no such file",
    )
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys/pair.key").write_bytes(bytes(32))
    (tmp_path / "keys/pair.key").chmod(0o600)
    check_rig(load_rig(path))


def test_all_problems_of_a_rig_come_together(write: Write) -> None:
    text = RIG.replace("sysid = 2", "sysid = 1").replace(":14542", ":14541").replace("eth2", "eth1")
    assert len(problems_of(write(text))) == 3


def test_rigs_are_found_by_name_or_path(write: Write, tmp_path: Path) -> None:
    path = write(RIG)
    assert find_rig("bench", [tmp_path]) == path
    assert find_rig(str(path)) == path
    with pytest.raises(
        RigError, match=r"no rig named 'bensh' \(did you mean 'bench'\?\); there are: bench"
    ):
        find_rig("bensh", [tmp_path])
    with pytest.raises(RigError, match="no such rig file"):
        find_rig("elsewhere/bench.toml", [tmp_path])


def test_a_rig_says_only_where_it_differs_from_the_one_it_is_like(
    write: Write, tmp_path: Path
) -> None:
    write(RIG)
    other = tmp_path / "elsewhere" / "gusty.toml"
    other.parent.mkdir()
    other.write_text(
        'name = "gusty"\nlike = "bench"\n[mission.guard]\nfence_radius_m = 9.0\n'
        '[sender.vehicle]\nsysid = 7\n[sender.link]\nfactory = "fake_parts:Fake"\nbind = "127.0.0.1:14701"\n'
        "[[markers]]\nid = 3\nside_m = 0.1\n"
    )
    rig, bench = load_rig(other, [tmp_path]), load_rig("bench", [tmp_path])
    assert (rig.name, rig.level, rig.file) == ("gusty", "hitl", other)
    assert rig.mission == {"guard": {"fence_radius_m": 9.0}}
    assert rig.sender.vehicle.options == {**bench.sender.vehicle.options, "sysid": 7}
    assert rig.sender.link.options == {"bind": "127.0.0.1:14701"}, (
        "another part is as it is written"
    )
    assert [marker.id for marker in rig.layout.markers] == [3]
    assert rig.receiver.vehicle.options == bench.receiver.vehicle.options
    assert load_rig(other, rig.folders).name == "gusty"
    with pytest.raises(RigError, match=r"gusty.toml: like: no rig named 'bench'"):
        load_rig(other)


@pytest.mark.parametrize(
    ("like", "expected"),
    [
        ('"bensh"', "a.toml: like: no rig named 'bensh'"),
        ('"gone.toml"', "gone.toml: no such rig file"),
        ("3", "a.toml: like is 3; expected the name of a rig"),
        ('"a.toml"', "a.toml: like = 'a.toml' leads back to a.toml"),
        ('"b.toml"', "b.toml: like = 'a.toml' leads back to a.toml"),
    ],
)
def test_a_rig_that_is_like_nothing_is_refused(tmp_path: Path, like: str, expected: str) -> None:
    (tmp_path / "a.toml").write_text(f"like = {like}\n")
    (tmp_path / "b.toml").write_text('like = "a.toml"\n')
    with pytest.raises(RigError) as caught:
        load_rig(tmp_path / "a.toml", [tmp_path])
    assert expected in str(caught.value)

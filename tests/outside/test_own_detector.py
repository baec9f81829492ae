"""A detector from outside: one file beside a rig, named in it; and what is told when it does not
fit.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from drivers.rig.tables import RigError
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library

HERE = Path(__file__).parent
RIG = """
like = "sim-rendered"
name = "mine"

[mission.deadlines]
peer_s = 5.0

[sender.perception.camera]
rate_hz = 20.0

[receiver.perception.camera]
rate_hz = 20.0

[receiver.perception.detector]
factory = "{factory}"
{options}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(HERE / "orange.py", tmp_path / "orange.py")
    return tmp_path


def written(folder: Path, factory: str, options: str = "") -> str:
    rig = folder / "mine.toml"
    rig.write_text(RIG.format(factory=factory, options=options), "utf-8")
    return str(rig)


def test_a_detector_in_a_file_beside_the_rig_flies_a_handover(folder: Path) -> None:
    rig = rig_library.load(written(folder, "orange.py:Orange", "least_px = 20"))
    out = folder / "run"
    out.mkdir()
    facts = fly_once(rig, 7, (), out, lambda _: None)
    assert (facts.outcome, facts.violations) == ("committed", {}), facts.detail


@pytest.mark.parametrize(
    ("factory", "options", "said"),
    [
        ("orange.py:Red", "", "has no Red"),
        ("orange.py:Orange", "least_hues = 4", "least_hue"),
        ("nowhere.py:Orange", "", "there is no part"),
        ("broken.py:Orange", "", "SyntaxError"),
        ("ends.py:Orange", "", "sys.exit(0)"),
        ("orange.py:OrangeConfig", "", "no Config dataclass"),
    ],
)
def test_what_does_not_fit_is_told_before_anything_moves(
    folder: Path, factory: str, options: str, said: str
) -> None:
    (folder / "broken.py").write_text("class Orange:\n  def", "utf-8")
    (folder / "ends.py").write_text("import sys\nsys.exit(0)\n", "utf-8")
    with pytest.raises(RigError) as refused:
        rig_library.load(written(folder, factory, options))
    assert said in str(refused.value) and "receiver.perception.detector" in str(refused.value)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (
            ("def __init__(self, config): pass", "def detect(self, image, region): return []"),
            "Orange(config, context)",
        ),
        (("def __init__(self, config, context): pass",), "no detect(image, region)"),
    ],
)
def test_a_part_of_another_shape_is_told_with_the_right_one(
    folder: Path, body: tuple[str, ...], said: str
) -> None:
    text = (folder / "orange.py").read_text("utf-8")
    begin = text.index("    def __init__")
    (folder / "orange.py").write_text(
        text[:begin] + "".join(f"    {line}\n" for line in body), "utf-8"
    )
    rig = rig_library.load(written(folder, "orange.py:Orange"))
    out = folder / "run"
    out.mkdir()
    with pytest.raises(RigError) as refused:
        fly_once(rig, 7, (), out, lambda _: None)
    assert said in str(refused.value)


def test_the_pages_example_is_the_one_that_flies() -> None:
    page = (HERE.parents[1] / "docs" / "own-parts.md").read_text("utf-8")
    assert "(../tests/outside/orange.py)" in page

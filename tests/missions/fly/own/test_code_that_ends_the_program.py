"""``sys.exit`` in what a rig or a mission names: never exit code 0 with nothing flown."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.interfaces import PartError
from drivers.rig.own_file import module_of
from missions import cli
from missions.look.report.records import load_facts, load_run
from path.messages import Role

REFUSED, CRASHED = 3, 31
EXITS = ("sys.exit(0)", "sys.exit()", "exit(0)", "raise SystemExit", "sys.exit('done')")


def ended(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    assert isinstance(end.value.code, int)
    said = capsys.readouterr()
    return end.value.code, said.out + said.err


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("leave", EXITS)
def test_a_mission_that_ends_the_program_while_it_is_loaded_is_refused(
    here: Path, capsys: pytest.CaptureFixture[str], leave: str
) -> None:
    (here / "own.py").write_text(f"import sys\n{leave}\nasync def mission(drone): pass\n")
    code, said = ended(capsys, "fly", "own.py", "--out", "run")
    assert code == REFUSED, said
    assert "own.py cannot be loaded: it ends the program" in said and "fix: " in said
    assert not (here / "run").exists()


COURSES = {
    "in its course": "sys.exit(0)",
    "in what it waits for": "await drone.until(lambda: sys.exit(0), 5.0, 'nothing')",
    "in its guidance": "drone.guide(lambda state: sys.exit(0))\n    await drone.until(lambda: False, 30.0, 'nothing')",
    "beside it": "drone.beside(leave())\n    await drone.until(lambda: False, 30.0, 'nothing')",
}


@pytest.mark.parametrize("where", COURSES)
def test_a_mission_that_ends_the_program_in_the_air_has_crashed_and_its_drones_land(
    here: Path, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    (here / "own.py").write_text(
        "import sys\nasync def leave(): sys.exit(0)\n"
        f"async def mission(drone):\n    await drone.take_off(2.0)\n    {COURSES[where]}\n"
    )
    code, said = ended(capsys, "fly", "own.py", "--out", "run", "--errors", "exact")
    facts = load_facts(here / "run")
    assert facts is not None
    assert (code, facts.outcome) == (CRASHED, "crashed"), said
    assert "sys.exit(0)" in facts.detail
    ends = [load_run(here / "run").role(role)["/outcome"][-1].record for role in Role]
    assert all(end["landed"] for end in ends)


FACTORY = """
import sys
from dataclasses import dataclass
{at_import}

class Part:
    @dataclass(frozen=True)
    class Config:
        pass
    def __init__(self, *_):
        {in_constructor}
    async def __aenter__(self):
        {at_opening}
    async def __aexit__(self, *_):
        pass
"""
WHERE = ("at_import", "in_constructor", "at_opening")


@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize("part", ["vehicle", "perception", "link"])
def test_a_factory_that_ends_the_program_flies_nothing_and_says_so(
    here: Path, capsys: pytest.CaptureFixture[str], part: str, where: str
) -> None:
    bodies = {name: "sys.exit(0)" if name == where else "pass" for name in WHERE}
    (here / f"leaving_{part}_{where}.py").write_text(FACTORY.format(**bodies))
    factory = f'{{ factory = "leaving_{part}_{where}:Part" }}'
    # the other drone waits no longer than this for one that never comes
    waits = "[mission.deadlines]\npeer_s = 2.0\n"
    (here / "rig.toml").write_text(f'like = "sim"\n{waits}[sender]\n{part} = {factory}\n')
    code, said = ended(capsys, "handoff", "--rig", "rig.toml", "--out", "run")
    assert (code, "sys.exit(0)" in said) == (REFUSED, True), said


@pytest.mark.parametrize("where", ["at_import", "in_constructor"])
def test_a_harness_that_ends_the_program_is_refused(
    here: Path, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    bodies = {name: "sys.exit(0)" if name == where else "pass" for name in WHERE}
    (here / f"leaving_harness_{where}.py").write_text(FACTORY.format(**bodies))
    (here / "rig.toml").write_text(f'like = "sim"\nharness = "leaving_harness_{where}:Part"\n')
    code, said = ended(capsys, "handoff", "--rig", "rig.toml", "--out", "run")
    assert (code, "sys.exit(0)" in said) == (REFUSED, True), said


def test_a_module_that_raises_while_it_is_imported_is_named(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "broken_part.py").write_text("1 / 0\n")
    (here / "rig.toml").write_text('like = "sim"\nharness = "broken_part:Part"\n')
    code, said = ended(capsys, "handoff", "--rig", "rig.toml", "--out", "run")
    assert code == REFUSED and "cannot import broken_part: ZeroDivisionError" in said, said


@pytest.mark.parametrize("seeds", ["1", "2"])
def test_a_harness_that_ends_the_program_while_it_flies_is_no_flight(
    here: Path, capsys: pytest.CaptureFixture[str], seeds: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(here))
    (here / f"leaving_in_flight_{seeds}.py").write_text(
        "import sys\nclass Harness:\n    def fly(self, request): sys.exit(0)\n"
    )
    (here / "rig.toml").write_text(f'like = "sim"\nharness = "leaving_in_flight_{seeds}:Harness"\n')
    code, said = ended(
        capsys, "handoff", "--rig", "rig.toml", "--out", "run", "--seeds", seeds, "--jobs", "1"
    )
    assert (code, "sys.exit(0)" in said) == (CRASHED, True), said


def test_an_exception_that_is_no_exception_is_told_too(tmp_path: Path) -> None:
    file = tmp_path / "mission.py"
    file.write_text("class Mine(BaseException): pass\nraise Mine('x')\n", "utf-8")
    with pytest.raises(PartError, match="cannot be loaded: Mine: x"):
        module_of(file, "mission")

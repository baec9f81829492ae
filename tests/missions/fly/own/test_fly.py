"""Missions of a person's own in virtual time: the example of the page, every way to end, and files
that are refused.
"""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from flight.outcome import Outcome
from missions.fly.own.command import fly_mission
from missions.fly.own.load import load_mission
from missions.ground import rig_library
from missions.look.report.command import make_report
from missions.look.report.records import RunFacts, load_run
from missions.look.report.truth import truth_of
from path.messages import Role

SEARCH = Path(__file__).parent / "search.py"
PAGE = Path(__file__).parents[4] / "docs" / "own-missions.md"
HOME_AND_BACK = """
from missions.own import Drone

async def mission(drone: Drone) -> None:
    await drone.take_off(2.0)
    {body}
"""
ONE_EACH = """
async def sender(drone):
    drone.observing = True
    await drone.until(lambda: drone.other.observing, 9.0, "no answer")

async def receiver(drone):
    await drone.until(lambda: drone.other.observing, 9.0, "no word")
    drone.observing = True
    await drone.until(lambda: False, 2.0, "told")
"""


def fly(
    mission: Path, out: Path, seed: int = 1, *faults: str, rig: str = "sim", exact: bool = False
) -> RunFacts:
    """``exact``: both positions are nearly right."""
    out.mkdir(exist_ok=True)
    loaded = rig_library.load(rig)
    loaded = (
        replace(loaded, world={**loaded.world, "estimator": {"position_m": 0.05}})
        if exact
        else loaded
    )
    return fly_mission(mission, loaded, seed, faults, out, lambda _: None)


def flown(tmp_path: Path, body: str, *faults: str, exact: bool = False) -> RunFacts:
    """Both drones take off and then do this."""
    mission = tmp_path / "own.py"
    mission.write_text(HOME_AND_BACK.format(body=body.replace("\n", "\n    ")), "utf-8")
    return fly(mission, tmp_path / "run", 1, *faults, exact=exact)


def landed(out: Path) -> dict[str, bool]:
    """By each drone's own word."""
    run = load_run(out)
    return {role.value: run.role(role)["/outcome"][-1].record["landed"] for role in Role}


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunFacts]:
    """The search, flown once: the run's folder, and how it ended."""
    out = tmp_path_factory.mktemp("searched") / "run"
    return out, fly(SEARCH, out, 11)


def test_the_search_finds_what_is_there_and_both_come_home(searched: tuple[Path, RunFacts]) -> None:
    found_and_came_home(*searched)


def test_the_search_finds_it_in_rendered_frames_too(tmp_path: Path) -> None:
    found_and_came_home(tmp_path, fly(SEARCH, tmp_path, 13, rig="sim-rendered"))


def found_and_came_home(out: Path, facts: RunFacts) -> None:
    assert (facts.outcome, facts.exit_code, facts.violations) == ("flown", 0, {}), facts.detail
    assert landed(out) == {"sender": True, "receiver": True}
    run = load_run(out)
    truth = truth_of(run.world)
    assert truth is not None
    found = [(role, one) for role in Role for one in run.role(role).get("/mission/found", ())]
    assert found
    for role, record in found:
        north, east, _ = record.record["place_n_m"]
        # what a drone's own position is off, what it sees is off too
        states = run.role(role)["/state"]
        state = min(states, key=lambda each: abs(each.stamp_ns - record.stamp_ns))
        body = truth.T_w_b(role, role, state.stamp_ns).t
        north -= state.record["position_n_m"][0] - body[1]
        east -= state.record["position_n_m"][1] - body[0]
        near = [truth.T_w_o(one, role, record.stamp_ns).t for one in truth.object_ids]
        assert min(math.hypot(east - t[0], north - t[1]) for t in near) < 0.6


def test_its_table_and_summary_say_how_it_went(
    searched: tuple[Path, RunFacts], capsys: pytest.CaptureFixture[str]
) -> None:
    out, _ = searched
    summary = make_report(out, True, sys.stdout)
    assert (out / "summary.json").is_file() and not (out / "run.png").exists()
    page = (out / "run.html").read_text("utf-8")
    assert "badge good" in page and f"path-handoff fly {SEARCH} --rig sim --seed 11" in page
    assert summary["outcome"] == "flown"
    assert summary["min_separation_m"] > summary["separation_limit_m"]
    assert [phase["phase"] for phase in summary["phases"]["sender"]][-3:] == [
        "depart",
        "land",
        "done",
    ]
    assert "flown" in capsys.readouterr().out


def test_the_example_that_the_page_names_is_short() -> None:
    assert SEARCH.relative_to(PAGE.parents[1]).as_posix() in PAGE.read_text("utf-8")
    assert len(SEARCH.read_text("utf-8").splitlines()) <= 40


def test_one_seed_is_one_run(searched: tuple[Path, RunFacts], tmp_path: Path) -> None:
    fly(SEARCH, tmp_path, 11)
    for log in ("sender.mcap", "receiver.mcap", "world.mcap"):
        assert (searched[0] / log).read_bytes() == (tmp_path / log).read_bytes(), log


@pytest.mark.parametrize(
    ("body", "outcome", "said"),
    [
        ("drone.fail('nothing to do')", Outcome.MISSION_FAILED, "nothing to do"),
        ("1 / 0", Outcome.CRASHED, "ZeroDivisionError"),
        (
            "await drone.fly_to(20.0, 0.0, 2.0, within_s=3.0)",
            Outcome.MISSION_FAILED,
            "not at north 20.0 m",
        ),
        (
            "await drone.until(lambda: False, 2.0, 'nothing happened')",
            Outcome.MISSION_FAILED,
            "nothing happened",
        ),
        ("await drone.take_off(2.0)", Outcome.MISSION_FAILED, "take_off in the air"),
        (
            "await drone.fly_to(28.0, drone.position_n_m[1], 2.0, speed_mps=3.0)",
            Outcome.GUARD,
            "fence",
        ),
    ],
)
def test_whatever_a_mission_does_it_has_an_end_and_its_drones_land(
    body: str, outcome: Outcome, said: str, tmp_path: Path
) -> None:
    facts = flown(tmp_path, body)
    assert (facts.outcome, facts.exit_code) == (outcome.label, outcome.exit_code)
    assert said in facts.detail
    assert facts.violations == {}
    assert landed(tmp_path / "run") == {"sender": True, "receiver": True}


def test_an_error_beside_a_mission_ends_it(tmp_path: Path) -> None:
    body = "async def fails(): raise ValueError('beside')\ndrone.beside(fails())\nawait drone.until(bool, 60.0, 'x')"
    facts = flown(tmp_path, body)
    assert facts.outcome == "crashed"
    assert "beside" in facts.detail


def test_flown_before_it_took_off(tmp_path: Path) -> None:
    mission = tmp_path / "own.py"
    mission.write_text(
        "async def mission(drone):\n    await drone.fly_to(1.0, 0.0, 2.0)\n", "utf-8"
    )
    facts = fly(mission, tmp_path / "run")
    assert (facts.outcome, facts.violations) == ("mission_failed", {})
    assert "take off first" in facts.detail


def test_the_monitors_watch_as_in_a_handoff(tmp_path: Path) -> None:
    body = "await drone.fly_to(0.0, 0.0, 2.0)\nawait drone.until(bool, 10.0, 'the other one came')"
    facts = flown(tmp_path, body, exact=True)  # they meet
    assert facts.outcome == "monitor_violated"
    assert set(facts.violations) == {"S9"}


def test_a_program_that_is_started_again_in_the_air_lands(tmp_path: Path) -> None:
    facts = flown(tmp_path, "await drone.until(bool, 20.0, 'waited')", "kill_sender=0.5@mission+10")
    assert landed(tmp_path / "run") == {"sender": True, "receiver": True}
    assert load_run(tmp_path / "run").sender["/outcome"][-1].record["outcome"] == "restarted"
    assert facts.violations == {}


def test_each_drone_may_have_a_coroutine_of_its_own(tmp_path: Path) -> None:
    mission = tmp_path / "own.py"
    mission.write_text(ONE_EACH, "utf-8")
    facts = fly(mission, tmp_path / "run")
    assert (facts.outcome, facts.detail) == ("mission_failed", "receiver: told within 2 s")
    assert load_run(tmp_path / "run").sender["/outcome"][-1].record["outcome"] == "flown"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "there is no mission"),
        ("", "nothing that flies the sender"),
        ("async def sender(drone): pass", "nothing that flies the receiver"),
        ("def mission(drone): pass", "no `async def`"),
        ("async def mission(drone) pass", "SyntaxError"),
        ("import nothing_of_this_name", "ModuleNotFoundError"),
    ],
)
def test_a_file_that_is_no_mission_is_refused_and_told_how(
    text: str | None, said: str, tmp_path: Path
) -> None:
    mission = tmp_path / "own.py"
    if text is not None:
        mission.write_text(text, "utf-8")
    with pytest.raises(PartError, match=re.escape(said)) as refused:
        load_mission(mission)
    assert refused.value.remedy

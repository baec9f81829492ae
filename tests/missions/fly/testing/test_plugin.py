"""The plugin in a test suite of somebody else's: runs, drones and monitors, and what is kept of a
failed test.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest_plugins = ("pytester",)

# the name of its entry point too, so that it is not loaded twice
PLUGIN = "missions.fly.testing.plugin"
MISSION = """
async def sender(drone):
    await drone.take_off(1.5)
    drone.log("up", {"height_m": -drone.position_n_m[2]})

receiver = sender
"""
CLASH = """
async def mission(drone):
    await drone.take_off(2.0)
    await drone.fly_to(0.0, 0.0, 2.0)
    await drone.until(bool, 10.0, "both stay")
"""
TESTS = """
from pathlib import Path

def test_flies(path_flights):
    run = path_flights.mission("hover.py", seed=5)
    assert (run.outcome, run.monitors) == ("flown", {})
    assert all(drone.landed and drone.outcome == "flown" for drone in run.drones.values())
    assert run.drones["sender"].logged("/mission/up")[0].record["height_m"] > 1.0
    assert run.world["/truth"]
    assert run.summary["seed"] == 5
    assert run.folder.is_relative_to(Path(__file__).parent)

def test_fails_after_a_flight(path_flights):
    assert path_flights.mission("hover.py").outcome == "committed"

def test_too_near(path_flights):
    path_flights.mission("clash.py")

def test_may_come_too_near(path_flights):
    assert set(path_flights.mission("clash.py", may_violate=("S9",)).monitors) == {"S9"}

def test_no_such_fault(path_flights):
    path_flights.mission("hover.py", faults=("no_such",))
"""


@pytest.fixture
def suite(pytester: pytest.Pytester) -> pytest.Pytester:
    pytester.makepyfile(hover=MISSION, clash=CLASH, test_field=TESTS)
    pytester.makeini("[pytest]\nfilterwarnings = error\n")
    # two that fly to one place
    meet = 'name = "meet"\nlike = "sim"\n[world.estimator]\nposition_m = 0.05\n'
    (pytester.path / "meet.toml").write_text(meet, "utf-8")
    return pytester


def test_a_monitor_fails_a_test_and_only_failed_runs_are_kept_and_named(
    suite: pytest.Pytester,
) -> None:
    result = suite.runpytest_subprocess(
        "-p", PLUGIN, "--path-rig", "meet.toml", "--path-runs", "kept"
    )
    result.assert_outcomes(passed=2, failed=3)
    result.stdout.fnmatch_lines_random(
        [
            "*a safety monitor was violated*",
            "*S9 at * sender and receiver are * apart*",
            "*kept/test_field.py_test_too_near/run-1/run.html*",
            "*kept/test_field.py_test_fails_after_a_flight/run-1*",
            "*no fault 'no_such'*",
            "*fix: one of: *",
        ]
    )
    too_near = suite.path / "kept" / "test_field.py_test_too_near" / "run-1"
    assert "separation" in (too_near / "run.html").read_text("utf-8")
    kept = {folder.parent.name for folder in (suite.path / "kept").glob("*/run-1")}
    assert kept == {
        f"test_field.py_test_{name}"
        for name in ("fails_after_a_flight", "too_near", "no_such_fault")
    }
    assert (too_near / "sender.mcap").stat().st_size > 0


def test_a_rig_that_is_none_is_refused_with_the_fix(suite: pytest.Pytester) -> None:
    result = suite.runpytest_subprocess("-p", PLUGIN, "--path-rig", "nowhere", "-k", "test_flies")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines_random(["*nowhere*", "*fix: *"])


def test_loading_it_imports_nothing_but_pytest() -> None:
    heavy = "{'numpy', 'cv2', 'numba', 'asyncio', 'msgspec', 'drivers', 'flight', 'path', 'hil'}"
    code = f"import sys, pytest; before = set(sys.modules); import {PLUGIN}; " + (
        f"print(sorted({heavy} & {{name.partition('.')[0] for name in set(sys.modules) - before}}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path.cwd()
    )
    assert done.stdout == "[]\n"

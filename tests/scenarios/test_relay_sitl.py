"""A relay in real time: programs, guards and the world as processes, MAVSDK, UDP and pictures
between them.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drivers.rig.read import find_rig, read_rig
from drivers.rig.toml_text import toml_text
from hil.camera.shared import folder
from missions.ground.rigs import FOLDER
from tests.overloaded import Flown, Repeating
from tests.run_processes import left_of, processes_of, says

START_LIMIT_S = 240.0  # kernels may have to be compiled
LEG_LIMIT_S = 180.0
LANDING_LIMIT_S = 120.0
OVERLOADED = 43


def hasty_rig(at: Path) -> Path:
    """Two drones, the first of which wants to be relieved as soon as it has the target."""
    table = read_rig(find_rig("relay-sitl", [FOLDER]), [FOLDER])
    table["name"] = "hasty"
    table["relay"]["drones"] = table["relay"]["drones"][:2]
    table["relay"]["drones"][0]["battery"] = 0.7
    at.mkdir()
    file = at / "hasty.toml"
    file.write_text(toml_text(table))
    return file


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for left-over processes in /proc")
def test_a_relief_takes_over_and_a_terminal_that_goes_away_lands_everybody_and_leaves_nothing(
    flown_again: Repeating,
) -> None:
    out, summary = flown_again(fly)
    assert (summary["outcome"], summary["monitors"]) == ("interrupted", {}), summary["notes"]
    assert summary["gap_s"]["max"] < summary["gap_bound_s"]
    record = json.loads((out / "relay.json").read_text())
    (leg,) = record["legs"]
    assert (leg["sender"], leg["receiver"], leg["outcome"]) == ("D1", "D2", "committed")
    assert {flight["drone"] for flight in record["flights"]} == {"D1", "D2"}
    kept = {name: json.loads((out / f"{name}.state.json").read_text()) for name in ("D1", "D2")}
    assert (kept["D1"]["role"], kept["D1"]["record"]["duty"]) == ("sender", "handed_over")
    assert kept["D2"]["record"]["duty"] in ("holding", "mine")


def fly(own: Path) -> Flown[tuple[Path, dict[str, Any]]]:
    """Until D2 holds, then the terminal goes away, and down: the folder of the run, and its summary."""
    out = own / "run"
    command = [sys.executable, "-m", "missions.cli", "relay", "--rig", str(hasty_rig(own / "rig"))]
    command += ["--drones", "2", "--out", str(out), "--no-picture"]
    seen: list[str] = []
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        there = says(process, "D1    holds", seen, START_LIMIT_S) and says(
            process, "D2    holds", seen, LEG_LIMIT_S
        )
        if there:
            # this command, the world, two programs, two guards
            assert len(processes_of(str(own))) >= 6
            process.send_signal(signal.SIGHUP)
        assert process.stdout is not None
        seen += process.stdout.readlines()
        assert process.wait(LANDING_LIMIT_S) in ((30, OVERLOADED) if there else (OVERLOADED,)), (
            "".join(seen)
        )
    assert left_of(str(own)) == []
    assert list(folder().glob(f"*run-{process.pid}-*")) == []

    summary = json.loads((out / "summary.json").read_text())
    return Flown(summary["outcome"], summary["detail"], (out, summary))

"""A relay in real time: programs, guards and the world as processes, MAVSDK, UDP and pictures between them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivers.rig_file import find_rig, read_rig
from drivers.toml_text import toml_text
from hil.shared_camera import folder
from missions.rig_list import FOLDER

START_LIMIT_S = 240.0  # kernels may have to be compiled
LEG_LIMIT_S = 90.0
LANDING_LIMIT_S = 60.0


def processes_of(name: str) -> list[str]:
    """Command lines of processes that name a folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if name in command:
            found.append(command)
    return found


def wait_for(process: subprocess.Popen[str], wanted: str, seen: list[str], within_s: float) -> None:
    assert process.stdout is not None
    end_s = time.monotonic() + within_s
    for line in process.stdout:
        seen.append(line)
        if wanted in line:
            return
        assert time.monotonic() < end_s, "".join(seen)
    pytest.fail(f"ended before {wanted!r}:\n{''.join(seen)}")


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
def test_a_relief_takes_over_and_ctrl_c_lands_everybody_and_leaves_nothing(tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "missions.cli", "relay", "--rig", str(hasty_rig(tmp_path / "rig"))]
    command += ["--drones", "2", "--out", str(out), "--no-picture"]
    seen: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        wait_for(process, "D1   holds", seen, START_LIMIT_S)
        wait_for(process, "D2   holds", seen, LEG_LIMIT_S)
        assert len(processes_of(str(tmp_path))) >= 6  # this command, the world, two programs, two guards
        process.send_signal(signal.SIGINT)
        assert process.stdout is not None
        seen += process.stdout.readlines()
        assert process.wait(LANDING_LIMIT_S) == 30, "".join(seen)
    assert processes_of(str(tmp_path)) == []
    assert list(folder().glob(f"*run-{process.pid}-*")) == []

    summary = json.loads((out / "summary.json").read_text())
    assert (summary["outcome"], summary["violations"]) == ("interrupted", {}), summary["notes"]
    assert summary["gap_s"]["max"] < summary["gap_bound_s"]
    record = json.loads((out / "relay.json").read_text())
    (leg,) = record["legs"]
    assert (leg["sender"], leg["receiver"], leg["outcome"]) == ("D1", "D2", "committed")
    assert {flight["drone"] for flight in record["flights"]} == {"D1", "D2"}
    kept = {name: json.loads((out / f"{name}.state.json").read_text()) for name in ("D1", "D2")}
    assert (kept["D1"]["role"], kept["D1"]["record"]["duty"]) == ("sender", "handed_over")
    assert kept["D2"]["record"]["duty"] in ("holding", "mine")

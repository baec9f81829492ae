"""Real processes, sockets and MAVSDK, in real time: being stopped in the air, and what is left
behind.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hil.camera.shared import folder
from tests.overloaded import Flown, Repeating
from tests.run_processes import left_of, processes_of, says

START_LIMIT_S = 240.0  # kernels may have to be compiled
LANDING_LIMIT_S = 120.0
OVERLOADED = 43


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for left-over processes in /proc")
def test_a_terminal_that_goes_away_lands_both_and_leaves_nothing_behind(
    flown_again: Repeating,
) -> None:
    out, pid = flown_again(fly)
    kept = {
        role: json.loads((out / f"{role}.state.json").read_text())["record"]
        for role in ("sender", "receiver")
    }
    assert (kept["sender"]["duty"], kept["receiver"]["duty"]) == ("mine", "observing")
    facts = json.loads((out / "run.json").read_text())
    assert facts["outcome"] == "interrupted"
    assert facts["violations"] == {}
    assert left_of(str(out)) == []
    assert list(folder().glob(f"*run-{pid}-*")) == []
    summary = json.loads((out / "summary.json").read_text())
    assert summary["outcome"] == "interrupted"


def fly(out: Path) -> Flown[tuple[Path, int]]:
    """To the stand-off, where the terminal goes away, and down: the folder, and the number of the
    command.
    """
    command = [
        sys.executable,
        "-m",
        "missions.cli",
        "handoff",
        "--rig",
        "sitl-light",
        "--out",
        str(out),
        "--no-picture",
    ]
    seen: list[str] = []
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        there = says(process, "stand-off", seen, START_LIMIT_S)
        if there:
            assert len(processes_of(str(out))) >= 4  # this command, the world, both roles
            process.send_signal(signal.SIGHUP)
        assert process.stdout is not None
        seen += process.stdout.readlines()
        assert process.wait(LANDING_LIMIT_S) in ((30, OVERLOADED) if there else (OVERLOADED,)), (
            "".join(seen)
        )
    facts = json.loads((out / "run.json").read_text())
    return Flown(facts["outcome"], facts["detail"], (out, process.pid))

"""A mission of a person's own in real time: real processes, sockets and MAVSDK."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

SEARCH = Path(__file__).parents[1] / "missions" / "own" / "search.py"
LIMIT_S = 300.0  # kernels may have to be compiled


def test_the_search_flies_in_processes_of_its_own(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "missions.cli", "fly", str(SEARCH), "--rig", "sitl-light", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert (done.returncode, summary["outcome"]) == (0, "flown"), done.stdout + done.stderr
    assert all(summary["roles"][role]["landed"] for role in ("sender", "receiver"))
    assert summary["monitors"] == {}

"""A mission of a person's own in real time: real processes, sockets and MAVSDK."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.overloaded import Flown, Repeating

SEARCH = Path(__file__).parents[1] / "missions" / "fly" / "own" / "search.py"
LIMIT_S = 300.0  # kernels may have to be compiled


def fly(out: Path) -> Flown[tuple[int, dict[str, Any], str]]:
    """The search, to its end: exit code, summary, and what was said."""
    command = [
        sys.executable,
        "-m",
        "missions.cli",
        "fly",
        str(SEARCH),
        "--rig",
        "sitl-light",
        "--out",
        str(out),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    said = done.stdout + done.stderr
    assert (out / "summary.json").exists(), said
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    return Flown(summary["outcome"], summary["detail"], (done.returncode, summary, said))


def test_the_search_flies_in_processes_of_its_own(flown_again: Repeating) -> None:
    code, summary, said = flown_again(fly)
    assert (code, summary["outcome"]) == (0, "flown"), said
    assert all(summary["roles"][role]["landed"] for role in ("sender", "receiver"))
    assert summary["monitors"] == {}

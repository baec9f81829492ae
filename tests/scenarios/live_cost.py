"""What ``--live`` costs a flight in real time: the same seed with and without it, by turns; not a
test, a command.

    python -m tests.scenarios.live_cost [--rig sitl-light] [--pairs 3] [--seed 0] [--out FOLDER]

With ``--live`` three others look at the page, each in a process of its own, and one of them is stopped
(SIGSTOP) from the take-off on. Of each flight: pairs a second, and how old a frame is when its cycle
begins, over both drones. The last lines are the medians, and their ratio.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from missions.look.live.gate import TOKEN
from missions.look.report.records import drone_logs
from tests.free_ports import free_port
from tests.missions.look.live.watcher import hears, look_too, until

SECRET = "0123456789abcdef"
FLIGHT_S = 400.0


@dataclass(frozen=True, slots=True)
class FlightFigures:
    """One flight. ``age_ms``: median and 95 %."""

    live: bool
    outcome: str
    pairs_hz: float
    age_ms: tuple[float, float]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rig", default="sitl-light")
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None)
    asked = parser.parse_args()
    out: Path = asked.out or Path(tempfile.mkdtemp(prefix="live-cost-"))
    flown: list[FlightFigures] = []
    for number in range(asked.pairs):
        for live in (True, False) if number % 2 else (False, True):
            folder = out / f"{number}-{'live' if live else 'plain'}"
            flown.append(fly(asked.rig, asked.seed + number, live, folder))
            print(flown[-1], flush=True)
    middles = [_middle([each for each in flown if each.live is live]) for live in (False, True)]
    for name, plain, with_live in zip(
        ("pairs a second", "age ms", "age ms, 95 %"), *middles, strict=True
    ):
        print(
            f"{name}: {plain:.2f} without, {with_live:.2f} with --live, ratio {with_live / plain:.3f}"
        )
    return 0


def fly(rig: str, seed: int, live: bool, out: Path) -> FlightFigures:
    command = [sys.executable, "-m", "missions.cli", "handoff", "--rig", rig, "--seed", str(seed)]
    command += ["--out", str(out), "--no-picture"]
    port = free_port(socket.SOCK_STREAM)
    if live:
        command += ["--live", f"127.0.0.1:{port}"]
    with ExitStack() as stack:
        flight = stack.enter_context(
            subprocess.Popen(command, stdout=subprocess.DEVNULL, env={**os.environ, TOKEN: SECRET})
        )
        stack.callback(flight.kill)
        if live:
            until(hears(port, SECRET), lambda now: bool(now["drones"]))
            look_too(port, SECRET, 3, stack)
        flight.wait(FLIGHT_S)
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    ages = [
        r.record["age_ns"] * 1e-6
        for log in drone_logs(out).values()
        for r in log
        if r.topic == "/frame"
    ]
    high = statistics.quantiles(ages, n=20)[-1]
    return FlightFigures(
        live, summary["outcome"], summary["pairs_hz"] or 0.0, (statistics.median(ages), high)
    )


def _middle(flights: list[FlightFigures]) -> tuple[float, float, float]:
    median = statistics.median
    rate = median(each.pairs_hz for each in flights)
    return (
        rate,
        median(each.age_ms[0] for each in flights),
        median(each.age_ms[1] for each in flights),
    )


if __name__ == "__main__":
    sys.exit(main())

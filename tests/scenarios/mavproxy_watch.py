"""Flies a handoff with MAVProxy beside it, and says what MAVProxy saw of both vehicles; not a test,
a command.

    python -m tests.scenarios.mavproxy_watch --mavproxy ENVIRONMENT/bin/mavproxy.py [--rig sitl]
    [--seed 0] [--pilot]

MAVProxy is installed in an environment of its own (``pip install MAVProxy future``). With
``--pilot`` it selects POSCTL for D1 once D1 judges answers: the script has to let go. The exit code
is 0 when both vehicles were watched with all their parameters, and the handoff was committed, or
given up to the pilot.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

from pymavlink import mavutil

FLIGHT_S = 600.0  # and the compiling before it
FETCH_S = 15.0
POSCTL = "long DO_SET_MODE 1 3"


@dataclass(slots=True)
class Watched:
    """What a ground station has of one vehicle."""

    heartbeats: int = 0
    positions: int = 0
    modes: list[str] = field(default_factory=list[str])
    parameters: set[str] = field(default_factory=set[str])
    announced: int = 0
    texts: list[str] = field(default_factory=list[str])


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mavproxy", type=Path, required=True)
    parser.add_argument("--rig", default="sitl")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pilot", action="store_true")
    parser.add_argument("--port", type=int, default=14550)
    parser.add_argument("--out", type=Path, default=None)
    asked = parser.parse_args()
    out: Path = asked.out or Path(tempfile.mkdtemp(prefix="mavproxy-watch-"))
    out.mkdir(parents=True, exist_ok=True)
    fly = [
        sys.executable,
        "-m",
        "missions.cli",
        "handoff",
        "--rig",
        asked.rig,
        "--seed",
        str(asked.seed),
    ]
    fly += ["--out", str(out / "run"), "--gcs", f"127.0.0.1:{asked.port}"]
    watch = [
        str(asked.mavproxy),
        f"--master=udpin:127.0.0.1:{asked.port}",
        f"--logfile={out / 'mav.tlog'}",
    ]
    with (
        (out / "mavproxy.txt").open("w") as said,
        subprocess.Popen(
            watch, stdin=subprocess.PIPE, stdout=said, stderr=said, text=True, cwd=out
        ) as proxy,
        subprocess.Popen(
            fly, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as flight,
    ):
        end = threading.Timer(FLIGHT_S, flight.terminate)
        end.start()
        try:
            _accompany(flight, proxy, asked.pilot)
        finally:
            end.cancel()
            proxy.terminate()
    outcome = json.loads((out / "run" / "summary.json").read_text("utf-8"))
    watched = read_log(out / "mav.tlog")
    print(f"{out}: {outcome['outcome']}: {outcome['detail']}")
    for system, each in sorted(watched.items()):
        print(f"system {system}: {each.heartbeats} heartbeats, {each.positions} positions, "
              f"{len(each.parameters)} of {each.announced} parameters, {' '.join(each.modes)}")  # fmt: skip
    whole = set(watched) >= {1, 2} and all(
        0 < each.announced == len(each.parameters) for each in watched.values()
    )
    ended = "pilot_override" if asked.pilot else "committed"
    return 0 if whole and outcome["outcome"] == ended else 1


def _accompany(flight: subprocess.Popen[str], proxy: subprocess.Popen[str], pilot: bool) -> None:
    """Passes the flight's lines on; as a pilot, takes D1 once it judges answers."""
    assert flight.stdout is not None and proxy.stdin is not None
    asked = False
    for line in flight.stdout:
        sys.stdout.write(line)
        sys.stdout.flush()
        if "take-off" in line and not asked:
            asked = True
            threading.Thread(target=_fetch, args=(proxy,), daemon=True).start()
        if pilot and "sender" in line and "verify" in line:
            pilot = False
            _type(proxy, "vehicle 1", POSCTL)
    flight.wait()


def _fetch(proxy: subprocess.Popen[str]) -> None:
    """Asks both vehicles for all parameters, one after the other: MAVProxy tries MAVFTP first,
    which they have not.
    """
    for system in (1, 2):
        _type(proxy, f"vehicle {system}", "param fetch")
        time.sleep(FETCH_S)


def _type(proxy: subprocess.Popen[str], *commands: str) -> None:
    assert proxy.stdin is not None
    for command in commands:
        proxy.stdin.write(command + "\n")
        proxy.stdin.flush()
        time.sleep(0.5)


def read_log(file: Path) -> dict[int, Watched]:
    """What MAVProxy logged of each vehicle."""
    watched: dict[int, Watched] = {}
    modes: dict[int, list[str]] = {}
    for message in _messages(file):
        kind, system = message.get_type(), message.get_srcSystem()
        if message.get_srcComponent() != 1:
            continue
        each = watched.setdefault(system, Watched())
        if kind == "HEARTBEAT":
            each.heartbeats += 1
            modes.setdefault(system, []).append(
                mavutil.interpret_px4_mode(message.base_mode, message.custom_mode)
            )
        elif kind == "GLOBAL_POSITION_INT":
            each.positions += 1
        elif kind == "PARAM_VALUE":
            each.parameters.add(message.param_id)
            each.announced = message.param_count
        elif kind == "STATUSTEXT":
            each.texts.append(message.text)
    for system, names in modes.items():
        watched[system].modes = [name for name, _ in groupby(names)]
    return watched


def _messages(file: Path) -> Iterator[Any]:
    log: Any = mavutil.mavlink_connection(str(file))
    while (message := log.recv_match()) is not None:
        yield message


if __name__ == "__main__":
    sys.exit(main())

"""Real processes, sockets and MAVSDK, in real time: a crew that designates and calls the flight off on
its page, and what is left behind.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from drivers.log.mcap_log import read_log
from hil.camera.shared import folder
from missions.look.live.gate import TOKEN
from tests.free_ports import free_port
from tests.missions.look.live.watcher import hears, look_too, tap_twice, until
from tests.overloaded import Flown, Repeating
from tests.run_processes import left_of, processes_of

LANDING_LIMIT_S = 120.0
OVERLOADED = 43
SECRET = "0123456789abcdef"
FINGER_M = 0.456
GONE_S = 3.0
"""Between two pictures of the page, while somebody else who looks at it stands still."""


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for left-over processes in /proc")
def test_a_crew_designates_on_the_page_and_calls_the_flight_off_though_somebody_else_s_page_stands(
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
    told = [each.record for each in read_log(out / "sender.mcap", {"/told"})]
    assert [each["used"] for each in told if each["error_m"] == FINGER_M] == [True]
    asked = [each.record for each in read_log(out / "operator.mcap", {"/operator"})]
    assert [(each["act"], each["done"]) for each in asked] == [("place", True), ("stop", True)]
    ends = [
        list(read_log(out / f"{role}.mcap", {"/outcome"}))[-1].record
        for role in ("sender", "receiver")
    ]
    assert [end["landed"] for end in ends] == [True, True]


def fly(out: Path) -> Flown[tuple[Path, int]]:
    """To the stand-off, as the page shows it, where it is called off there, and down: the folder,
    and the number of the command.
    """
    port = free_port(socket.SOCK_STREAM)
    command = [sys.executable, "-m", "missions.cli", "handoff", "--rig", "sitl-light"]
    command += ["--out", str(out), "--no-picture", "--live", f"127.0.0.1:{port}"]
    with ExitStack() as stack:
        said = stack.enter_context((out / "said.txt").open("w+"))
        process = stack.enter_context(
            subprocess.Popen(
                command, stdout=said, stderr=subprocess.STDOUT, env={**os.environ, TOKEN: SECRET}
            )
        )
        heard = hears(port, SECRET)
        there = until(heard, lambda now: phase_of(now, "sender") == "acquire") is not None
        if there:
            look_too(port, SECRET, 2, stack)
            tap = {"act": "place", "place": place_of(out), "error_m": FINGER_M}
            assert "m north" in tap_twice(port, SECRET, tap)
            there = until(timely(heard), lambda now: phase_of(now, "receiver") == "stand-off")
        if there:
            assert len(processes_of(str(out))) >= 4  # this command, the world, both roles
            assert tap_twice(port, SECRET, {"act": "stop"}) == "called off"
        code = process.wait(LANDING_LIMIT_S)
        said.seek(0)
        assert code in ((30, OVERLOADED) if there else (OVERLOADED,)), said.read()
    facts = json.loads((out / "run.json").read_text())
    return Flown(facts["outcome"], facts["detail"], (out, process.pid))


def phase_of(now: dict[str, Any], name: str) -> str:
    return next((drone["phase"] for drone in now["drones"] if drone["name"] == name), "")


def place_of(out: Path) -> list[float]:
    """Where the target is now, in truth: north and east."""
    *_, newest = read_log(out / "world.mcap", {"/truth"})
    east, north, _ = newest.record["objects"][0]["t"]
    return [north, east]


def timely(heard: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """What is heard; fails where the page stands still."""
    newest_s = time.monotonic()
    for now in heard:
        assert time.monotonic() - newest_s < GONE_S
        newest_s = time.monotonic()
        yield now

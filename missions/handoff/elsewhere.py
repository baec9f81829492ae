"""Stands in for a drone's program that a person starts in another shell, and tells the harness what its log says.

    python -m missions.handoff.elsewhere ROLE RUN_FOLDER

The harness starts it where it would start the program itself. A program that was killed may be started again: its
further log is followed too, until one has an outcome.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from drivers.log.mcap_log import parts
from flight.harness.flights import Progress, RoleResult, encode_event
from flight.outcome import Outcome
from missions.live.follow import LogFollower
from path.messages import Role

POLL_S = 0.1
LANDING_S = 50.0


def events(role: Role, folder: Path) -> Iterator[Progress | RoleResult | None]:
    """Yields what a role's log says, as soon as it says it; None when there is nothing new."""
    logs: dict[Path, LogFollower] = {}
    while True:
        for path in parts(folder, role.value):
            logs.setdefault(path, LogFollower(path))
        for log in logs.values():
            for said in log.new():
                topic = said.topic.rpartition("/")[2]
                if topic in ("phase", "outcome"):
                    record: dict[str, Any] = msgspec.json.decode(said.message.data)
                    yield _event(role, topic, said.message.log_time, record)
        yield None


def _event(role: Role, topic: str, stamp_ns: int, record: dict[str, Any]) -> Progress | RoleResult:
    if topic == "phase":
        note = record.get("note", "")
        return Progress(role, stamp_ns, record["phase"], 0, 0, None, None, None, 0.0, False, note)
    outcome = Outcome.from_label(record["outcome"])
    return RoleResult(role, outcome, record["detail"], record["responsible"], record["landed"])


def main() -> None:
    """Told to end, it waits for a program that runs: that is another shell's to stop, and then has to land."""
    role, folder = Role(sys.argv[1]), Path(sys.argv[2])
    told_s: list[float] = []

    def told(number: int, frame: object) -> None:
        del number, frame
        told_s.append(time.monotonic())

    signal.signal(signal.SIGTERM, told)
    for event in events(role, folder):
        if event is None:
            if told_s and (not parts(folder, role.value) or time.monotonic() - told_s[0] > LANDING_S):
                return
            time.sleep(POLL_S)
            continue
        print(encode_event(event), flush=True)
        if isinstance(event, RoleResult):
            return


if __name__ == "__main__":
    main()

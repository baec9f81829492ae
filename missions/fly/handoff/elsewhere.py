"""Stands in for a drone's program that a person starts in another shell, and tells the harness what
its log says.

    python -m missions.fly.handoff.elsewhere ROLE RUN_FOLDER WAIT_S TYPED

The harness starts it where it would start the program itself. It waits for a log for so long, and
says meanwhile what is to be typed; then nobody has come, and that is the role's end. A program that
was killed may be started again: its further log is followed too, until one has an outcome.
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
from flight.harness.flights import ABSENT, Progress, RoleResult, encode_event
from flight.outcome import Outcome
from missions.look.live.follow import LogFollower
from path.messages import Role

POLL_S = 0.1
LANDING_S = 50.0
SAYS_EVERY_S = 30.0


def events(role: Role, folder: Path) -> Iterator[Progress | RoleResult | None]:
    """Yield what a role's log says, as soon as it says it; None when there is nothing new."""
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


def _event(
    role: Role,
    topic: str,
    stamp_ns: int,
    record: dict[str, Any],
) -> Progress | RoleResult:
    if topic == "phase":
        note = record.get("note", "")
        return Progress(role, stamp_ns, record["phase"], 0, 0, None, None, None, 0.0, False, note)
    outcome = Outcome.from_label(record["outcome"])
    return RoleResult(role, outcome, record["detail"], record["responsible"], record["landed"])


class Waiting:
    """The time in which a person may start the program: what is said meanwhile, and what when it is
    over.

    Args:
        wait_s: for so long it may take.
        typed: what the person is to type.
    """

    def __init__(
        self,
        role: Role,
        wait_s: float,
        typed: str,
        now_s: float,
    ) -> None:
        self._role = role
        self._wait_s = wait_s
        self._typed = typed
        self._ends_s = now_s + wait_s
        self._says_s = now_s

    def news(self, now_s: float) -> Progress | RoleResult | None:
        """Return what is to be said now; a result ends the wait."""
        if now_s >= self._ends_s:
            return _nobody(
                self._role,
                Outcome.NOT_STARTED,
                f"nobody started its program within {self._wait_s:g} s",
            )
        if now_s < self._says_s:
            return None
        self._says_s = now_s + SAYS_EVERY_S
        left_s = round(self._ends_s - now_s)
        note = f"start it now, within {left_s} s, in another shell: {self._typed}"
        return Progress(self._role, 0, ABSENT, 0, 0, None, None, None, 0.0, False, note)


def _nobody(
    role: Role,
    outcome: Outcome,
    detail: str,
) -> RoleResult:
    """Return the end of a program that never was: its vehicle stands where it stood."""
    return RoleResult(role, outcome, detail, responsible=False, landed=True)


def main() -> None:
    """Told to end, it waits for a program that runs: that is another shell's to stop, and then has
    to land.
    """
    role = Role(sys.argv[1])
    folder = Path(sys.argv[2])
    waiting = Waiting(role, float(sys.argv[3]), sys.argv[4], time.monotonic())
    told_s: list[float] = []

    def told(number: int, frame: object) -> None:
        del number, frame
        told_s.append(time.monotonic())

    signal.signal(signal.SIGTERM, told)
    for said in events(role, folder):
        event = said
        now_s = time.monotonic()
        if event is None and not parts(folder, role.value):
            event = waiting.news(now_s)
            if told_s:
                event = _nobody(
                    role,
                    Outcome.INTERRUPTED,
                    "it ended before anybody started its program",
                )
        if event is not None:
            print(encode_event(event), flush=True)
        if isinstance(event, RoleResult):
            return
        if said is None:
            if told_s and now_s - told_s[0] > LANDING_S:
                return
            time.sleep(POLL_S)


if __name__ == "__main__":
    main()

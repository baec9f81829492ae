"""The record of a rig's first flights: which steps of docs/field.md were done, when, and by what.

``doctor`` and the flights tick what they see by themselves, a crew ticks the rest with ``path-handoff
checklist RIG --tick``. The record refuses nothing and ends nothing: it says what is not ticked. Only
rigs of real drones have one, a line of JSON for each tick.
"""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Any

from drivers.rig.parts import Rig
from flight.outcome import Outcome
from path.messages import Role

STEPS = {
    "doctor-d1": "bench, propellers off: doctor on D1, no fault",
    "doctor-d2": "the same on D2",
    "switches": "switches and sticks, in the ground station",
    "blocks": "on blocks: refused; kill, mode, radio off",
    "by-hand": "by hand, no program: square, LAND, RETURN",
    "guard": "hover by hand, the guard watching",
    "one-drone": "one drone: 10 s; mode, sticks, kill -9",
    "one-target": "D1 and a target, D2 on the ground",
    "two-drones": "two, 10 m apart; both pilots take over",
    "hand-over": "a hand-over: committed",
}
"""By the name that ``--tick`` takes, in the order of docs/field.md."""

_OF_OUTCOME = {Outcome.COMMITTED: "hand-over", Outcome.FLOWN: "one-drone"}
_OF_SENDER_ALONE = (Outcome.PEER_LOST, Outcome.NO_AGREEMENT)


class FirstFlights:
    """The record of one rig on this computer, in ``runs`` of the folder one is in. Of a rig that
    flies in a harness nothing is kept, and nothing is said.
    """

    def __init__(self, rig: Rig, folder: Path = Path("runs")) -> None:
        self.file = folder / f"{rig.name}.first-flights.jsonl"
        self._kept = rig.harness is None
        self.failed = ""

    def tick(self, step: str, what: str) -> None:
        """Keep that a step was done. What cannot be written is kept in ``failed``, and no more."""
        if not self._kept:
            return
        line = json.dumps({"step": step, "at": f"{datetime.now():%Y-%m-%d %H:%M}", "what": what})
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with self.file.open("a", encoding="utf-8") as file:
                file.write(f"\n{line}\n")  # what was torn off before it is a line of its own
        except OSError as error:
            self.failed = f"{self.file}: {error.strerror}: first flights are not kept"

    def doctor(self, role: Role) -> None:
        """Tick that ``doctor`` tested all of a role and found no fault."""
        self.tick("doctor-d1" if role is Role.SENDER else "doctor-d2", "by doctor")

    def flight(self, role: Role, outcome: Outcome) -> None:
        """Tick what a flight from a drone's own computer was."""
        step = _OF_OUTCOME.get(outcome)
        if role is Role.SENDER and outcome in _OF_SENDER_ALONE:
            step = "one-target"
        if step is not None:
            self.tick(step, f"{role.value}: {outcome.label}")

    def done(self) -> dict[str, str]:
        """Return each step with when it was last ticked and by what; "" for never."""
        done = dict.fromkeys(STEPS, "")
        for line in self._lines():
            if line.get("step") in done:
                done[line["step"]] = f"{line.get('at', '')}, {line.get('what', '')}"
        return done

    def left(self) -> str:
        """Return in a line what is not ticked; "" where no record is kept."""
        if not self._kept:
            return ""
        if self.failed:
            return f"{self.failed}\n"
        missing = [step for step, when in self.done().items() if not when]
        if not missing:
            return "first flights: all are ticked\n"
        return (
            f"first flights not ticked: {', '.join(missing)} (docs/field.md; nothing is refused)\n"
        )

    def _lines(self) -> list[dict[str, Any]]:
        """Return what the file says; a line that is damaged says nothing."""
        try:
            text = self.file.read_text("utf-8", errors="replace")
        except OSError:
            return []
        found: list[dict[str, Any]] = []
        for line in text.splitlines():
            try:
                said = json.loads(line)
            except ValueError:
                continue
            if isinstance(said, dict):
                found.append(said)
        return found

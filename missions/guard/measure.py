"""The measurement of ``path-handoff guard --measure``: how soon a vehicle is held, down, or let go of.

It is held and down after its program was killed or hung. A script lets go of one that a pilot takes: by a second ground
station, or by the radio's switches and sticks.

Real programs, real signals, real sockets: one flight for each fault, role and phase. The autopilots' own failsafe for
setpoints is switched off, or waits, so that what is measured is the guard. In virtual time (rig ``sim``) there are the
pilot's cases alone.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from drivers.log.mcap_log import read_log
from drivers.rig.parts import Rig
from drivers.rig.toml_text import toml_text
from flight.outcome import Outcome
from flight.phases import Phase
from missions import rig_library
from missions.handoff.command import fly_once
from missions.options.field import GuardOptions
from missions.report.command import show
from missions.report.records import SUMMARY
from missions.run_folder import claim_folder, new_folder
from path.messages import Role

TAKEOVER = "pilot_takeover"  # the receiver's vehicle only
RADIO = ("rc_mode", "rc_sticks", "rc_kill", "rc_lost")
OF_PROGRAM = ("kill", "stop", "stall")
KINDS = {**dict.fromkeys(OF_PROGRAM, ""), "stall": "=5", TAKEOVER: "", **dict.fromkeys(RADIO, "")}
LET_GO_S = {TAKEOVER: 0.5, "rc_mode": 0.5, "rc_sticks": 0.5, "rc_kill": 1.5, "rc_lost": 1.0}
"""After this time no setpoint may come. PX4 tells of a kill switch once a second; a radio is lost after 0.5 s."""
MOMENTS = {
    Role.SENDER: ("take-off+2", "acquire+1.5", "follow+3", "verify+1", "depart+1", "land+1"),
    Role.RECEIVER: ("take-off+2", "stand-off+3", "search", "approach+1", "verify+1", "follow+1", "depart+1", "land+1"),
}
ORDER = {phase.title: int(phase) for phase in Phase}
HOLD_LIMIT_S = 1.0
RESTORED_S = 1.2  # its heartbeat, which tells that it is disarmed, comes once a second
PX4_FAILSAFE, WAITS_S = "COM_OF_LOSS_T", 5.0


@dataclass(frozen=True, slots=True)
class Reaction:
    """One flight. Times are from the signal; None: it never came.

    Attributes:
        mode: of the vehicle when it happened.
        held_s: until it was in HOLD, LAND or RETURN.
        landed_s: until it was disarmed on the ground.
        let_go_s: until its last setpoint, which may have come before.
        after: modes the vehicle went through afterwards.
        apart_m: least true distance between the two, both in the air, from then on; None: they were not.
        other_down: the other drone was on the ground, disarmed, in the end.
        own: how the program itself ended; the run may be called by what the other one came to.
        reason: why the guard took it; empty when it did not.
    """

    fault: str
    role: str
    moment: str
    mode: str
    held_s: float | None
    landed_s: float | None
    let_go_s: float | None
    after: tuple[str, ...]
    reason: str
    outcome: str
    violations: dict[str, int]
    apart_m: float | None = None
    other_down: bool = True
    own: str = ""

    @property
    def reached(self) -> bool:
        """Returns whether the vehicle was in the air under a script when it happened."""
        return self.mode in ("offboard", "takeoff", "hold")


def measure(options: GuardOptions) -> int:
    """Flies every case and prints the table; returns 1 when a guard or a script failed.

    A vehicle was not held within a second or did not land, or a script did not let go at once.
    """
    folder = new_folder(options.out)
    claim_folder(folder, SUMMARY, '"reactions"')
    (folder / SUMMARY).write_text(json.dumps({"reactions": []}) + "\n", "utf-8")  # whose folder it is, from now on
    rig = with_patient_failsafe(rig_library.load(options.rig), folder)
    reactions: list[Reaction] = []
    every = list(cases(options.role, options.case, kinds_of(rig)))
    for number, (fault, role, moment) in enumerate(every, 1):
        name = f"{_named(fault, role)}{KINDS[fault]}@{moment}"
        out = new_folder(folder / name.replace("@", "-").replace("=", "-").replace("+", "-"))
        facts = fly_once(rig, 0, ("no_failsafe", name), out, lambda _: None)
        reaction = read_reaction(out, fault, role, moment, facts.outcome, dict(facts.violations))
        reactions.append(reaction)
        sys.stdout.write(f"[{number}/{len(every)}] {name}: {_words(reaction)}\n")
        sys.stdout.flush()
        records = [asdict(each) for each in reactions]
        (folder / SUMMARY).write_text(json.dumps({"reactions": records}, indent=2) + "\n", "utf-8")
    show(table(reactions), sys.stdout)
    sys.stdout.write(f"\n{folder}: {SUMMARY}, and a folder for each flight\n")
    return 0 if all(is_met(reaction) for reaction in reactions) else 1


def with_patient_failsafe(rig: Rig, folder: Path) -> Rig:
    """PX4's own failsafe for setpoints waits until the guard has had its turn; a fault switches an embedded one off."""
    patient = {
        role.value: {"vehicle": {"parameters": {PX4_FAILSAFE: WAITS_S}}}
        for role in Role
        if PX4_FAILSAFE in rig.role(role).vehicle.options.get("parameters", {})
    }
    if not patient:
        return rig
    file = folder / "rig.toml"
    file.write_text(toml_text({"name": rig.name, "like": str(rig.file.resolve()), **patient}), "utf-8")
    return rig_library.load(str(file))


def kinds_of(rig: Rig) -> tuple[str, ...]:
    """Returns what can be tried on a rig: programs of their own can hang; pilots have radios unless it says not."""
    own = OF_PROGRAM if rig.level not in ("sim", "sim-rendered") else ()
    simulated = "sender_simulator" in rig.world
    radio = () if simulated and any(rig.role(role).vehicle.options.get("rc") == "none" for role in Role) else RADIO
    return (*own, TAKEOVER, *radio)


def _named(fault: str, role: Role) -> str:
    return fault if fault == TAKEOVER else f"{fault}_{role.value}"


def cases(role: str, only: Sequence[str], kinds: Sequence[str] = tuple(KINDS)) -> Iterator[tuple[str, Role, str]]:
    """(fault, role, moment) of every flight; ``only``: those whose name has one of these in it."""
    every = [(own, moment) for own, moments in MOMENTS.items() for moment in moments if role in ("both", own.value)]
    for own, moment in sorted(every, key=lambda entry: ORDER[entry[1].partition("+")[0]]):  # short flights first
        for fault in kinds:
            if fault == TAKEOVER and own is Role.SENDER:
                continue
            if not only or any(word in f"{_named(fault, own)}@{moment}" for word in only):
                yield fault, own, moment


def read_reaction(out: Path, fault: str, role: Role, moment: str, outcome: str, violations: dict[str, int]) -> Reaction:
    """Reads what became of the vehicle, by the world's own log; why, by the guard's."""
    at_ns: int | None = None
    last_ns: int | None = None
    apart_m: list[tuple[int, float]] = []
    other_armed = False
    modes: list[tuple[int, str, bool]] = []
    for record in read_log(out / "world.mcap"):
        if record.topic == "/fault" and record.record["fault"].startswith(_named(fault, role)):
            at_ns = record.stamp_ns
        elif record.topic == "/autopilot" and record.record["role"] == role.value:
            modes.append((record.stamp_ns, record.record["mode"], record.record["armed"]))
        elif record.topic == "/autopilot":
            other_armed = record.record["armed"]
        elif record.topic == "/truth":
            one, two = record.record["sender"], record.record["receiver"]
            if one["in_air"] and two["in_air"]:
                apart_m.append((record.stamp_ns, math.dist(one["t"], two["t"])))
        elif record.topic == "/setpoint_gap" and record.record["role"] == role.value:
            last_ns = record.record["last_ns"]
    if at_ns is None:
        return Reaction(fault, role.value, moment, "not reached", None, None, None, (), "", outcome, violations)
    before = [mode for stamp_ns, mode, armed in modes if stamp_ns <= at_ns and armed]
    later = [entry for entry in modes if entry[0] > at_ns]
    mode = before[-1] if before else "not armed"
    return Reaction(
        fault=fault,
        role=role.value,
        moment=moment,
        mode=mode,
        held_s=0.0 if mode == "hold" else _first(at_ns, [s for s, m, _ in later if m in ("hold", "land", "return")]),
        landed_s=_first(at_ns, [s for s, _, armed in later if not armed]),
        let_go_s=None if last_ns is None else (last_ns - at_ns) * 1e-9,
        after=tuple(m for _, m, armed in _without_restored(later) if armed),
        reason=_reason(out / f"{role.value}.guard.mcap"),
        outcome=outcome,
        violations=violations,
        apart_m=min((distance_m for stamp_ns, distance_m in apart_m if stamp_ns >= at_ns), default=None),
        other_down=not other_armed,
        own=_own_outcome(out / f"{role.value}.mcap"),
    )


def _without_restored(modes: Sequence[tuple[int, str, bool]]) -> Sequence[tuple[int, str, bool]]:
    """Without the mode from before the landing, which a PX4 selects again a moment before it tells that it disarmed."""
    for k in range(1, len(modes) - 1):
        (_, before, _), (at_ns, _, _), (disarmed_ns, _, armed) = modes[k - 1 : k + 2]
        if before == "land" and not armed and disarmed_ns - at_ns < RESTORED_S * 1e9:
            return [*modes[:k], *modes[k + 1 :]]
    return modes


def _first(at_ns: int, stamps_ns: Sequence[int]) -> float | None:
    return (min(stamps_ns) - at_ns) * 1e-9 if stamps_ns else None


def _own_outcome(log: Path) -> str:
    """The end that a role's program named; empty when it named none."""
    ends = [r.record["outcome"] for r in read_log(log) if r.topic == "/outcome"] if log.exists() else []
    return str(ends[-1]) if ends else ""


def _reason(log: Path) -> str:
    taken = [r.record for r in read_log(log) if r.topic == "/guard" and r.record["stage"] in ("holding", "landing")]
    return str(taken[0]["reason"]) if taken else ""


def is_met(reaction: Reaction) -> bool:
    """Held in time and down; or, when its mode was changed, let go of at once. On the ground there is nothing to do."""
    if not reaction.reached:
        return reaction.mode != "not reached"
    if reaction.fault in LET_GO_S:
        late = reaction.let_go_s is not None and reaction.let_go_s > LET_GO_S[reaction.fault]
        known = Outcome.PILOT_OVERRIDE.label in (reaction.own, reaction.outcome)
        return not late and known and reaction.other_down and not reaction.violations and _left_alone(reaction)
    return reaction.held_s is not None and reaction.held_s <= HOLD_LIMIT_S and reaction.landed_s is not None


def _left_alone(reaction: Reaction) -> bool:
    """Returns whether only the pilot, or the autopilot without its radio, changed the mode afterwards."""
    match reaction.fault:
        case "rc_kill":
            return reaction.after == ()
        case "rc_lost":
            return reaction.after in (("hold", "land"), ("land",))
        case _:
            return len(reaction.after) == 1


def _words(reaction: Reaction) -> str:
    if not reaction.reached:
        return f"nothing to take: {reaction.mode}"
    if reaction.fault in LET_GO_S:
        return f"last setpoint {_let_go(reaction)}; {reaction.outcome} ({' → '.join((reaction.mode, *reaction.after))})"
    seconds = ["never" if value is None else f"after {value:.2f} s" for value in (reaction.held_s, reaction.landed_s)]
    return f"held {seconds[0]}, down {seconds[1]} ({' → '.join((reaction.mode, *reaction.after))})"


def table(reactions: Sequence[Reaction]) -> Table:
    """One row for each phase, kinds of fault beside each other."""
    tried = [kind for kind in KINDS if any(r.fault == kind for r in reactions)]
    made = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for title in ("program", "phase", "mode", *(f"{kind}{KINDS[kind]}" for kind in tried)):
        made.add_column(title, no_wrap=True)
    rows = sorted({(r.role, r.moment) for r in reactions}, key=lambda row: (row[0], ORDER[row[1].partition("+")[0]]))
    for role, moment in rows:
        found: dict[str, Any] = {r.fault: r for r in reactions if (r.role, r.moment) == (role, moment)}
        mode = " / ".join(dict.fromkeys(r.mode for r in found.values()))
        made.add_row(role, moment, mode, *(_figures(found.get(kind)) for kind in tried))
    return made


def _figures(reaction: Reaction | None) -> str:
    if reaction is None or not reaction.reached:
        return "-"
    if reaction.fault in LET_GO_S:
        return _let_go(reaction)
    held, landed = (("never" if value is None else f"{value:.2f}") for value in (reaction.held_s, reaction.landed_s))
    return f"{held} / {landed}"


def _let_go(reaction: Reaction) -> str:
    return "never sent" if reaction.let_go_s is None else f"{reaction.let_go_s:+.3f} s"

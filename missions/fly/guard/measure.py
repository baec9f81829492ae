"""The measurement of ``path-handoff guard --measure``: how soon a vehicle is held, down, or let go
of.

It is held and down after its program was killed or hung. A script lets go of one that a pilot
takes: by a second ground station, or by the radio's switches and sticks.

Real programs, real signals, real sockets: one flight for each fault, role and phase. The
autopilots' own failsafe for setpoints is switched off, or waits, so that what is measured is the
guard. In virtual time (rig ``sim``) there are the pilot's cases alone.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from drivers.rig.parts import Rig
from drivers.rig.toml_text import toml_text
from flight.phases import Phase
from missions.fly.guard.reaction import LET_GO_S, TAKEOVER, Reaction, is_met, named, read_reaction
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.ground.options.field import GuardOptions
from missions.ground.run_folder import claim_folder, new_folder, unless_refused, write_json
from missions.look.report.command import show
from missions.look.report.records import SUMMARY
from path.messages import Role

RADIO = ("rc_mode", "rc_sticks", "rc_kill", "rc_lost")
OF_PROGRAM = ("kill", "stop", "stall")
KINDS = {**dict.fromkeys(OF_PROGRAM, ""), "stall": "=5", TAKEOVER: "", **dict.fromkeys(RADIO, "")}
MOMENTS = {
    Role.SENDER: ("take-off+2", "acquire+1.5", "follow+3", "verify+1", "depart+1", "land+1"),
    Role.RECEIVER: (
        "take-off+2",
        "stand-off+3",
        "search",
        "approach+1",
        "verify+1",
        "follow+1",
        "depart+1",
        "land+1",
    ),
}
ORDER = {phase.title: int(phase) for phase in Phase}
PX4_FAILSAFE = "COM_OF_LOSS_T"
WAITS_S = 5.0


def measure(options: GuardOptions) -> int:
    """Fly every case and print the table; returns 1 when a guard or a script failed.

    A vehicle was not held within a second or did not land, or a script did not let go at once.
    """
    with unless_refused(options.out) as folder:
        claim_folder(folder, SUMMARY, '"reactions"')
        return _measure(options, folder)


def _measure(options: GuardOptions, folder: Path) -> int:
    # whose folder it is, from now on
    write_json(folder / SUMMARY, {"reactions": []})
    rig = with_patient_failsafe(rig_library.load(options.rig), folder)
    reactions: list[Reaction] = []
    every = list(cases(options.role, options.case, kinds_of(rig)))
    for number, (fault, role, moment) in enumerate(every, 1):
        name = f"{named(fault, role)}{KINDS[fault]}@{moment}"
        out = new_folder(folder / name.replace("@", "-").replace("=", "-").replace("+", "-"))
        facts = fly_once(rig, 0, ("no_failsafe", name), out, lambda _: None)
        reaction = read_reaction(out, fault, role, moment, facts.outcome, dict(facts.violations))
        reactions.append(reaction)
        sys.stdout.write(f"[{number}/{len(every)}] {name}: {_words(reaction)}\n")
        sys.stdout.flush()
        records = [asdict(each) for each in reactions]
        write_json(folder / SUMMARY, {"reactions": records})
    show(table(reactions), sys.stdout)
    sys.stdout.write(f"\n{folder}: {SUMMARY}, and a folder for each flight\n")
    return 0 if all(is_met(reaction) for reaction in reactions) else 1


def with_patient_failsafe(rig: Rig, folder: Path) -> Rig:
    """PX4's own failsafe for setpoints waits until the guard has had its turn; a fault switches an
    embedded one off.
    """
    patient = {
        role.value: {"vehicle": {"parameters": {PX4_FAILSAFE: WAITS_S}}}
        for role in Role
        if PX4_FAILSAFE in rig.role(role).vehicle.options.get("parameters", {})
    }
    if not patient:
        return rig
    file = folder / "rig.toml"
    file.write_text(
        toml_text({"name": rig.name, "like": str(rig.file.resolve()), **patient}), "utf-8"
    )
    return rig_library.load(str(file))


def kinds_of(rig: Rig) -> tuple[str, ...]:
    """Return what can be tried on a rig: programs of their own can hang; pilots have radios unless
    it says not.
    """
    own = OF_PROGRAM if rig.level not in ("sim", "sim-rendered") else ()
    simulated = "sender_simulator" in rig.world
    radio = (
        ()
        if simulated and any(rig.role(role).vehicle.options.get("rc") == "none" for role in Role)
        else RADIO
    )
    return (*own, TAKEOVER, *radio)


def cases(
    role: str,
    only: Sequence[str],
    kinds: Sequence[str] = tuple(KINDS),
) -> Iterator[tuple[str, Role, str]]:
    """(fault, role, moment) of every flight; ``only``: those whose name has one of these in it."""
    every = [
        (own, moment)
        for own, moments in MOMENTS.items()
        for moment in moments
        if role in ("both", own.value)
    ]
    # short flights first
    for own, moment in sorted(every, key=lambda entry: ORDER[entry[1].partition("+")[0]]):
        for fault in kinds:
            if fault == TAKEOVER and own is Role.SENDER:
                continue
            if not only or any(word in f"{named(fault, own)}@{moment}" for word in only):
                yield fault, own, moment


def _words(reaction: Reaction) -> str:
    if not reaction.reached:
        return f"nothing to take: {reaction.mode}"
    if reaction.fault in LET_GO_S:
        return f"last setpoint {_let_go(reaction)}; {reaction.outcome} ({' → '.join((reaction.mode, *reaction.after))})"
    seconds = [
        "never" if value is None else f"after {value:.2f} s"
        for value in (reaction.held_s, reaction.landed_s)
    ]
    return f"held {seconds[0]}, down {seconds[1]} ({' → '.join((reaction.mode, *reaction.after))})"


def table(reactions: Sequence[Reaction]) -> Table:
    """One row for each phase, kinds of fault beside each other."""
    tried = [kind for kind in KINDS if any(r.fault == kind for r in reactions)]
    made = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for title in ("program", "phase", "mode", *(f"{kind}{KINDS[kind]}" for kind in tried)):
        made.add_column(title, no_wrap=True)
    rows = sorted(
        {(r.role, r.moment) for r in reactions},
        key=lambda row: (row[0], ORDER[row[1].partition("+")[0]]),
    )
    for role, moment in rows:
        found: dict[str, Any] = {
            r.fault: r for r in reactions if (r.role, r.moment) == (role, moment)
        }
        mode = " / ".join(dict.fromkeys(r.mode for r in found.values()))
        made.add_row(role, moment, mode, *(_figures(found.get(kind)) for kind in tried))
    return made


def _figures(reaction: Reaction | None) -> str:
    if reaction is None or not reaction.reached:
        return "-"
    if reaction.fault in LET_GO_S:
        return _let_go(reaction)
    held, landed = (
        ("never" if value is None else f"{value:.2f}")
        for value in (reaction.held_s, reaction.landed_s)
    )
    return f"{held} / {landed}"


def _let_go(reaction: Reaction) -> str:
    return "never sent" if reaction.let_go_s is None else f"{reaction.let_go_s:+.3f} s"

"""Runs of whole handoffs in which the link is bad, a program is killed, or a stranger floods it;
what came of each.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.link.wire import KEY_LENGTH
from drivers.rig.toml_text import toml_text
from flight.phases import COURSE
from missions.ground import rig_library
from missions.look.report.records import last
from missions.look.report.summary import summarize
from missions.trials.cost.processes import duty as processes_duty
from missions.trials.cost.processes.duty import Responsibility
from missions.trials.shared import flown
from path.messages import Role
from path.values import frozen

SIM = "sim"
LIVE = "sitl-light"

Kinds = Sequence[tuple[str, tuple[str, ...]]]
LINKS: Kinds = (
    ("no loss", ()),
    ("10 % lost", ("link_loss=0.1",)),
    ("30 % lost", ("link_loss=0.3",)),
    ("50 % lost", ("link_loss=0.5",)),
    ("200 ms jitter", ("link_jitter=0.2",)),
    ("all sent twice, 20 % overtaken", ("link_duplicate=1", "link_reorder=0.2")),
    ("20 % damaged", ("link_corrupt=0.2",)),
    ("10 % lost, 10 % damaged, half twice, 50 ms jitter",
     ("link_loss=0.1", "link_corrupt=0.1", "link_duplicate=0.5", "link_jitter=0.05")),
)  # fmt: skip
ATTACKS: Kinds = (
    ("nobody attacks", ()),
    ("2,000 packets a second", ("attack=2000",)),
    ("2,000 a second, and 20 % lost", ("attack=2000", "link_loss=0.2")),
)
STEPS = {
    Role.SENDER: ("released", "handed_over"),
    Role.RECEIVER: ("provisional", "holding", "let_go"),
}
NO_CONFIRM = "link_out=3@handed_over"  # so that a receiver lets go


@frozen
class ProcessRun:
    """One run. ``what`` names it for a reader, ``where`` is the moment of a kill."""

    rig: str
    seed: int
    what: str
    faults: tuple[str, ...]
    folder: Path
    killed: Role | None = None
    where: str = ""
    restart_s: float | None = None


@frozen
class Came:
    """The result of a run.

    Attributes:
        outcomes: by role; "died" for a program that was not started again, with the run's own
            ending for the rest.
        landed: both vehicles on the ground, disarmed.
        violations: of the harness's monitors, by name.
    """

    asked: ProcessRun
    outcome: str
    detail: str
    outcomes: dict[str, str]
    landed: bool
    violations: dict[str, int]
    notes: tuple[str, ...]
    duty: Responsibility
    agreement_s: float | None
    wrong: bool
    dropped: dict[str, dict[str, int]]
    wall_s: float


def signed_rig(name: str, folder: Path) -> str:
    """A rig like the named one whose drones share a key, made in a folder; its file."""
    key = folder / "pair.key"
    file = folder / f"{name}-signed.toml"
    key.write_bytes(os.urandom(KEY_LENGTH))
    key.chmod(0o600)
    links = {role.value: {"link": {"key_file": key.name}} for role in Role}
    like = str(rig_library.load(name).file.resolve())
    file.write_text(
        toml_text({"like": like, **links}, f"{name}, whose drones share a key"), "utf-8"
    )
    return str(file)


def links(rig: str, seeds: Sequence[int], out: Path) -> list[ProcessRun]:
    """Whole handoffs on links of every badness."""
    return _each(LINKS, rig, seeds, out / "link")


def attacks(rig: str, seeds: Sequence[int], out: Path) -> list[ProcessRun]:
    """Whole handoffs beside a third process that floods both roles, and the same without it."""
    return _each(ATTACKS, rig, seeds, out / "attack")


def _each(kinds: Kinds, rig: str, seeds: Sequence[int], out: Path) -> list[ProcessRun]:
    return [
        ProcessRun(rig, seed, what, faults, out.with_name(f"{out.name}-{number}-{seed}"))
        for number, (what, faults) in enumerate(kinds)
        for seed in seeds
    ]


def kills(
    rig: str,
    seeds: Sequence[int],
    phases_s: Sequence[float],
    restarts_s: Sequence[float | None],
    out: Path,
) -> list[ProcessRun]:
    """Return a kill of either side in every phase of its course, and at every record it writes
    down.

    The phases' kills come ``phases_s`` after each began. All are without and with being started
    again.
    """
    asked: list[ProcessRun] = []
    for role in Role:
        moments = [(phase.title, after_s) for phase in COURSE[role] for after_s in phases_s]
        moments += [(step, 0.0) for step in STEPS[role]]
        for moment, after_s in moments:
            for restart_s in restarts_s:
                for seed in seeds:
                    asked.append(
                        _kill(
                            rig,
                            seed,
                            role,
                            moment,
                            after_s,
                            restart_s,
                            out / f"kill-{len(asked):04d}",
                        )
                    )
    return asked


def _kill(
    rig: str,
    seed: int,
    role: Role,
    moment: str,
    after_s: float,
    restart_s: float | None,
    folder: Path,
) -> ProcessRun:
    where = moment + (f"+{after_s:g}" if after_s else "")
    fault = f"kill_{role.value}" + ("" if restart_s is None else f"={restart_s:g}") + f"@{where}"
    faults = (NO_CONFIRM, fault) if moment == "let_go" else (fault,)
    return ProcessRun(
        rig, seed, f"{role.value} killed at {where}", faults, folder, role, where, restart_s
    )


def fly(asked: ProcessRun) -> Came:
    """One run; its logs are thrown away unless something is wrong with it."""
    facts, run = flown.fly(rig_library.load(asked.rig), asked.seed, asked.faults, asked.folder)
    summary: dict[str, Any] = summarize(run)
    truth = last(run.world, "/truth")
    came = Came(
        asked=asked,
        outcome=facts.outcome,
        detail=facts.detail,
        outcomes={role.value: _ending(summary, role, asked) for role in Role},
        landed=truth is not None and not any(truth.record[role.value]["in_air"] for role in Role),
        violations=dict(facts.violations),
        notes=facts.notes,
        duty=processes_duty.read(asked.folder),
        agreement_s=summary["agreement_s"],
        wrong=summary["wrong_handover"] is True,
        dropped=summary["link_dropped"],
        wall_s=facts.wall_s,
    )
    if not suspicious(came):
        flown.throw_away(asked.folder)
    return came


def suspicious(came: Came) -> bool:
    """Worth a look at its logs."""
    return bool(
        came.violations
        or came.duty.both_s
        or not came.landed
        or came.wrong
        or came.outcome == "harness_failed"
    )


def _ending(summary: dict[str, Any], role: Role, asked: ProcessRun) -> str:
    end = summary["roles"][role.value]
    return (
        "died"
        if end is None or (role is asked.killed and asked.restart_s is None)
        else str(end["outcome"])
    )

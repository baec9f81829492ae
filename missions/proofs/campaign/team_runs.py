"""Runs of whole teams in virtual time: the team, its field and its faults are drawn from level,
seed and number.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.interfaces import PartError
from drivers.rig.parts import Rig, with_errors
from flight.harness.fleet import TeamConfig
from flight.outcome import Outcome
from missions.fly.fleet.command import fly as fly_team
from missions.fly.fleet.command import tell
from missions.fly.relay.ground import Event
from missions.ground import rig_library
from missions.ground.options.flights import TeamOptions
from missions.ground.options.proofs import CampaignOptions
from missions.ground.options.words import LevelName
from missions.ground.team_config import team_of
from missions.proofs.campaign.plan import seed_of
from missions.proofs.campaign.results import OBSERVED_PERCENT, RunLine, story_folder, unread_folder
from path.values import frozen

if TYPE_CHECKING:
    from missions.proofs.campaign.run import RunOrder

RIG = "team-sim"
MOVED_M = 1.5  # of each target's place, on each axis
LEG_S = 420.0  # about, of one target
REPEATED = {"duplicate": 0.2, "corrupt": 0.1, "reorder": 0.2}  # shares of the packets, at most
KILLS = {"kill_receiver": "receiver", "kill_sender": "sender"}
PILOTS = {
    f"{name}_{role}": role
    for name in ("rc_mode", "rc_sticks", "rc_kill", "rc_lost")
    for role in ("sender", "receiver")
}
HOSTILE = {
    **KILLS, **PILOTS, "pilot_takeover": "receiver", "motor_kill": "receiver", "camera_freeze": "receiver",
    "fc_link_loss": "receiver", "battery_sag": "sender", "lookalike": "sender", "depth_holes": "sender",
    "marker_hidden": "sender",
}  # fmt: skip
"""Everything that virtual time knows to go wrong with a drone or around it, by the role whose
course says when.
"""
MOMENTS = {
    "receiver": ("stand-off", "search", "approach", "verify", "provisional", "holding"),
    "sender": ("follow", "verify", "released"),
}


@frozen
class TeamPlan:
    """Everything that is drawn for one run.

    Attributes:
        seed: of its world and of every noise.
        drones, targets: how many of the rig's take part.
        moved_m: of each target (E, N), against the rig's place.
        faults: as a user would order them, by their leg.
    """

    seed: int
    drones: int
    targets: int
    moved_m: tuple[tuple[float, float], ...]
    faults: tuple[str, ...]


def draw(
    config: TeamConfig,
    seed: int,
    level: LevelName,
    number: int,
    hours: float,
) -> TeamPlan:
    """The plan of a run."""
    rng = random.Random(seed_of("team", seed, level, number))
    targets = rng.randint(1, len(config.targets))
    drones = rng.randint(min(2 * targets, len(config.drones)), len(config.drones))
    moved = tuple(
        (rng.uniform(-MOVED_M, MOVED_M), rng.uniform(-MOVED_M, MOVED_M)) for _ in range(targets)
    )
    legs = max(1, round(targets * 3600.0 * hours / LEG_S))
    return TeamPlan(rng.getrandbits(31), drones, targets, moved, tuple(_faults(rng, level, legs)))


def _faults(
    rng: random.Random,
    level: LevelName,
    legs: int,
) -> list[str]:
    """Of the link in all legs; of programs, cameras, vehicles and batteries in some, a fifth of
    them at most.
    """
    if level == "none":
        return []
    most = {"lossy": 0.3, "harsh": 0.3, "hostile": 0.2}[level]
    faults = [
        f"link_loss={rng.uniform(0.05, most):.3f}",
        f"link_jitter={rng.uniform(0.0, 0.05):.3f}",
    ]
    faults += [f"link_{name}={rng.uniform(0.0, share):.3f}" for name, share in REPEATED.items()]
    if level == "lossy":
        return faults
    kinds = tuple(KILLS if level == "harsh" else HOSTILE)
    for leg in sorted(rng.sample(range(1, legs + 1), max(1, legs // 5))):
        kind = rng.choice(kinds)
        if rng.random() < 0.3:
            kind = "link_out"
        faults.append(f"{leg}:{_fault(rng, kind)}")
    return faults


def _fault(rng: random.Random, kind: str) -> str:
    role = HOSTILE.get(kind, "sender")
    value = ""
    if kind == "link_out" or kind.startswith("rc_lost"):
        value = f"={rng.uniform(0.2, 3.0):.2f}"
    elif kind == "battery_sag":
        value = f"={rng.uniform(0.4, 0.55):.2f}"
    elif kind in KILLS and rng.random() < 0.5:
        value = f"={rng.uniform(0.2, 3.0):.2f}"
    return f"{kind}{value}@{rng.choice(MOMENTS[role])}+{rng.uniform(0.0, 4.0):.2f}"


def fly(order: RunOrder) -> list[RunLine]:
    """Does an order's runs; nothing of their logs is left."""
    rig, config = _team(order)
    lines: list[RunLine] = []
    for level, number in order.runs:
        with unread_folder() as folder:
            lines.append(_fly(rig, config, order, level, number, folder, lambda _: None))
    return lines


def replay(order: RunOrder, out: Path | None) -> RunLine:
    """The run's story on the terminal, and its logs in a folder."""
    rig, config = _team(order)
    (level, number), *_ = order.runs
    folder = story_folder(out)
    plan = draw(config, order.seed, level, number, _hours(order, config))
    sys.stdout.write(f"{plan.drones} drones, {plan.targets} targets, seed {plan.seed}\n")
    sys.stdout.write("".join(f"--fault {fault}\n" for fault in plan.faults))
    line = _fly(rig, config, order, level, number, folder, tell)
    sys.stdout.write(f"logs: {folder}\n")
    return line


def _team(order: RunOrder) -> tuple[Rig, TeamConfig]:
    named = RIG if order.rig == CampaignOptions().rig else order.rig
    rig = with_errors(rig_library.load(named), order.errors)
    if rig.level != "sim":
        raise PartError(
            f"rig {rig.name} is of level {rig.level}",
            "a campaign of teams wants a rig of level sim",
        )
    return rig, team_of(rig)


def _hours(order: RunOrder, config: TeamConfig) -> float:
    return config.hours if order.hours is None else order.hours


def _fly(
    rig: Rig, config: TeamConfig, order: RunOrder, level: LevelName, number: int, folder: Path,
    say: Callable[[Event], None],
) -> RunLine:  # fmt: skip
    hours = _hours(order, config)
    plan = draw(config, order.seed, level, number, hours)
    some = team_of(rig, plan.drones, plan.targets)
    placed = tuple(
        replace(each, place_m=(each.place_m[0] + east, each.place_m[1] + north))
        for each, (east, north) in zip(some.targets, plan.moved_m, strict=True)
    )
    options = TeamOptions(rig=rig.name, hours=hours, seed=plan.seed, fault=plan.faults)
    summary, record = fly_team(rig, replace(some, targets=placed), options, folder, say)
    figures = {
        "simulated_s": summary["simulated_s"],
        "unobserved_s": math.fsum(
            to_s - since_s for each in record["unobserved"].values() for since_s, to_s in each
        ),
    }
    if summary["gap_s"] is not None:
        figures["gap_s"] = summary["gap_s"]["max"]
    rounded = {key: round(value, 4) for key, value in figures.items()}
    observed = {name: share for name, share in targets_of(summary).items() if share is not None}
    return RunLine(
        number,
        level,
        named(summary),
        tuple(summary["notes"]),
        (),
        rounded,
        observed_percent=observed,
    )


def targets_of(summary: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the percent of the time for which each target was observed; None for one that was
    never acquired.
    """
    return {name: share for name, share in summary["observed_percent"].items() if name != "all"}


def named(summary: Mapping[str, Any]) -> str:
    """Return a run's outcome, in which every target counts that was ever acquired."""
    if summary["outcome"] in (Outcome.MONITOR_VIOLATED.label, Outcome.WRONG_OBJECT.label):
        return "violated"
    least = min((share for share in targets_of(summary).values() if share is not None), default=0.0)
    if summary["outcome"] == Outcome.COMMITTED.label and least < OBSERVED_PERCENT:
        return f"observed < {OBSERVED_PERCENT:g} %"
    return str(summary["outcome"]).replace("_", " ")

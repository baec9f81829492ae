"""The cost of a team by its size: processor time for each drone and simulated hour, and a field of
two hundred drones.

The flights go one after the other in this process, so that each has the processor's caches to
itself. The first one is not counted: it loads what every later one finds loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from drivers.rig.parts import Rig
from flight.outcome import Outcome
from missions.fly.team.command import fly_team
from missions.ground.options.flights import TeamOptions
from missions.ground.run_folder import new_folder
from missions.ground.shown import tell_line
from missions.ground.team_config import checked_team, fenced, laid_out
from missions.look.report.palette import DIM, NEEDED, ROLE
from missions.look.report.tables import counts_text, sum_of
from missions.trials.shared.drawing import panels, save
from missions.trials.shared.trial import (
    TrialFinding,
    TrialPicture,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.messages import Role
from path.values import frozen

TITLE = "Fleet: processor time for each drone and simulated hour, by the size of the team"
PAPER = ""

PICTURE = "fleet.png"
BATTERY = 0.68  # at the beginning: each target is handed over once in five minutes
FLAT = 0.20  # either way, of the middle between the cheapest and the dearest team


@frozen
class TeamSize:
    """One flight that is measured. ``hours``: of simulated time until everybody is called home."""

    drones: int
    targets: int
    hours: float


SIZES = tuple(TeamSize(drones, drones // 2, 0.08) for drones in (2, 4, 6, 10, 20, 40))
FIELD = TeamSize(200, 60, 1.0 / 6.0)
QUICK = (TeamSize(2, 1, 0.004), TeamSize(3, 1, 0.004))
FIRST = TeamSize(2, 1, 0.004)


@frozen
class TeamCost:
    """The measured cost of one flight of a team.

    Attributes:
        cpu_s_per_drone_hour, cpu_s_per_flown_hour: of all drones, and of those in the air.
        observed_percent: of all targets together, since each was acquired; None when none was.
        violations: by monitor.
    """

    drones: int
    targets: int
    simulated_s: float
    cpu_s: float
    cpu_s_per_drone_hour: float
    cpu_s_per_flown_hour: float
    outcome: str
    legs: int
    observed_percent: float | None
    violations: dict[str, int]


def check(rig: Rig) -> None:
    """Raise PartError for a rig without a team."""
    checked_team(rig)


def run(request: TrialRequest) -> TrialResult:
    """Raise PartError for a rig without a team."""
    if not request.quick:
        _fly(request, FIRST, "first")
    sizes = request.work.steps("teams", QUICK if request.quick else SIZES)
    teams = [_measured(request, size) for size in sizes]
    _draw(teams, request.out / PICTURE)
    fields = [] if request.quick else [_measured(request, FIELD)]
    costs = teams + fields
    violations = sum_of(cost.violations for cost in costs)
    return TrialResult(
        summary={
            "teams": [asdict(cost) for cost in costs],
            "off_the_middle": off_the_middle(teams),
        },
        findings=_findings(teams, fields, violations),
        tables=(_table(costs),),
        pictures=(TrialPicture(PICTURE, "The band is 20 % to either side of the middle."),),
        notes=(
            f"Rig {request.rig.name}, seed {request.seed}: fields laid out like the rig's. Two drones for each target, "
            f"with {100 * BATTERY:.0f} % of their charge at the beginning; the largest field has fewer targets, and "
            "full batteries. Processor time of the one process that is harness, world, monitors and all programs.",
        ),
        violations=violations,
    )


def _measured(request: TrialRequest, size: TeamSize) -> TeamCost:
    """The cost of a flight, told as soon as it is known: the later ones take longer."""
    cost = _fly(request, size, f"{size.drones}")
    tell_line(
        f"{cost.drones} drones on {cost.targets} targets, {cost.simulated_s / 60.0:.1f} min: {cost.cpu_s:.1f} s of "
        f"processor time, {cost.cpu_s_per_drone_hour:.1f} s a drone and hour, {cost.legs} hand-overs, {cost.outcome}"
    )
    return cost


def _fly(request: TrialRequest, size: TeamSize, name: str) -> TeamCost:
    field = laid_out(checked_team(request.rig), size.drones, size.targets)
    battery = 1.0 if size is FIELD else BATTERY
    config = replace(field, drones=tuple(replace(drone, battery=battery) for drone in field.drones))
    options = TeamOptions(
        rig=request.rig.name,
        drones=size.drones,
        targets=size.targets,
        hours=size.hours,
        seed=request.seed,
    )
    folder = new_folder(request.out / name)
    summary, _ = fly_team(fenced(request.rig, config), config, options, folder, lambda _: None)
    return cost_of(summary)


def cost_of(summary: dict[str, Any]) -> TeamCost:
    """Return what a team's ``summary.json`` says of its cost."""
    return TeamCost(
        drones=summary["drones"],
        targets=summary["targets"],
        simulated_s=summary["simulated_s"],
        cpu_s=summary["cpu_s"],
        cpu_s_per_drone_hour=summary["cpu_s_per_drone_hour"],
        cpu_s_per_flown_hour=summary["cpu_s_per_flown_hour"],
        outcome=summary["outcome"],
        legs=summary["legs_handed_over"],
        observed_percent=summary["observed_percent"]["all"],
        violations=dict(summary["monitors"]),
    )


def off_the_middle(teams: Sequence[TeamCost]) -> float:
    """Return how far the cheapest and the dearest team are from the middle between them, as a
    share of it.
    """
    each = [cost.cpu_s_per_drone_hour for cost in teams]
    return (max(each) - min(each)) / (max(each) + min(each))


def _findings(
    teams: Sequence[TeamCost], fields: Sequence[TeamCost], violations: dict[str, int]
) -> tuple[TrialFinding, ...]:
    off = off_the_middle(teams)
    least = teams[0].drones
    most = teams[-1].drones
    each = ", ".join(f"{cost.cpu_s_per_drone_hour:.1f}" for cost in teams)
    return (
        TrialFinding(f"processor time of a drone and hour, {least} to {most} drones, s", each),
        TrialFinding(
            "of these the cheapest and the dearest, off their middle", f"{100 * off:.0f} %",
            goal=f"<= {100 * FLAT:.0f} %", verdict=verdict(off <= FLAT),
        ),
        *(
            TrialFinding(
                f"{field.drones} drones on {field.targets} targets, {field.simulated_s / 60.0:.1f} min", field.outcome,
                goal="to its end", verdict=verdict(field.outcome == Outcome.COMMITTED.label),
                note=f"{field.cpu_s:.0f} s of processor time, {field.cpu_s_per_drone_hour:.1f} s a drone and hour",
            )
            for field in fields
        ),
        TrialFinding("monitors violated", counts_text(violations, "0"), goal="0", verdict=verdict(not violations)),
    )  # fmt: skip


def _table(costs: Sequence[TeamCost]) -> TrialTable:
    rows = tuple(
        (
            f"{cost.drones}", f"{cost.targets}", f"{cost.simulated_s / 60.0:.1f}", f"{cost.legs}",
            "-" if cost.observed_percent is None else f"{cost.observed_percent:.2f}", f"{cost.cpu_s:.1f}",
            f"{cost.cpu_s_per_drone_hour:.1f}", f"{cost.cpu_s_per_flown_hour:.1f}",
        )
        for cost in costs
    )  # fmt: skip
    return TrialTable(
        "Each team",
        (
            "drones", "targets", "min", "hand-overs", "observed, %", "processor time, s", "s a drone and hour",
            "s a drone and hour in the air",
        ),
        rows,
    )  # fmt: skip


def _draw(teams: Sequence[TeamCost], path: Path) -> None:
    figure, (axes,) = panels(8.0, 4.2)
    drones = [cost.drones for cost in teams]
    each = [cost.cpu_s_per_drone_hour for cost in teams]
    middle = 0.5 * (min(each) + max(each))
    axes.axhspan((1.0 - FLAT) * middle, (1.0 + FLAT) * middle, color=DIM, alpha=0.15, lw=0.0)
    axes.plot(drones, each, "o-", color=NEEDED, lw=1.6, label="each drone and simulated hour")
    flown = [cost.cpu_s_per_flown_hour for cost in teams]
    axes.plot(
        drones,
        flown,
        "s--",
        color=ROLE[Role.SENDER],
        lw=1.2,
        label="each hour that a drone is in the air",
    )
    axes.set_xscale("log")
    axes.set_xticks(drones, [f"{number}" for number in drones])
    axes.minorticks_off()
    axes.set(xlabel="drones, two for each target", ylabel="processor time, s", ylim=(0.0, None))
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    axes.grid(alpha=0.3, color=DIM)
    save(figure, path)

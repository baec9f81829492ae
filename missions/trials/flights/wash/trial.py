"""Whole hand-overs by drones of four sizes, each in the other's air: without it, as it is, and twice
as fast.

Distances follow from the sizes as for every flight: 0.65 to 1.25 m between the bodies at the
viewpoint, which are those of the paper's flights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from drivers.rig.facts import DroneFacts, TargetFacts
from drivers.rig.parts import Rig
from flight.plan.complete import complete
from missions.ground.rig_library import mission_of, shorter
from missions.look.report.summary import summarize
from missions.trials.shared.flown import at_least, fly_and_throw_away, never
from missions.trials.shared.statistics import wilson
from missions.trials.shared.trial import (
    TrialRequest,
    TrialResult,
    TrialTable,
)
from path.values import frozen

TITLE = "Wash: hand-overs by drones of four sizes in each other's air"
PAPER = ""

CAR = TargetFacts(0.32, 0.22, 0.16, 0.3)
SIZES = ((0.2, 0.08), (0.35, 0.35), (0.6, 1.2), (0.8, 2.5))
"""Diameter over the tips in m, and mass in kg: a Tello, a small one, the usual one, a large one."""
AIR = (0.0, 1.0, 2.0)
"""Times the speed that the air has by mass and propellers."""
FLIGHTS = 100
COMMIT_RATE = 0.95
CONE_RAD = math.radians(30.0)
BELOW_M = 1.0


@frozen
class WashOrder:
    """One flight to fly. ``times``: of the air's speed."""

    rig: Rig
    mass_kg: float
    times: float
    seed: int
    folder: Path


@frozen
class WashFlight:
    """The end of one flight. ``nearest_m``: between the middles of both drones in the air, in truth."""

    mass_kg: float
    times: float
    outcome: str
    nearest_m: float
    contact: bool
    wrong: bool
    violations: int


def run(request: TrialRequest) -> TrialResult:
    sizes = SIZES[-1:] if request.quick else SIZES
    rigs = {mass_kg: of_size(request.rig, wide_m, mass_kg) for wide_m, mass_kg in sizes}
    seeds = range(request.seed, request.seed + (1 if request.quick else FLIGHTS))
    air = (1.0,) if request.quick else AIR
    orders = [
        WashOrder(rig, mass_kg, times, seed, request.out / f"{mass_kg:g}-{times:g}-{seed}")
        for (mass_kg, rig), times, seed in product(rigs.items(), air, seeds)
    ]
    flown = request.work.map("hand-overs flown", fly_order, orders)
    cells = [cell_of(rigs[mass_kg], flown, mass_kg, times) for mass_kg, times in product(rigs, air)]
    return result(cells, flown)


def of_size(rig: Rig, diameter_m: float, mass_kg: float) -> Rig:
    """Return the rig with drones of that size, and all that follows from it."""
    drone = replace(rig.drone or DroneFacts(), diameter_m=diameter_m, mass_kg=mass_kg)
    return shorter(complete(replace(rig, drone=drone, target=rig.target or CAR)))


def fly_order(order: WashOrder) -> WashFlight:
    """Fly one; its logs are read and thrown away."""
    faults = (f"wash={order.times:g}",)
    facts, records = fly_and_throw_away(order.rig, order.seed, faults, order.folder)
    summary = summarize(records)
    nearest_m = summary["min_separation_m"]
    nearest_m = math.inf if nearest_m is None else nearest_m
    diameter_m = mission_of(order.rig).separation.horizontal_m
    return WashFlight(
        order.mass_kg,
        order.times,
        facts.outcome,
        nearest_m,
        nearest_m < diameter_m,
        bool(summary["wrong_handover"]),
        sum(facts.violations.values()),
    )


def cell_of(rig: Rig, flown: Sequence[WashFlight], mass_kg: float, times: float) -> dict[str, Any]:
    """Return what came of the flights of one size in air of one strength."""
    own = [each for each in flown if each.mass_kg == mass_kg and each.times == times]
    committed = sum(each.outcome == "committed" for each in own)
    apart = mission_of(rig).separation
    return {
        "mass_kg": mass_kg,
        "diameter_m": apart.horizontal_m,
        "wash": times,
        "flights": len(own),
        "commit_rate": committed / len(own),
        "commit_interval": list(wilson(committed, len(own))),
        "contacts": sum(each.contact for each in own),
        "wrong": sum(each.wrong for each in own),
        "violations": sum(each.violations for each in own),
        "nearest_m": min(each.nearest_m for each in own),
        "viewpoint_m": apart.viewpoint_m,
        "keep_out_before_m": BELOW_M * math.tan(CONE_RAD),
        "keep_out_after_m": apart.wash_m + BELOW_M * apart.wash_per_m,
    }


def result(cells: Sequence[dict[str, Any]], flown: Sequence[WashFlight]) -> TrialResult:
    """Return the result of so many flights."""
    contacts = sum(each.contact for each in flown)
    wrong = sum(each.wrong for each in flown)
    usual = [each for each in flown if each.times == 1.0]
    committed = sum(each.outcome == "committed" for each in usual)
    findings = (
        at_least("committed in the air as it is", committed, len(usual), COMMIT_RATE),
        never("contacts", contacts),
        never("wrong objects", wrong),
    )
    rate = committed / len(usual)
    summary = {"commit_rate": rate, "contacts": contacts, "wrong": wrong, "cells": list(cells)}
    violations = sum(each.violations for each in flown)
    return TrialResult(
        summary,
        findings,
        tables=(_table(cells),),
        notes=NOTES,
        violations={"all": violations} if violations else {},
    )


def _table(cells: Sequence[dict[str, Any]]) -> TrialTable:
    columns = (
        *("kg", "diameter, m", "air, times", "flights", "committed", "contacts", "nearest, m"),
        *("asked apart, m", "keep-out 1 m below by the cone, m", "by the air, m"),
    )
    rows = [
        (
            f"{cell['mass_kg']:g}",
            f"{cell['diameter_m']:g}",
            f"{cell['wash']:g}",
            str(cell["flights"]),
            f"{cell['commit_rate']:.0%}",
            str(cell["contacts"]),
            f"{cell['nearest_m']:.2f}",
            f"{cell['viewpoint_m']:.2f}",
            f"{cell['keep_out_before_m']:.2f}",
            f"{cell['keep_out_after_m']:.2f}",
        )
        for cell in cells
    ]
    return TrialTable("Hand-overs in each other's air", columns, rows)


NOTES = (
    "A contact: the middles of both drones nearer to each other than their diameter, in truth.",
    "All sizes fly by the same airframe of the simulation: what differs is their air, what it does to the other, and "
    "the distances that follow from their size.",
    "The keep-out is of drones that hold against 0.6 m/s2, in no wind; wind leans it.",
)

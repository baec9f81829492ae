"""Rendezvous from bad positions: does the receiver find the sender, and does it ever come too near
on its way.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from drivers.rig.parts import Rig
from flight.rendezvous.course import stand_off_m
from missions.ground.resumable_lines import ResumableLines
from missions.ground.rig_library import mission_of
from missions.trials.flights.rendezvous import flights
from missions.trials.flights.rendezvous.flights import RendezvousOrder, RendezvousResult
from missions.trials.flights.rendezvous.pictures import draw
from missions.trials.shared.statistics import upper_bound, wilson
from missions.trials.shared.trial import (
    TrialFinding,
    TrialPicture,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)

TITLE = "Rendezvous: positions that are wrong by metres, in wind"
PAPER = ""

MISSIONS = 1000
QUICK_MISSIONS = 4
GOAL = 0.95
PICTURE = "rendezvous.png"
KEPT = "missions.jsonl"


def run(request: TrialRequest) -> TrialResult:
    rig = request.rig
    count = QUICK_MISSIONS if request.quick else MISSIONS
    asked = flights.asked_for(rig, count, request.seed, request.out / "flights")
    flown = _flown(request, asked)
    separation = mission_of(rig).separation
    draw(flown, separation, request.out / PICTURE)
    return TrialResult(
        summary=flights.as_summary(flown),
        findings=_findings(flown, separation.minimum_m),
        noise=TrialTable(
            "What goes wrong",
            ("what", "how much"),
            _conditions(rig),
            "Directions are drawn by seed.",
        ),
        tables=(_ends(flown), _times(flown)),
        pictures=(
            TrialPicture(
                PICTURE,
                "Left: the receiver's true ways around the sender until it verifies, from above, in the sender's "
                "heading; right: the smallest true separation of each mission.",
            ),
        ),
        notes=(
            "Separation, ellipsoid and downwash are judged from the truth at 20 Hz, from both drones' take-off to the "
            "first landing. Any mission in which a monitor was violated keeps its logs under flights/. Each mission is "
            f"a line of {KEPT}: the same command goes on with a folder that was begun.",
        ),
        violations=sum((Counter(one.violations) for one in flown), Counter[str]()),
    )


def _flown(request: TrialRequest, asked: Sequence[RendezvousOrder]) -> list[RendezvousResult]:
    """Each is kept as soon as it is flown: the same command with the same ``--out`` flies what is
    left.
    """
    rig = request.rig
    errors = rig.world.get("errors")
    head = {
        "format": "path-handoff rendezvous 2",
        "rig": str(rig.file),
        "seed": request.seed,
        "errors": errors,
    }
    with ResumableLines(request.out / KEPT, RendezvousResult, head) as kept:
        done = {one.seed for one in kept.lines}
        left = [one for one in asked if one.seed not in done]
        for one in request.work.stream("missions", flights.fly, left):
            kept.add([one])
        seeds = {one.seed for one in asked}
        return sorted((one for one in kept.lines if one.seed in seeds), key=lambda one: one.seed)


def _findings(flown: Sequence[RendezvousResult], minimum_m: float) -> tuple[TrialFinding, ...]:
    count = len(flown)
    arrived = sum(one.arrived for one in flown)
    committed = sum(one.committed for one in flown)
    inside = sum(one.ellipsoid is not None and one.ellipsoid < 1.0 for one in flown)
    near = [(one.separation_m, one.seed) for one in flown if one.separation_m is not None]
    nearest_m, of_seed = min(near, default=(math.inf, 0))
    violated = sum(bool(one.violations) for one in flown)
    washed = [one.downwash_s for one in flown if one.downwash_s > 0.0]
    return (
        TrialFinding(
            "the receiver reached its viewpoint", f"{arrived} of {count}", _share(arrived, count), "",
            f">= {100 * GOAL:.0f} %", verdict(arrived >= GOAL * count),
        ),
        TrialFinding("handed over", f"{committed} of {count}", _share(committed, count)),
        TrialFinding(
            "inside the separation ellipsoid", f"{inside} of {count}", f"<= {100 * upper_bound(inside, count):.2f} %",
            "", "0", verdict(inside == 0),
        ),
        TrialFinding(
            "smallest separation, m", f"{nearest_m:.2f}", f"seed {of_seed}", "",
            f">= {minimum_m:.2f}", verdict(nearest_m >= minimum_m),
        ),
        TrialFinding(
            "missions in which a monitor was violated", f"{violated} of {count}", "", "", "0", verdict(violated == 0)
        ),
        TrialFinding(
            "missions with a drone below the other's rotors", f"{len(washed)} of {count}",
            f"for {max(washed, default=0.0):.1f} s at most",
        ),
        TrialFinding("went around", f"{sum(one.go_arounds > 0 for one in flown)} of {count}"),
    )  # fmt: skip


def _share(part: int, whole: int) -> str:
    low, high = wilson(part, whole)
    return f"{100 * low:.1f}-{100 * high:.1f} %"


def _ends(flown: Sequence[RendezvousResult]) -> TrialTable:
    examples = {one.outcome: one for one in reversed(flown)}
    rows = tuple(
        (name, str(number), f"{examples[name].why} (seed {examples[name].seed})")
        for name, number in flights.reasons(flown).items()
    )
    return TrialTable(
        "Why the rest did not hand over", ("outcome", "missions", "for example"), rows
    )


def _times(flown: Sequence[RendezvousResult]) -> TrialTable:
    took = np.array([one.rendezvous_s for one in flown if one.rendezvous_s is not None])
    if not len(took):
        return TrialTable("From the first way to the viewpoint", ("", "s"), ())
    rows = tuple(
        (name, f"{np.percentile(took, q):.1f}")
        for name, q in (("median", 50), ("p95", 95), ("longest", 100))
    )
    return TrialTable("From the first way to the viewpoint", ("", "s"), rows)


def _conditions(rig: Rig) -> tuple[tuple[str, ...], ...]:
    """Return the conditions in the rig's own tables."""
    world = rig.world
    mission = mission_of(rig)
    apart = world.get("position_offset", {})
    wind = world.get("wind", {})
    across_m = float(apart.get("across_m", 0.0))
    height_m = float(apart.get("height_m", 0.0))
    known = mission.rendezvous
    return (
        (
            "positions apart, besides each estimator's own error",
            f"{across_m:.1f} m across, {height_m:.1f} m in height",
        ),
        (
            "each estimator's own error",
            "0.25 m per axis, 0.2 m in height, constant; wanders 0.01 m per root second",
        ),
        (
            "wind, gusts (standard deviation)",
            f"{wind.get('speed_mps', 0.0):.1f} m/s, {wind.get('gust_mps', 0.0):.1f}",
        ),
        (
            "what the mission takes them for",
            f"{known.positions_within_m:.1f} m and {known.heights_within_m:.1f} m",
        ),
        ("stand-off that follows", f"{stand_off_m(mission):.2f} m"),
        ("target", "0.33 m car, 0.3 m/s; three look-alikes"),
        ("markers", ", ".join(f"{1000 * marker.side_m:.0f} mm" for marker in rig.layout.markers)),
    )

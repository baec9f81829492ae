"""The figures of a relay (``summary.json``) and the table at its end. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from drivers.rig.parts import Rig
from flight.harness.fleet import RelayConfig
from flight.harness.relay import RelayReport
from flight.outcome import Outcome
from missions.fly.relay.crew import Crew
from missions.fly.relay.ground import Event, Leg
from missions.fly.relay.legs import Base
from missions.ground.options.flights import HoursOptions, RelayOptions
from missions.ground.rig_library import mission_of
from missions.look.report.tables import counts_text, figures_grid, plain_table
from path.protocol.bounds import gap_bound_s
from path.protocol.values import ProtocolConfig


def summarize_relay(
    rig: Rig,
    config: RelayConfig,
    options: RelayOptions,
    base: Base,
    report: RelayReport,
    outcome: Outcome,
    detail: str,
) -> dict[str, Any]:
    """Everything ``summary.json`` holds; null where there is nothing to say."""
    return {
        **summary_of(rig, options, base, report, outcome, detail),
        "landings": {drone.name: spread([f.battery for f in report.flown if f.drone == drone.name])
                     for drone in config.drones},
        "violations": dict(sorted(report.violations.items())),
    }  # fmt: skip


def summary_of(
    rig: Rig,
    options: HoursOptions,
    base: Crew[Any, Any, Any],
    report: RelayReport,
    outcome: Outcome,
    detail: str,
) -> dict[str, Any]:
    """The figures of a relay and of a team alike."""
    done = [leg for leg in base.legs if leg.outcome == Outcome.COMMITTED.label]
    protocol = ProtocolConfig.of_clocks(mission_of(rig).clock_uncertainty_s)
    took = [leg.held_s - leg.called_s for leg in done if leg.held_s is not None]
    return {
        "outcome": outcome.label,
        "exit_code": outcome.exit_code,
        "detail": detail,
        "rig": rig.name,
        "seed": options.seed,
        "errors": dict(report.errors),
        "drones": len(base.config.drones),
        "hours": base.hours,
        "faults": list(options.fault),
        "simulated_s": round(report.simulated_s, 2),
        "wall_s": round(report.wall_s, 1),
        "legs": len(base.legs),
        "legs_handed_over": len(done),
        "legs_ended": dict(
            sorted(Counter(leg.outcome or "unfinished" for leg in base.legs).items())
        ),
        "alarms": sum(event.what == "alarm" for event in base.events),
        "leg_s": spread(took),
        "gap_s": spread(list(report.gaps_s.values())),
        "gap_bound_s": round(gap_bound_s(protocol), 2),
        "reserve": base.config.reserve,
        "closest_m": None if report.closest_m != report.closest_m else round(report.closest_m, 3),
        "closest_pair": list(report.closest_pair),
        "notes": list(report.notes),
    }


def spread(values: Sequence[float]) -> dict[str, float] | None:
    """Number, smallest, median and largest."""
    if not values:
        return None
    low, median, high = (round(float(np.percentile(values, q)), 4) for q in (0, 50, 100))
    return {"number": len(values), "min": low, "median": median, "max": high}


def leg_record(leg: Leg, report: RelayReport) -> dict[str, Any]:
    """One leg in a record."""
    return {
        "leg": leg.number, "sender": leg.sender, "receiver": leg.receiver, "called_s": round(leg.called_s, 2),
        "held_s": None if leg.held_s is None else round(leg.held_s, 2), "outcome": leg.outcome,
        "detail": leg.detail, "battery": round(leg.battery, 4),
        "gap_s": round(report.gaps_s[leg.number], 4) if leg.number in report.gaps_s else None,
    }  # fmt: skip


def flown_record(events: Sequence[Event], report: RelayReport) -> dict[str, Any]:
    """Every flight, every word to the crew, the batteries now and then, and notes on what went
    wrong, in a record.
    """
    return {
        "flights": [
            {"drone": f.drone, "began_s": round(f.began_s, 2), "ended_s": round(f.ended_s, 2),
             "battery": round(f.battery, 4)}
            for f in report.flown
        ],
        "events": [{"time_s": e.time_s, "drone": e.drone, "what": e.what, "text": e.text} for e in events],
        "samples": [[s.time_s, list(s.responsible), list(s.battery), list(s.airborne)] for s in report.samples],
        "notes": list(report.notes),
    }  # fmt: skip


def heading(summary: Mapping[str, Any], size: str) -> list[RenderableType]:
    """The first lines of a table: outcome, rig, ``size``, faults, and why."""
    good = summary["outcome"] == Outcome.COMMITTED.label
    head = Text.assemble(
        (f" {summary['outcome']} ", "bold black on green" if good else "bold white on red")
    )
    head.append(f"  rig {summary['rig']}, seed {summary['seed']}, {size}")
    if summary["faults"]:
        head.append(f", faults: {', '.join(summary['faults'])}", "yellow")
    parts: list[RenderableType] = [Text(), head]
    if summary["detail"]:
        parts.append(Text(f"  {summary['detail']}", "yellow"))
    return parts


def relay_table(summary: Mapping[str, Any]) -> RenderableType:
    """Return the table of one relay for a person."""
    parts = heading(summary, f"{summary['drones']} drones")
    landings = plain_table("", "flights", "battery at landing: min", "median", "max")
    for name, each in summary["landings"].items():
        cells = ("0", "-", "-", "-") if each is None else _cells(each)
        landings.add_row(name, *cells)
    return Group(*parts, Text(), figures_grid(relay_rows(summary)), Text(), landings)


def _cells(each: Mapping[str, float]) -> tuple[str, ...]:
    return str(each["number"]), *(f"{100 * each[key]:.1f} %" for key in ("min", "median", "max"))


def relay_rows(s: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(name, value) of what a person wants to know."""
    return [
        ("simulated", _lasted(s["simulated_s"])),
        ("legs", f"{s['legs']}: {counts_text(s['legs_ended'])}"),
        ("from the call to holding", spread_text(s["leg_s"], 1)),
        ("nobody responsible", f"{spread_text(s['gap_s'], 4)} (bound {s['gap_bound_s']:.2f} s)"),
        ("no relief ready, said", f"{s['alarms']} times"),
        ("smallest separation", closest_text(s)),
        ("reserve", f"{100 * s['reserve']:.0f} %"),
        ("monitors", counts_text(s["violations"], "no violation")),
        ("speed", speed_text(s, 0)),
    ]


def closest_text(s: Mapping[str, Any]) -> str:
    """The smallest separation, and between whom."""
    return (
        "-"
        if s["closest_m"] is None
        else f"{s['closest_m']:.2f} m, {' and '.join(s['closest_pair'])}"
    )


def speed_text(s: Mapping[str, Any], digits: int) -> str:
    """The speed against real time."""
    if s["wall_s"] <= 0.0:
        return "-"
    return f"{s['simulated_s'] / s['wall_s']:.{digits}f} x real time ({s['wall_s']:.0f} s)"


def _lasted(seconds: float) -> str:
    return f"{seconds / 3600.0:.2f} h" if seconds >= 3600.0 else f"{seconds / 60.0:.1f} min"


def spread_text(each: Mapping[str, float] | None, digits: int) -> str:
    """Median and range of a ``spread`` in s."""
    if each is None:
        return "-"
    return f"median {each['median']:.{digits}f} s, {each['min']:.{digits}f} to {each['max']:.{digits}f} s"

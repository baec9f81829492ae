"""The figures of a relay or a team (``summary.json``), its record (``relay.json``, ``team.json``)
and the table at its end. Pure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from drivers.rig.parts import Rig
from flight.harness.fleet import RelayConfig, TeamConfig
from flight.harness.relay import RelayReport, TargetWatch
from flight.outcome import OBJECT_MONITOR, Outcome
from missions.fly.relay.crew import Crew
from missions.fly.relay.ground import Leg
from missions.ground.options.flights import HoursOptions
from missions.ground.rig_library import mission_of
from missions.look.report.tables import counts_text, figures_grid, plain_table
from path.protocol.bounds import gap_bound_s
from path.protocol.values import ProtocolConfig

HOUR_S = 3600.0
MANY = 16  # drones or targets: more have no names in a table or at an axis


def name_of(config: RelayConfig) -> str:
    """Return the name of the command that flies it, which its files have too."""
    return "team" if isinstance(config, TeamConfig) else "relay"


def targets_of(config: RelayConfig) -> tuple[str, ...]:
    """Return the targets' names; a relay has one without a name in the rig."""
    if isinstance(config, TeamConfig):
        return tuple(target.name for target in config.targets)
    return ("target",)


def summary_of(
    rig: Rig,
    options: HoursOptions,
    base: Crew[Any, Any],
    report: RelayReport,
    outcome: Outcome,
    detail: str,
) -> dict[str, Any]:
    """Everything ``summary.json`` holds; null where there is nothing to say."""
    config = base.config
    names = targets_of(config)
    done = [leg for leg in base.legs if leg.outcome == Outcome.COMMITTED.label]
    protocol = ProtocolConfig.of_clocks(mission_of(rig).clock_uncertainty_s)
    took = [leg.held_s - leg.called_s for leg in done if leg.held_s is not None]
    drone_hours = len(config.drones) * report.simulated_s / HOUR_S
    flown_hours = sum(report.aloft_s.values()) / HOUR_S
    bytes_per_s = {drone.name: _rate(report.bytes_sent.get(drone.name, 0), report.simulated_s)
                   for drone in config.drones}  # fmt: skip
    return {
        "outcome": outcome.label,
        "exit_code": outcome.exit_code,
        "detail": detail,
        "rig": rig.name,
        "seed": options.seed,
        "errors": dict(report.errors),
        "drones": len(config.drones),
        **({"targets": len(names)} if isinstance(config, TeamConfig) else {}),
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
        "leg_s": _spread(took),
        "gap_s": _spread(list(report.gaps_s.values())),
        "gap_bound_s": round(gap_bound_s(protocol), 2),
        "observed_percent": _observed_percent(names, report.watched),
        "first_observed_s": {
            name: None if seen.first_s is None else round(seen.first_s, 1)
            for name, seen in zip(names, report.watched, strict=True)
        },
        "wrong": report.violations.get(OBJECT_MONITOR, 0),
        "monitors": dict(sorted(report.violations.items())),
        "lost": sum(event.what == "lost" for event in base.events),
        "reserve": config.reserve,
        "landings": {
            drone.name: _spread([f.battery for f in report.flown if f.drone == drone.name])
            for drone in config.drones
        },
        "battery_at_landing": _spread([flight.battery for flight in report.flown]),
        "closest_m": None if report.closest_m != report.closest_m else round(report.closest_m, 3),
        "closest_pair": list(report.closest_pair),
        "bytes_per_s": bytes_per_s,
        "bytes_per_s_mean": _rate(
            sum(report.bytes_sent.values()) / len(config.drones), report.simulated_s
        ),
        "flown_h": round(flown_hours, 3),
        "cpu_s": round(report.cpu_s, 1),
        "cpu_s_per_drone_hour": round(report.cpu_s / drone_hours, 2) if drone_hours > 0.0 else None,
        "cpu_s_per_flown_hour": round(report.cpu_s / flown_hours, 2) if flown_hours > 0.0 else None,
        "notes": list(report.notes),
    }


def _rate(count: float, seconds: float) -> float:
    return round(count / seconds, 1) if seconds > 0.0 else 0.0


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    """Number, smallest, median and largest."""
    if not values:
        return None
    low, median, high = (round(float(np.percentile(values, q)), 4) for q in (0, 50, 100))
    return {"number": len(values), "min": low, "median": median, "max": high}


def _observed_percent(
    names: Sequence[str], watched: Sequence[TargetWatch]
) -> dict[str, float | None]:
    """By target, since somebody was responsible for it for the first time; and ``all`` of them
    together.
    """
    percent: dict[str, float | None] = {
        name: _percent(seen.observed_s, seen.of_s)
        for name, seen in zip(names, watched, strict=True)
    }
    whole = _percent(sum(s.observed_s for s in watched), sum(s.of_s for s in watched))
    return {**percent, "all": whole}


def _percent(observed_s: float, of_s: float) -> float | None:
    return round(100.0 * observed_s / of_s, 3) if of_s > 0.0 else None


# --- the record ---


def record_of(
    base: Crew[Any, Any],
    report: RelayReport,
    outcome: Outcome,
) -> dict[str, Any]:
    """Who had which target when, every leg, every flight, every word to the crew, and the
    batteries now and then.
    """
    names = targets_of(base.config)
    return {
        "outcome": outcome.label,
        "drones": [drone.name for drone in base.config.drones],
        "targets": list(names),
        "reserve": base.config.reserve,
        "legs": [{"target": names[leg.target], **_leg_record(leg, report)} for leg in base.legs],
        "spells": [
            {"target": names[spell.target], "drone": spell.drone, "from_s": round(spell.from_s, 2),
             "to_s": None if spell.to_s is None else round(spell.to_s, 2)}
            for spell in base.spells
        ],
        "unobserved": {
            name: [[round(since_s, 2), round(to_s, 2)] for since_s, to_s in seen.spells]
            for name, seen in zip(names, report.watched, strict=True)
        },
        "flights": [
            {"drone": f.drone, "began_s": round(f.began_s, 2), "ended_s": round(f.ended_s, 2),
             "battery": round(f.battery, 4)}
            for f in report.flown
        ],
        "events": [{"time_s": e.time_s, "drone": e.drone, "what": e.what, "text": e.text} for e in base.events],
        "samples": [[s.time_s, list(s.responsible), list(s.battery), list(s.airborne)] for s in report.samples],
        "notes": list(report.notes),
    }  # fmt: skip


def _leg_record(leg: Leg, report: RelayReport) -> dict[str, Any]:
    return {
        "leg": leg.number, "sender": leg.sender, "receiver": leg.receiver, "called_s": round(leg.called_s, 2),
        "held_s": None if leg.held_s is None else round(leg.held_s, 2), "outcome": leg.outcome,
        "detail": leg.detail, "battery": round(leg.battery, 4),
        "gap_s": round(report.gaps_s[leg.number], 4) if leg.number in report.gaps_s else None,
    }  # fmt: skip


# --- the table ---


def size_text(summary: Mapping[str, Any]) -> str:
    """How many take part."""
    targets = f", {summary['targets']} targets" if "targets" in summary else ""
    return f"{summary['drones']} drones{targets}"


def fleet_table(summary: Mapping[str, Any]) -> RenderableType:
    """Return the table for a person: outcome, rig, size, faults and why; figures; batteries."""
    good = summary["outcome"] == Outcome.COMMITTED.label
    head = Text.assemble(
        (f" {summary['outcome']} ", "bold black on green" if good else "bold white on red")
    )
    head.append(f"  rig {summary['rig']}, seed {summary['seed']}, {size_text(summary)}")
    if summary["faults"]:
        head.append(f", faults: {', '.join(summary['faults'])}", "yellow")
    lines: list[RenderableType] = [Text(), head]
    if summary["detail"]:
        lines.append(Text(f"  {summary['detail']}", "yellow"))
    lines += [Text(), figures_grid(fleet_rows(summary))]
    if summary["drones"] <= MANY:
        landings = plain_table("", "flights", "battery at landing: min", "median", "max")
        for name, each in summary["landings"].items():
            cells = ("0", "-", "-", "-") if each is None else _cells(each)
            landings.add_row(name, *cells)
        lines += [Text(), landings]
    return Group(*lines)


def _cells(each: Mapping[str, float]) -> tuple[str, ...]:
    return str(each["number"]), *(f"{100 * each[key]:.1f} %" for key in ("min", "median", "max"))


def fleet_rows(s: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(name, value) of what a person wants to know."""
    observed = s["observed_percent"]
    each = [(name, value) for name, value in observed.items() if name != "all"]
    worst = sorted(each, key=lambda pair: -1.0 if pair[1] is None else pair[1])[:6]
    shown = ", ".join(f"{name} {_share(value)}" for name, value in worst)
    landing = s["battery_at_landing"]
    at_least = "-" if landing is None else f"{100 * landing['min']:.1f} % at least"
    return [
        ("simulated", f"{_lasted(s['simulated_s'])}, {s['flown_h']:.2f} h in the air"),
        (
            "observed",
            f"{_share(observed['all'])} ({shown}{', ...' if len(each) > len(worst) else ''})",
        ),
        ("legs", f"{s['legs']}: {counts_text(s['legs_ended'])}"),
        ("wrong objects", str(s["wrong"])),
        ("targets lost, and pointed at again", str(s["lost"])),
        ("from the call to holding", _spread_text(s["leg_s"], 1)),
        ("nobody responsible", f"{_spread_text(s['gap_s'], 4)} (bound {s['gap_bound_s']:.2f} s)"),
        ("no drone ready, said", f"{s['alarms']} times"),
        ("battery at landing", f"{at_least} (reserve {100 * s['reserve']:.0f} %)"),
        ("smallest separation", _closest_text(s)),
        ("sent by a drone", f"{s['bytes_per_s_mean']:.0f} B/s in the mean"),
        ("monitors", counts_text(s["monitors"], "no violation")),
        ("processor time", f"{_number(s['cpu_s_per_drone_hour'])} s a drone and simulated hour"),
        ("speed", _speed_text(s)),
    ]


def _closest_text(s: Mapping[str, Any]) -> str:
    """The smallest separation, and between whom."""
    if s["closest_m"] is None:
        return "-"
    return f"{s['closest_m']:.2f} m, {' and '.join(s['closest_pair'])}"


def _speed_text(s: Mapping[str, Any]) -> str:
    """The speed against real time."""
    if s["wall_s"] <= 0.0:
        return "-"
    return f"{s['simulated_s'] / s['wall_s']:.1f} x real time ({s['wall_s']:.0f} s)"


def _lasted(seconds: float) -> str:
    return f"{seconds / HOUR_S:.2f} h" if seconds >= HOUR_S else f"{seconds / 60.0:.1f} min"


def _spread_text(each: Mapping[str, float] | None, digits: int) -> str:
    """Median and range of a ``_spread`` in s."""
    if each is None:
        return "-"
    return f"median {each['median']:.{digits}f} s, {each['min']:.{digits}f} to {each['max']:.{digits}f} s"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} %"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"

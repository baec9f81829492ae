"""The figures of a team (``summary.json``), its record (``team.json``) and the table at its end.
Pure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from drivers.rig.parts import Rig
from flight.harness.fleet import TeamConfig
from flight.harness.relay import RelayReport, TargetWatch
from flight.outcome import OBJECT_MONITOR, Outcome
from missions.fly.relay.report import (
    closest_text,
    flown_record,
    heading,
    leg_record,
    speed_text,
    spread,
    spread_text,
    summary_of,
)  # fmt: skip
from missions.fly.team.base import TeamBase
from missions.ground.options.flights import TeamOptions
from missions.look.report.tables import counts_text, figures_grid

HOUR_S = 3600.0


def summarize_team(
    rig: Rig,
    config: TeamConfig,
    options: TeamOptions,
    base: TeamBase,
    report: RelayReport,
    outcome: Outcome,
    detail: str,
) -> dict[str, Any]:
    """Everything ``summary.json`` holds; null where there is nothing to say."""
    drone_hours = len(config.drones) * report.simulated_s / HOUR_S
    flown_hours = sum(report.aloft_s.values()) / HOUR_S
    return {
        **summary_of(rig, options, base, report, outcome, detail),
        "targets": len(config.targets),
        "observed_percent": observed_percent(config, report),
        "first_observed_s": {
            each.name: None if seen.first_s is None else round(seen.first_s, 1)
            for each, seen in zip(config.targets, report.watched, strict=True)
        },
        "wrong": report.violations.get(OBJECT_MONITOR, 0),
        "monitors": dict(sorted(report.violations.items())),
        "lost": sum(event.what == "lost" for event in base.events),
        "battery_at_landing": spread([flight.battery for flight in report.flown]),
        "bytes_per_s": {
            drone.name: round(report.bytes_sent.get(drone.name, 0) / report.simulated_s, 1)
            for drone in config.drones
        },
        "bytes_per_s_mean": round(
            sum(report.bytes_sent.values()) / report.simulated_s / len(config.drones), 1
        ),
        "flown_h": round(flown_hours, 3),
        "cpu_s": round(report.cpu_s, 1),
        "cpu_s_per_drone_hour": round(report.cpu_s / drone_hours, 2) if drone_hours > 0.0 else None,
        "cpu_s_per_flown_hour": round(report.cpu_s / flown_hours, 2) if flown_hours > 0.0 else None,
    }


def observed_percent(config: TeamConfig, report: RelayReport) -> dict[str, float | None]:
    """By target's name, since somebody was responsible for it for the first time; and ``all`` of
    them together.
    """
    percent: dict[str, float | None] = {
        each.name: _percent(seen.observed_s, seen.of_s)
        for each, seen in zip(config.targets, report.watched, strict=True)
    }
    whole = _percent(sum(s.observed_s for s in report.watched), sum(s.of_s for s in report.watched))
    return {**percent, "all": whole}


def _percent(observed_s: float, of_s: float) -> float | None:
    return round(100.0 * observed_s / of_s, 3) if of_s > 0.0 else None


def record_of(config: TeamConfig, base: TeamBase, report: RelayReport) -> dict[str, Any]:
    """``team.json``: who had which target when, every leg, every flight, every word to the crew."""
    names = [target.name for target in config.targets]
    return {
        "drones": [drone.name for drone in config.drones],
        "targets": names,
        "reserve": config.reserve,
        "legs": [{"target": names[leg.target], **leg_record(leg, report)} for leg in base.legs],
        "spells": [
            {"target": names[spell.target], "drone": spell.drone, "from_s": round(spell.from_s, 2),
             "to_s": None if spell.to_s is None else round(spell.to_s, 2)}
            for spell in base.spells
        ],
        "unobserved": {name: _unobserved(seen) for name, seen in zip(names, report.watched, strict=True)},
        **flown_record(base.events, report),
    }  # fmt: skip


def _unobserved(seen: TargetWatch) -> list[list[float]]:
    return [[round(since_s, 2), round(to_s, 2)] for since_s, to_s in seen.spells]


def team_table(summary: Mapping[str, Any]) -> RenderableType:
    """The lines that a person wants to read of a team's flights."""
    parts = heading(summary, f"{summary['drones']} drones, {summary['targets']} targets")
    return Group(*parts, Text(), figures_grid(team_rows(summary)))


def team_rows(s: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(name, value) of what a person wants to know."""
    observed = s["observed_percent"]
    each = [(name, value) for name, value in observed.items() if name != "all"]
    worst = sorted(each, key=lambda pair: -1.0 if pair[1] is None else pair[1])[:6]
    shown = ", ".join(f"{name} {_share(value)}" for name, value in worst)
    landing = s["battery_at_landing"]
    at_least = "-" if landing is None else f"{100 * landing['min']:.1f} % at least"
    return [
        ("simulated", f"{s['simulated_s'] / 60.0:.1f} min, {s['flown_h']:.2f} h in the air"),
        (
            "observed",
            f"{_share(observed['all'])} ({shown}{', ...' if len(each) > len(worst) else ''})",
        ),
        ("legs", f"{s['legs']}: {counts_text(s['legs_ended'])}"),
        ("wrong objects", str(s["wrong"])),
        ("targets lost, and pointed at again", str(s["lost"])),
        ("from the call to holding", spread_text(s["leg_s"], 1)),
        ("nobody responsible", f"{spread_text(s['gap_s'], 4)} (bound {s['gap_bound_s']:.2f} s)"),
        ("no drone ready, said", f"{s['alarms']} times"),
        ("battery at landing", f"{at_least} (reserve {100 * s['reserve']:.0f} %)"),
        ("smallest separation", closest_text(s)),
        ("sent by a drone", f"{s['bytes_per_s_mean']:.0f} B/s in the mean"),
        ("monitors", counts_text(s["monitors"], "no violation")),
        ("processor time", f"{_number(s['cpu_s_per_drone_hour'])} s a drone and simulated hour"),
        ("speed", speed_text(s, 1)),
    ]


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} %"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"

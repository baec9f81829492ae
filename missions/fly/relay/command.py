"""``path-handoff relay``: one target, handed from drone to drone as batteries run down, and what
came of it.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from drivers.rig.parts import Rig, with_errors
from flight.harness.fleet import RelayConfig
from flight.harness.relay import RelayReport
from missions.fly.relay.config import relay_of
from missions.fly.relay.drone.life import DroneFlight
from missions.fly.relay.ending import Showing, Values
from missions.fly.relay.flying import carry_out, fly_on_field, hours_of, judge
from missions.fly.relay.ground import Tell
from missions.fly.relay.legs import Base
from missions.fly.relay.process import processes_of
from missions.fly.relay.report import (
    flown_record,
    leg_record,
    relay_rows,
    relay_table,
    summarize_relay,
)
from missions.ground import rig_library
from missions.ground.ground_station import name_ground_station
from missions.ground.options.flights import RelayOptions


def run(options: RelayOptions) -> int:
    """``path-handoff relay``; returns the relay's exit code. Raises PartError for what was asked
    wrongly.
    """
    rig = with_errors(rig_library.load(options.rig), options.errors)
    name_ground_station(rig, options.gcs)
    config = relay_of(rig, options.drones)
    size = f"{options.drones} drones, {hours_of(config, options):g} h"
    showing = Showing(
        "relay", "missions.fly.relay.picture:draw_relay", _why, relay_rows, relay_table
    )
    return carry_out(options, showing, size, partial(fly_relay, rig, config, options))


def _why(summary: Values) -> str:
    return f"{summary['legs_handed_over']} of {summary['legs']} legs handed over"


def fly_relay(
    rig: Rig, config: RelayConfig, options: RelayOptions, out: Path, say: Tell
) -> tuple[dict[str, Any], dict[str, Any]]:
    """One relay to its end; its logs are in ``out``. Returns summary and record."""
    base = Base(config, say, hours_of(config, options))
    program = partial(DroneFlight, rig, config, base)
    processes = processes_of(rig, config, out, base, options.logs)
    report = fly_on_field("relay", rig, base, options, out, program, processes)
    outcome, detail = judge(base, report)
    record = {"outcome": outcome.label, **record_of(config, base, report)}
    return summarize_relay(rig, config, options, base, report, outcome, detail), record


def record_of(config: RelayConfig, base: Base, report: RelayReport) -> dict[str, Any]:
    """``relay.json``: every leg, every flight, every word to the crew, and the batteries now and
    then.
    """
    return {
        "drones": [drone.name for drone in config.drones],
        "reserve": config.reserve,
        "legs": [leg_record(leg, report) for leg in base.legs],
        **flown_record(base.events, report),
    }

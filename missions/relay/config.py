"""The relay in a rig, checked."""

from __future__ import annotations

from dataclasses import replace

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from flight.harness.relay import RelayConfig


def relay_of(rig: Rig, drones: int) -> RelayConfig:
    """The rig's relay with its first ``drones`` drones. Raises PartError."""
    if not rig.relay:
        raise PartError(
            f"rig {rig.name} has no [relay]", "use --rig relay-sim, relay-sitl, or a rig like them (docs/relay.md)"
        )
    config = decode_table(rig.relay, RelayConfig, rig.where("[relay]"), rig.file.parent)
    if not 2 <= drones <= len(config.drones):
        there = f"rig {rig.name} names {len(config.drones)}"
        raise PartError(
            f"--drones {drones}: {there}, and a relay takes two at least", "add [[relay.drones]] to the rig"
        )
    return replace(config, drones=config.drones[:drones])

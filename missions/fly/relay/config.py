"""The relay in a rig, checked."""

from __future__ import annotations

from dataclasses import replace

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from flight.harness.fleet import RelayConfig, relay_of_rig


def relay_of(rig: Rig, drones: int) -> RelayConfig:
    """The rig's relay with its first ``drones`` drones. Raises PartError."""
    if not rig.relay:
        raise PartError(
            f"rig {rig.name} has no [relay]",
            "use --rig relay, or a rig like it (docs/relay.md)",
        )
    config = relay_of_rig(rig)
    if not 2 <= drones <= len(config.drones):
        there = f"rig {rig.name} names {len(config.drones)}"
        raise PartError(
            f"--drones {drones}: {there}, and a relay takes two at least",
            "add [[relay.drones]] to the rig",
        )
    return replace(config, drones=config.drones[:drones])

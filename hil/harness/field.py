"""What a relay or a team is flown on, in virtual and in real time alike: its world, its drones as
they are built, and what watches them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from flight.harness.fleet import NamedDrone, NamedTarget, RelayConfig, pair_of
from flight.harness.relay import POINTING_M, Pointed
from hil.harness.sim import mission_config
from hil.monitors.relay import RelayMonitors
from hil.world.config import HomeConfig, WorldConfig
from hil.world.errors import Built, as_built, put_down
from hil.world.world import OTHER, OWN, Fleet
from path.protocol.values import ProtocolConfig
from path.values import frozen


@frozen
class Field:
    """Its drones are known by their names.

    Attributes:
        pairs: the rig of each drone; to its own parts it is always the receiver.
        built: how each truly is.
    """

    world: Fleet
    pairs: Mapping[str, Rig]
    built: Mapping[str, Built]
    monitors: RelayMonitors

    def end_flight(self, name: str, cut_off_s: list[float], now_s: float) -> None:
        """Tell the monitors of a flight, before the drone's autopilot is started anew.

        Args:
            cut_off_s: when the harness itself stopped its setpoints; forgotten then.
        """
        sessions = self.world.drone(name).autopilot.offboard_sessions
        self.monitors.on_offboard(name, sessions, cut_off_s)
        self.monitors.on_swap(name, now_s)
        cut_off_s.clear()


def make_field(
    rig: Rig, config: RelayConfig, targets: Sequence[NamedTarget], seed: int, hours: float
) -> Field:
    """Make the field of a relay, or of a team that has ``targets``."""
    world_config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
    world = fleet_of(world_config, seed, config.drones, targets)
    pairs = {drone.name: pair_of(rig, drone, drone) for drone in config.drones}
    built = {
        name: as_built(pair, seed, {OTHER: 0, OWN: k})
        for k, (name, pair) in enumerate(pairs.items())
    }
    owns = {name: each.rig.receiver for name, each in built.items()}
    count = max(1, len(targets))
    mission = mission_config(rig)
    monitors = RelayMonitors(
        rig.method, mission.separation.minimum_m, mission.guard, ProtocolConfig.of_clocks(mission.clock_uncertainty_s),
        config=config, world=world, own=owns, targets=count,
    )  # fmt: skip
    if targets:
        monitors.watched_until_s = 3600.0 * hours
    return Field(world, pairs, built, monitors)


def fleet_of(
    config: WorldConfig, seed: int, drones: Sequence[NamedDrone], targets: Sequence[NamedTarget]
) -> Fleet:
    """Return drones that are off, where the crew has put them down."""
    homes = {
        drone.name: HomeConfig(
            put_down(drone.home_m, config.errors.sizes, seed, k), drone.heading_deg
        )
        for k, drone in enumerate(drones)
    }
    fleet = Fleet(config, seed, homes, targets=targets, on=False)
    for drone in drones:
        fleet.battery(drone.name, drone.battery)
    return fleet


def pointing(seed: int) -> np.random.Generator:
    """Return what a person's hand errs by."""
    return np.random.default_rng([seed, 0x706F696E74])


def pointed(
    place_m: Sequence[float],
    yaw_rad: float,
    speed_mps: float,
    time_s: float,
    hand: np.random.Generator,
) -> Pointed:
    """Return where a person points: off by some centimetres, and knowing how the object drives.

    Args:
        place_m: (E, N) in truth.
    """
    east, north = place_m
    off_n_m, off_e_m = (POINTING_M * hand.standard_normal(2)).tolist()
    velocity = speed_mps * math.sin(yaw_rad), speed_mps * math.cos(yaw_rad), 0.0
    return Pointed((north + off_n_m, east + off_e_m, 0.0), velocity, time_s)

"""What a day does to a flight besides wind: faults by name, none of which is there unless asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from path.messages import Vec3

COMPASS_S = 60.0  # until a compass is off by all that it goes off
SPELL_S = 0.2  # that a leg or a propeller is before the marker at a time
SWING_S = 8.0  # that an exposure takes there and back


@dataclass(slots=True)
class Weather:
    """The weather of one world.

    Attributes:
        compass: degrees by which each drone's heading goes off, to either side by seed.
        leg: share of the time that something of the drone itself is before its marker.
        slope: of the ground to the north, rise over run: what is on the ground stands so much
            higher. The drones' homes, and the ground below them, are level.
        exposure: stops by which exposures swing up and down again.
        smudge: share of the image's height that a smudge on each lens is wide.
    """

    seed: int
    compass: float = 0.0
    leg: float = 0.0
    slope: float = 0.0
    exposure: float = 0.0
    smudge: float = 0.0

    def turns_rad(self, drones: int, for_s: float, time_s: float) -> list[float]:
        """Return by how much each drone's heading goes off meanwhile."""
        if self.compass == 0.0 or time_s > COMPASS_S:
            return [0.0] * drones
        sides = np.random.default_rng([self.seed, 0x636D70]).choice((-1.0, 1.0), drones)
        return (sides * math.radians(self.compass) * for_s / COMPASS_S).tolist()

    def hides_marker(self, time_s: float) -> bool:
        """Return whether something is before the marker."""
        if self.leg == 0.0:
            return False
        spell = math.floor(time_s / SPELL_S)
        return np.random.default_rng([self.seed, 0x6C6567, spell]).random() < self.leg

    def higher(self, place_w_m: Vec3) -> Vec3:
        """Return where something stands that would stand there on level ground."""
        east, north, up = place_w_m
        return east, north, up + self.slope * north

    def light(self, time_s: float) -> float:
        """Return how many times the light an exposure takes in."""
        return 2.0 ** (self.exposure * math.sin(2.0 * math.pi * time_s / SWING_S))

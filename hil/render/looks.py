"""The look of each scene: sun, ground, sky, shadows, glare, lamps, and what they do to the sensor.

All figures are assumed, so that pictures look like what the name says; none was measured on a
place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Literal

import numpy as np

from flight.harness.renderer import Imaging
from hil.render.sensor import SensorNoise
from hil.render.shutter import Shutter
from hil.world.config import SceneName
from hil.world.errors import LONGEST_S
from path.arrays import Array, Singles
from path.values import frozen

Bgr = tuple[float, float, float]
GroundKind = Literal["soil", "grass", "gravel", "tarmac", "concrete"]
_LENGTH = math.sqrt(0.36**2 + 0.30**2 + 0.88**2)
PLAIN_SUN = (0.36 / _LENGTH, -0.30 / _LENGTH, 0.88 / _LENGTH)
Litter = Literal["none", "leaves", "stones", "lines"]


@frozen
class Tints:
    """The ground's colour: base + fine gain x fine grey level + rough gain x rough grey level; and
    the sky's. BGR.
    """

    base: Bgr = (24.0, 34.0, 38.0)
    fine: Bgr = (0.42, 0.46, 0.42)
    rough: Bgr = (0.12, 0.20, 0.08)
    sky: Bgr = (206.0, 196.0, 184.0)

    @property
    def rows(self) -> Singles:
        return np.array((self.base, self.fine, self.rough, self.sky), np.float32)


@frozen
class Look:
    """One scene as cameras see it.

    Attributes:
        sun: towards the sun or the brightest part of the sky, world ENU; its length is how strong
            it is, 1 as in "plain".
        ground, tints: the ground's texture and colours.
        gain: of all light, by colour, before the sensor.
        shadow: share of the light that a shadow on the ground takes; ``penumbra_px``: width of its
            soft edge.
        veil: grey levels of glare towards the sun; it falls with the angle from it.
        lamps: lamps above, whose reflections the floor shows.
        litter: what lies about, ``pieces`` of it, at places drawn by the seed.
        exposure_times: exposures as times the camera's.
        read_times, shot_times, depth_times, holes_times: the sensor's noise as times the rig's.
        dark_lost, gleam_lost: shares of black surfaces and of gleaming paint without depth
            (``hil.render.surfaces``).
    """

    sun: tuple[float, float, float] = PLAIN_SUN
    ground: GroundKind = "soil"
    tints: Tints = field(default_factory=Tints)
    gain: Bgr = (1.0, 1.0, 1.0)
    shadow: float = 0.0
    penumbra_px: float = 1.0
    veil: float = 0.0
    lamps: bool = False
    litter: Litter = "none"
    pieces: int = 0
    exposure_times: float = 1.0
    read_times: float = 1.0
    shot_times: float = 1.0
    depth_times: float = 1.0
    holes_times: float = 1.0
    dark_lost: float = 0.0
    gleam_lost: float = 0.0

    @property
    def sun_w(self) -> Array:
        """(3,) towards the sun, as long as it is strong."""
        return np.array(self.sun)

    def noise(self, own: SensorNoise) -> SensorNoise:
        """The noise of a camera in this light."""
        return replace(
            own,
            read_sigma=own.read_sigma * self.read_times,
            shot_gain=min(1.0, own.shot_gain * self.shot_times),
            depth_sigma_at_1m_m=own.depth_sigma_at_1m_m * self.depth_times,
            depth_hole_rate=min(1.0, own.depth_hole_rate * self.holes_times),
            depth_dark_lost=self.dark_lost,
            depth_gleam_lost=self.gleam_lost,
        )

    def shutter(self, own: Shutter) -> Shutter:
        """The exposure that this light asks for."""
        return replace(own, exposure_s=min(LONGEST_S, own.exposure_s * self.exposure_times))

    def imaging(self, own: Imaging) -> Imaging:
        """The imaging of a camera in this light: its noise."""
        read = own.read_sigma * self.read_times
        shot = own.shot_gain * self.shot_times
        return replace(own, read_sigma=read, shot_gain=shot)


def _sun(
    azimuth_deg: float,
    elevation_deg: float,
    strength: float,
) -> tuple[float, float, float]:
    """``azimuth_deg``: clockwise from north."""
    a = math.radians(azimuth_deg)
    e = math.radians(elevation_deg)
    return (
        strength * math.cos(e) * math.sin(a),
        strength * math.cos(e) * math.cos(a),
        strength * math.sin(e),
    )


_GRASS = Tints((16.0, 40.0, 30.0), (0.22, 0.52, 0.34), (0.06, 0.16, 0.14), (224.0, 196.0, 160.0))
_GRAVEL = Tints((46.0, 52.0, 56.0), (0.50, 0.54, 0.56), (0.10, 0.10, 0.10), (206.0, 204.0, 202.0))
_TARMAC = Tints((30.0, 30.0, 30.0), (0.30, 0.30, 0.30), (0.16, 0.16, 0.16), (150.0, 190.0, 226.0))
_DUSK = Tints((40.0, 40.0, 42.0), (0.44, 0.46, 0.48), (0.12, 0.12, 0.12), (150.0, 118.0, 104.0))
_HALL = Tints((84.0, 92.0, 94.0), (0.30, 0.32, 0.32), (0.10, 0.10, 0.10), (176.0, 184.0, 186.0))

LOOKS: Mapping[SceneName, Look] = {
    "plain": Look(),
    "outdoor-sun": Look(
        _sun(150.0, 55.0, 1.45), "grass", _GRASS, shadow=0.58, penumbra_px=0.8, litter="leaves", pieces=160,
        exposure_times=0.4, depth_times=1.3, holes_times=1.5, dark_lost=0.6, gleam_lost=0.8,
    ),
    "overcast": Look(
        _sun(0.0, 90.0, 0.55), "gravel", _GRAVEL, (0.92, 0.90, 0.88), shadow=0.12, penumbra_px=9.0, litter="stones",
        pieces=120, dark_lost=0.5,
    ),
    "low-sun": Look(
        _sun(15.0, 14.0, 1.7), "tarmac", _TARMAC, (0.86, 0.98, 1.06), shadow=0.62, penumbra_px=1.2, veil=95.0,
        litter="leaves", pieces=60, depth_times=1.3, holes_times=1.5, dark_lost=0.6, gleam_lost=0.8,
    ),
    "dusk": Look(
        _sun(270.0, 40.0, 0.45), "gravel", _DUSK, (0.42, 0.34, 0.31), shadow=0.10, penumbra_px=12.0, litter="stones",
        pieces=80, exposure_times=2.0, read_times=3.5, shot_times=5.0, dark_lost=0.5,
    ),
    "hall": Look(
        _sun(0.0, 90.0, 0.7), "concrete", _HALL, (0.86, 0.92, 0.94), shadow=0.28, penumbra_px=7.0, lamps=True,
        litter="lines", exposure_times=1.5, read_times=1.5, shot_times=1.5, dark_lost=0.5,
    ),
}  # fmt: skip

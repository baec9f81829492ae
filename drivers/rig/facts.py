"""What a crew measures or chooses, as a rig says it: target, drones, depth cameras, site.

From these tables ``flight.plan`` derives heights, distances, times and thresholds. A rig without
``[target]`` says all of that by itself.

[target]                     # the body, and what it can do
length_m = 4.5
width_m = 1.8
height_m = 1.5
max_speed_mps = 3.0

[drone]                      # both drones
diameter_m = 0.6             # over the tips of the propellers

[depth]
max_m = 6.0                  # how far the depth cameras can be trusted

[link]
latency_s = 0.15             # one way
loss = 0.2

[height]
rangefinder_max_m = 12.0     # how far the drones' rangefinders measure; leave out without one

[site]
wind_mps = 4.0               # the strongest mean wind to fly in

[detector]
measured = "measured.json"   # by `path-handoff detect --measure`; leave out for what is usual
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from drivers.detectors.measured import Rates, read_measured
from drivers.rig.obstacle import Obstacle
from path.bounds import Bounds
from path.values import frozen


@frozen
class TargetFacts:
    """The target's body and motion.

    Attributes:
        length_m, width_m, height_m: of a box around it and what sticks out of it; the same
            whichever way it heads.
        max_speed_mps, max_accel_mps2: the most it may do in this mission, in any direction.
        flies: it moves up and down too.
    """

    length_m: Annotated[float, Bounds(0.02, 50.0)]
    width_m: Annotated[float, Bounds(0.02, 50.0)]
    height_m: Annotated[float, Bounds(0.02, 50.0)]
    max_speed_mps: Annotated[float, Bounds(0.0, 30.0)] = 0.5
    max_accel_mps2: Annotated[float, Bounds(0.0, 20.0)] = 0.6
    flies: bool = False

    @property
    def span_m(self) -> float:
        """Return the diameter of the upright cylinder that it fits into, whichever way it heads."""
        return math.hypot(self.length_m, self.width_m)


@frozen
class DroneFacts:
    """Both drones, as a data sheet and a test flight tell.

    Attributes:
        diameter_m: over the tips of the propellers.
        mass_kg: as it flies; None: what drones of that diameter usually weigh.
        propeller_m: diameter of one of ``propellers``; None: the usual share of ``diameter_m``.
        hold_m: how far it wanders about a place that it is told to hold.
        response_s: until it has answered to 63 % of a new velocity.
        max_speed_mps: the fastest that the crew lets it fly.
        max_tilt_deg: the most that its autopilot tilts it.
        tilt_per_mps_deg: how much a metre a second of wind tilts it as it hovers.
    """

    diameter_m: Annotated[float, Bounds(0.05, 5.0)] = 0.6
    mass_kg: Annotated[float | None, Bounds(0.01, 50.0, "kg")] = None
    propeller_m: Annotated[float | None, Bounds(0.01, 2.0)] = None
    propellers: Annotated[int, Bounds(3, 16, "propellers")] = 4
    hold_m: Annotated[float, Bounds(0.005, 5.0)] = 0.2
    response_s: Annotated[float, Bounds(0.1, 5.0)] = 1.0
    max_speed_mps: Annotated[float, Bounds(0.1, 30.0)] = 5.0
    max_tilt_deg: Annotated[float, Bounds(2.0, 60.0)] = 20.0
    tilt_per_mps_deg: Annotated[float, Bounds(0.0, 20.0, "deg s/m")] = 1.75

    def __post_init__(self) -> None:
        if self.propeller_m is not None and self.propeller_m >= self.diameter_m:
            said = f"{self.propeller_m!r} is not below diameter_m = {self.diameter_m!r}"
            raise ValueError(f"propeller_m: {said}")


@frozen
class SiteFacts:
    """The place and the weather that are flown in.

    Attributes:
        wind_mps, gust_mps: the mean wind, and the standard deviation about it.
        corners_m: (north, east) of the corners of a site with walls, in order; empty: there are
            none.
        ceiling_m: above the ground; None: there is none.
        position_m: standard deviation per axis of where the drones take themselves to be in flight;
            walls and obstacles are kept from by twice that besides.
        obstacles: what stands in the way, as far as the crew knows.
        unmeasured: more may stand there: drones keep off what their depth cameras see.
    """

    wind_mps: Annotated[float, Bounds(0.0, 30.0)] = 1.5
    gust_mps: Annotated[float, Bounds(0.0, 15.0)] = 0.4
    corners_m: Annotated[tuple[tuple[float, float], ...], Bounds(-1000.0, 1000.0)] = ()
    ceiling_m: Annotated[float | None, Bounds(1.0, 120.0)] = None
    position_m: Annotated[float, Bounds(0.0, 20.0)] = 0.5
    obstacles: tuple[Obstacle, ...] = ()
    unmeasured: bool = False


@frozen
class DepthFacts:
    """The depth cameras, by data sheet or a measurement against a wall.

    Attributes:
        min_m, max_m: what they can be trusted with.
        sigma_at_1m_m: noise at 1 m; it grows with the square of the distance.
    """

    min_m: Annotated[float, Bounds(0.05, 50.0)] = 0.3
    max_m: Annotated[float, Bounds(0.1, 100.0)] = 6.0
    sigma_at_1m_m: Annotated[float, Bounds(0.0, 1.0, above=True)] = 0.005


@frozen
class LinkFacts:
    """The link between the drones, as a test on the ground shows it.

    Attributes:
        latency_s: that a packet takes one way, the slow ones among them.
        loss: share of packets that never come.
    """

    latency_s: Annotated[float, Bounds(0.0, 2.0)] = 0.02
    loss: Annotated[float, Bounds(0.0, 0.9, "of 1")] = 0.0


@frozen
class DetectorFacts:
    """How well detectors find such targets.

    Attributes:
        measured: file that ``path-handoff detect --measure`` wrote.
        light: of those pictures the ones that count; None: all.
    """

    measured: Path
    light: Literal["dark", "dim", "bright"] | None = None

    def rates(self) -> Rates:
        """Return what was measured. Raises PartError for a file that says nothing of it."""
        return read_measured(self.measured, self.light)


@frozen
class HeightFacts:
    """How well the drones know their height over the ground that the target stands on. Level ground
    is meant.

    Attributes:
        drift_m: how far the autopilot's own height wanders in a minute (barometer; of PX4 and
            ArduPilot alike).
        rangefinder_max_m, rangefinder_min_m: what rangefinders that look down measure between; 0:
            there are none.
        rangefinder_sigma_m: of one measurement, scale included.
        uneven_m: by how much the ground below a drone may be higher or lower than that at the
            target.
    """

    drift_m: Annotated[float, Bounds(0.0, 10.0)] = 0.3
    rangefinder_max_m: Annotated[float, Bounds(0.0, 200.0)] = 0.0
    rangefinder_min_m: Annotated[float, Bounds(0.0, 10.0)] = 0.1
    rangefinder_sigma_m: Annotated[float, Bounds(0.001, 2.0)] = 0.05
    uneven_m: Annotated[float, Bounds(0.0, 10.0)] = 0.05

    def __post_init__(self) -> None:
        if 0.0 < self.rangefinder_max_m <= self.rangefinder_min_m:
            said = f"{self.rangefinder_max_m!r} is not above rangefinder_min_m = {self.rangefinder_min_m!r}"
            raise ValueError(f"rangefinder_max_m: {said}")

    @property
    def has_rangefinder(self) -> bool:
        """Return whether there are rangefinders."""
        return self.rangefinder_max_m > 0.0


DERIVED = (
    "mission.take_off_height_m",
    "mission.receiver_take_off_height_m",
    "mission.max_accel_mps2",
    "mission.depart_m",
    "mission.target.height_m",
    "mission.target.half_size_m",
    "mission.target.flies",
    "mission.target.own_m",
    "mission.target.fastest_mps",
    "mission.follow",
    "mission.separation",
    "mission.rendezvous.stand_off_m",
    "mission.rendezvous.clearance_m",
    "mission.rendezvous.stand_off_tolerance_m",
    "mission.rendezvous.search_slide_m",
    "mission.rendezvous.arrived_m",
    "mission.rendezvous.arrived_speed_mps",
    "mission.rendezvous.max_speed_mps",
    "mission.rendezvous.max_position_sigma_m",
    "mission.rendezvous.image_margin_px",
    "mission.rendezvous.max_range_m",
    "mission.deadlines",
    "method.evidence",
    "method.target_center_sigma_m",
    "method.max_depth_spread_m",
    "method.min_search_px",
    "method.max_search_px",
    "method.relative_speed_mps",
    "method.relative_accel_mps2",
)
"""Keys and tables whose values follow from the target: they are of one target, and of no other."""


def without_derived(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a rig's tables without what follows from its target."""
    keys: list[list[str]] = [str(key).split(".") for key in DERIVED]
    return _without(table, keys)


def _without(table: Mapping[str, Any], keys: list[list[str]]) -> dict[str, Any]:
    kept: dict[str, Any] = {}
    for name, value in table.items():
        below = [rest for first, *rest in keys if first == name]
        if [] in below:
            continue
        kept[name] = _without(value, below) if isinstance(value, Mapping) else value
    return kept

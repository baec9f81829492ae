"""Whole missions of level ``sim`` for the rendezvous: how near the drones truly came, and where it
ended.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.rig.parts import Rig
from flight.config import SeparationConfig
from flight.phases import Phase
from missions.ground import rig_library
from missions.ground.rig_library import mission_of
from missions.look.report.records import Records, RunRecords
from missions.trials.shared import flown
from path.geometry.rotation import yaw_of
from path.messages import Role, Vec3
from path.values import frozen

STEP = 5  # every so many records of the truth are kept of a way


@frozen
class RendezvousOrder:
    """One mission."""

    rig: Rig
    seed: int
    folder: Path


@frozen
class RendezvousResult:
    """The result of a mission.

    Attributes:
        seed: of the mission.
        arrived: the receiver reached the viewpoint and began to verify.
        why: what the role whose mission ended first said, when it did not hand over.
        separation_m: the smallest one between the bodies, in truth; None when they never flew
            together.
        ellipsoid: the smallest distance in units of the separation ellipsoid: inside below 1; None
            likewise.
        downwash_s: how long the lower drone was in the cone below the upper one.
        began_s, arrived_s: of the receiver's way to the stand-off, and of its verifying; None when
            it did not.
        way_h_m: the receiver's true places from the sender until it verifies, in the sender's
            heading (forward, right, up).
    """

    seed: int
    outcome: str
    why: str
    arrived: bool
    go_arounds: int
    separation_m: float | None
    ellipsoid: float | None
    downwash_s: float
    began_s: float | None
    arrived_s: float | None
    violations: Mapping[str, int]
    way_h_m: tuple[Vec3, ...]

    @property
    def committed(self) -> bool:
        return self.outcome == "committed"

    @property
    def rendezvous_s(self) -> float | None:
        """The time from the take-off's end to the viewpoint."""
        return (
            None
            if self.began_s is None or self.arrived_s is None
            else self.arrived_s - self.began_s
        )


def asked_for(rig: Rig, count: int, seed: int, out: Path) -> list[RendezvousOrder]:
    return [RendezvousOrder(rig, seed * 1_000_000 + k, out / f"{k:04d}") for k in range(count)]


def fly(asked: RendezvousOrder) -> RendezvousResult:
    """One mission from take-off to landing. Its logs are kept only when a monitor was violated."""
    rig = rig_library.shorter(asked.rig)
    facts, run = flown.fly(rig, asked.seed, (), asked.folder)
    began_s = _entered(run, Phase.STAND_OFF)
    arrived_s = _entered(run, Phase.VERIFY)
    places = list(_places(run.world))
    separation = mission_of(rig).separation
    result = RendezvousResult(
        seed=asked.seed,
        outcome=facts.outcome,
        why=facts.detail,
        arrived=arrived_s is not None,
        go_arounds=sum(
            one.record["note"].startswith("goes around") for one in run.receiver.get("/note", ())
        ),
        separation_m=min((math.hypot(*place.offset_w_m) for place in places), default=None),
        ellipsoid=min((_in_ellipsoids(place, separation) for place in places), default=None),
        downwash_s=_in_cone_s(places, separation),
        began_s=began_s,
        arrived_s=arrived_s,
        violations=dict(facts.violations),
        way_h_m=_way(run, places, began_s, arrived_s),
    )
    if not result.violations:
        flown.throw_away(asked.folder)
    return result


def _entered(run: RunRecords, phase: Phase) -> float | None:
    """Return when the receiver first entered a phase, on its own clock, s; None when it did not."""
    of = (
        one.stamp_ns for one in run.receiver.get("/phase", ()) if one.record["phase"] == phase.title
    )
    first = next(of, None)
    return None if first is None else first * 1e-9


@frozen
class _Place:
    """Both drones in truth, while both are in the air; ``offset_w_m`` from the sender to the
    receiver, ENU.
    """

    at_s: float
    offset_w_m: Vec3
    heading_rad: float  # of the sender, counted from east


def _places(world: Records) -> Iterator[_Place]:
    for one in world.get("/truth", ()):
        gives = one.record[Role.SENDER.value]
        takes = one.record[Role.RECEIVER.value]
        if gives["in_air"] and takes["in_air"]:
            (e0, n0, u0), (e1, n1, u1) = gives["t"], takes["t"]
            yield _Place(one.stamp_ns * 1e-9, (e1 - e0, n1 - n0, u1 - u0), yaw_of(gives["q"]))


def _in_ellipsoids(place: _Place, separation: SeparationConfig) -> float:
    """The distance in units of the separation ellipsoid."""
    east, north, up = place.offset_w_m
    return math.hypot(math.hypot(east, north) / separation.horizontal_m, up / separation.vertical_m)


def _in_cone_s(places: Sequence[_Place], separation: SeparationConfig) -> float:
    """Return how long one was in the downwash of the other, s."""
    slope = math.tan(math.radians(separation.downwash_half_angle_deg))
    cone_s = 0.0
    before_s = math.inf
    for place in places:
        east, north, up = place.offset_w_m
        if math.hypot(east, north) < abs(up) * slope:
            cone_s += max(0.0, place.at_s - before_s)
        before_s = place.at_s
    return cone_s


def _way(
    run: RunRecords, places: Sequence[_Place], began_s: float | None, arrived_s: float | None
) -> tuple[Vec3, ...]:
    """Return the way from the stand-off's beginning until it verifies, or for as long as both
    fly.
    """
    if began_s is None or not run.world.get("/scene"):
        return ()
    offset_s = run.world["/scene"][0].record["clock_offset_ns"][Role.RECEIVER.value] * 1e-9
    end_s = math.inf if arrived_s is None else arrived_s - offset_s
    of = [place for place in places if began_s - offset_s <= place.at_s <= end_s]
    return tuple(_from_heading(place) for place in of[::STEP])


def _from_heading(place: _Place) -> Vec3:
    east, north, up = place.offset_w_m
    c = math.cos(place.heading_rad)
    s = math.sin(place.heading_rad)
    return c * east + s * north, s * east - c * north, up


def separations_m(flown: Sequence[RendezvousResult]) -> list[float]:
    """Return the separations of the missions in which both flew."""
    return [one.separation_m for one in flown if one.separation_m is not None]


def reasons(flown: Sequence[RendezvousResult]) -> dict[str, int]:
    """Counts how those ended that did not hand over, the most frequent first."""
    return dict(Counter(one.outcome for one in flown if not one.committed).most_common())


def as_summary(flown: Sequence[RendezvousResult]) -> dict[str, Any]:
    """Plain numbers."""
    return {
        "missions": len(flown),
        "arrived": sum(one.arrived for one in flown),
        "committed": sum(one.committed for one in flown),
        "go_arounds": sum(one.go_arounds for one in flown),
        "violations": sum(sum(one.violations.values()) for one in flown),
        "smallest_separation_m": min(separations_m(flown), default=None),
        "smallest_ellipsoid": min(
            (one.ellipsoid for one in flown if one.ellipsoid is not None), default=None
        ),
        "in_downwash": sum(one.downwash_s > 0.0 for one in flown),
        "longest_in_downwash_s": max(one.downwash_s for one in flown),
        "reasons": reasons(flown),
    }

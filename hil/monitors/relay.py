"""Monitors of what must never happen in a relay or a team: a handoff's for each leg, and those of
all drones at once.

Of all drones: for each target at most one is responsible (S1), nobody is for no longer than lease,
uncertainty and guard allow (L2), every two that are in the air keep their separation (S9), none is
below the reserve before it has landed, and who is responsible has the right object (S12). Gaps that
a dead program, an orphan or a target that was given up leaves are outcomes, not gaps of the
protocol. A relay is a team with one target.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from drivers.rig.parts import RoleRig
from flight.harness.fleet import RelayConfig
from flight.harness.relay import FieldSample, FlightTruth
from flight.outcome import OBJECT_MONITOR
from hil.monitors.monitors import Monitors
from hil.monitors.observed import ObservedTime
from hil.monitors.scripts import VehicleTruth, pixel_of, vehicles_of
from hil.world.distances import obstacles_m
from hil.world.fields import NUMBERS
from hil.world.snapshot import DroneTruth, ObjectTruth
from hil.world.world import Fleet
from path.protocol.bounds import gap_bound_s

Seen = tuple[Mapping[str, DroneTruth], Sequence[ObjectTruth]]
LOOK_S = 0.5  # at the object that the responsible drone has


@dataclass(slots=True)
class _WatchedFlight:
    began_s: float
    battery: float = math.inf  # the smallest while it was armed
    told: bool = False


@dataclass(slots=True)
class RelayMonitors(Monitors):
    """Stamps are of the world's clock. ``on_truth`` is to be called often while drones are in the
    air.

    Attributes:
        own: how each drone truly is.
        seen: drones and objects at a time of the world's clock, for records that are older than the
            world's present.
    """

    config: RelayConfig = field(kw_only=True)
    world: Fleet = field(kw_only=True)
    own: Mapping[str, RoleRig] = field(kw_only=True)
    targets: int = field(default=1, kw_only=True)
    flown: list[FlightTruth] = field(default_factory=list[FlightTruth])
    samples: list[FieldSample] = field(default_factory=list[FieldSample])
    seen: Callable[[float], Seen] | None = None
    watched_until_s: float = math.inf  # the team is called home then
    observed: list[ObservedTime] = field(init=False)
    bytes_sent: Counter[str] = field(default_factory=Counter[str])
    aloft_s: dict[str, float] = field(default_factory=dict[str, float])
    # which target a drone is on; the first if not said
    _on: dict[str, int] = field(default_factory=dict[str, int])
    # who had it until the hand-over under way
    _before: dict[int, str] = field(default_factory=dict[int, str])
    # leg, and bytes in it
    _sent: dict[str, tuple[int, int]] = field(default_factory=dict[str, tuple[int, int]])
    _truth_s: float | None = None
    _flights: dict[str, _WatchedFlight] = field(default_factory=dict[str, _WatchedFlight])
    # by target, since when nobody is
    _alone_s: dict[int, float] = field(default_factory=dict[int, float])
    _looked_s: dict[str, float] = field(default_factory=dict[str, float])
    _wrong: set[str] = field(default_factory=set[str])

    def __post_init__(self) -> None:
        Monitors.__post_init__(self)  # with slots there is no super() here
        self.observed = [ObservedTime() for _ in range(self.targets)]

    def violated_in(self, leg: int, name: str, time_s: float, what: str) -> None:
        if name != "L2":  # of all drones that are on a target
            self.violated(name, time_s, f"leg {leg}: {what}")

    # --- told by the harness ---

    def on_leg(self, number: int, sender: str, receiver: str) -> None:
        Monitors.on_leg(self, number, sender, receiver)
        self._on[receiver] = self.target_of(sender)

    def target_of(self, name: str) -> int:
        """Return the target that a drone is on."""
        return self._on.get(name, 0)

    def on_assigned(self, name: str, target: int) -> None:
        """It is sent to find a target."""
        self._on[name] = target

    def on_given_up(self, target: int) -> None:
        """Nobody has it, and everybody knows: no gap of the protocol, until somebody finds it
        again.
        """
        self._alone_s.pop(target, None)

    def on_over(self, name: str) -> None:
        """Its program has ended on the ground: it holds nothing."""
        self.claims.drop(name)

    def on_switched_on(self, name: str, now_s: float) -> None:
        self._flights[name] = _WatchedFlight(now_s)

    def on_swap(self, name: str, now_s: float) -> None:
        """End a drone's flight, before its autopilot is started anew."""
        flight = self._flights.pop(name, None)
        autopilot = self.world.drone(name).autopilot
        if flight is not None:
            self.flown.append(
                FlightTruth(name, flight.began_s, now_s, min(flight.battery, autopilot.battery))
            )

    def on_death(self, who: str) -> None:
        Monitors.on_death(self, who)
        self._alone_s.pop(self.target_of(who), None)

    def on_record(self, who: str, topic: str, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        Monitors.on_record(self, who, topic, stamp_w_ns, record)
        if topic in ("/target", "/track"):
            self._on_box(who, stamp_w_ns * 1e-9, record["box"])
        elif topic == "/link" and who in self._legs:
            self._on_traffic(who, self._legs[who].number, int(record["bytes_sent"]))

    # --- truth ---

    def on_truth(self, now_s: float) -> None:
        world = self.world
        self.on_near(now_s, world.closest(self.min_separation_m))
        self.on_obstacles(now_s, obstacles_m(world))
        since_s = now_s - (now_s if self._truth_s is None else self._truth_s)
        self._truth_s = now_s
        for name in world.airborne:
            self.aloft_s[name] = self.aloft_s.get(name, 0.0) + since_s
        for name, flight in self._flights.items():
            autopilot = world.drone(name).autopilot
            if not autopilot.armed:
                continue
            flight.battery = min(flight.battery, autopilot.battery)
            if flight.battery < self.config.reserve and not flight.told:
                flight.told = True
                self.violated(
                    "reserve",
                    now_s,
                    f"{name} flies with its battery at {100 * flight.battery:.1f} %",
                )

    def on_watched(self, now_s: float) -> None:
        """As often as ``on_truth``, when what drones looked at until then is known."""
        if now_s <= self.watched_until_s:
            for observed in self.observed:
                observed.tick(now_s)

    def on_vehicles(self, now_s: float, vehicles: Mapping[str, VehicleTruth]) -> None:
        """S7 and S10, when the records up to then are known; seldom is enough."""
        groups: dict[int, list[str]] = {}
        for name in self.world.names:
            if name in vehicles:
                groups.setdefault(self.target_of(name), []).append(name)
        self.scripts.on_truth(now_s, vehicles, groups.values())

    def vehicles(self) -> dict[str, VehicleTruth]:
        """The truth about those that are switched on, now."""
        return vehicles_of(self.world, self.own, self.target_of)

    def sample(self, now_s: float, batteries: tuple[float, ...], airborne: tuple[str, ...]) -> None:
        self.samples.append(
            FieldSample(
                round(now_s, 2), tuple(sorted(self.claims.holders(now_s))), batteries, airborne
            )
        )

    def findings(self) -> dict[str, Any]:
        """Return what was seen, as fields of a ``flight.harness.relay.RelayReport``."""
        return {
            "violations": dict(self.violations),
            "notes": tuple(self.details),
            "gaps_s": {
                leg.number: gap_s for leg in self.legs if (gap_s := leg.leases.gap_s) is not None
            },
            "flown": tuple(self.flown),
            "samples": tuple(self.samples),
            "closest_m": self.closest_m if math.isfinite(self.closest_m) else math.nan,
            "closest_pair": self.closest_pair,
            "watched": tuple(observed.watched() for observed in self.observed),
            "bytes_sent": dict(self.bytes_sent),
            "aloft_s": dict(self.aloft_s),
        }

    def _on_traffic(self, name: str, leg: int, sent: int) -> None:
        """A link counts from its opening; each leg has one of its own."""
        of, before = self._sent.get(name, (leg, 0))
        before = before if of == leg and sent >= before else 0
        self.bytes_sent[name] += sent - before
        self._sent[name] = leg, sent

    def _holders(self, target: int, now_s: float) -> tuple[str, ...]:
        """The drones that are responsible for a target."""
        return tuple(name for name in self.claims.holders(now_s) if self.target_of(name) == target)

    def _on_responsibility(self, who: str, now_s: float, record: Mapping[str, Any]) -> None:
        before = self.claims.holds(who, now_s)
        target = self.target_of(who)
        self.claims.note(who, record)
        holders = self._holders(target, now_s)
        if not record["responsible"]:
            if before:
                self._before[target] = who
                self._alone_s.pop(target, None)
                if not holders:
                    self._alone_s[target] = now_s
            return
        self.observed[target].acquired(now_s)
        self._at_once(holders, now_s)
        if target in self._alone_s:
            alone_s = now_s - self._alone_s.pop(target)
            bound_s = gap_bound_s(self.protocol)
            if alone_s > bound_s:
                self.violated(
                    "L2",
                    now_s,
                    f"nobody was responsible for {alone_s:.2f} s, the bound is {bound_s:.2f} s",
                )

    def _on_box(self, name: str, now_s: float, box: list[float] | None) -> None:
        """The object in the middle of what the responsible drone takes for the target must be the
        target.
        """
        if box is None or now_s - self._looked_s.get(name, -LOOK_S) < LOOK_S:
            return
        target = self.target_of(name)
        responsible = self.claims.holds(name, now_s)
        if not responsible and not (target in self._alone_s and self._before.get(target) == name):
            return
        self._looked_s[name] = now_s
        u = box[0] + 0.5 * box[2]
        v = box[1] + 0.5 * box[3]
        if self.seen is None:
            drone = self.world.truth_of(name)
            objects = self.world.objects_near(name)
        else:
            drones, objects = self.seen(now_s)
            drone = drones[name]
        own = self.own[name]
        off = {thing.object_id: math.dist((u, v), pixel_of(drone, own, thing)) for thing in objects}
        found = min(off, key=lambda number: math.inf if math.isnan(off[number]) else off[number])
        if found == target * NUMBERS:
            self._wrong.discard(name)
            self.observed[target].look(now_s)
        elif responsible and name not in self._wrong:
            self._wrong.add(name)
            self.violated(
                OBJECT_MONITOR, now_s, f"{name} is responsible and looks at object {found}"
            )

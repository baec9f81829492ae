"""The monitors of what no script may do, from true states and the roles' phases: S7, S10, and S11
at a site's walls.

S7 is held as far as it can be measured: while the camera of a drone whose mission goes on truly has
the target's middle in its image, one such drone looks at its frames (a record of one, at most
``LOOKS_S`` old). A mission goes on from the moment a role follows the target, or searches for the
other drone, until it departs, lands or its program dies.

S10: once a pilot has the vehicle, no setpoint comes any more and no script changes the mode; once a
pilot has stopped its motors, it is sent nothing and not armed again; once the autopilot itself
holds it, no script flies it on; below the battery's limit, or outside the fence, the mission ends.
What was under way when it happened may still arrive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from drivers.interfaces import FlightMode
from drivers.rig.parts import RoleRig
from flight.config import GuardConfig
from flight.phases import Phase
from hil.autopilot.autopilot import Autopilot
from hil.world.snapshot import DroneTruth, ObjectTruth
from hil.world.world import Fleet
from path.messages import Vec3
from path.values import frozen

Violated = Callable[[str, float, str], None]

LOOKS_S = 1.0
NOTICED_S = 1.5  # mode and battery come with heartbeats; then the script ends its mission
FENCE_SLACK_M = 0.5  # of the vehicle's own estimate
BODY_M = 0.16  # around the middle of a drone

WATCHING = frozenset(
    phase.title for phase in (Phase.FOLLOW, Phase.SEARCH, Phase.APPROACH, Phase.VERIFY)
)
ENDING = frozenset(phase.title for phase in (Phase.DEPART, Phase.LAND, Phase.DONE))


@frozen
class VehicleTruth:
    """The truth of one vehicle at an instant.

    Attributes:
        armed: and no kill switch keeps the motors still.
        killed: the pilot has stopped the motors.
        failsafe: the autopilot's own that has the vehicle; empty for none.
        setpoint_s: when the newest setpoint arrived, world's clock.
        position_n_m: true, north, east, down.
        sees_target: the target's middle is in its camera's image.
        pilots_mode: the newest that the pilot selected, where that is known.
    """

    mode: FlightMode
    armed: bool
    pilot: bool
    killed: bool
    battery: float
    low_battery: float
    setpoint_s: float
    position_n_m: Vec3
    sees_target: bool
    failsafe: str = ""
    pilots_mode: FlightMode | None = None


@dataclass(slots=True)
class ScriptMonitor:
    """Each kind of violation of a role counts once."""

    violated: Violated
    guard: GuardConfig = field(default_factory=GuardConfig)
    _phase: dict[str, str] = field(default_factory=dict[str, str])
    _looked_s: dict[str, float] = field(default_factory=dict[str, float])
    _since_s: dict[tuple[str, str], float] = field(default_factory=dict[tuple[str, str], float])
    _mode: dict[str, FlightMode] = field(default_factory=dict[str, FlightMode])  # a pilot's
    _told: set[str] = field(default_factory=set[str])

    def on_phase(self, who: str, now_s: float, phase: str) -> None:
        if phase in WATCHING and self._phase.get(who) not in WATCHING:
            self._looked_s[who] = now_s  # from here on it has to
        self._phase[who] = phase

    def on_frame(self, who: str, now_s: float) -> None:
        self._looked_s[who] = now_s

    def on_death(self, who: str) -> None:
        self._phase.pop(who, None)

    def on_truth(
        self,
        now_s: float,
        vehicles: Mapping[str, VehicleTruth],
        together: Iterable[Iterable[str]] | None = None,
    ) -> None:
        """``together``: those that are on one target; all when it is not said."""
        for group in (vehicles,) if together is None else together:
            self._observed(now_s, {who: vehicles[who] for who in group})
        for who, vehicle in vehicles.items():
            self._obeyed(who, now_s, vehicle)
            self._clear_of_walls(who, now_s, vehicle)

    def _observed(self, now_s: float, vehicles: Mapping[str, VehicleTruth]) -> None:
        """S7."""
        watching = [who for who in vehicles if self._phase.get(who) in WATCHING]
        seen = any(vehicles[who].sees_target for who in watching)
        if not seen or any(now_s - self._looked_s.get(who, 0.0) <= LOOKS_S for who in watching):
            return
        self._once("S7", now_s, "a camera has the target in its image, and nobody looks")

    def _clear_of_walls(self, who: str, now_s: float, vehicle: VehicleTruth) -> None:
        """S11, as far as a site has walls."""
        north, east, _ = vehicle.position_n_m
        if self.guard.fence().room_m(north, east) < BODY_M:
            self._once("S11", now_s, f"{who} touches a wall of the site")

    def _obeyed(self, who: str, now_s: float, vehicle: VehicleTruth) -> None:
        """S10."""
        north, east, down = vehicle.position_n_m
        limit = self.guard
        outside = (north * north + east * east) ** 0.5 > limit.fence_radius_m + FENCE_SLACK_M
        outside = outside or -down > limit.fence_height_m + FENCE_SLACK_M
        outside = outside or limit.fence().room_m(north, east) < -FENCE_SLACK_M
        ruled = {
            "pilot": vehicle.armed and vehicle.pilot,
            "kill": vehicle.killed,
            "failsafe": vehicle.armed and bool(vehicle.failsafe),
            "battery": vehicle.armed and vehicle.battery < limit.min_battery,
            "fence": vehicle.armed and outside,
        }
        for reason, rules in ruled.items():
            if not rules:
                self._since_s.pop((reason, who), None)
                if reason == "pilot":
                    self._mode.pop(who, None)
                continue
            since_s = self._since_s.setdefault((reason, who), now_s)
            if now_s - since_s > NOTICED_S:
                self._after(reason, who, since_s, now_s, vehicle)

    def _after(
        self, reason: str, who: str, since_s: float, now_s: float, vehicle: VehicleTruth
    ) -> None:
        if reason == "pilot":
            if vehicle.setpoint_s > since_s + NOTICED_S:
                self._once("S10", now_s, f"the {who}'s script sends setpoints to a pilot's vehicle")
            mode = self._mode.setdefault(who, vehicle.mode)
            if (
                vehicle.mode not in (mode, vehicle.pilots_mode)
                and not vehicle.failsafe
                and vehicle.battery > vehicle.low_battery
            ):
                self._once(
                    "S10",
                    now_s,
                    f"the {who}'s script took the vehicle from its pilot: {vehicle.mode.value}",
                )
        elif reason == "kill":
            if vehicle.armed or vehicle.setpoint_s > since_s + NOTICED_S:
                self._once(
                    "S10",
                    now_s,
                    f"the {who}'s script flies a vehicle whose motors the pilot stopped",
                )
        elif reason == "failsafe":
            if vehicle.mode is FlightMode.OFFBOARD or vehicle.setpoint_s > since_s + NOTICED_S:
                self._once(
                    "S10",
                    now_s,
                    f"the {who}'s script flies on against its autopilot: {vehicle.failsafe}",
                )
        elif vehicle.mode is FlightMode.OFFBOARD and self._phase.get(who, "") not in ("", *ENDING):
            self._once("S10", now_s, f"the {who}'s mission goes on against its limit: {reason}")

    def _once(self, name: str, now_s: float, what: str) -> None:
        if what not in self._told:
            self._told.add(what)
            self.violated(name, now_s, what)


def vehicles_of(
    world: Fleet, own: Mapping[str, RoleRig], target_of: Callable[[str], int] = lambda _: 0
) -> dict[str, VehicleTruth]:
    """The truth about the vehicles that are switched on, now.

    Args:
        own: how each drone truly is.
        target_of: the number of the target that a drone is on.
    """
    return {
        name: vehicle_truth(
            world.drone(name).autopilot,
            world.truth_of(name),
            own[name],
            world.target(target_of(name)),
        )
        for name in world.names
        if name in world.on
    }


def vehicle_truth(
    autopilot: Autopilot, drone: DroneTruth, own: RoleRig, target: ObjectTruth
) -> VehicleTruth:
    """The truth about one vehicle."""
    u, v = pixel_of(drone, own, target)
    east, north, up = drone.T_w_b.t.tolist()
    return VehicleTruth(
        mode=autopilot.mode,
        armed=autopilot.powered,
        pilot=autopilot.pilot_in_control,
        pilots_mode=autopilot.pilots_mode,
        killed=autopilot.killed,
        failsafe=autopilot.failsafe,
        battery=autopilot.battery,
        low_battery=autopilot.config.low_battery,
        setpoint_s=autopilot.newest_setpoint_s,
        position_n_m=(north, east, -up),
        # NaN behind the camera
        sees_target=0.0 <= u < own.camera.width and 0.0 <= v < own.camera.height,
    )


def pixel_of(drone: DroneTruth, own: RoleRig, thing: ObjectTruth) -> tuple[float, float]:
    """Returns the pixel of an object's origin in a drone's image; NaN behind the camera."""
    thing_b_m = drone.T_w_b.R.T @ (np.array(thing.position_w_m) - drone.T_w_b.t)
    thing_c_m = own.mount.T_b_c.R.T @ (thing_b_m - own.mount.T_b_c.t)
    return own.camera.project_point(tuple(thing_c_m.tolist()))

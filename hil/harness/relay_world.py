"""The world of a relay or a team: drones and targets on one field, and what the parts of one drone
are connected to.

A drone's parts are made once and stay open while its role changes. To its own vehicle and its own
camera it is always the receiver, who sees the other drone's marker when there is another drone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.interfaces import FlightMode
from flight.harness.fleet import NamedDrone, NamedTarget
from hil.autopilot.autopilot import Autopilot
from hil.autopilot.radio import CENTRED
from hil.harness.inject import inject_in_world
from hil.world.config import HomeConfig, WorldConfig
from hil.world.distances import Nearness, nearness
from hil.world.dynamics import CONTACT
from hil.world.errors import put_down
from hil.world.fields import TargetField
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from hil.world.targets import Point
from hil.world.world import STEP_HZ, Fleet, SimDrone, at_home
from path.messages import Role

OWN = Role.RECEIVER
OTHER = Role.SENDER
# after these it is his, or holds and waits for him
THE_PILOTS = ("pilot_takeover", "rc_mode", "rc_sticks", "rc_lost")
PILOT_LANDS_S = 15.0  # after he took a drone over he lands it where it is
# before that, of the sticks: moved while it lands they would take it out of its landing
LETS_GO_S = 2.0


class RelayWorld(Fleet[str]):
    """Drones that are switched on one by one. What is off stands at its home and costs nothing."""

    def __init__(
        self,
        config: WorldConfig,
        seed: int,
        drones: tuple[NamedDrone, ...],
        targets: Sequence[NamedTarget] = (),
    ) -> None:
        """``targets``: none for the one of ``config``. Raises ValueError when the objects do not
        fit.
        """
        self._targets = targets
        sizes = config.errors.sizes
        self._homes = {
            drone.name: HomeConfig(put_down(drone.home_m, sizes, seed, k), drone.heading_deg)
            for k, drone in enumerate(drones)
        }
        self._seeds = np.random.SeedSequence([seed, 0x52454C]).spawn(len(drones))
        self._boots = dict.fromkeys(self._homes, 0)
        self.on: set[str] = set()
        self._rows = {name: k for k, name in enumerate(self._homes)}
        self._truths: dict[str, DroneTruth] = {}
        # the rows of those in the air, once they were asked for
        self._aloft: list[int] | None = None
        self._covered: set[str] = set()  # whose markers are
        self._no_depth: set[str] = set()  # whose depth cameras measure nothing on objects
        self._pilot_lands_s: dict[str, float] = {}  # when, of drones that a pilot took over
        super().__init__(config, seed, self._homes, {})
        for drone in drones:
            self.battery(drone.name, drone.battery)

    def _place_traffic(self, keep_clear: Sequence[Point], seed: np.random.SeedSequence) -> None:
        starts = [(each.place_m, each.named_at_s) for each in self._targets] or [
            (self.config.target.start_m, 0.0)
        ]
        seeds = seed.spawn(len(starts)) if self._targets else [seed]
        self._field = TargetField(
            self.config.target, self.config.look_alikes, starts, keep_clear, seeds
        )

    def send_lookalike(self, target: int = 0) -> None:
        """Past one of the targets; see ``Fleet.send_lookalike``."""
        self._field.send_lookalike(target, self.traffic_s)
        self._changed()

    def inject(
        self, fault: str, drone: str | None, value: float | None, leg: Sequence[str]
    ) -> None:
        """A fault of a leg: of a drone, or of the field around it. ``leg``: its sender and
        receiver.
        """
        if fault == "marker_hidden":
            self._covered.add(leg[0])
        elif fault == "depth_holes":
            self._no_depth.update(leg)
        else:
            inject_in_world(fault, drone, self, value)
        if drone is not None and fault.startswith(THE_PILOTS):
            self._pilot_lands_s[drone] = self.time_s + PILOT_LANDS_S
        self._changed()

    def close_leg(self, sender: str, receiver: str) -> None:
        """The cameras and markers of a leg's drones are as before: what was wrong in it alone is
        over.
        """
        self._covered -= {sender, receiver}
        self._no_depth -= {sender, receiver}
        self._changed()

    def switch_on(self, name: str) -> None:
        """Switch a drone on, with a position solution of its own that has not wandered yet."""
        self._sensors.begin_anew(self.names.index(name), self.config.estimator)
        self._drones[name].telemetry.clear()
        self.on.add(name)

    def swap(self, name: str, battery: float = 1.0) -> None:
        """Put a drone at its home, with a battery of that charge, off; its autopilot will start
        anew.
        """
        row = self.names.index(name)
        self._boots[name] = self._boots[name] + 1
        self._states[row] = at_home(self._homes[name], self.config.airframe.leg_m)
        self._commands[row] = 0.0
        seed = int(
            np.random.SeedSequence(
                (*self._seeds[row].generate_state(2), self._boots[name])
            ).generate_state(1)[0]
        )
        self._drones[name].autopilot = Autopilot(self.config.autopilot, seed)
        self.battery(name, battery)
        self.on.discard(name)
        self._pilot_lands_s.pop(name, None)
        self.close_leg(name, name)

    def _sense(self) -> None:
        rows = self._sensors.tick(self._states)
        time_s = self._step / STEP_HZ
        for i, (name, drone) in enumerate(self._drones.items()):
            if name in self.on:
                drone.sense(time_s, rows[i].tolist())

    def _command(self) -> None:
        self._commanded_step = self._step
        now_s = self._step / STEP_HZ
        for name, at_s in list(self._pilot_lands_s.items()):
            autopilot = self._drones[name].autopilot
            if now_s >= at_s:
                del self._pilot_lands_s[name]
                autopilot.request_mode(now_s, FlightMode.LAND, by_pilot=True)
            elif now_s >= at_s - LETS_GO_S:
                autopilot.radio.transmitter.sticks = CENTRED
        for i, (name, drone) in enumerate(self._drones.items()):
            if name in self.on:
                self._commands[i] = drone.command(now_s)

    def _changed(self) -> None:
        self._truths.clear()
        self._aloft = None

    # --- truth ---

    def truth(self) -> dict[str, DroneTruth]:
        """Of every drone; most want one or two."""
        return self.truths()

    def truth_of(self, name: str) -> DroneTruth:
        truth = self._truths.get(name)
        if truth is None:
            row = self._rows[name]
            (truth,) = self._truths_of(slice(row, row + 1), (self._drones[name],))
            self._truths[name] = truth
        return truth

    @property
    def objects(self) -> tuple[ObjectTruth, ...]:
        """All around the first target."""
        return self._field.near(self._field.starts[0], self.traffic_s)

    @property
    def all_objects(self) -> tuple[ObjectTruth, ...]:
        """All around all targets."""
        return self._field.all(self.traffic_s)

    def objects_near(self, name: str) -> tuple[ObjectTruth, ...]:
        """The objects that a drone may see."""
        north, east, _ = self._drones[name].true_position_n_m
        return self._field.near((east, north), self.traffic_s)

    def target(self, number: int) -> ObjectTruth:
        return self._field.target(number, self.traffic_s)

    @property
    def airborne(self) -> tuple[str, ...]:
        names = self.names
        return tuple([names[row] for row in self._rows_aloft()])

    def _rows_aloft(self) -> list[int]:
        if self._aloft is None:
            self._aloft = np.flatnonzero(self._states[:, CONTACT] == 0.0).tolist()
        return self._aloft

    def closest(self, within_m: float) -> Nearness:
        """The distances between drones in the air, in truth."""
        return nearness(self.airborne, self._states[self._rows_aloft(), :3], within_m)

    @property
    def batteries(self) -> tuple[float, ...]:
        """The batteries in the order of ``names``."""
        return tuple(round(drone.autopilot.battery, 4) for drone in self._drones.values())

    def view(self, own: str, other: str | None) -> Snapshot:
        """The truth at ``time_s`` as far as a pair is concerned."""
        truth = self.truth_of
        drones = {OWN: truth(own)} if other is None else {OTHER: truth(other), OWN: truth(own)}
        covered = other in self._covered
        no_depth = own in self._no_depth
        return Snapshot(
            self.time_s, drones, self.objects_near(own), covered, no_depth, self.detector, self.config.target.kind,
            self.config.target.stretch,
        )  # fmt: skip


class PairView:
    """A world of two, for the parts of one drone."""

    def __init__(self, world: RelayWorld, own: str) -> None:
        self._world = world
        self._own = own
        self.other: str | None = None
        self._seen: Snapshot | None = None
        self._seen_other: str | None = None

    @property
    def time_s(self) -> float:
        return self._world.time_s

    def drone(self, role: Role) -> SimDrone:
        """Its own, whatever it is called: a part knows no other vehicle."""
        del role
        return self._world.drone(self._own)

    def snapshot(self) -> Snapshot:
        if (
            self._seen is None
            or self._seen.time_s != self._world.time_s
            or self._seen_other != self.other
        ):
            self._seen = self._world.view(self._own, self.other)
            self._seen_other = self.other
        return self._seen

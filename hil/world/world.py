"""The truth: any number of drones with their autopilots, wind, targets and their look-alikes, and
the faults of the world. A pair is a fleet of two.

Physics runs in fixed steps on a grid of its own and the autopilots on every fourth of them, so that
how often and how finely ``advance`` is called changes nothing. Random numbers come from one stream
for each purpose: what one consumer draws never shifts another's. World frame ``w`` is ENU with its
origin on the ground, drones are reckoned in NED ``n``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drivers.interfaces import FlightMode
from drivers.rig.obstacle import Obstacle
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from flight.harness.fleet import NamedTarget
from hil.autopilot.autopilot import Autopilot, Estimate
from hil.autopilot.radio import CENTRED
from hil.world.air import Air
from hil.world.clutter import Crate
from hil.world.config import HomeConfig, PositionOffsetConfig, WorldConfig
from hil.world.detector import measured_on
from hil.world.distances import Nearness, nearness
from hil.world.dynamics import (
    COMMAND_SIZE,
    CONTACT,
    MOTORS_FLY,
    MOTORS_IDLE,
    MOTORS_OFF,
    ROTOR_PHASE,
    Array,
    fly,
    poses_w,
    standing,
)
from hil.world.estimator import Sensors
from hil.world.fields import NUMBERS, TargetField
from hil.world.obstacles import ObstaclesConfig, crates_of, stand
from hil.world.rangefinder import SimRangefinder
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from hil.world.weather import Weather
from path.geometry.transforms import Pose
from path.messages import Quat, Role, Vec3

STEP_HZ = 200
STEPS_PER_TICK = 4
TICK_S = STEPS_PER_TICK / STEP_HZ
TARGET_STEPS = 4 * STEPS_PER_TICK  # between two looks at what the air does to targets
TELEMETRY_TICKS = 128
PILOT_LANDS_S = 15.0  # after he took a drone over he lands it where it is
# before that, of the sticks: moved while it lands they would take it out of its landing
LETS_GO_S = 2.0
OWN = Role.RECEIVER
OTHER = Role.SENDER


class VehicleTelemetry(NamedTuple):
    """A drone's words about itself at one tick. The height in ``position_n_m`` is that above its
    home.
    """

    time_s: float
    estimate: Estimate
    mode: FlightMode
    armed: bool
    landed: bool
    armable: bool
    battery: float
    killed: bool = False
    position_n_m: Vec3 = (0.0, 0.0, 0.0)
    below_m: float | None = None


class SimDrone:
    """One drone: its autopilot, what it believes, and (for the harness alone) what is true.

    Attributes:
        autopilot: commands go here, between two calls of ``World.advance``.
        estimate: the newest one, at most a tick old.
        position_n_m: by that estimate, but the height is that above home: what a drone tells its
            companion.
        down_off_m: what it is wrong by besides, downward.
        resets: how often its estimator has stepped.
        telemetry: one entry a tick, newest last, the last ``TELEMETRY_TICKS`` of them.
        rangefinder: that looks down; None without one.
        hears: called before each step of the autopilot with its time: what it was told until then
            is to be told it.
    """

    def __init__(
        self, autopilot: Autopilot, state: Array, rangefinder: SimRangefinder | None = None
    ) -> None:
        self.autopilot = autopilot
        self.rangefinder = rangefinder
        self.estimate = Estimate(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        self.position_n_m: Vec3 = (0.0, 0.0, 0.0)
        self.down_off_m = 0.0
        self.resets = 0
        self.telemetry: deque[VehicleTelemetry] = deque(maxlen=TELEMETRY_TICKS)
        self.hears: Callable[[float], None] | None = None
        self._state = state

    @property
    def on_ground(self) -> bool:
        """Truth: whether it stands on its legs."""
        return bool(self._state[CONTACT])

    @property
    def true_position_n_m(self) -> Vec3:
        n, e, d = self._state[:3].tolist()
        return n, e, d

    @property
    def true_velocity_n_mps(self) -> Vec3:
        n, e, d = self._state[3:6].tolist()
        return n, e, d

    @property
    def true_q_n_b(self) -> Quat:
        w, x, y, z = self._state[6:10].tolist()
        return w, x, y, z

    def sense(self, time_s: float, row: list[float]) -> None:
        """Take the estimate of a tick: position, velocity, attitude in one row. Only the world
        calls this.
        """
        n, e, d, vn, ve, vd, w, x, y, z = row
        self.estimate = Estimate(time_s, (n, e, d), (vn, ve, vd), (w, x, y, z), self.resets)
        own = self.autopilot
        self.position_n_m = (
            n,
            e,
            d - (d if own.home_n_m is None else own.home_n_m[2]) + self.down_off_m,
        )
        said = VehicleTelemetry(
            time_s, self.estimate, own.mode, own.powered, own.landed, own.armable, own.battery, own.killed,
            self.position_n_m, self._below_m(time_s),
        )  # fmt: skip
        self.telemetry.append(said)

    def _below_m(self, time_s: float) -> float | None:
        if self.rangefinder is None:
            return None
        self.rangefinder.sense(time_s, -self.true_position_n_m[2], self.true_q_n_b)
        return self.rangefinder.below_m

    def command(self, time_s: float) -> tuple[float, ...]:
        """Step the autopilot at a tick; a command row of ``hil.world.dynamics``. Only the world
        calls this.
        """
        if self.hears is not None:
            self.hears(time_s)
        command = self.autopilot.step(time_s, self.estimate, bool(self._state[CONTACT]))
        if command.velocity_n_mps is None:
            return (
                (MOTORS_IDLE if command.thrust_on else MOTORS_OFF),
                0.0,
                0.0,
                0.0,
                command.yaw_rad,
            )
        return MOTORS_FLY, *command.velocity_n_mps, command.yaw_rad


class Fleet:
    """Drones by name with their autopilots, and the traffic on the ground.

    All is a function of the seed and of what the autopilots are told. What is off stands at its
    home and costs nothing.

    Args:
        off: NED errors of positions besides the estimators'.
        targets: none for the one of ``config``.
        on: whether all drones are switched on from the start.
    """

    def __init__(
        self,
        config: WorldConfig,
        seed: int,
        homes: Mapping[str, HomeConfig],
        off: Mapping[str, Vec3] | None = None,
        targets: Sequence[NamedTarget] = (),
        *,
        on: bool = True,
    ) -> None:
        """Raise ValueError when the objects do not fit."""
        self.config = config
        traffic, sensors, autopilots = np.random.SeedSequence(seed).spawn(3)
        self._traffic = TargetField(
            config.target,
            config.look_alikes,
            [(each.place_m, each.named_at_s) for each in targets] or [(config.target.start_m, 0.0)],
            [home.position_m for home in homes.values()],
            traffic.spawn(len(targets)) if targets else [traffic],
        )
        self.obstacles = stand(
            config.obstacles,
            config.errors.sizes.home_m,
            self._traffic.ways,
            [home.position_m for home in homes.values()],
            seed,
        )
        self._traffic_began_s = 0.0
        off = off or {}
        self._homes = homes
        self._rows = {name: row for row, name in enumerate(homes)}
        self.on = set(homes) if on else set[str]()
        self._seeds = np.random.SeedSequence([seed, 0x52454C]).spawn(len(homes))
        self._boots = dict.fromkeys(homes, 0)
        self._truths: dict[str, DroneTruth] = {}
        # the rows of those in the air, once they were asked for
        self._aloft: list[int] | None = None
        self._covered: dict[str, float] = {}  # whose markers are, and until when
        self._crates: tuple[Crate, ...] = ()
        self._no_depth: set[str] = set()  # whose depth cameras measure nothing on objects
        self._pilot_lands_s: dict[str, float] = {}  # when, of drones that a pilot took over
        estimator = config.estimator.times(config.errors.sizes)
        self._sensors = Sensors(config.wind, estimator, TICK_S, sensors.spawn(len(homes)))
        for i, name in enumerate(homes):
            self._sensors.position_bias[i] += off.get(name, (0.0, 0.0, 0.0))
        self._airframe = config.airframe.row()
        light = max(1, len(targets)) if config.target.kind == "drone" else 0
        drag_hz = config.airframe.drag_hz
        self.weather = Weather(seed)
        self.air = Air(config.air, drag_hz, len(homes), light, seed, TICK_S)
        self._states = np.stack([at_home(home, config.airframe.leg_m) for home in homes.values()])
        self._commands = np.zeros((len(homes), COMMAND_SIZE))
        self._drones = {
            name: SimDrone(
                Autopilot(config.autopilot, int(own.generate_state(1)[0])),
                self._states[i],
                SimRangefinder(config.rangefinder, seed, i)
                if config.rangefinder.max_m > 0.0
                else None,
            )
            for i, (name, own) in enumerate(zip(homes, autopilots.spawn(len(homes)), strict=True))
        }
        for name, (_, _, down) in off.items():
            self._drones[name].down_off_m = down
        self._step = 0
        self._commanded_step = -1
        self.detector = config.detector or measured_on(config.target.kind, config.scene.name)
        self.time_s = 0.0
        self._sense()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._drones)

    def drone(self, name: str) -> SimDrone:
        return self._drones[name]

    def switch_on(self, name: str) -> None:
        """Switch a drone on, with a position solution of its own that has not wandered yet."""
        self._sensors.begin_anew(self._rows[name], self.config.estimator)
        self._drones[name].telemetry.clear()
        self.on.add(name)

    def swap(self, name: str, battery: float = 1.0) -> None:
        """Put a drone at its home, with a battery of that charge, off; its autopilot will start
        anew.
        """
        row = self._rows[name]
        self._boots[name] += 1
        self._states[row] = at_home(self._homes[name], self.config.airframe.leg_m)
        self._commands[row] = 0.0
        entropy = (*self._seeds[row].generate_state(2), self._boots[name])
        seed = int(np.random.SeedSequence(entropy).generate_state(1)[0])
        self._drones[name].autopilot = Autopilot(self.config.autopilot, seed)
        self.battery(name, battery)
        self.on.discard(name)
        self._pilot_lands_s.pop(name, None)
        self.uncover(name)

    def landed(self, name: str) -> bool:
        """Return whether a drone stands on the ground, disarmed."""
        drone = self._drones[name]
        return drone.on_ground and not drone.autopilot.armed

    def advance(self, to_s: float) -> None:
        """Let time pass until ``to_s``, the time since the world began. Raises ValueError for the
        past.
        """
        if to_s < self.time_s:
            raise ValueError(f"the world is at {self.time_s} s and cannot go back to {to_s} s")
        last = math.floor(to_s * STEP_HZ + 1e-6)
        while self._step < last:
            into_tick = self._step % STEPS_PER_TICK
            if into_tick == 0 and self._commanded_step != self._step:
                self._command()
            steps = min(STEPS_PER_TICK - into_tick, last - self._step)
            sensors = self._sensors
            errors = sensors.velocity_errors, sensors.attitude_errors
            fly(
                self._states,
                self._commands,
                sensors.winds,
                self.air.pushes,
                *errors,
                self._airframe,
                1.0 / STEP_HZ,
                steps,
            )
            self._step += steps
            if self._step % STEPS_PER_TICK == 0:
                self._sense()
        if to_s > self.time_s:
            self.time_s = to_s
            self._changed()

    def _sense(self) -> None:
        turns = self.weather.turns_rad(len(self._states), TICK_S, self._step / STEP_HZ)
        self._sensors.attitude_bias[:, 2] += turns
        rows = self._sensors.tick(self._states)
        self.air.tick(self._states, self._sensors.winds)
        self._move_targets()
        time_s = self._step / STEP_HZ
        altitude = self.config.altitude
        for number, (name, drone) in enumerate(self._drones.items()):
            if name in self.on:
                drone.autopilot.altitude_error_m = altitude.error_m(number, time_s)
                drone.sense(time_s, rows[number].tolist())

    def _move_targets(self) -> None:
        """Let the drones' air push what is light enough."""
        count = len(self.air.shifts_w_m)
        if not count or self._step % TARGET_STEPS:
            return
        now_s = max(0.0, self._step / STEP_HZ - self._traffic_began_s)
        places = [self._traffic.target(number, now_s).position_w_m for number in range(count)]
        by_s = TARGET_STEPS / STEP_HZ
        self.air.move_targets(places, self._states, self._sensors.winds, by_s)

    def _pushed(self, thing: ObjectTruth) -> ObjectTruth:
        """Return a thing where sloping ground and the drones' air have it."""
        if self.weather.slope:
            thing = replace(thing, position_w_m=self.weather.higher(thing.position_w_m))
        number, apart = divmod(thing.object_id, NUMBERS)
        if apart or number >= len(self.air.shifts_w_m):
            return thing
        east, north, up = (self.air.shifts_w_m[number] + thing.position_w_m).tolist()
        return replace(thing, position_w_m=(east, north, up))

    def _command(self) -> None:
        self._commanded_step = self._step
        now_s = self._step / STEP_HZ
        if self._pilot_lands_s:
            self._let_pilots_land(now_s)
        for i, (name, drone) in enumerate(self._drones.items()):
            if name in self.on:
                self._commands[i] = drone.command(now_s)

    def _let_pilots_land(self, now_s: float) -> None:
        for name, at_s in list(self._pilot_lands_s.items()):
            autopilot = self._drones[name].autopilot
            if now_s >= at_s:
                del self._pilot_lands_s[name]
                autopilot.request_mode(now_s, FlightMode.LAND, by_pilot=True)
            elif now_s >= at_s - LETS_GO_S:
                autopilot.radio.transmitter.sticks = CENTRED

    def _changed(self) -> None:
        """Drop what was worked out of the truth before it changed."""
        self._truths.clear()
        self._aloft = None

    # --- truth ---

    def truth_of(self, name: str) -> DroneTruth:
        """Of one drone; most want one or two."""
        truth = self._truths.get(name)
        if truth is None:
            row = self._rows[name]
            (truth,) = self._truths_of(slice(row, row + 1), (self._drones[name],))
            self._truths[name] = truth
        return truth

    @property
    def all_objects(self) -> tuple[ObjectTruth, ...]:
        """All around all targets."""
        return tuple(map(self._pushed, self._traffic.all(self.traffic_s)))

    def objects_near(self, name: str) -> tuple[ObjectTruth, ...]:
        """The objects that a drone may see."""
        north, east, _ = self._drones[name].true_position_n_m
        near = self._traffic.near((east, north), self.traffic_s)
        return tuple(map(self._pushed, near))

    def target(self, number: int = 0) -> ObjectTruth:
        return self._pushed(self._traffic.target(number, self.traffic_s))

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
        """The truth at ``time_s`` as far as one drone is concerned, which is always the receiver to
        its own parts: it sees the other drone's marker when there is another drone.
        """
        truth = self.truth_of
        drones = {OWN: truth(own)} if other is None else {OTHER: truth(other), OWN: truth(own)}
        hidden = other is not None and self._hidden(other)
        return self._seen(drones, self.objects_near(own), hidden, own in self._no_depth)

    def _hidden(self, name: str) -> bool:
        """Return whether a drone's marker is covered."""
        covered = self.time_s < self._covered.get(name, -math.inf)
        return covered or self.weather.hides_marker(self.time_s)

    def _seen(
        self,
        drones: dict[Role, DroneTruth],
        objects: tuple[ObjectTruth, ...],
        marker_hidden: bool,
        depth_holes: bool,
    ) -> Snapshot:
        target = self.config.target
        return Snapshot(
            self.time_s, drones, objects, marker_hidden, depth_holes, self.detector, target.kind, target.stretch,
            self._crates, crates_of(self.obstacles), self.weather.light(self.time_s), self.weather.smudge,
        )  # fmt: skip

    def truths(self) -> dict[str, DroneTruth]:
        """Of every drone at ``time_s``; between two physics steps they are carried on by their
        velocities.
        """
        return dict(
            zip(self._drones, self._truths_of(slice(None), self._drones.values()), strict=True)
        )

    def _truths_of(self, rows: slice, drones: Iterable[SimDrone]) -> list[DroneTruth]:
        """Of the drones of some rows."""
        states = self._states[rows]
        poses = np.empty((len(states), 12))
        poses_w(states, self._late_s(), poses)
        return [
            DroneTruth(
                Pose(pose[:9].reshape(3, 3), pose[9:]), (row[4], row[3], -row[5]), row[ROTOR_PHASE],
                drone.autopilot.armed, (row[10], row[11], row[12]),
            )
            for drone, row, pose in zip(drones, states.tolist(), poses, strict=True)
        ]  # fmt: skip

    def _late_s(self) -> float:
        """Return the time from the state rows to ``time_s``, s."""
        return self.time_s - self._step / STEP_HZ

    # --- faults ---

    def hide_marker(self, name: str, for_s: float = math.inf) -> None:
        """Cover a drone's marker for so long."""
        self._covered[name] = self.time_s + for_s
        self._changed()

    def depth_holes(self, *names: str) -> None:
        """Let the depth cameras of drones measure nothing on objects."""
        self._no_depth.update(names)
        self._changed()

    def uncover(self, *names: str) -> None:
        """Let the markers and depth cameras of drones be as before."""
        for name in names:
            self._covered.pop(name, None)
        self._no_depth.difference_update(names)
        self._changed()

    def pilot_lands(self, name: str) -> None:
        """Let the pilot who takes a drone over land it, after a while."""
        self._pilot_lands_s[name] = self.time_s + PILOT_LANDS_S

    def hold_traffic(self) -> None:
        """Keep everything on the ground where it begins until ``begin_traffic``."""
        self._traffic_began_s = math.inf
        self._changed()

    def begin_traffic(self) -> None:
        """Let the time of what is on the ground run from now on, if it was held."""
        self._traffic_began_s = min(self._traffic_began_s, self.time_s)
        self._changed()

    @property
    def traffic_s(self) -> float:
        """The time of what is on the ground."""
        return max(0.0, self.time_s - self._traffic_began_s)

    def degrade_detectors(self, **changes: float) -> None:
        """Let all drones' detectors be worse by some of the fields of ``DetectorConfig``."""
        self.detector = replace(self.detector, **changes)
        self._changed()

    def send_lookalike(self, target: int = 0) -> None:
        """One more look-alike drives across, close past a target, and away; it is gone after seven
        seconds.
        """
        self._traffic.send_lookalike(target, self.traffic_s)
        self._changed()

    def step_estimator(self, name: str, shift_n_m: Vec3, turn_rad: float) -> None:
        """Let a drone's estimate of its place and heading step, for good. The drone stays where it
        is.

        Its autopilot goes on from there: a hold or a take-off under way is flown by the new place.
        """
        row = self._rows[name]
        self._sensors.position_bias[row] += shift_n_m
        self._sensors.attitude_bias[row, 2] += turn_rad
        self._drones[name].resets += 1

    def battery(self, name: str, fraction: float) -> None:
        """Set what is left of a drone's charge, 0..1."""
        self._drones[name].autopilot.set_battery(fraction)


class World(Fleet):
    """Everything that is true of a pair, whose drones are called by their roles."""

    def __init__(self, config: WorldConfig, seed: int) -> None:
        """Raise ValueError when the objects do not fit."""
        self._snapshot: Snapshot | None = None
        homes: dict[str, HomeConfig] = {role: config.true_home(role, seed) for role in Role}
        off: dict[str, Vec3] = {Role.RECEIVER: receiver_off(config.position_offset, seed)}
        super().__init__(config, seed, homes, off)
        stand = [home.position_m for home in homes.values()]
        self._crates = self._traffic.crates(config.scene.crates, stand, seed)

    def _changed(self) -> None:
        super()._changed()
        self._snapshot = None

    def snapshot(self) -> Snapshot:
        """The truth at ``time_s``."""
        if self._snapshot is None:
            truths = self.truths()
            drones = {role: truths[role] for role in Role}
            hidden = any(map(self._hidden, drones))
            self._snapshot = self._seen(drones, self.all_objects, hidden, bool(self._no_depth))
        return self._snapshot


def receiver_off(apart: PositionOffsetConfig, seed: int) -> Vec3:
    """The constant part of the receiver's position error, NED: what it believes less what is
    true.
    """
    # after the seeds of the fleet
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(4)[3])
    angle = rng.uniform(0.0, 2.0 * math.pi)
    up = bool(rng.integers(2))
    return (
        apart.across_m * math.cos(angle), apart.across_m * math.sin(angle), -apart.height_m if up else apart.height_m
    )  # fmt: skip


def at_home(home: HomeConfig, leg_m: float) -> Array:
    """State row of a drone that stands there."""
    east, north = home.position_m
    return standing(north, east, math.radians(home.heading_deg), leg_m)


def drawn_obstacles(rig: Rig, count: int, seed: int) -> tuple[Obstacle, ...]:
    """Return the obstacles that a seed puts into a rig's world. Raises RigError."""
    config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
    return World(replace(config, obstacles=ObstaclesConfig(count)), seed).obstacles

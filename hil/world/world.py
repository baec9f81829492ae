"""The truth: two drones with their autopilots, wind, the target and its look-alikes, and the faults
of the world.

Physics runs in fixed steps on a grid of its own and the autopilots on every fourth of them, so that
how often and how finely ``advance`` is called changes nothing. Random numbers come from one stream
for each purpose: what one consumer draws never shifts another's. World frame ``w`` is ENU with its
origin on the ground, drones are reckoned in NED ``n``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from drivers.interfaces import FlightMode
from hil.autopilot.autopilot import Autopilot, Estimate
from hil.world.config import HomeConfig, PositionOffsetConfig, WorldConfig
from hil.world.detector import measured_on
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
from hil.world.rangefinder import SimRangefinder
from hil.world.snapshot import DroneTruth, Snapshot
from hil.world.targets import GroundVehicles, Point
from path.geometry.transforms import Pose
from path.messages import Quat, Role, Vec3

STEP_HZ = 200
STEPS_PER_TICK = 4
TICK_S = STEPS_PER_TICK / STEP_HZ
TELEMETRY_TICKS = 128

Name = TypeVar("Name", bound=Hashable)


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


class Fleet(Generic[Name]):
    """Drones by name with their autopilots, and the traffic on the ground.

    All is a function of the seed and of what the autopilots are told.
    """

    def __init__(
        self,
        config: WorldConfig,
        seed: int,
        homes: Mapping[Name, HomeConfig],
        off: Mapping[Name, Vec3],
    ) -> None:
        """``off``: NED errors of positions besides the estimators'. Raises ValueError when the
        objects do not fit.
        """
        self.config = config
        traffic, sensors, autopilots = np.random.SeedSequence(seed).spawn(3)
        keep_clear = [home.position_m for home in homes.values()]
        self._place_traffic(keep_clear, traffic)
        self._traffic_began_s = 0.0
        estimator = config.estimator.times(config.errors.sizes)
        self._sensors = Sensors(config.wind, estimator, TICK_S, sensors.spawn(len(homes)))
        for i, name in enumerate(homes):
            self._sensors.position_bias[i] += off.get(name, (0.0, 0.0, 0.0))
        self._airframe = config.airframe.row()
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
        self._marker_hidden = False
        self._depth_holes = False
        self.detector = config.detector or measured_on(config.target.kind, config.scene.name)
        self.time_s = 0.0
        self._sense()

    def _place_traffic(self, keep_clear: Sequence[Point], seed: np.random.SeedSequence) -> None:
        """Raise ValueError when the objects do not fit."""
        self._traffic = GroundVehicles(
            self.config.target, self.config.look_alikes, keep_clear, seed
        )

    @property
    def names(self) -> tuple[Name, ...]:
        return tuple(self._drones)

    def drone(self, name: Name) -> SimDrone:
        return self._drones[name]

    def landed(self, name: Name) -> bool:
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
        rows = self._sensors.tick(self._states).tolist()
        time_s = self._step / STEP_HZ
        altitude = self.config.altitude
        for number, (drone, row) in enumerate(zip(self._drones.values(), rows, strict=True)):
            drone.autopilot.altitude_error_m = altitude.error_m(number, time_s)
            drone.sense(time_s, row)

    def _command(self) -> None:
        self._commanded_step = self._step
        for i, drone in enumerate(self._drones.values()):
            self._commands[i] = drone.command(self._step / STEP_HZ)

    def _changed(self) -> None:
        """Drop what was worked out of the truth before it changed."""

    def truths(self) -> dict[Name, DroneTruth]:
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

    def hide_marker(self, hidden: bool) -> None:
        """Cover the markers, or uncover them."""
        self._marker_hidden = hidden
        self._changed()

    def depth_holes(self, holes: bool) -> None:
        """Let the depth cameras measure nothing on objects, or let them see again."""
        self._depth_holes = holes
        self._changed()

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
        """Let both drones' detectors be worse by some of the fields of ``DetectorConfig``."""
        self.detector = replace(self.detector, **changes)
        self._changed()

    def send_lookalike(self) -> None:
        """One more look-alike drives across, close past the target, and away; it is gone after
        seven seconds.
        """
        self._traffic.send_lookalike(self.traffic_s)
        self._changed()

    def step_estimator(self, name: Name, shift_n_m: Vec3, turn_rad: float) -> None:
        """Let a drone's estimate of its place and heading step, for good. The drone stays where it
        is.

        Its autopilot goes on from there: a hold or a take-off under way is flown by the new place.
        """
        row = self.names.index(name)
        self._sensors.position_bias[row] += shift_n_m
        self._sensors.attitude_bias[row, 2] += turn_rad
        self._drones[name].resets += 1

    def battery(self, name: Name, fraction: float) -> None:
        """Set what is left of a drone's charge, 0..1."""
        self._drones[name].autopilot.set_battery(fraction)


class World(Fleet[Role]):
    """Everything that is true of a pair."""

    def __init__(self, config: WorldConfig, seed: int) -> None:
        """Raise ValueError when the objects do not fit."""
        self._snapshot: Snapshot | None = None
        self.min_separation_m = math.inf  # of the two bodies, while both were in the air
        off = {Role.RECEIVER: receiver_off(config.position_offset, seed)}
        super().__init__(config, seed, {role: config.true_home(role, seed) for role in Role}, off)

    def _sense(self) -> None:
        super()._sense()
        if self.both_in_air:
            self.min_separation_m = min(self.min_separation_m, self.separation_m)

    def _changed(self) -> None:
        self._snapshot = None

    # --- truth ---

    @property
    def separation_m(self) -> float:
        """True distance between the two bodies."""
        sender, receiver = self._states[:, :3].tolist()
        return math.dist(sender, receiver)

    @property
    def both_in_air(self) -> bool:
        return not (self._states[0, CONTACT] or self._states[1, CONTACT])

    def snapshot(self) -> Snapshot:
        """The truth at ``time_s``."""
        if self._snapshot is None:
            objects = self._traffic.at(self.traffic_s)
            self._snapshot = Snapshot(
                self.time_s, self.truths(), objects, self._marker_hidden, self._depth_holes, self.detector,
                self.config.target.kind, self.config.target.stretch,
            )  # fmt: skip
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

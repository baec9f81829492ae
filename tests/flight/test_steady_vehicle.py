"""A vehicle whose estimator steps, as the flight above it knows it."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import pytest

from drivers.interfaces import Capability, Vehicle, VehicleState, VelocitySetpoint
from drivers.perception.history import StateHistory
from flight.config import MissionConfig
from flight.guidance import Vec3, add, scale, subtract
from flight.steady_vehicle import SteadyVehicle
from path.geometry.rotation import yaw_of
from path.messages import Quat
from tests.flight.test_estimator_steps import PERIOD_NS, states, stepped

NORTH: VelocitySetpoint = VelocitySetpoint((0.5, 0.0, 0.0), 0.1)


@dataclass
class Played:
    """A vehicle that says one state after another."""

    says: Sequence[VehicleState]
    now: int = 0
    flown: list[VelocitySetpoint] = field(default_factory=list[VelocitySetpoint])
    history: StateHistory = field(default_factory=StateHistory)
    lacks: frozenset[Capability] = frozenset({Capability.GEOFENCE})

    @property
    def state(self) -> VehicleState:
        return self.says[self.now]

    def attitude_at(self, stamp_ns: int) -> Quat:
        return self.history.attitude_at(stamp_ns)

    def fly(self, setpoint: VelocitySetpoint) -> None:
        self.flown.append(setpoint)

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        self.flown.append(first)

    def keep_geofence(self) -> str:
        return "kept"


class Watched:
    """The steady vehicle on it, with what it said of each state."""

    def __init__(self, says: Sequence[VehicleState]) -> None:
        self.played = Played(says)
        self.vehicle = SteadyVehicle(cast(Vehicle, self.played), MissionConfig())
        self.said: list[VehicleState] = []
        for k, each in enumerate(says):
            self.played.now = k
            self.played.history.add(each.stamp_ns, each.q_n_b)
            self.said.append(self.vehicle.state)


def apart_m(said: Sequence[VehicleState], true: Sequence[VehicleState]) -> float:
    return max(math.dist(a.position_n_m, b.position_n_m) for a, b in zip(said, true, strict=True))


def turned_deg(said: Sequence[VehicleState], true: Sequence[VehicleState]) -> float:
    return max(
        abs(math.degrees(yaw_of(a.q_n_b) - yaw_of(b.q_n_b)))
        for a, b in zip(said, true, strict=True)
    )


def test_without_steps_its_states_are_the_vehicles_own() -> None:
    true = states(300)
    watched = Watched(true)
    assert all(a is b for a, b in zip(watched.said, true, strict=True))
    watched.vehicle.fly(NORTH)
    assert watched.played.flown == [NORTH]


def test_states_go_on_as_if_nothing_had_stepped_however_often_it_does() -> None:
    true = states(700)
    says: Sequence[VehicleState] = true
    for at, shift, turn in (
        (200, (1.0, -0.5, 0.0), 0.3),
        (350, (0.0, 0.0, -0.8), 0.0),
        (500, (-2.0, 0.4, 0.5), -0.6),
    ):
        says = stepped(says, at, shift, turn)
    watched = Watched(says)
    assert len(watched.vehicle.steps) == 3
    assert apart_m(watched.said, true) < 0.1
    assert turned_deg(watched.said, true) < 1.5
    assert all(
        a.velocity_n_mps == b.velocity_n_mps for a, b in zip(watched.said, true, strict=True)
    )


def walking(made: Sequence[VehicleState], sigma_m: float, time_s: float) -> list[VehicleState]:
    """The same, but for a position that walks as an Ornstein-Uhlenbeck process."""
    rng = random.Random(7)
    every_s = (made[1].stamp_ns - made[0].stamp_ns) * 1e-9
    decay = math.exp(-every_s / time_s)
    drive_m = sigma_m * math.sqrt(1.0 - decay**2)
    off: Vec3 = (0.0, 0.0, 0.0)
    walked: list[VehicleState] = []
    for each in made:
        new = (rng.gauss(0.0, drive_m), rng.gauss(0.0, drive_m), rng.gauss(0.0, drive_m))
        off = add(scale(off, decay), new)
        walked.append(replace(each, position_n_m=add(each.position_n_m, off)))
    return walked


def unexplained_m(said: Sequence[VehicleState], true: Sequence[VehicleState]) -> float:
    """How far what is said moves from one state to the next without the vehicle: root mean square
    of the last half."""
    off = [subtract(a.position_n_m, b.position_n_m) for a, b in zip(said, true, strict=True)]
    half = off[len(off) // 2 :]
    moves = [math.dist(a, b) for a, b in itertools.pairwise(half)]
    return math.sqrt(sum(each**2 for each in moves) / len(moves))


@pytest.mark.parametrize("period_ns", [PERIOD_NS, 5 * PERIOD_NS, 10 * PERIOD_NS])
def test_a_position_that_walks_is_no_motion_of_the_vehicle(period_ns: int) -> None:
    true = states(1000, period_ns=period_ns)
    says = walking(true, 2.0, 60.0)
    watched = Watched(says)
    assert unexplained_m(watched.said, true) < 0.3 * unexplained_m(says, true)
    for raw, said in zip(says[-3:], watched.said[-3:], strict=True):
        assert said.velocity_n_mps == raw.velocity_n_mps
    reported = watched.vehicle.as_reported(watched.said[-1].position_n_m)
    assert reported == pytest.approx(says[-1].position_n_m)


def test_a_position_that_drifts_as_usual_is_followed_as_it_is() -> None:
    """Nothing is taken out of a GPS that walks half a metre within twenty minutes."""
    says = walking(states(1000), 0.5, 1200.0)
    watched = Watched(says)
    assert all(a is b for a, b in zip(watched.said, says, strict=True))


def test_telemetry_that_comes_late_is_no_walk() -> None:
    """For four states it stands still, and leaps then."""
    true = states(1000)
    says = [replace(each, position_n_m=true[k - k % 4].position_n_m) for k, each in enumerate(true)]
    assert apart_m(Watched(says).said, says) == 0.0


def test_a_place_is_told_to_others_as_the_autopilot_has_it() -> None:
    shift: Vec3 = (1.0, -0.5, -0.7)
    watched = Watched(stepped(states(400), 200, shift))
    assert watched.vehicle.as_reported((2.0, 2.0, -2.0)) == pytest.approx(
        (3.0, 1.5, -2.7), abs=0.05
    )


@pytest.mark.parametrize("turn_deg", [20.0, -40.0])
def test_a_heading_is_commanded_as_the_autopilot_has_it_and_a_velocity_as_it_is(
    turn_deg: float,
) -> None:
    watched = Watched(stepped(states(400), 200, (0.0, 0.0, 0.0), math.radians(turn_deg)))
    watched.vehicle.fly(NORTH)
    (sent,) = watched.played.flown
    assert sent.velocity_n_mps == NORTH.velocity_n_mps
    assert math.degrees(sent.yaw_rad - NORTH.yaw_rad) == pytest.approx(turn_deg, abs=1.0)


def test_the_attitude_of_a_frame_is_without_the_step_before_in_and_after_it() -> None:
    true = states(400, turning_rps=0.5)
    watched = Watched(stepped(true, 200, (0.0, 0.0, 0.0), math.radians(30.0)))
    own = StateHistory()
    for each in true:
        own.add(each.stamp_ns, each.q_n_b)
    step_ns = true[200].stamp_ns
    for stamp_ns in range(step_ns - 3 * PERIOD_NS, step_ns + 3 * PERIOD_NS, PERIOD_NS // 4):
        off_rad = yaw_of(watched.vehicle.attitude_at(stamp_ns)) - yaw_of(own.attitude_at(stamp_ns))
        assert abs(math.degrees(off_rad)) < 1.0, stamp_ns


def test_an_attitude_that_is_asked_for_looks_at_what_has_come_since() -> None:
    true = states(201)
    says = stepped(true, 200, (0.0, 0.0, 0.0), math.radians(30.0))
    watched = Watched(says[:200])
    watched.played.says = says
    watched.played.now = 200
    watched.played.history.add(says[200].stamp_ns, says[200].q_n_b)
    off_rad = yaw_of(watched.vehicle.attitude_at(says[200].stamp_ns)) - yaw_of(true[200].q_n_b)
    assert abs(math.degrees(off_rad)) < 1.0


def test_back_on_the_ground_a_height_counts_from_there() -> None:
    says = stepped(states(400), 200, (0.0, 0.0, 1.0))
    down = [replace(each, armed=False, in_air=False) for each in says[390:]]
    watched = Watched([*says[:390], *down])
    assert watched.said[389].position_n_m[2] == pytest.approx(
        says[389].position_n_m[2] - 1.0, abs=0.05
    )
    assert watched.said[-1].position_n_m[2] == says[399].position_n_m[2]


def test_what_only_some_vehicles_can_do_is_still_there() -> None:
    vehicle: Any = Watched(states(5)).vehicle
    assert vehicle.keep_geofence() == "kept"
    assert vehicle.lacks == {Capability.GEOFENCE}
    assert vehicle.ignored == {}
    assert getattr(vehicle, "examine", None) is None


def test_a_vehicle_is_made_steady_once() -> None:
    vehicle = Watched(states(5)).vehicle
    assert SteadyVehicle.of(vehicle, MissionConfig()) is vehicle

"""The quadrotor: it tilts to move, stands against wind, follows commands, and stops at the
ground.
"""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.world.dynamics import (
    ATTITUDE,
    CONTACT,
    GRAVITY_MPS2,
    MOTORS_FLY,
    MOTORS_IDLE,
    MOTORS_OFF,
    POSITION,
    RATES,
    ROTOR_PHASE,
    THRUST,
    VELOCITY,
    AirframeConfig,
    fly,
    standing,
)
from path.geometry.rotation import R_from_quat, rpy_from_quat

DT = 0.005
CONFIG = AirframeConfig()
Array = NDArray[np.float64]


class Drone:
    """One drone under a command."""

    def __init__(self, height_m: float = 0.0, yaw: float = 0.0) -> None:
        self.states = standing(0.0, 0.0, yaw, CONFIG.leg_m)[np.newaxis].copy()
        self.command = np.zeros((1, 5))
        self.wind = np.zeros((1, 3))
        self.push = np.zeros((1, 3))
        self.velocity_error = np.zeros((1, 3))
        self.attitude_error = np.zeros((1, 3))
        self.told_yaw = yaw
        if height_m:
            self.states[0, 2] = -height_m
            self.states[0, THRUST] = GRAVITY_MPS2
            self.states[0, CONTACT] = 0.0

    def go(
        self,
        seconds: float,
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        motors: float = MOTORS_FLY,
    ) -> Array:
        """The states at every step, shape (steps, STATE_SIZE)."""
        self.command[0] = (motors, *velocity, self.told_yaw)
        rows: list[Array] = []
        for _ in range(round(seconds / DT)):
            self.step(1)
            rows.append(self.states[0].copy())
        return np.array(rows)

    def step(self, steps: int) -> None:
        errors = self.velocity_error, self.attitude_error
        fly(self.states, self.command, self.wind, self.push, *errors, CONFIG.row(), DT, steps)

    @property
    def rpy_deg(self) -> tuple[float, float, float]:
        roll, pitch, yaw = (
            math.degrees(angle) for angle in rpy_from_quat(tuple(self.states[0, ATTITUDE].tolist()))
        )
        return roll, pitch, yaw


def test_a_step_of_velocity_is_reached_in_about_a_second_and_hardly_passed() -> None:
    drone = Drone(5.0)
    drone.go(2.0)
    north = drone.go(4.0, (1.0, 0.0, 0.0))[:, VELOCITY][:, 0]
    rise_s = (int(np.argmax(north > 0.9)) - int(np.argmax(north > 0.1))) * DT
    assert 0.3 < rise_s < 1.2
    assert north.max() < 1.12
    assert north[-1] == pytest.approx(1.0, abs=0.03)


def test_it_tilts_into_an_acceleration_and_back() -> None:
    drone = Drone(5.0)
    drone.go(1.0)
    rows = drone.go(3.0, (2.0, 0.0, 0.0))
    pitch = np.array([rpy_from_quat(tuple(row))[1] for row in rows[:, ATTITUDE].tolist()])
    assert math.degrees(pitch.min()) < -10.0  # nose down to go north
    assert math.degrees(pitch.max()) > -5.0
    drone.go(3.0, (2.0, 0.0, 0.0))
    drag_tilt = math.degrees(math.atan(CONFIG.drag_hz * 2.0 / GRAVITY_MPS2))
    assert drone.rpy_deg[1] == pytest.approx(-drag_tilt, abs=0.3)


def test_tilt_is_limited() -> None:
    rows = Drone(5.0).go(3.0, (50.0, 0.0, 0.0))
    tilt = np.array(
        [math.acos(R_from_quat(tuple(row))[2, 2]) for row in rows[:, ATTITUDE].tolist()]
    )
    limit = math.atan(CONFIG.max_horizontal_mps2 / (GRAVITY_MPS2 - 0.5))
    assert math.degrees(tilt.max()) < math.degrees(limit) + 4.0


def test_it_leans_into_a_steady_wind_and_stays() -> None:
    drone = Drone(5.0)
    drone.wind[0] = (-4.0, 0.0, 0.0)  # from the north
    drone.go(12.0)
    late = drone.go(2.0)
    assert np.abs(late[:, VELOCITY]).max() < 0.02
    assert drone.rpy_deg[1] == pytest.approx(
        -math.degrees(math.atan(CONFIG.drag_hz * 4.0 / GRAVITY_MPS2)), abs=0.2
    )


def test_a_push_from_above_sinks_it_at_first_and_is_stood_against_then() -> None:
    drone = Drone(5.0)
    drone.push[0] = (0.0, 0.0, 2.0)
    sinking = drone.go(8.0)
    assert 0.2 < sinking[:, VELOCITY][:, 2].max() < 1.0
    late = drone.go(1.0)
    assert np.abs(late[:, VELOCITY]).max() < 0.05
    assert late[-1, THRUST] == pytest.approx(GRAVITY_MPS2 + 2.0, abs=0.1)


def test_the_wrong_level_of_the_estimator_is_flown_but_does_not_drift() -> None:
    drone = Drone(5.0)
    drone.attitude_error[0] = (math.radians(1.0), 0.0, 0.0)
    drone.go(10.0)
    assert np.abs(drone.states[0, VELOCITY]).max() < 0.02
    # truly level: the loop tilts against the error
    assert drone.rpy_deg[0] == pytest.approx(0.0, abs=0.05)


def test_velocity_errors_of_the_estimator_become_drift() -> None:
    drone = Drone(5.0)
    drone.velocity_error[0] = (0.0, 0.0, 0.1)
    drone.go(5.0)
    assert drone.states[0, VELOCITY][2] == pytest.approx(-0.1, abs=0.005)


def test_the_heading_follows_at_the_yaw_rate_and_the_short_way() -> None:
    drone = Drone(5.0, yaw=math.radians(170.0))
    drone.go(1.0)
    drone.told_yaw = math.radians(-170.0)
    rows = drone.go(2.0)
    assert rows[:, RATES][:, 2].max() < math.radians(CONFIG.max_yaw_rate_dps) * 1.1
    assert rows[:, RATES][:, 2].min() > -0.2
    assert drone.rpy_deg[2] == pytest.approx(-170.0, abs=0.5)
    assert np.abs(rows[:, VELOCITY]).max() < 0.05


def test_height_is_kept_while_flying_fast() -> None:
    drone = Drone(5.0)
    drone.go(1.0)
    rows = drone.go(5.0, (2.0, 2.0, 0.0))
    assert np.abs(rows[:, POSITION][:, 2] + 5.0).max() < 0.2


def test_it_stands_until_it_lifts_off_and_stops_at_the_ground() -> None:
    drone = Drone(yaw=0.5)
    drone.wind[0] = (8.0, 0.0, 0.0)
    assert (drone.go(1.0, motors=MOTORS_OFF)[:, CONTACT] == 1.0).all()
    idle = drone.go(1.0, motors=MOTORS_IDLE)
    assert (idle[:, CONTACT] == 1.0).all()
    assert np.array_equal(idle[-1, POSITION], [0.0, 0.0, -CONFIG.leg_m])
    assert np.ptp(idle[:, ROTOR_PHASE]) > 0.0
    drone.go(2.0, (0.0, 0.0, -1.0))
    assert drone.states[0, CONTACT] == 0.0
    assert drone.states[0, 2] < -1.0
    drone.go(6.0, (0.0, 0.0, 0.7))
    assert drone.states[0, CONTACT] == 1.0
    assert drone.states[0, 2] == -CONFIG.leg_m
    assert drone.rpy_deg[:2] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_many_steps_in_one_call_are_many_calls_of_one_step() -> None:
    one, other = Drone(2.0), Drone(2.0)
    one.go(0.5, (1.0, 0.5, -0.2))
    other.command[0] = (MOTORS_FLY, 1.0, 0.5, -0.2, 0.0)
    other.step(100)
    assert np.array_equal(one.states, other.states)


def test_refuses_an_airframe_that_cannot_fly() -> None:
    with pytest.raises(ValueError, match="max_thrust_g"):
        AirframeConfig(max_thrust_g=0.9)

"""A quadrotor: velocity command -> acceleration -> attitude and thrust -> motion, in local NED.

The attitude follows its set point as a damped second-order system and the thrust with a lag, so the
drone must tilt to accelerate or to stand against wind, as a camera on it sees. Drag grows linearly
with the speed through the air (rotor drag). One row of ``states`` is one drone; the columns are the
slices below.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from path.arrays import Array
from path.bounds import Bounds, check_bounds
from path.compiled import inner, kernel
from path.messages import Quat

Parameters = tuple[float, ...]

# Columns of a state row.
POSITION = slice(0, 3)  # N, E, D in m
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 10)  # wxyz, body FRD to NED
RATES = slice(10, 13)  # rad/s, body
THRUST = 13  # specific, m/s^2, along -z of the body
INTEGRAL = slice(14, 17)  # of the velocity loop, m/s^2
YAW_GOAL = 17  # the commanded heading, slewed
ROTOR_PHASE = 18
CONTACT = 19  # 1 while the legs stand on the ground
STATE_SIZE = 20

# Columns of a command row: what the motors may do, velocity NED, yaw.
MOTORS = 0
MOTORS_OFF = 0.0
MOTORS_IDLE = 1.0
MOTORS_FLY = 2.0
COMMAND_SIZE = 5

GRAVITY_MPS2 = 9.80665
IDLE_THRUST = 1.0  # m/s^2
MAX_INTEGRAL = 3.0  # m/s^2: wind of about 8 m/s
HOVER_TURN_RATE = 380.0  # rad/s of the drawn rotors at hover


@dataclass(frozen=True, slots=True)
class AirframeConfig:
    """A 1.5 kg quadrotor with a well tuned, not aggressive, velocity loop. The order is the one
    ``fly`` unpacks.
    """

    gain_horizontal_hz: Annotated[float, Bounds(0.1, 50.0)] = 2.5
    integral_horizontal_hz2: Annotated[float, Bounds(0.0, 50.0)] = 0.8
    gain_vertical_hz: Annotated[float, Bounds(0.1, 50.0)] = 4.0
    integral_vertical_hz2: Annotated[float, Bounds(0.0, 50.0)] = 2.0
    max_horizontal_mps2: Annotated[float, Bounds(0.1, 50.0)] = 3.5
    max_vertical_mps2: Annotated[float, Bounds(0.1, 50.0)] = 4.0
    # natural frequency of roll and pitch
    attitude_radps: Annotated[float, Bounds(1.0, 100.0)] = 14.0
    yaw_radps: Annotated[float, Bounds(0.5, 100.0)] = 5.0
    damping: Annotated[float, Bounds(0.1, 5.0, "of 1")] = 0.85
    max_yaw_rate_dps: Annotated[float, Bounds(1.0, 720.0)] = 60.0
    thrust_lag_s: Annotated[float, Bounds(0.0, 2.0, above=True)] = 0.04
    drag_hz: Annotated[float, Bounds(0.0, 20.0)] = 0.3
    max_thrust_g: Annotated[float, Bounds(1.0, 20.0, above=True)] = 2.0
    leg_m: Annotated[float, Bounds(0.0, 2.0)] = 0.1  # body origin above the ground when landed

    def __post_init__(self) -> None:
        check_bounds(self)

    def row(self) -> tuple[float, ...]:
        """The parameters as ``fly`` takes them."""
        return tuple(float(getattr(self, name)) for name in self.__slots__)


def standing(north_m: float, east_m: float, yaw_rad: float, leg_m: float) -> Array:
    """State row of a drone standing on the ground (D = 0), motors off."""
    row = np.zeros(STATE_SIZE)
    row[POSITION] = (north_m, east_m, -leg_m)
    row[ATTITUDE] = (math.cos(yaw_rad / 2.0), 0.0, 0.0, math.sin(yaw_rad / 2.0))
    row[YAW_GOAL] = yaw_rad
    row[CONTACT] = 1.0
    return row


@inner
def _clamp(value: float, low: float, high: float) -> float:
    return min(high, max(low, value))


@inner
def _wanted_force(
    s: Array, c: Array, velocity_error: Array, p: Parameters, dt: float
) -> tuple[float, float, float]:
    """Specific force (thrust direction and size, NED) that the velocity loop asks for; advances its
    integral.
    """
    ex = c[1] - s[3] - velocity_error[0]
    ey = c[2] - s[4] - velocity_error[1]
    ez = c[3] - s[5] - velocity_error[2]
    ax = p[0] * ex + s[14]
    ay = p[0] * ey + s[15]
    az = p[2] * ez + s[16]
    size = math.hypot(ax, ay)
    if size > p[4]:
        ax = ax * p[4] / size
        ay = ay * p[4] / size
    else:  # an integral that grows while the loop is saturated overshoots
        s[14] = _clamp(s[14] + p[1] * ex * dt, -MAX_INTEGRAL, MAX_INTEGRAL)
        s[15] = _clamp(s[15] + p[1] * ey * dt, -MAX_INTEGRAL, MAX_INTEGRAL)
    if abs(az) > p[5]:
        az = math.copysign(p[5], az)
    else:
        s[16] = _clamp(s[16] + p[3] * ez * dt, -MAX_INTEGRAL, MAX_INTEGRAL)
    return ax, ay, az - GRAVITY_MPS2


@inner
def _wanted_attitude(fx: float, fy: float, fz: float, yaw: float) -> Quat:
    """Quaternion whose body z points against the force and whose nose is at ``yaw``: tilt after
    yaw.
    """
    size = math.sqrt(fx * fx + fy * fy + fz * fz)
    zx = -fx / size
    zy = -fy / size
    zz = -fz / size
    # Shortest rotation from the vertical to z: axis (-zy, zx, 0), angle acos(zz); half-angle form.
    w = math.sqrt(0.5 * (1.0 + zz))
    tx = -0.5 * zy / w
    ty = 0.5 * zx / w
    cy = math.cos(0.5 * yaw)
    sy = math.sin(0.5 * yaw)
    return w * cy, tx * cy + ty * sy, ty * cy - tx * sy, w * sy


@inner
def _turn(s: Array, goal: Quat, attitude_error: Array, p: Parameters, dt: float) -> None:
    """Second-order response of the attitude to the goal; integrates rates and quaternion."""
    w = s[6]
    x = s[7]
    y = s[8]
    z = s[9]
    gw, gx, gy, gz = goal
    ew = w * gw + x * gx + y * gy + z * gz
    ex = w * gx - x * gw - y * gz + z * gy
    ey = w * gy + x * gz - y * gw - z * gx
    ez = w * gz - x * gy + y * gx - z * gw
    sign = 2.0 if ew >= 0.0 else -2.0
    tilt2 = p[6] * p[6]
    yaw2 = p[7] * p[7]
    damping = 2.0 * p[8]
    s[10] += (tilt2 * (sign * ex - attitude_error[0]) - damping * p[6] * s[10]) * dt
    s[11] += (tilt2 * (sign * ey - attitude_error[1]) - damping * p[6] * s[11]) * dt
    s[12] += (yaw2 * (sign * ez - attitude_error[2]) - damping * p[7] * s[12]) * dt
    hx = 0.5 * dt * s[10]
    hy = 0.5 * dt * s[11]
    hz = 0.5 * dt * s[12]
    nw = w - x * hx - y * hy - z * hz
    nx = x + w * hx + y * hz - z * hy
    ny = y + w * hy + z * hx - x * hz
    nz = z + w * hz + x * hy - y * hx
    scale = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    s[6], s[7], s[8], s[9] = nw * scale, nx * scale, ny * scale, nz * scale


@inner
def _move(s: Array, wind: Array, push: Array, p: Parameters, dt: float) -> None:
    """Thrust, gravity and drag move the drone; the ground stops it."""
    w = s[6]
    x = s[7]
    y = s[8]
    z = s[9]
    thrust = s[13]
    loose = 1.0 - s[19]  # legs on the ground hold against wind
    drag = p[11] * loose
    ax = -thrust * 2.0 * (x * z + w * y) - drag * (s[3] - wind[0]) + loose * push[0]
    ay = -thrust * 2.0 * (y * z - w * x) - drag * (s[4] - wind[1]) + loose * push[1]
    az = GRAVITY_MPS2 - thrust * (1.0 - 2.0 * (x * x + y * y)) - drag * (s[5] - wind[2])
    az += loose * push[2]
    s[3], s[4], s[5] = s[3] + ax * dt, s[4] + ay * dt, s[5] + az * dt
    s[0], s[1], s[2] = s[0] + s[3] * dt, s[1] + s[4] * dt, s[2] + s[5] * dt
    s[19] = 0.0
    if s[2] >= -p[13] and s[5] >= 0.0:
        s[19] = 1.0
        s[2] = -p[13]
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        s[6], s[7], s[8], s[9] = math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)
        s[3:6] = 0.0
        s[10:13] = 0.0
        s[14:17] = 0.0
        s[17] = yaw


@inner
def _substep(
    s: Array,
    c: Array,
    wind: Array,
    push: Array,
    velocity_error: Array,
    attitude_error: Array,
    p: Parameters,
    dt: float,
) -> None:
    if c[0] == MOTORS_FLY:
        fx, fy, fz = _wanted_force(s, c, velocity_error, p, dt)
        step = math.radians(p[9]) * dt
        turn = c[4] - s[17]
        turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
        s[17] += _clamp(turn, -step, step)
        goal = _wanted_attitude(fx, fy, fz, s[17])
        w = s[6]
        x = s[7]
        y = s[8]
        z = s[9]
        along = -(
            fx * 2.0 * (x * z + w * y)
            + fy * 2.0 * (y * z - w * x)
            + fz * (1.0 - 2.0 * (x * x + y * y))
        )
        wanted = _clamp(along, IDLE_THRUST, p[12] * GRAVITY_MPS2)
        _turn(s, goal, attitude_error, p, dt)
    else:
        wanted = IDLE_THRUST if c[0] == MOTORS_IDLE else 0.0
    s[13] += (wanted - s[13]) * dt / p[10]
    s[18] = (s[18] + HOVER_TURN_RATE * math.sqrt(max(s[13], 0.0) / GRAVITY_MPS2) * dt) % (
        2.0 * math.pi
    )
    _move(s, wind, push, p, dt)


@kernel
def fly(
    states: Array,
    commands: Array,
    winds: Array,
    pushes: Array,
    velocity_errors: Array,
    attitude_errors: Array,
    parameters: Parameters,
    dt: float,
    steps: int,
) -> None:
    """Advance every drone by ``steps`` of ``dt`` seconds, in place.

    Args:
        states: (n, STATE_SIZE) rows.
        commands: (n, COMMAND_SIZE) rows, constant over the call.
        winds: (n, 3) air velocity at the drone, NED m/s.
        pushes: (n, 3) by the air of others besides, NED m/s^2.
        velocity_errors: (n, 3) estimated minus true velocity: the loop follows what the estimator
            says.
        attitude_errors: (n, 3) estimated against true attitude, rotation vector in the body frame,
            rad.
        parameters: ``AirframeConfig.row()``.
    """
    for i in range(states.shape[0]):
        for _ in range(steps):
            _substep(
                states[i],
                commands[i],
                winds[i],
                pushes[i],
                velocity_errors[i],
                attitude_errors[i],
                parameters,
                dt,
            )


@kernel
def poses_w(states: Array, late_s: float, out: Array) -> None:
    """Poses of all drones in ENU (rows of ``R_w_b``, then ``t_w``), ``late_s`` after their state
    (less than a step).

    Args:
        out: (n, 12), written.
    """
    for i in range(states.shape[0]):
        s = states[i]
        row = out[i]
        half = 0.5 * max(late_s, 0.0)
        p = half * s[10]
        q = half * s[11]
        r = half * s[12]
        w = s[6] - s[7] * p - s[8] * q - s[9] * r
        x = s[7] + s[6] * p + s[8] * r - s[9] * q
        y = s[8] + s[6] * q - s[7] * r + s[9] * p
        z = s[9] + s[6] * r + s[7] * q - s[8] * p
        scale = 2.0 / (w * w + x * x + y * y + z * z)
        row[0], row[1], row[2] = (
            scale * (x * y + w * z),
            1.0 - scale * (x * x + z * z),
            scale * (y * z - w * x),
        )
        row[3], row[4], row[5] = (
            1.0 - scale * (y * y + z * z),
            scale * (x * y - w * z),
            scale * (x * z + w * y),
        )
        row[6], row[7], row[8] = (
            scale * (w * y - x * z),
            -scale * (y * z + w * x),
            scale * (x * x + y * y) - 1.0,
        )
        row[9] = s[1] + 2.0 * half * s[4]
        row[10] = s[0] + 2.0 * half * s[3]
        row[11] = -(s[2] + 2.0 * half * s[5])

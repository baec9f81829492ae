"""A Tello's state, ten times a second, and its place from that: whole degrees, decimetres a second,
no position.

Axes are those of the SDK: x forward, y right, z down at the heading in which the drone was switched
on (``vgx vgy vgz``, dm/s); pitch is positive nose up, roll right side down, yaw clockwise from that
heading; ``h``, ``tof`` are cm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, TypeGuard

from path.messages import Quat, Vec3
from path.values import frozen

# of each field that is needed, in its own unit: beyond is no measurement
MOST: dict[str, tuple[float, float]] = {
    "pitch": (-360.0, 360.0), "roll": (-360.0, 360.0), "yaw": (-360.0, 360.0),
    "vgx": (-1e3, 1e3), "vgy": (-1e3, 1e3), "vgz": (-1e3, 1e3),
    "tof": (-1e5, 1e5), "h": (-1e5, 1e5), "bat": (0.0, 100.0), "time": (0.0, 1e6),
}  # fmt: skip
# 10 cm is what it says when it stands; beyond the other it sees nothing
TOF_FLOOR_M = 0.11
TOF_CEILING_M = 6.0
TOF_SHARE = 0.3  # of the difference between the rangefinder and the height reckoned, each packet
TOF_JUMP_M = 0.35  # more than that at once is something below it, not its height
LONGEST_STEP_S = 0.5

VelocityFrame = Literal["start", "body"]


@frozen
class TelloReport:
    """One state packet. Angles rad, ``velocity_mps`` in the drone's axes (see the module), heights
    above the ground.
    """

    arrival_ns: int
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    velocity_mps: Vec3
    tof_m: float
    height_m: float
    battery: float
    motors_s: int
    hottest_c: float


def read_report(fields: Mapping[str, object], arrival_ns: int) -> TelloReport | None:
    """Return a packet that djitellopy parsed; None when what is needed is missing, no number or
    beyond any range.

    Never raises: it runs on the one thread that receives for all drones.
    """
    values: dict[str, float] = {}
    for name, (least, most) in MOST.items():
        value = fields.get(name)
        if not _within(value, least, most):
            return None
        values[name] = float(value)
    hottest = fields.get("temph")
    return TelloReport(
        arrival_ns,
        math.radians(values["roll"]),
        math.radians(values["pitch"]),
        math.radians(values["yaw"]),
        (0.1 * values["vgx"], 0.1 * values["vgy"], 0.1 * values["vgz"]),
        0.01 * values["tof"],
        0.01 * values["h"],
        0.01 * values["bat"],
        int(values["time"]),
        float(hottest) if _within(hottest, -300.0, 300.0) else 0.0,
    )


def _within(
    value: object,
    least: float,
    most: float,
) -> TypeGuard[int | float]:
    """Return whether this is a number within bounds; a comparison bears integers that are too long
    for a float.
    """
    return (
        isinstance(value, (int, float)) and not isinstance(value, bool) and least <= value <= most
    )


def quaternion(
    roll_rad: float,
    pitch_rad: float,
    yaw_rad: float,
) -> Quat:
    """Body FRD to NED, wxyz, from yaw, then pitch, then roll."""
    cr = math.cos(roll_rad / 2.0)
    sr = math.sin(roll_rad / 2.0)
    cp = math.cos(pitch_rad / 2.0)
    sp = math.sin(pitch_rad / 2.0)
    cy = math.cos(yaw_rad / 2.0)
    sy = math.sin(yaw_rad / 2.0)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


@frozen
class Placement:
    """The place of the drone when it is connected: north and east of the mission's origin in m, and
    its heading.

    ``*_sigma``: how well whoever put it there did.
    """

    north_m: float
    east_m: float
    heading_rad: float
    position_sigma_m: float
    velocity_sigma_mps: float


class DeadReckoning:
    """Position in NED from the velocities reported, starting where the drone was put; height from
    the rangefinder.
    """

    def __init__(self, placement: Placement, frame: VelocityFrame) -> None:
        self._placement = placement
        self._frame = frame
        self._last: TelloReport | None = None
        self._yaw0_rad = 0.0
        self._flown_s = 0.0
        self.north_m = placement.north_m
        self.east_m = placement.east_m
        self.height_m = 0.0
        self.velocity_n_mps: Vec3 = (0.0, 0.0, 0.0)

    @property
    def heading_rad(self) -> float:
        """The heading of the nose, clockwise from north."""
        yaw = self._last.yaw_rad - self._yaw0_rad if self._last is not None else 0.0
        return self._placement.heading_rad + yaw

    @property
    def position_n_m(self) -> Vec3:
        return self.north_m, self.east_m, -self.height_m

    @property
    def position_sigma_m(self) -> float:
        """Horizontal standard deviation per axis: the placement's, and what a constant velocity
        error made of it.
        """
        return math.hypot(
            self._placement.position_sigma_m, self._placement.velocity_sigma_mps * self._flown_s
        )

    def add(self, report: TelloReport) -> None:
        """Take in the next packet. Standing on the ground, it stays where it is."""
        last = self._last
        if last is None:
            self._yaw0_rad = report.yaw_rad
        self._last = report
        turn = (
            self._placement.heading_rad - self._yaw0_rad
            if self._frame == "start"
            else self.heading_rad
        )
        c = math.cos(turn)
        s = math.sin(turn)
        x, y, down = report.velocity_mps
        velocity = (c * x - s * y, s * x + c * y, down)
        dt = (
            min((report.arrival_ns - last.arrival_ns) * 1e-9, LONGEST_STEP_S)
            if last is not None
            else 0.0
        )
        north, east, _ = self.velocity_n_mps
        standing = report.height_m <= 0.0 and report.tof_m < TOF_FLOOR_M
        if not standing:
            self.north_m += 0.5 * dt * (north + velocity[0])
            self.east_m += 0.5 * dt * (east + velocity[1])
            self._flown_s += dt
        self.height_m = 0.0 if standing else self._height(report, dt)
        self.velocity_n_mps = velocity

    def _height(self, report: TelloReport, dt: float) -> float:
        """The rangefinder, smoothed by the climb rate; what jumps is not the ground that it took
        off from.
        """
        reckoned = self.height_m - report.velocity_mps[2] * dt
        if TOF_FLOOR_M <= report.tof_m <= TOF_CEILING_M:
            measured = report.tof_m * math.cos(report.roll_rad) * math.cos(report.pitch_rad)
            if abs(measured - reckoned) < TOF_JUMP_M:
                return reckoned + TOF_SHARE * (measured - reckoned)
        return reckoned + 0.1 * (report.height_m - reckoned)

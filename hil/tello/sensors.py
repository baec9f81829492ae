"""The words of an emulated Tello: its state packets and the answers to queries, rounded as the real
one's.
"""

from __future__ import annotations

import math

from hil.world.world import SimDrone
from path.geometry.rotation import rpy_from_quat, wrapped

STANDING_CM = 10  # what the rangefinder says on the ground
BARO_M = 150.0  # above the sea, of the ground


class TelloSensors:
    """One drone's. ``home_yaw_rad``: the heading in which it was switched on, its yaw of zero.

    Attributes:
        ground_d_m: where it took off, by its own estimate.
        motors_s: how long its motors have run.
    """

    def __init__(self, drone: SimDrone, home_yaw_rad: float) -> None:
        self._drone = drone
        self._home_yaw_rad = home_yaw_rad
        self.ground_d_m = 0.0
        self.motors_s = 0.0

    def state_text(self) -> str:
        """One state packet, as of now."""
        drone = self._drone
        roll, pitch, yaw = self.attitude_deg()
        c = math.cos(self._home_yaw_rad)
        s = math.sin(self._home_yaw_rad)
        vn, ve, vd = drone.estimate.velocity_n_mps
        x, y, z = (round(10.0 * v) for v in (c * vn + s * ve, c * ve - s * vn, vd))
        height_cm = 10 * self._height_dm() if drone.autopilot.armed else 0
        return (
            f"mid:-1;x:-100;y:-100;z:-100;mpry:0,0,0;pitch:{pitch};roll:{roll};yaw:{yaw};vgx:{x};vgy:{y};vgz:{z};"
            f"templ:65;temph:67;tof:{self._tof_cm()};h:{height_cm};bat:{self._battery()};"
            f"baro:{self._baro_m():.2f};time:{int(self.motors_s)};agx:0.00;agy:0.00;agz:-1000.00;\r\n"
        )

    def answers(self) -> dict[str, str]:
        """Return the answers to the queries about the drone itself."""
        roll, pitch, yaw = self.attitude_deg()
        return {
            "battery?": f"{self._battery()}",
            "time?": f"{int(self.motors_s)}s",
            "height?": f"{self._height_dm()}dm",
            "temp?": "65~67C",
            "attitude?": f"pitch:{pitch};roll:{roll};yaw:{yaw};",
            "baro?": f"{self._baro_m():.6f}",
            "tof?": f"{10 * self._tof_cm()}mm",
            "wifi?": "90",
        }

    def attitude_deg(self) -> tuple[int, int, int]:
        """Roll, pitch and yaw in whole degrees; yaw from where the nose was when it was switched
        on.
        """
        roll, pitch, yaw = rpy_from_quat(self._drone.estimate.q_n_b)
        roll_deg, pitch_deg, yaw_deg = map(
            math.degrees, (roll, pitch, wrapped(yaw - self._home_yaw_rad))
        )
        return round(roll_deg), round(pitch_deg), round(yaw_deg)

    def _battery(self) -> int:
        return round(100 * self._drone.autopilot.battery)

    def _height_dm(self) -> int:
        return round(10.0 * (self.ground_d_m - self._drone.estimate.position_n_m[2]))

    def _tof_cm(self) -> int:
        """Down to flat ground, along its own axis."""
        _, x, y, _ = self._drone.true_q_n_b
        upright = 1.0 - 2.0 * (x * x + y * y)
        return max(
            STANDING_CM, round(-100.0 * self._drone.true_position_n_m[2] / max(upright, 0.5))
        )

    def _baro_m(self) -> float:
        return BARO_M - self._drone.estimate.position_n_m[2]

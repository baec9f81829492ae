"""Positions of a beacon as external vision of an autopilot that has no GPS:
VISION_POSITION_ESTIMATE, once each.
"""

from __future__ import annotations

import logging
import math

import numpy as np

from drivers.interfaces import BeaconError, BeaconFix, Beacons
from drivers.mavlink.modes import PX4, AutopilotKind
from drivers.mavlink.session import MavsdkSession
from drivers.mavlink.telemetry import TelemetrySlots
from drivers.mavlink.vehicle_config import VisionConfig
from drivers.rig.parts import Origin, PartContext, create
from path.geometry.rotation import R_from_quat
from path.messages import Vec3

READ_S = 1.0
# for so long the estimator has to stand still
REST_S = 3.0
REST_MPS = 0.2
COVARIANCES = 21  # the upper triangle of six by six, by rows
POSITION_VARIANCES = (0, 6, 11)
ANGLE_VARIANCES = (15, 18, 20)

_log = logging.getLogger(__name__)


def beacon_in_n(place_m: Vec3, config: VisionConfig) -> Vec3:
    """A place in the beacons' frame (z up) in the mission's frame, NED."""
    x, y, z = place_m
    c = math.cos(math.radians(config.x_heading_deg))
    s = math.sin(math.radians(config.x_heading_deg))
    north_m, east_m, down_m = config.zero_n_m
    return north_m + x * c + y * s, east_m + x * s - y * c, down_m - z


class VisionFeed:
    """Passes positions on until it is cancelled. The autopilot's own failsafe acts when they stop.

    Attributes:
        sent: positions passed on.
        origin_sent: whether the autopilot was told where on earth its zero is: only after it has
            begun to use the positions and has come to rest on them.
    """

    def __init__(
        self,
        config: VisionConfig,
        context: PartContext,
        session: MavsdkSession,
        telemetry: TelemetrySlots,
    ) -> None:
        self._config = config
        self._origin = context.origin
        self._session = session
        self._telemetry = telemetry
        self._beacons: Beacons = create(config.beacons, context)
        self.sent = 0
        self.origin_sent = False
        self._rests_since_ns: int | None = None
        self._newest_us = -1

    async def run(self) -> None:
        """Raise BeaconError for beacons that cannot be opened, VehicleError when nothing can be
        sent any more.
        """
        async with self._beacons as beacons:
            while True:
                try:
                    fix = await beacons.read(READ_S)
                except BeaconError as error:
                    _log.warning("no external vision: %s", error)
                    if error.final:
                        return
                    continue
                if fix is None:
                    return
                self._take(fix)

    def _take(self, fix: BeaconFix) -> None:
        config = self._config
        if (
            fix.address != config.address
            or fix.quality < config.least_quality
            or fix.host_ns is None
        ):
            return
        # A packet that came sooner than any before tells that the beacons' clock was taken for too
        # late: what it stamps may lie before what was said. An estimator takes no time twice.
        if fix.host_ns // 1000 <= self._newest_us:
            return
        self._newest_us = fix.host_ns // 1000
        self._session.send("VISION_POSITION_ESTIMATE", self._estimate(fix, fix.host_ns))
        self.sent += 1
        if not self.origin_sent and self._at_rest(fix.host_ns):
            self._session.send(
                "SET_GPS_GLOBAL_ORIGIN", origin_fields(self._origin, self._telemetry.kind)
            )
            self.origin_sent = True

    def _at_rest(self, now_ns: int) -> bool:
        telemetry = self._telemetry
        rests = (
            telemetry.health.get("is_local_position_ok", False)
            and math.hypot(*telemetry.velocity_n_mps) < REST_MPS
        )
        if not rests:
            self._rests_since_ns = None
        elif self._rests_since_ns is None:
            self._rests_since_ns = now_ns
        return self._rests_since_ns is not None and now_ns - self._rests_since_ns >= REST_S * 1e9

    def _estimate(self, fix: BeaconFix, host_ns: int) -> dict[str, object]:
        """The body's position; the angles are the autopilot's own and told as unknown."""
        R_n_b = R_from_quat(self._telemetry.attitude_at(host_ns))
        x, y, z = (
            np.array(beacon_in_n(fix.position_m, self._config)) - R_n_b @ self._config.lever_b_m
        ).tolist()
        covariance = [0.0] * COVARIANCES
        for k in POSITION_VARIANCES:
            covariance[k] = self._config.sigma_m**2
        for k in ANGLE_VARIANCES:
            covariance[k] = math.pi**2
        return {
            "usec": host_ns // 1000,
            "x": x,
            "y": y,
            "z": z,
            "roll": math.atan2(float(R_n_b[2, 1]), float(R_n_b[2, 2])),
            "pitch": -math.asin(max(-1.0, min(1.0, float(R_n_b[2, 0])))),
            "yaw": math.atan2(float(R_n_b[1, 0]), float(R_n_b[0, 0])),
            "covariance": covariance,
            "reset_counter": 0,
        }


def origin_fields(origin: Origin, kind: AutopilotKind | None) -> dict[str, object]:
    """Return the fields of SET_GPS_GLOBAL_ORIGIN, at sea level for a PX4.

    Whenever that begins with vision anew, after a second without, it takes its height for an
    altitude, and its local frame would jump by the origin's.
    """
    altitude_m = 0.0 if kind is PX4 else origin.altitude_m
    return {
        "latitude": round(origin.latitude_deg * 1e7),
        "longitude": round(origin.longitude_deg * 1e7),
        "altitude": round(altitude_m * 1e3),
        "time_usec": 0,
    }

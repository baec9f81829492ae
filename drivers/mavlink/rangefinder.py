"""What a vehicle's rangefinder that looks down measures, from DISTANCE_SENSOR (132). One rule,
whoever listens.

Field facts (common.xml, PX4's and ArduPilot's senders): distances are centimetres; ``orientation``
25 looks down, a vehicle may carry others that look elsewhere; one that measures nothing tells a
value at or beyond its own limits, or a ``signal_quality`` of 1, while 0 is "not known";
``covariance`` is a variance in cm2, of which 255 and, by PX4, 0 mean that it is not known. What is
not measured is unknown: neither 0 nor the limit is a distance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from drivers.interfaces import Below

DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270
INVALID_SIGNAL = 1
UNKNOWN_COVARIANCES = (0, 255)
STALE_NS = 500_000_000
CM = 0.01


class Rangefinder:
    """The newest distance downward. Of several sensors that look down the one with the lowest id
    counts.

    Attributes:
        trouble: why the newest message tells no distance, in words; empty when it does, or none
            came.
    """

    def __init__(self) -> None:
        self._id: int | None = None
        self._newest: Below | None = None
        self.trouble = ""

    @property
    def heard(self) -> bool:
        """Return whether a sensor that looks down was ever heard."""
        return self._id is not None

    def on_distance(self, fields: Mapping[str, Any], now_ns: int) -> None:
        """Take the fields of a DISTANCE_SENSOR."""
        number = int(fields["id"])
        if int(fields["orientation"]) != DOWN or (self._id is not None and number > self._id):
            return
        self._id = number
        least, most, distance = (
            _number(fields, f"{which}_distance") for which in ("min", "max", "current")
        )
        quality = _number(fields, "signal_quality")
        self.trouble = ""
        if quality == INVALID_SIGNAL:
            self.trouble = "it says that its signal is invalid"
        elif not (least < distance < most):
            said = (
                f"{CM * distance:.2f} m, and it measures from {CM * least:.2f} to {CM * most:.2f} m"
            )
            self.trouble = f"it says {said}"
        if self.trouble:
            self._newest = None
            return
        covariance = _number(fields, "covariance")
        known = math.isfinite(covariance) and covariance not in UNKNOWN_COVARIANCES
        sigma_m = CM * math.sqrt(covariance) if known else None
        self._newest = Below(now_ns, CM * distance, sigma_m)

    def at(self, now_ns: int) -> Below | None:
        """Return what it measures; None for what is older than half a second."""
        newest = self._newest
        return None if newest is None or now_ns - newest.stamp_ns > STALE_NS else newest


def _number(fields: Mapping[str, Any], name: str) -> float:
    """Return a field of a message, NaN where it is null or left out, as an extension of an older
    sender is.
    """
    value = fields.get(name)
    return math.nan if value is None else float(value)

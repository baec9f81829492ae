"""Whether a Tello flies, by its state packets: its clock of running motors, its height, its
rangefinder.

What it says in words is no evidence: "ok" may come and nothing happen, "error" may come and it
flies.
"""

from __future__ import annotations

from drivers.tello.state import TOF_FLOOR_M, TelloReport

# its clock of running motors counts whole seconds: not for so long, and they stand
MOTORS_OFF_S = 1.6
ON_GROUND_M = 0.25
_NEVER_NS = -(1 << 62)


class FlightEvidence:
    """What state packets have shown. ``add`` takes each of them, on the thread that receives
    them.
    """

    def __init__(self) -> None:
        self._motors_s: int | None = None
        self._counted_ns = _NEVER_NS  # when the clock of running motors changed last, role clock
        self._counted_since_sent = False
        self._sent_up = False

    def send_up(self) -> None:
        """Note that a take-off is about to be sent: from here on it may fly, until packets show
        that it landed.
        """
        self._counted_since_sent = False
        self._sent_up = True

    def call_off(self) -> None:
        """Note that the take-off was refused, or that it is down: what packets show is all there is
        to it.
        """
        self._sent_up = False

    def add(self, report: TelloReport, height_m: float) -> None:
        """Take the next packet, and the height that was reckoned from it and those before."""
        counted = self._motors_s is not None and report.motors_s != self._motors_s
        if counted:
            self._counted_ns = report.arrival_ns
            self._counted_since_sent = True
        self._motors_s = report.motors_s
        if self._counted_since_sent and self.down(report, height_m):
            self._sent_up = False

    def motors_run(self, at_ns: int) -> bool:
        """Return whether the clock of running motors had just counted at an instant, role clock."""
        return at_ns - self._counted_ns < MOTORS_OFF_S * 1e9

    def up(self, report: TelloReport) -> bool:
        """Return whether it flies: it was sent up and nothing shows that it landed, or this packet
        shows it.
        """
        high = report.height_m > ON_GROUND_M and report.tof_m > ON_GROUND_M
        return self._sent_up or high or self.motors_run(report.arrival_ns)

    def down(self, report: TelloReport, height_m: float) -> bool:
        """Return whether a packet shows it on the ground: motors stand, low above whatever is below
        it.
        """
        low = height_m < ON_GROUND_M or report.tof_m < TOF_FLOOR_M
        return low and not self.motors_run(report.arrival_ns)

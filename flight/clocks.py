"""The other drone's clock, from pings over the link.

Each answered ping bounds the offset ``theta`` (peer minus own) without any assumption but that
packets take time: the ping left before it came in, the pong too, so ``sent - arrival <= theta <=
received - ping_sent`` (the two sides of the NTP exchange). The filter keeps the intersection of all
these intervals, widened by the drift that the clocks may have since. What is left is ruled by the
quickest exchanges in each direction, as in minimum-RTT selection, but it is a bound, not an
estimate: an exchange outside it is no noise, it shows that a clock was stepped.
"""

from __future__ import annotations

import math
from enum import Enum

from path.messages import Ping, Pong
from path.values import frozen


@frozen
class ClockConfig:
    """
    Attributes:
        max_drift_ppm: largest rate by which the two clocks may part.
        min_samples: exchanges before the alignment is used.
        max_uncertainty_s: an offset known no better than this is not used.
        max_inconsistent: this many contradicting exchanges in a row are a clock fault.
    """

    max_drift_ppm: float = 200.0
    min_samples: int = 3
    max_uncertainty_s: float = 0.1
    max_inconsistent: int = 3


class PingResult(Enum):
    """The effect of an answered ping on the alignment."""

    TAKEN = "taken"
    DUPLICATE = "duplicate"  # or overtaken by the answer to a later ping
    INCONSISTENT = "inconsistent"


def answer(
    ping: Ping,
    received_ns: int,
    now_ns: int,
) -> Pong:
    """The pong for a ping that came in at ``received_ns``, to be sent at once."""
    return Pong(
        nonce=ping.nonce,
        ping_sent_ns=ping.sent_ns,
        received_ns=received_ns,
        sent_ns=now_ns,
    )


class ClockAlignment:
    """Offset between this role's clock and the peer's. No I/O, no clock of its own.

    ``nonce`` of the pings must grow. A clock step is never followed: the alignment is not ``ready``
    from the first exchange that contradicts it, and ``fault`` is set for good after
    ``max_inconsistent`` in a row, until ``reset``.
    """

    def __init__(self, config: ClockConfig | None = None) -> None:
        self._config = config or ClockConfig()
        self._drift = self._config.max_drift_ppm * 1e-6
        self.reset()

    def reset(self) -> None:
        """Forget everything, the fault included."""
        self._low_ns = 0
        self._high_ns = 0
        self._updated_ns = 0
        self._samples = 0
        self._inconsistent = 0
        self._last_nonce = -1
        self._fault = False

    def on_pong(self, pong: Pong, arrival_ns: int) -> PingResult:
        """Take an answered ping. ``arrival_ns`` is of this role's clock, as is the echoed
        ``ping_sent_ns``.
        """
        if pong.nonce <= self._last_nonce:
            return PingResult.DUPLICATE
        self._last_nonce = pong.nonce
        low = pong.sent_ns - arrival_ns
        high = pong.received_ns - pong.ping_sent_ns
        # that bound is as old as the exchange
        high += math.ceil(abs(arrival_ns - pong.ping_sent_ns) * self._drift)
        if self._samples:
            widening = self._widening_ns(arrival_ns)
            low = max(low, self._low_ns - widening)
            high = min(high, self._high_ns + widening)
        if low > high:
            self._inconsistent += 1
            self._fault = self._fault or self._inconsistent >= self._config.max_inconsistent
            return PingResult.INCONSISTENT
        self._low_ns = low
        self._high_ns = high
        self._updated_ns = arrival_ns
        self._samples += 1
        self._inconsistent = 0
        return PingResult.TAKEN

    @property
    def fault(self) -> bool:
        """A clock was stepped, or runs away faster than any clock may."""
        return self._fault

    @property
    def ready(self) -> bool:
        """Return whether stamps may be converted now."""
        return (
            not self._fault
            and self._inconsistent == 0
            and self._samples >= self._config.min_samples
            and self.uncertainty_ns <= self._config.max_uncertainty_s * 1e9
        )

    @property
    def samples(self) -> int:
        """Return the number of exchanges that were taken."""
        return self._samples

    @property
    def offset_ns(self) -> int:
        """Peer's clock minus own."""
        return (self._low_ns + self._high_ns) // 2

    @property
    def uncertainty_ns(self) -> int:
        """Bound on the error of ``offset_ns`` at the newest exchange."""
        return (self._high_ns - self._low_ns + 1) // 2

    def uncertainty_at(self, own_ns: int) -> int:
        """Bound on the error of ``offset_ns`` at another instant, own clock."""
        return self.uncertainty_ns + self._widening_ns(own_ns)

    def to_own_ns(self, peer_ns: int) -> int:
        return peer_ns - self.offset_ns

    def _widening_ns(self, own_ns: int) -> int:
        return math.ceil(abs(own_ns - self._updated_ns) * self._drift)

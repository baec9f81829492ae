from __future__ import annotations

import random
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flight.clocks import ClockAlignment, ClockConfig, PingResult, answer
from path.messages import Ping, Pong

S = 1_000_000_000
MS = 1_000_000


@dataclass
class Peers:
    """Two clocks over one true time, and what lies between them."""

    offset_ns: int = 5 * S
    drift_ppm: float = 0.0
    now_ns: int = 100 * S
    nonce: int = 0
    alignment: ClockAlignment = field(default_factory=ClockAlignment)

    def peer(self, own_ns: int) -> int:
        return own_ns + self.offset_ns + round((own_ns - 100 * S) * self.drift_ppm * 1e-6)

    def exchange(self, there_ns: int, back_ns: int, pause_ns: int = S // 4) -> PingResult:
        """One ping and its answer, with the delays of both ways, after a pause."""
        self.now_ns += pause_ns
        self.nonce += 1
        ping = Ping(self.nonce, self.now_ns)
        received = self.now_ns + there_ns
        sent = received + 50_000
        self.last = answer(ping, self.peer(received), self.peer(sent))
        self.now_ns = sent + back_ns
        return self.alignment.on_pong(self.last, self.now_ns)

    @property
    def error_ns(self) -> int:
        return self.alignment.to_own_ns(self.peer(self.now_ns)) - self.now_ns


def test_a_symmetric_link_gives_the_offset() -> None:
    peers = Peers()
    assert not peers.alignment.ready
    for _ in range(3):
        assert peers.exchange(2 * MS, 2 * MS) is PingResult.TAKEN
    assert peers.alignment.ready
    assert abs(peers.error_ns) < 1000  # half the drift that a round trip allows
    assert abs(peers.alignment.uncertainty_ns - 2 * MS) < 0.2 * MS
    assert peers.alignment.to_own_ns(123 + peers.alignment.offset_ns) == 123


def test_the_quickest_exchange_rules() -> None:
    peers = Peers()
    peers.exchange(1 * MS, 1 * MS)
    for _ in range(8):
        peers.exchange(80 * MS, 1 * MS)
    assert abs(peers.error_ns) < 0.6 * MS
    assert peers.alignment.uncertainty_ns < 2 * MS


@given(
    seed=st.integers(0, 10_000), offset_s=st.floats(-1e6, 1e6), drift_ppm=st.floats(-190.0, 190.0)
)
def test_the_error_stays_within_the_uncertainty(
    seed: int, offset_s: float, drift_ppm: float
) -> None:
    rng = random.Random(seed)
    peers = Peers(offset_ns=round(offset_s * S), drift_ppm=drift_ppm)
    for _ in range(60):
        lost = rng.random() < 0.3
        if lost:
            peers.now_ns += S // 4
            continue
        there, back = (round(rng.expovariate(1 / 5e6)) + 300_000 for _ in range(2))
        assert peers.exchange(there, back) is PingResult.TAKEN
        assert abs(peers.error_ns) <= peers.alignment.uncertainty_ns + 1
    for ahead in (S, 10 * S):
        own = peers.now_ns + ahead
        error = peers.alignment.to_own_ns(peers.peer(own)) - own
        assert abs(error) <= peers.alignment.uncertainty_at(own) + 1


@pytest.mark.parametrize("step_ns", [30 * MS, -30 * MS, 3600 * S])
def test_a_clock_step_is_a_fault_and_is_not_followed(step_ns: int) -> None:
    peers = Peers()
    for _ in range(10):
        peers.exchange(1 * MS, 1 * MS)
    before = peers.alignment.offset_ns
    peers.offset_ns += step_ns
    assert peers.exchange(1 * MS, 1 * MS) is PingResult.INCONSISTENT
    assert not peers.alignment.ready and not peers.alignment.fault
    for _ in range(2):
        peers.exchange(1 * MS, 1 * MS)
    assert peers.alignment.fault
    assert peers.alignment.offset_ns == before
    peers.offset_ns -= step_ns  # stepping back does not undo it
    peers.exchange(1 * MS, 1 * MS)
    assert peers.alignment.fault and not peers.alignment.ready
    peers.alignment.reset()
    for _ in range(3):
        peers.exchange(1 * MS, 1 * MS)
    assert peers.alignment.ready and abs(peers.error_ns) < 1000


def test_one_odd_exchange_only_pauses_the_alignment() -> None:
    peers = Peers()
    for _ in range(5):
        peers.exchange(1 * MS, 1 * MS)
    odd = Pong(peers.nonce + 1, peers.now_ns, peers.now_ns, peers.now_ns)
    assert peers.alignment.on_pong(odd, peers.now_ns + MS) is PingResult.INCONSISTENT
    assert not peers.alignment.ready
    peers.nonce += 1
    assert peers.exchange(1 * MS, 1 * MS) is PingResult.TAKEN
    assert peers.alignment.ready and not peers.alignment.fault and abs(peers.error_ns) < 1000


def test_a_clock_that_runs_away_is_a_fault() -> None:
    peers = Peers(drift_ppm=5000.0)
    for _ in range(40):
        peers.exchange(100_000, 100_000)
    assert peers.alignment.fault


def test_duplicates_and_latecomers_change_nothing() -> None:
    peers = Peers()
    for _ in range(3):
        peers.exchange(1 * MS, 1 * MS)
    state = (peers.alignment.offset_ns, peers.alignment.uncertainty_ns)
    assert peers.alignment.on_pong(peers.last, peers.now_ns + S) is PingResult.DUPLICATE
    assert (peers.alignment.offset_ns, peers.alignment.uncertainty_ns) == state


def test_an_offset_known_too_badly_is_not_used() -> None:
    peers = Peers(alignment=ClockAlignment(ClockConfig(max_uncertainty_s=0.01)))
    for _ in range(5):
        peers.exchange(15 * MS, 15 * MS)
    assert not peers.alignment.ready and not peers.alignment.fault
    peers.exchange(2 * MS, 2 * MS)
    assert peers.alignment.ready

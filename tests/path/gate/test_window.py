"""The window counts distinct fresh pairs and nothing else (S6, G6), whatever comes in and in
whatever order.
"""

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from path.config import MethodConfig
from path.gate.window import AgreementWindow, FramePair, serial_difference
from path.observations import MissReason

MS = 1_000_000
PERIOD = 20 * MS
SMALL = replace(MethodConfig(), hold_frames=6, hold_s=0.1, max_gap_s=0.05)


def pair_of(
    index: int, period_ns: int = PERIOD, own_period_ns: int = PERIOD, start: int = 65_530
) -> FramePair:
    """D2's frame of this index and D1's frames around it, in a steady stream; the sequence wraps on
    the way.
    """
    capture_ns = index * period_ns + 3 * MS
    before = capture_ns // own_period_ns
    own = (before, before * own_period_ns), (before + 1, (before + 1) * own_period_ns)
    return FramePair((start + index) % 65_536, capture_ns, own)


def pairs_until_complete(
    config: MethodConfig, period_ns: int, own_period_ns: int = PERIOD
) -> tuple[int, int]:
    """Frames of D2 needed, and the time from the first to the last, in a stream that always
    agrees.
    """
    window = AgreementWindow(config)
    for index in range(5000):
        window.agree(pair_of(index, period_ns, own_period_ns))
        if window.complete:
            return index + 1, index * period_ns
    raise AssertionError("never complete")


@given(st.integers(0, 65_535), st.integers(-32_768, 32_767))
def test_serial_arithmetic_wraps(start: int, ahead: int) -> None:
    assert serial_difference((start + ahead) % 65_536, start) == ahead


def test_the_papers_window_takes_seven_seconds_at_50_hz() -> None:
    # 350 frames at 50 Hz span 6.98 s: the 351st brings the seven seconds
    assert pairs_until_complete(MethodConfig(), PERIOD) == (351, 7_000_000_000)


def test_a_slow_camera_needs_all_frames_and_a_fast_one_all_the_time() -> None:
    frames, span_ns = pairs_until_complete(MethodConfig(), 33 * MS, 33 * MS)
    assert frames == 350
    assert span_ns > 11_000_000_000
    frames, span_ns = pairs_until_complete(MethodConfig(), 16 * MS, 16 * MS)
    assert frames > 350
    assert span_ns >= 7_000_000_000


def test_a_fast_camera_against_a_slow_one_counts_at_the_slow_ones_pace() -> None:
    frames, span_ns = pairs_until_complete(MethodConfig(), 10 * MS, 40 * MS)
    assert frames > 4 * 348
    assert span_ns >= 348 * 40 * MS


def test_no_pair_is_lost_to_the_phase_of_two_equal_cameras() -> None:
    window = AgreementWindow(MethodConfig())
    for index in range(100):
        # captures fall just before or after D1's own, in turn
        jitter = 2 * MS if index % 2 else -2 * MS
        capture_ns = (index + 1) * PERIOD + jitter
        before = capture_ns // PERIOD
        own = (before, before * PERIOD), (before + 1, (before + 1) * PERIOD)
        assert window.agree(FramePair(index, capture_ns, own)) is None
    assert window.count == 100


def test_duplicates_and_old_packets_neither_advance_nor_restart() -> None:
    window = AgreementWindow(SMALL)
    for index in (0, 1, 3):
        assert window.agree(pair_of(index)) is None
    assert window.agree(pair_of(3)) is MissReason.DUPLICATE
    assert window.agree(pair_of(2)) is MissReason.STALE
    assert window.disagree(pair_of(2).peer_sequence, pair_of(2).capture_ns) is MissReason.STALE
    assert window.disagree(pair_of(3).peer_sequence, pair_of(3).capture_ns) is MissReason.DUPLICATE
    assert window.count == 3


def test_a_new_sequence_with_an_old_frame_of_either_side_does_not_count() -> None:
    window = AgreementWindow(SMALL)
    assert window.agree(pair_of(0)) is None
    assert window.agree(pair_of(1)) is None
    frozen_peer = pair_of(2)._replace(capture_ns=pair_of(1).capture_ns)
    assert window.agree(frozen_peer) is MissReason.STALE
    frozen_own = pair_of(3)._replace(own_frames=pair_of(0).own_frames)
    assert window.agree(frozen_own) is MissReason.DUPLICATE
    assert window.count == 2


def test_a_fresh_disagreement_restarts() -> None:
    window = AgreementWindow(SMALL)
    for index in range(4):
        window.agree(pair_of(index))
    assert window.disagree(pair_of(4).peer_sequence, pair_of(4).capture_ns) is None
    assert window.count == 0
    assert window.span_s == 0.0


def test_a_disagreement_restarts_even_when_the_clocks_stepped_back() -> None:
    window = AgreementWindow(SMALL)
    for index in range(4):
        window.agree(pair_of(index))
    assert window.disagree(pair_of(4).peer_sequence, 0) is None
    assert window.count == 0


def test_no_run_reaches_across_a_miss_of_d1() -> None:
    window = AgreementWindow(SMALL)
    window.restart(pair_of(3).capture_ns)
    assert window.agree(pair_of(2)) is MissReason.STALE  # evaluated late, captured before the miss
    assert window.agree(pair_of(4)) is None
    assert window.count == 1


def test_lost_packets_are_bridged_up_to_the_gap() -> None:
    window = AgreementWindow(SMALL)
    window.agree(pair_of(0))
    window.agree(pair_of(2))
    assert window.count == 2
    assert not window.expire(pair_of(4).capture_ns)
    assert window.expire(pair_of(5).capture_ns)
    assert window.count == 0
    window.agree(pair_of(10))
    window.agree(pair_of(13))  # 60 ms later: a new run, by itself
    assert window.count == 1


def test_a_complete_window_does_not_stay_so() -> None:
    window = AgreementWindow(SMALL)
    for index in range(8):
        window.agree(pair_of(index))
    assert window.complete
    window.disagree(pair_of(8).peer_sequence, pair_of(8).capture_ns)
    assert not window.complete


TICK = 5 * MS
ticks = st.integers(0, 60)
beside = st.integers(-3, 3)


def tick_pair(tick: int, own: int | None = None, capture: int | None = None) -> FramePair:
    """D2's frame of a tick, with D1's frames and the capture instant of any other tick."""
    own = tick if own is None else own
    capture = tick if capture is None else capture
    return FramePair(
        (65_500 + tick) % 65_536, capture * TICK, ((own, own * TICK), (own + 1, (own + 1) * TICK))
    )


class AnyInput(RuleBasedStateMachine):
    """Whatever is fed, a complete window rests on enough distinct agreeing frames of both sides, in
    order.
    """

    def __init__(self) -> None:
        super().__init__()
        self.window = AgreementWindow(SMALL)
        self.run: list[FramePair] = []
        self.offered: set[int] = set()

    @rule(tick=ticks, own=beside, capture=beside)
    def agree_on_a_mixed_up_pair(self, tick: int, own: int, capture: int) -> None:
        self._agree(tick_pair(tick, tick + own, tick + capture))

    @rule(shuffled=st.lists(ticks, max_size=12))
    def agree_on_a_shuffled_stream(self, shuffled: list[int]) -> None:
        for tick in shuffled:
            self._agree(tick_pair(tick))

    @rule(
        first=ticks, stride=st.integers(1, 6), length=st.integers(1, 16), repeats=st.integers(1, 2)
    )
    def agree_on_an_echoed_stream(self, first: int, stride: int, length: int, repeats: int) -> None:
        for tick in range(first, first + stride * length, stride):
            for _ in range(repeats):
                self._agree(tick_pair(tick))

    @rule(first=ticks, length=st.integers(1, 16))
    def agree_on_a_restamped_echo(self, first: int, length: int) -> None:
        for tick in range(first, first + length):
            self._agree(tick_pair(first, own=tick, capture=tick))

    @rule(first=ticks, length=st.integers(1, 16))
    def agree_with_a_frozen_camera_of_d1(self, first: int, length: int) -> None:
        for tick in range(first, first + length):
            self._agree(tick_pair(tick, own=first))

    @rule(first=ticks, length=st.integers(1, 16))
    def agree_with_a_frozen_camera_of_d2(self, first: int, length: int) -> None:
        for tick in range(first, first + length):
            self._agree(tick_pair(tick, capture=first))

    @rule(tick=ticks)
    def disagree(self, tick: int) -> None:
        pair = tick_pair(tick)
        if self.window.disagree(pair.peer_sequence, pair.capture_ns) is None:
            self.run.clear()

    @rule(tick=ticks)
    def miss(self, tick: int) -> None:
        self.window.restart(tick * TICK)
        self.run.clear()

    def _agree(self, pair: FramePair) -> None:
        before = self.window.count
        self.offered.add(pair.peer_sequence)
        refusal = self.window.agree(pair)
        if refusal is not None:
            assert self.window.count == before
            return
        if self.window.count == 1:
            self.run.clear()
        self.run.append(pair)
        self.count_is_that_of_distinct_fresh_pairs()
        self.complete_means_enough_of_both()

    @invariant()
    def count_is_that_of_distinct_fresh_pairs(self) -> None:
        assert self.window.count == len(self.run) <= len(self.offered)
        for earlier, later in zip(self.run, self.run[1:], strict=False):
            assert serial_difference(later.peer_sequence, earlier.peer_sequence) > 0
            assert 0 < later.capture_ns - earlier.capture_ns <= 50 * MS
        own = -(10**9)
        for pair in self.run:  # each pair has a frame of D1 to itself
            own = min(frame[0] for frame in pair.own_frames if frame[0] > own)

    @invariant()
    def complete_means_enough_of_both(self) -> None:
        if self.window.complete:
            assert len(self.run) >= 6
            assert self.run[-1].capture_ns - self.run[0].capture_ns >= 100 * MS


TestAnyInput = AnyInput.TestCase
TestAnyInput.settings = settings(max_examples=100, stateful_step_count=12)


def test_the_span_is_the_shorter_one_whichever_sides_stamps_it_is_of() -> None:
    for capture_s, own_s in ((1, 2), (2, 1)):
        window = AgreementWindow(SMALL)
        first = FramePair(1, 10_000 * MS, ((1, 3_000 * MS), (2, 3_000 * MS)))
        window.agree(first)
        window._max_gap_ns = 10_000 * MS  # as if there were pairs in between
        after = (3_000 + 1_000 * own_s) * MS
        window.agree(FramePair(2, (10_000 + 1_000 * capture_s) * MS, ((2, after), (3, after))))
        assert window.span_s == 1.0


def test_a_miss_of_an_earlier_instant_does_not_let_older_pairs_count() -> None:
    window = AgreementWindow(SMALL)
    assert window.agree(pair_of(10)) is None
    window.restart(pair_of(5).capture_ns)
    late = pair_of(8)._replace(peer_sequence=pair_of(20).peer_sequence)
    assert window.agree(late) is MissReason.STALE


def test_a_frame_that_was_passed_over_is_a_floor_for_what_is_captured() -> None:
    """A newer sequence with an older capture, after a frame that added nothing, is no new evidence
    (G6).
    """
    window = AgreementWindow(SMALL)
    assert window.agree(pair_of(0)) is None
    assert window.skip(pair_of(2).peer_sequence, pair_of(2).capture_ns) is None
    late = pair_of(1)._replace(peer_sequence=pair_of(3).peer_sequence)
    assert window.agree(late) is MissReason.STALE
    # it does not come down again
    assert window.skip(pair_of(4).peer_sequence, pair_of(1).capture_ns) is None
    assert (
        window.agree(pair_of(2)._replace(peer_sequence=pair_of(5).peer_sequence))
        is MissReason.STALE
    )
    assert window.agree(pair_of(6)) is None

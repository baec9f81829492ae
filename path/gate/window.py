"""The gate before a commit, and the paper's, "count": consecutive agreements on distinct fresh
frame pairs only.

Paper, eq. temporal_verification. The other gate, ``path.gate.evidence``, rests on the same run of
pairs.

What is safe, and why:

- Only an agreeing pair of a *new* D2 frame with a *new* D1 frame advances the count, at a *later*
  capture instant than anything counted or missed before. A loop that runs faster than the cameras,
  a repeated or late packet and a frozen camera advance nothing.
- A fresh frame of either side that does not agree restarts the count, whatever its reason: the
  paper does not say what a missed detection is, and "consecutive" is taken at its word.
- What is no evidence (an old, repeated or broken packet, a packet lost) changes nothing by itself:
  otherwise an echo could hold a handoff up for ever. It cannot stretch a run either: two agreeing
  pairs more than ``max_gap_s`` apart do not belong to one run.
- Number of pairs and elapsed time must both be reached, the time on the capture stamps of both
  sides.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from path.config import MethodConfig
from path.observations import MissReason

SERIAL = 1 << 16


def serial_difference(a: int, b: int) -> int:
    """Return how far u16 sequence ``a`` is ahead of ``b``, in -32768..32767.

    Serial number arithmetic.
    """
    return ((a - b + SERIAL // 2) % SERIAL) - SERIAL // 2


Offset = tuple[float, float]
"""In D1's image, m at the depth of what it is measured from."""


class Offsets(NamedTuple):
    """Where D2's box is, seen by D1, against where each object would have it.

    The target, and those that D1 sees beside it (``path.target.rivals``).
    """

    target_m: Offset
    rivals_m: tuple[Offset, ...] = ()


class FramePair(NamedTuple):
    """The frames that a comparison used.

    Attributes:
        peer_sequence: u16 sequence of D2's frame.
        capture_ns: when D2's frame was taken, D1's clock.
        own_frames: D1's frames before and after that instant, ``(frame number, stamp)`` each; the
            same one twice when the instants coincide.
        offsets: of D2's box from the target and from what is beside it; None when nobody looked.
        oversize: by how many standard deviations a box is larger than the target can be; 0 when
            nobody looked.
        placed_iou: the overlap with D2's box where a body of the stated size has its middle; None:
            no size is stated.
    """

    peer_sequence: int
    capture_ns: int
    own_frames: tuple[tuple[int, int], tuple[int, int]]
    offsets: Offsets | None = None
    oversize: float = 0.0
    placed_iou: float | None = None


class Evidence(NamedTuple):
    """The evidence reached and needed that it is the same object.

    Both are log10 of one over the probability of being fooled: 4 is one in ten thousand.
    """

    reached: float
    needed: float


class Gate(Protocol):
    """What decides from the pairs of one attempt whether both boxes show the same thing.

    Pure; it never looks at a clock.
    """

    @property
    def count(self) -> int:
        """Pairs of the run under way: agreeing, distinct and without a miss in between."""
        ...

    @property
    def span_s(self) -> float:
        """Time from the first to the last pair of the run.

        The shorter one of both sides' stamps.
        """
        ...

    @property
    def complete(self) -> bool:
        """Return whether the target may be handed over now.

        It does not stay so when a pair disagrees.
        """
        ...

    @property
    def evidence(self) -> Evidence | None:
        """None when pairs are all that counts."""
        ...

    def agree(
        self,
        pair: FramePair,
        iou: float,
        tau: float,
    ) -> MissReason | None:
        """An agreeing pair, ``iou >= tau``. Returns why it does not count, None when it does.

        DUPLICATE and STALE say that it is no new evidence. AMBIGUOUS_TARGET says that a box is of
        more than the target: the pair was taken as one that disagrees.
        """
        ...

    def disagree(
        self,
        peer_sequence: int,
        capture_ns: int,
        by: float | None = None,
    ) -> MissReason | None:
        """Take in a D2 frame that does not agree.

        Returns why it is no new evidence (DUPLICATE or STALE), else None.

        ``by``: its strength, (S - tau) / (1 - tau), below 0; None when there was nothing to
        compare.
        """
        ...

    def restart(self, stamp_ns: int) -> None:
        """A frame of D1 at this instant (D1's clock) did not show the target."""
        ...

    def end_run(self, stamp_ns: int) -> None:
        """Begin a new run at this instant of D1's clock.

        What was reckoned before does not go with what comes after.
        """
        ...

    def expire(self, instant_ns: int) -> bool:
        """Restart when a pair captured at ``instant_ns`` would come too late for the run.

        Returns whether that was so.
        """
        ...

    def refusal(self, peer_sequence: int) -> MissReason | None:
        """Return DUPLICATE for the newest D2 frame compared, STALE for an older one, else None."""
        ...


class AgreementWindow:
    """The gate "count": consecutive agreeing pairs.

    Mutable; one instance for one attempt.
    """

    def __init__(self, config: MethodConfig) -> None:
        self._hold_frames = config.hold_frames
        self._hold_ns = round(config.hold_s * 1e9)
        self._max_gap_ns = round(config.max_gap_s * 1e9)
        self._count = 0
        self._first = (0, 0)  # capture instant and own stamp of the first pair of the run
        self._last = (0, 0)
        self._peer: int | None = None
        self._own: int | None = None
        # nothing captured at or before this may be counted any more
        self._floor_ns: int | None = None

    @property
    def count(self) -> int:
        return self._count

    @property
    def span_s(self) -> float:
        return self._span_ns / 1e9

    @property
    def _span_ns(self) -> int:
        return (
            min(self._last[0] - self._first[0], self._last[1] - self._first[1])
            if self._count
            else 0
        )

    @property
    def complete(self) -> bool:
        """Return whether the run is long enough in pairs and in time (V_k of the paper)."""
        return self._count >= self._hold_frames and self._span_ns >= self._hold_ns

    @property
    def evidence(self) -> Evidence | None:
        return None

    def agree(
        self,
        pair: FramePair,
        iou: float = 1.0,
        tau: float = 0.0,
    ) -> MissReason | None:
        """Count an agreeing pair; by how much it agrees does not matter here."""
        del iou, tau
        refusal = self.refusal(pair.peer_sequence)
        if refusal is not None:
            return refusal
        self._peer = pair.peer_sequence
        if self._floor_ns is not None and pair.capture_ns <= self._floor_ns:
            return MissReason.STALE
        before, after = pair.own_frames
        own = before if self._own is None or before[0] > self._own else after
        if self._own is not None and own[0] <= self._own:
            return MissReason.DUPLICATE
        self.expire(pair.capture_ns)
        self._own = own[0]
        self._floor_ns = pair.capture_ns
        self._last = (pair.capture_ns, own[1])
        if not self._count:
            self._first = self._last
        self._count += 1
        return None

    def disagree(
        self,
        peer_sequence: int,
        capture_ns: int,
        by: float | None = None,
    ) -> MissReason | None:
        """Restarts the run, by however much the pair disagrees."""
        del by
        refusal = self.skip(peer_sequence, capture_ns)
        if refusal is None:
            self.restart(capture_ns)
        return refusal

    def skip(self, peer_sequence: int, capture_ns: int) -> MissReason | None:
        """A D2 frame that adds nothing, and takes nothing. Returns why it is no new one."""
        refusal = self.refusal(peer_sequence)
        if refusal is None:
            self._peer = peer_sequence
            self._floor_ns = (
                capture_ns if self._floor_ns is None else max(self._floor_ns, capture_ns)
            )
        return refusal

    def restart(self, stamp_ns: int) -> None:
        """No run may reach across it."""
        self._count = 0
        self._floor_ns = stamp_ns if self._floor_ns is None else max(self._floor_ns, stamp_ns)

    def end_run(self, stamp_ns: int) -> None:
        self.restart(stamp_ns)

    def expire(self, instant_ns: int) -> bool:
        if not self._count or instant_ns - self._last[0] <= self._max_gap_ns:
            return False
        self._count = 0
        return True

    def refusal(self, peer_sequence: int) -> MissReason | None:
        if self._peer is None:
            return None
        ahead = serial_difference(peer_sequence, self._peer)
        if ahead > 0:
            return None
        return MissReason.STALE if ahead else MissReason.DUPLICATE

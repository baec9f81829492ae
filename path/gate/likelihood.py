"""The gate "likelihood": a sequential test of which object D2's box is of, from where that box
lies.

For D2's box in pair k and object j, ``path.target.rivals`` gives the offset o_kj from where D1 has
that object, across D1's line of sight. If the box is of j,

    o_kj = beta + n_k,    beta ~ N(0, B),    n_k of variance N and correlation time T, per axis.

beta is drawn once an attempt: calibration, mounts, print, attitude, clocks, depth, where the middle
of a box lies on a body. B = ``offset_sigma_m`` squared, which ``path-handoff plan`` works out for
the geometry at hand; it is known from ``offset_known`` measurements, so that its tail is Student's.
N and T are estimated while it runs: s^2 over the run, and the correlation of pairs that follow one
another. Over a run of length t the mean of the offsets is then one observation of variance

    B + N / m,    m = 1 + t / 2T independent ones of n

and the scatter s_j^2 another, of m - 1 degrees of freedom: about the object that the box is of it
is noise, about one that moves differently it is more. The log likelihood of j, both axes together,
is

    l_j = -known ln(1 + |mean o_j|^2 / (2 known (B + N/m))) - (m - 1) ln(s_j^2 + N_0)

N_0, a share of B, is what scatters at least. Against D1's target, H_0, stand

    H_j   an object that D1 sees beside it:     ln L = l_0 - l_j
    H_u   one that D1 does not see, anywhere in the area A in which D2 takes a box for the target's, in a share
          ``unseen`` of the hand-overs:         ln L = l_0 - ln unseen + ln (A / 2 pi (B + N/m))

and, in each, pairs whose boxes do not overlap as they should: of the same object a share ODD of
them at most, of others half. The evidence is the least of them. The target is handed over when it
is at least 1/alpha, for HELD_S, after ``min_s`` and ``min_pairs``: a likelihood ratio exceeds 1/a
under the other hypothesis with a probability of at most a, at any time (Ville). A run that was
broken off is another try: the j-th may spend alpha / (j (j + 1)).

That D1 itself has gone over to another object is not asked here: it offers no frame of which it is
not sure (``path.belief``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from path.config import EvidenceConfig, MethodConfig
from path.gate.window import AgreementWindow, Evidence, FramePair, Offset, Offsets
from path.observations import MissReason

HELD_S = 0.3
CORRELATED_S = 0.25
"""T before it is known: overlaps half a second apart still agree (docs/gates.md)."""
PRIOR_PAIRS = 20.0
"""So many pairs the prior of T is worth."""
LEAST_SCATTER = 0.03
"""N_0 of B: boxes' noise that is averaged over T."""
REACH_SIGMAS = 8.3
"""Of beta: how far from its prior D2 takes a box for the target's. 3.5 of the 7 cm that it looks
around a small car.
"""
ODD = 0.1
"""The share of pairs that do not overlap though they are of one object: a detector's inventions,
and spells of blur.
"""


@dataclass(slots=True)
class Scatter:
    """Offsets from one object: their mean, and how they scatter about it, both axes together."""

    count: int = 0
    total: Offset = (0.0, 0.0)
    squares: float = 0.0
    products: float = 0.0  # of each with the one before it
    last: Offset = (0.0, 0.0)

    def note(self, offset_m: Offset) -> None:
        x, y = offset_m
        self.total = self.total[0] + x, self.total[1] + y
        self.squares += x * x + y * y
        if self.count:
            self.products += x * self.last[0] + y * self.last[1]
        self.last = offset_m
        self.count += 1

    @property
    def mean2(self) -> float:
        """The squared length of the mean."""
        return (self.total[0] ** 2 + self.total[1] ** 2) / self.count**2

    @property
    def variance(self) -> float:
        """Per axis."""
        return 0.5 * max(0.0, self.squares / self.count - self.mean2)

    @property
    def correlation(self) -> float:
        """Of offsets that follow one another, 0..1."""
        if self.count < 3 or not self.variance > 0.0:
            return 0.0
        together = self.products / (self.count - 1) - self.mean2
        return min(0.999, max(0.0, 0.5 * together / self.variance))


@dataclass(slots=True)
class _Run:
    """What a run of agreeing pairs has."""

    begin_ns: int = 0
    newest_ns: int = 0
    target: Scatter = field(default_factory=Scatter)
    beside: list[tuple[Scatter, Scatter]] = field(default_factory=list[tuple[Scatter, Scatter]])
    odd: int = 0
    sure_ns: int | None = None  # since when its evidence is enough

    @property
    def span_s(self) -> float:
        return (self.newest_ns - self.begin_ns) * 1e-9

    def note(
        self,
        offsets: Offsets,
        capture_ns: int,
        same_m: float,
    ) -> None:
        """Take in the offsets of a pair.

        Objects beside the target are those of the pairs before, by where they are.
        """
        self.newest_ns = capture_ns
        self.target.note(offsets.target_m)
        free = list(self.beside)
        for rival_m in offsets.rivals_m:
            apart = [
                math.dist(_from_target(each), _difference(rival_m, offsets.target_m))
                for each in free
            ]
            nearest = min(range(len(free)), key=apart.__getitem__, default=None)
            if nearest is None or apart[nearest] > same_m:
                own = (Scatter(), Scatter())
                self.beside.append(own)
            else:
                own = free.pop(nearest)
            own[0].note(offsets.target_m)
            own[1].note(rival_m)


def _difference(a: Offset, b: Offset) -> Offset:
    return a[0] - b[0], a[1] - b[1]


def _from_target(each: tuple[Scatter, Scatter]) -> Offset:
    """Return where an object was last, from the target."""
    return _difference(each[1].last, each[0].last)


class LikelihoodGate:
    """Implements ``path.gate.window.Gate``. One instance for one attempt."""

    def __init__(self, config: MethodConfig) -> None:
        own = config.evidence
        self._config = own
        limits = replace(
            config,
            hold_frames=own.min_pairs,
            hold_s=own.min_s,
            max_gap_s=own.max_gap_s,
        )
        self._window = AgreementWindow(limits)
        self._run = _Run()
        self._runs = 0
        self._agreed = False

    @property
    def count(self) -> int:
        return self._window.count

    @property
    def span_s(self) -> float:
        return self._window.span_s

    @property
    def evidence(self) -> Evidence:
        needed = -math.log10(self._config.alpha)
        spent = math.log10(0.5 * self._runs * (self._runs + 1.0)) if self._runs else 0.0
        return Evidence(self._reached() / math.log(10.0), needed + spent)

    @property
    def complete(self) -> bool:
        sure_ns = self._run.sure_ns
        held = sure_ns is not None and (self._run.newest_ns - sure_ns) * 1e-9 >= HELD_S
        return self._agreed and held and self._window.complete

    def agree(
        self,
        pair: FramePair,
        iou: float,
        tau: float,
    ) -> MissReason | None:
        if not iou >= tau:  # no pair that agrees: whoever says so is wrong, and gains nothing
            return self.disagree(pair.peer_sequence, pair.capture_ns, -1.0)
        if pair.oversize > self._config.size_sigmas:
            refusal = self.disagree(pair.peer_sequence, pair.capture_ns, -math.inf)
            return refusal or MissReason.AMBIGUOUS_TARGET
        refusal = self._window.agree(pair)
        if refusal is not None:
            return refusal
        if self._window.count == 1:
            self._runs += 1
            self._run = _Run(pair.capture_ns, pair.capture_ns)
        self._agreed = True
        if pair.offsets is not None:
            self._run.note(pair.offsets, pair.capture_ns, self._reach_m)
        self._judge(pair.capture_ns)
        return None

    def disagree(
        self,
        peer_sequence: int,
        capture_ns: int,
        by: float | None = None,
    ) -> MissReason | None:
        refusal = self._window.skip(peer_sequence, capture_ns)
        if refusal is None and by is not None and self._window.count:
            self._agreed = False
            self._run.odd += 1
            self._judge(capture_ns)
        return refusal

    def restart(self, stamp_ns: int) -> None:
        """D1 missed the target: that costs no evidence; the pairs around it cannot be compared."""

    def end_run(self, stamp_ns: int) -> None:
        """The next run is one more of this attempt, and may spend what that one may."""
        self._window.restart(stamp_ns)

    def expire(self, instant_ns: int) -> bool:
        return self._window.expire(instant_ns)

    def refusal(self, peer_sequence: int) -> MissReason | None:
        return self._window.refusal(peer_sequence)

    @property
    def _reach_m(self) -> float:
        return REACH_SIGMAS * self._config.offset_sigma_m

    def _judge(self, capture_ns: int) -> None:
        evidence = self.evidence
        run = self._run
        if evidence.reached < evidence.needed:
            run.sure_ns = None
        elif run.sure_ns is None:
            run.sure_ns = capture_ns

    def _reached(self) -> float:
        """Return the natural logarithm of the evidence of the run under way; never below 0."""
        run = self._run
        own = self._config
        if not (self._window.count and run.target.count):
            return 0.0
        independent = self._independent(run)
        variance = _mean_variance(run.target, independent, own)
        area = 0.5 * self._reach_m**2 / variance
        reached = _of_mean(run.target, independent, own) - math.log(own.unseen) + math.log(area)
        for target, rival in run.beside:
            many = 1.0 + (independent - 1.0) * target.count / run.target.count
            reached = min(reached, _likelihood(target, many, own) - _likelihood(rival, many, own))
        compared = run.target.count + run.odd
        share = run.odd / compared
        # odd pairs come in spells: as many independent ones as there are of offsets
        odds = independent * (
            share * math.log(2.0 * ODD) + (1.0 - share) * math.log(2.0 * (1.0 - ODD))
        )
        return max(0.0, reached + min(0.0, odds))

    @staticmethod
    def _independent(run: _Run) -> float:
        """Return how many independent offsets a run is worth: m."""
        if run.target.count < 2 or not run.span_s > 0.0:
            return 1.0
        step_s = run.span_s / (run.target.count - 1)
        measured = run.target.correlation
        prior = math.exp(-step_s / CORRELATED_S)
        correlation = (PRIOR_PAIRS * prior + run.target.count * measured) / (
            PRIOR_PAIRS + run.target.count
        )
        time_s = -step_s / math.log(max(1e-6, correlation))
        return 1.0 + run.span_s / (2.0 * time_s)


def _mean_variance(
    offsets: Scatter,
    independent: float,
    config: EvidenceConfig,
) -> float:
    return config.offset_sigma_m**2 + offsets.variance / independent


def _of_mean(
    offsets: Scatter,
    independent: float,
    config: EvidenceConfig,
) -> float:
    half = 0.5 * offsets.mean2 / _mean_variance(offsets, independent, config)
    return -config.offset_known * math.log1p(half / config.offset_known)


def _likelihood(
    offsets: Scatter,
    independent: float,
    config: EvidenceConfig,
) -> float:
    """Return l_j."""
    least = LEAST_SCATTER * config.offset_sigma_m**2
    scatter = math.log(offsets.variance + least)
    return _of_mean(offsets, independent, config) - (independent - 1.0) * scatter

"""A sender's run of agreeing pairs as the safety monitors recount it, from the records alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hil.monitors.likelihood_recount import recounted
from path.arrays import Array
from path.config import MethodConfig
from path.gate.likelihood import HELD_S, REACH_SIGMAS

ROUNDING = 1e-9


class PairsAtPaces:
    """The runs of each test that the gate makes of the same pairs, any of which may decide; one, as
    a rule.
    """

    def __init__(self, method: MethodConfig) -> None:
        paces = method.evidence.paces if method.gate == "evidence" else (method.evidence,)
        methods = [replace(method, evidence=own) for own in paces]
        self._paces = [AgreedPairs(own, alone=len(methods) == 1) for own in methods]

    @property
    def about(self) -> tuple[int, int | None]:
        """The target and the epoch that they are of."""
        return self._paces[0].target_id, self._paces[0].epoch

    @property
    def full(self) -> bool:
        """Return whether one of them is enough for a commit."""
        return any(pace.full for pace in self._paces)

    def __str__(self) -> str:
        return "; ".join(str(pace) for pace in self._paces)

    def missed(self, record: Mapping[str, Any]) -> None:
        """An answer that does not agree."""
        for pace in self._paces:
            pace.missed(record)

    def agreed(self, record: Mapping[str, Any]) -> str | None:
        """An agreeing pair that the role counted; what is wrong with that, None when it is right by
        one of them.
        """
        wrong = [pace.agreed(record) for pace in self._paces]
        return None if None in wrong else wrong[0]


@dataclass(slots=True)
class AgreedPairs:
    """The run of agreeing pairs, and its blocks when the gate goes by evidence (S5, S6).

    It takes a role's word only where that claims less: a run that begins again for a reason the
    records of D2's answers do not show, such as a frame of D1's own without the target.
    """

    method: MethodConfig
    alone: bool = True  # no other test goes on beside it, so that the role's count is of this one
    pairs: int = 0
    first_ns: int = 0
    last_ns: int = -1
    target_id: int = -1
    epoch: int | None = None
    runs: int = 0  # of the epoch
    logs: float = 0.0  # log10 of the run's evidence
    agrees: bool = False  # the newest pair that was compared
    block_ns: int = 0  # where the block under way begins
    # strength, and whether it agrees
    block: list[tuple[float, bool]] = field(default_factory=list[tuple[float, bool]])
    offsets: list[tuple[int, Any, Any]] = field(default_factory=list[tuple[int, Any, Any]])
    """Of the run: capture stamp, offset from the target and from what is beside it."""
    odd: int = 0  # pairs of the run that were compared and did not agree
    sure_ns: int | None = None  # since when the evidence of the gate "likelihood" is enough

    @property
    def span_s(self) -> float:
        return (self.last_ns - self.first_ns) * 1e-9 if self.pairs else 0.0

    @property
    def reached(self) -> float:
        """log10 of the evidence of the run under way; 0 without any."""
        if not self.pairs:
            return 0.0
        if self.method.gate == "likelihood":
            return recounted(self.offsets, self.first_ns, self.odd, self.method.evidence)
        # what later runs, and tests that share alpha, need more is against accidents; errors that
        # last are drawn once
        share = self.method.evidence.accident_share
        return min(
            self.logs, self._identified + math.log10(0.5 * self.runs * (self.runs + 1) / share)
        )

    @property
    def _identified(self) -> float:
        """log10 of what the offsets of D2's box say for the target: against one unseen, and against
        one beside it.
        """
        own = self.method.evidence
        if not self.offsets:
            return 0.0
        targets = np.array([target for _, target, _ in self.offsets])
        found = self._likely(targets) + math.log10(0.5 * REACH_SIGMAS**2) - math.log10(own.unseen)
        near = [(target, rival) for _, target, rival in self.offsets if rival is not None]
        if near:
            then, beside = (np.array(column) for column in zip(*near, strict=True))
            found = min(found, self._likely(then) - self._likely(beside))
        _, target, rival = self.offsets[-1]
        if rival is not None and math.dist(target, rival) < own.apart_m:
            found = min(found, -math.log10(own.swap))
        return max(0.0, found)

    def _likely(self, offsets: Array) -> float:
        own = self.method.evidence
        off2 = float(np.sum(np.mean(offsets, axis=0) ** 2)) / own.offset_sigma_m**2
        return -own.offset_known * math.log10(1.0 + off2 / (2.0 * own.offset_known))

    @property
    def _needed(self) -> float:
        """log10 of the evidence that the run under way needs."""
        if not self.runs:
            return math.inf
        own = self.method.evidence
        if self.method.gate == "likelihood":
            return math.log10(0.5 * self.runs * (self.runs + 1) / own.alpha)
        return math.log10(self.runs * (self.runs + 1) / (own.alpha * own.accident_share))

    @property
    def full(self) -> bool:
        """Return whether the run is enough for a commit, by the gate of the rig."""
        if self.method.gate != "count":
            own = self.method.evidence
            enough = self.agrees and self.reached >= self._needed - ROUNDING
            if self.method.gate == "likelihood":
                enough = (
                    enough
                    and self.sure_ns is not None
                    and (self.last_ns - self.sure_ns) * 1e-9 >= HELD_S
                )
            return enough and self.pairs >= own.min_pairs and self.span_s >= own.min_s - ROUNDING
        return (
            self.pairs >= self.method.hold_frames and self.span_s >= self.method.hold_s - ROUNDING
        )

    def __str__(self) -> str:
        evidence = (
            f", evidence {self.reached:.2f} in run {self.runs}"
            if self.method.gate != "count"
            else ""
        )
        return f"{self.pairs} pairs, {self.span_s:.2f} s{evidence}"

    def missed(self, record: Mapping[str, Any]) -> None:
        """An answer that does not agree: the end of pairs in a row; as evidence, only what was
        compared counts.
        """
        if self.method.gate == "count":
            self.pairs = 0
            return
        iou = record["iou"]
        tau = record["tau"]
        if iou is None or tau is None:
            return
        self.agrees = False
        if self.method.gate == "likelihood":
            self.odd += 1
            self._note_sure(int(record["capture_ns"]))
        # boxes that overlap and are too large for the target disagree as much as any
        elif self.pairs:
            self._compare(int(record["capture_ns"]), iou if iou < tau else -math.inf, tau)

    def agreed(self, record: Mapping[str, Any]) -> str | None:
        """An agreeing pair that the role counted; what is wrong with that, None when nothing is."""
        capture_ns = int(record["capture_ns"])
        iou = record["iou"]
        tau = record["tau"]
        if capture_ns <= self.last_ns or iou is None or tau is None or not iou >= tau:
            return f"a pair counted that must not: {dict(record)}"
        if (
            self.method.gate != "count"
            and (record.get("oversize") or 0.0) > self.method.evidence.size_sigmas
        ):
            return f"a box larger than the target counted: {dict(record)}"
        gap_ns = capture_ns - self.last_ns
        if record["epoch"] != self.epoch:
            self.epoch = record["epoch"]
            self.runs = 0
            self.pairs = 0
        if (
            self.pairs == 0
            or (self.alone and record["count"] == 1)
            or record["target_id"] != self.target_id
            or gap_ns > round(self.max_gap_s * 1e9)
        ):
            self._begin(capture_ns, int(record["target_id"]))
        self.pairs += 1
        self.last_ns = capture_ns
        self.agrees = True
        if self.method.gate != "count" and record.get("offset_m") is not None:
            self.offsets.append((capture_ns, record["offset_m"], record.get("rival_offset_m")))
        if self.method.gate == "likelihood":
            self._note_sure(capture_ns)
        if self.method.gate == "evidence":
            placed = record.get("placed_iou")
            self._compare(capture_ns, iou if placed is None else placed, tau)
        if record["count"] > self.pairs:
            return f"the role counts {record['count']}, the monitor {self.pairs}"
        claimed = record["evidence"]
        if claimed is not None and claimed > self.reached + ROUNDING:
            return f"the role has evidence {claimed:.2f}, the monitor {self.reached:.2f}"
        return None

    @property
    def max_gap_s(self) -> float:
        return (
            self.method.max_gap_s if self.method.gate == "count" else self.method.evidence.max_gap_s
        )

    def _note_sure(self, capture_ns: int) -> None:
        if self.reached < self._needed - ROUNDING:
            self.sure_ns = None
        elif self.sure_ns is None:
            self.sure_ns = capture_ns

    def _begin(self, capture_ns: int, target_id: int) -> None:
        self.pairs = 0
        self.first_ns = capture_ns
        self.target_id = target_id
        self.runs += 1
        self.logs = 0.0
        self.block_ns = capture_ns
        self.block = []
        self.offsets = []
        self.odd = 0
        self.sure_ns = None

    def _compare(
        self,
        capture_ns: int,
        iou: float,
        tau: float,
    ) -> None:
        own = self.method.evidence
        self.block.append(((iou - tau) / max(1.0 - tau, ROUNDING), iou >= tau))
        if (
            capture_ns - self.block_ns < round(own.block_s * 1e9)
            or len(self.block) < own.block_pairs
        ):
            return
        middle = float(np.median([strength for strength, _ in self.block]))
        share = sum(agrees for _, agrees in self.block) / len(self.block)
        good = middle >= own.strength - ROUNDING and share >= own.block_share - ROUNDING
        if self.logs == 0.0:
            self.logs = -math.log10(own.first_rate) if good else 0.0
        elif good:
            self.logs += math.log10((1.0 - (1.0 - own.next_rate) * own.setback) / own.next_rate)
        else:
            self.logs += math.log10(own.setback)
        self.block_ns = capture_ns
        self.block = []
        if self.logs <= ROUNDING:
            self.pairs = 0
            self.logs = 0.0

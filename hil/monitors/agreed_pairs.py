"""What the safety monitors make of a sender's agreeing pairs: the run under way, recounted from the records alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from path.config import MethodConfig

ROUNDING = 1e-9


@dataclass(slots=True)
class AgreedPairs:
    """The run of agreeing pairs, and its blocks when the gate goes by evidence (S5, S6).

    It takes a role's word only where that claims less: a run that begins again for a reason the records of D2's answers
    do not show, such as a frame of D1's own without the target.
    """

    method: MethodConfig
    pairs: int = 0
    first_ns: int = 0
    last_ns: int = -1
    target_id: int = -1
    epoch: int | None = None
    runs: int = 0  # of the epoch
    blocks: int = 0
    block_ns: int = 0  # where the block under way begins
    block_pairs: int = 0
    block_sum: float = 0.0

    @property
    def span_s(self) -> float:
        return (self.last_ns - self.first_ns) * 1e-9 if self.pairs else 0.0

    @property
    def chance(self) -> float:
        """Bound on a run like this one being an accident, 1 without evidence."""
        own = self.method.evidence
        return own.first_rate * own.next_rate ** (self.blocks - 1) if self.pairs and self.blocks else 1.0

    @property
    def full(self) -> bool:
        """Whether the run is enough for a commit, by the gate of the rig."""
        if self.method.gate == "evidence":
            own = self.method.evidence
            allowed = own.alpha / (self.runs * (self.runs + 1)) if self.runs else 0.0
            enough = self.chance <= allowed * (1.0 + ROUNDING)
            return enough and self.pairs >= own.min_pairs and self.span_s >= own.min_s - ROUNDING
        return self.pairs >= self.method.hold_frames and self.span_s >= self.method.hold_s - ROUNDING

    def __str__(self) -> str:
        evidence = f", chance {self.chance:.2g} in run {self.runs}" if self.method.gate == "evidence" else ""
        return f"{self.pairs} pairs, {self.span_s:.2f} s{evidence}"

    def miss(self) -> None:
        self.pairs = 0

    def agreed(self, record: Mapping[str, Any]) -> str | None:
        """An agreeing pair that the role counted; what is wrong with that, None when nothing is."""
        capture_ns, iou, tau = int(record["capture_ns"]), record["iou"], record["tau"]
        if capture_ns <= self.last_ns or iou is None or tau is None or not iou >= tau:
            return f"a pair counted that must not: {dict(record)}"
        gap_ns = capture_ns - self.last_ns
        if record["epoch"] != self.epoch:
            self.epoch, self.runs, self.pairs = record["epoch"], 0, 0
        if (
            self.pairs == 0
            or record["count"] == 1
            or record["target_id"] != self.target_id
            or gap_ns > round(self.method.max_gap_s * 1e9)
        ):
            self._begin(capture_ns, int(record["target_id"]))
        self.pairs += 1
        self.last_ns = capture_ns
        self._judge_block((iou - tau) / max(1.0 - tau, ROUNDING))
        if record["count"] > self.pairs:
            return f"the role counts {record['count']}, the monitor {self.pairs}"
        claimed, own = record["evidence"], -math.log10(self.chance)
        if claimed is not None and claimed > own + ROUNDING:
            return f"the role has evidence {claimed:.2f}, the monitor {own:.2f}"
        return None

    def _begin(self, capture_ns: int, target_id: int) -> None:
        self.pairs, self.first_ns, self.target_id = 0, capture_ns, target_id
        self.runs += 1
        self.blocks, self.block_ns, self.block_pairs, self.block_sum = 0, capture_ns, 0, 0.0

    def _judge_block(self, strength: float) -> None:
        own = self.method.evidence
        self.block_pairs += 1
        self.block_sum += strength
        long_enough = self.last_ns - self.block_ns >= round(own.block_s * 1e9)
        if self.method.gate != "evidence" or not long_enough or self.block_pairs < own.block_pairs:
            return
        if self.block_sum / self.block_pairs >= own.strength - ROUNDING:
            self.blocks += 1
            self.block_ns, self.block_pairs, self.block_sum = self.last_ns, 0, 0.0
        else:
            self.pairs = 0

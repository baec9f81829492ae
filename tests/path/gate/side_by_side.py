"""Several gates beside each other, to compare them."""

from __future__ import annotations

from typing import TypeVar

from path.gate.window import Evidence, FramePair, Gate
from path.observations import MissReason

T = TypeVar("T")


def _first(answers: list[T]) -> T:
    """Returns the answer of the deciding gate, once all have been asked."""
    return answers[0]


class SideBySide:
    """Several gates fed with the same pairs: the first one decides, the others look on (to compare
    them).
    """

    def __init__(self, first: Gate, *others: Gate) -> None:
        self.gates: tuple[Gate, ...] = (first, *others)

    @property
    def count(self) -> int:
        return self.gates[0].count

    @property
    def span_s(self) -> float:
        return self.gates[0].span_s

    @property
    def evidence(self) -> Evidence | None:
        return self.gates[0].evidence

    @property
    def complete(self) -> bool:
        return self.gates[0].complete

    def agree(self, pair: FramePair, iou: float, tau: float) -> MissReason | None:
        return _first([gate.agree(pair, iou, tau) for gate in self.gates])

    def disagree(
        self, peer_sequence: int, capture_ns: int, by: float | None = None
    ) -> MissReason | None:
        return _first([gate.disagree(peer_sequence, capture_ns, by) for gate in self.gates])

    def restart(self, stamp_ns: int) -> None:
        for gate in self.gates:
            gate.restart(stamp_ns)

    def end_run(self, stamp_ns: int) -> None:
        for gate in self.gates:
            gate.end_run(stamp_ns)

    def expire(self, instant_ns: int) -> bool:
        return _first([gate.expire(instant_ns) for gate in self.gates])

    def refusal(self, peer_sequence: int) -> MissReason | None:
        return self.gates[0].refusal(peer_sequence)

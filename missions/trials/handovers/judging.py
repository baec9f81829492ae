"""One verdict, one batch: how every experiment of this question has its Monte-Carlo hand-overs
judged.

Both gates are told the same pairs. An experiment says what is asked of each attempt and what is
kept of it; processes run batches of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from drivers.collector import collector_off
from drivers.rig.parts import Rig
from flight.harness.montecarlo import HandoverRunner, Series, agreeing, tell
from missions.ground.rig_library import trial_part
from path.config import GateKind, MethodConfig
from path.gate.evidence import make_gate
from path.values import frozen

# The paper's and the default. Other kinds of gate are not judged here.
GATES: tuple[GateKind, GateKind] = ("count", "evidence")
GATE_TITLES = {"count": "350 in a row", "evidence": "evidence"}

Asked = TypeVar("Asked")
Answer = TypeVar("Answer")


@frozen
class Verdict:
    """What one gate made of an attempt.

    Attributes:
        after_s: from the first agreeing pair to the commit, as the paper counts; None without a
            commit.
        since_s: from D2's first frame to the commit; None without one.
        right: whether D2's box was of the target; False without a commit.
        same: whether it was of the object that D1's box was of: D1 may have gone over to another
            one itself.
    """

    after_s: float | None = None
    since_s: float | None = None
    right: bool = False
    same: bool = False

    @property
    def committed(self) -> bool:
        return self.after_s is not None

    @property
    def wrong(self) -> bool:
        """Whether another object was handed over."""
        return self.committed and not self.right

    @property
    def fooled(self) -> bool:
        """Whether both boxes agreed although they were of different objects."""
        return self.committed and not self.same


@frozen
class JudgedAttempt:
    """One attempt by both gates; ``count`` is None where it was not run to the end of that gate."""

    index: int
    count: Verdict | None
    evidence: Verdict

    def by(self, gate: GateKind) -> Verdict | None:
        """Return the verdict of a gate."""
        return self.count if gate == "count" else self.evidence


Attempts = Sequence[JudgedAttempt]


def verdict_of(
    series: Series,
    method: MethodConfig,
    gate: GateKind,
) -> Verdict:
    """Return what a gate makes of all that D1 was told."""
    own = replace(method, gate=gate)
    done = tell(series, make_gate(own), own) if len(series) else None
    if done is None:
        return Verdict()
    now_ns = int(series.now_ns[done])
    first_ns = int(series.capture_ns[np.argmax(agreeing(series, own))])
    return Verdict(
        after_s=(now_ns - first_ns) * 1e-9,
        since_s=(now_ns - int(series.capture_ns[0])) * 1e-9,
        right=bool(series.right[done]),
        same=bool(series.same[done]),
    )


def verdicts_of(attempts: Attempts, gate: GateKind) -> list[Verdict]:
    """Return the verdicts of a gate on those attempts that were run to its end."""
    found = (each.by(gate) for each in attempts)
    return [verdict for verdict in found if verdict is not None]


def times_s(attempts: Attempts, gate: GateKind) -> list[float]:
    """Return the times from the first agreeing pair to the commit, of those that committed."""
    verdicts = verdicts_of(attempts, gate)
    return [verdict.after_s for verdict in verdicts if verdict.after_s is not None]


def wrongly(attempts: Attempts, gate: GateKind) -> int:
    """Count the attempts in which a gate handed over another object."""
    return sum(verdict.wrong for verdict in verdicts_of(attempts, gate))


def judge_all(
    rig: Rig,
    judge: Callable[[HandoverRunner, MethodConfig, Asked], Answer],
    asked: Sequence[Asked],
) -> list[Answer]:
    """Judge one after another. Garbage is looked for after them: they leave next to none."""
    runner: HandoverRunner = trial_part(rig, "montecarlo")(rig).warmed()
    with collector_off():
        return [judge(runner, rig.method, one) for one in asked]


def batches(
    rig: Rig,
    judge: Callable[[HandoverRunner, MethodConfig, Asked], Answer],
    asked: Sequence[Asked],
    of: int,
) -> list[partial[list[Answer]]]:
    """Cut what is asked into batches of so many, each for a process of its own."""
    return [partial(judge_all, rig, judge, asked[at : at + of]) for at in range(0, len(asked), of)]


def together(parts: Iterable[Sequence[Answer]]) -> list[Answer]:
    """Return the answers of all batches as one list."""
    return [answer for part in parts for answer in part]

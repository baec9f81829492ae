"""How far D1's identity is to be believed: of the frames with a stated probability, the share that
was wrong.
"""

from __future__ import annotations

from collections.abc import Sequence

from flight.harness.montecarlo import StatedIdentity
from missions.trials.shared.statistics import upper_bound
from missions.trials.shared.trial import TrialTable

EDGES = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0)
"""Of the stated probability that D1 follows another object than the designated one: each bin ends
at the next.
"""

StatedCounts = tuple[tuple[int, int], ...]
"""Of one attempt, for each bin: its frames, and those in which D1 followed another object."""

NOTHING_STATED: StatedCounts = ((0, 0),) * len(EDGES)


def counted(stated: Sequence[StatedIdentity]) -> StatedCounts:
    """Count the frames of an attempt by what D1 stated in them."""
    frames = [0] * len(EDGES)
    wrong = [0] * len(EDGES)
    for each in stated:
        doubt = 1.0 - each.probability
        own = next(k for k, edge in enumerate(EDGES) if doubt >= edge or edge == 0.0)
        frames[own] += 1
        wrong[own] += not each.right
    return tuple(zip(frames, wrong, strict=True))


def reliability(attempts: Sequence[StatedCounts]) -> TrialTable:
    """Return the table of stated probabilities against the shares that were wrong.

    Frames of one attempt have one cause: so many attempts had such a frame, and in so many of them
    one was wrong.
    """
    rows: list[tuple[str, ...]] = []
    for k, edge in enumerate(EDGES):
        own = [each[k] for each in attempts if each[k][0]]
        frames = sum(each[0] for each in own)
        wrong = sum(each[1] for each in own)
        in_attempts = sum(each[1] > 0 for each in own)
        above = 1.0 if k == 0 else EDGES[k - 1]
        share = f"{wrong / frames:.2g}" if frames else "-"
        bound = f"{upper_bound(in_attempts, len(own)):.2g}" if own else "-"
        rows.append(
            (f"{edge:g} to {above:g}", str(frames), share, str(len(own)), str(in_attempts), bound)
        )
    return TrialTable(
        "What D1 states of the object that it follows: the probability that it is not the designated one",
        (
            "stated",
            "frames",
            "share wrong",
            "attempts",
            "with a wrong one",
            "share, at most (95 %)",
        ),
        rows,
        "Of the frames that show what D1 follows in a box of its own, offered or not.",
    )

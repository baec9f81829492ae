"""What a program gives up when it does not keep up, in which order, and when it takes it up
again.
"""

from __future__ import annotations

import math
from itertools import groupby, pairwise

from flight.shedding import (
    BEATS,
    CALM_S,
    IN_ORDER,
    LATE_S,
    Shed,
    Shedding,
)

ON_TIME, LATE = 0.5 * LATE_S, 2.0 * LATE_S


def beats(shedding: Shedding, seconds: float, late: float) -> list[Shed]:
    """So many seconds of beats, of which this share is late."""
    count = round(seconds / 0.05)
    due = [k for k in range(count) if int((k + 1) * late) > int(k * late)]
    changes = (shedding.beat(LATE if k in due else ON_TIME) for k in range(count))
    return [change for change in changes if change is not None]


def test_a_program_that_keeps_up_gives_nothing_up() -> None:
    shedding = Shedding()
    assert beats(shedding, 60.0, 0.5) == []
    assert (shedding.pictures, shedding.search_every, shedding.frames_every) == (True, 1, 1)


def test_what_must_give_way_gives_way_in_order() -> None:
    shedding = Shedding()
    seen = [(shedding.pictures, shedding.search_every, shedding.frames_every)]
    changes: list[Shed] = []
    for _ in range(20 * 60):
        change = shedding.beat(LATE)
        changes += [] if change is None else [change]
        seen.append((shedding.pictures, shedding.search_every, shedding.frames_every))
    assert [(change.what, change.gone) for change in changes] == [(what, True) for what in IN_ORDER]
    states = [state for state, _ in groupby(seen)]
    assert states == [(True, 1, 1), (False, 1, 1), (False, 4, 1), (False, 4, 2), (False, 4, 3)]


def test_a_moment_of_lateness_costs_nothing() -> None:
    shedding = Shedding()
    beats(shedding, 10.0, 0.1)
    assert beats(shedding, 0.02 * BEATS, 1.0) == []
    assert beats(shedding, 10.0, 0.1) == []


def test_it_comes_back_one_by_one_after_calm_and_ever_more_slowly() -> None:
    shedding = Shedding()
    assert [change.what for change in beats(shedding, 4.2, 1.0)] == list(IN_ORDER[:2])
    assert beats(shedding, CALM_S - 0.5, 0.0) == []
    back = beats(shedding, 3.0, 0.0)
    assert [(change.what, change.gone) for change in back] == [(IN_ORDER[1], False)]
    assert beats(shedding, 1.5 * CALM_S, 0.0) == []  # twice as long
    assert [change.what for change in beats(shedding, CALM_S, 0.0)] == [IN_ORDER[0]]
    assert shedding.gone == 0


def frames_taken(shedding: Shedding, interval_ns: int, cycle_ns: int, count: int) -> list[int]:
    """The ids that a program looks at: always the newest there is, as soon as it is done and has
    waited.
    """
    now_ns, newest, taken = interval_ns, 0, list[int]()
    while newest < count:
        newest = max(newest + 1, now_ns // interval_ns)
        now_ns = max(now_ns, newest * interval_ns)
        shedding.took(newest, newest * interval_ns, now_ns)
        taken.append(newest)
        now_ns += cycle_ns
        now_ns += math.ceil(shedding.until_next_s(now_ns) * 1e9)
    return taken


def test_frames_are_left_out_evenly() -> None:
    shedding = Shedding()
    assert frames_taken(shedding, 33_000_000, 10_000_000, 30) == list(range(1, 31))
    beats(shedding, 6.4, 1.0)
    assert shedding.frames_every == 2
    steps = frames_taken(shedding, 33_000_000, 10_000_000, 60)
    assert {b - a for a, b in pairwise(steps[2:])} == {2}


def test_a_cycle_that_takes_longer_than_that_is_not_waited_for() -> None:
    shedding = Shedding()
    beats(shedding, 6.4, 1.0)
    taken = frames_taken(shedding, 33_000_000, 150_000_000, 60)
    assert {b - a for a, b in pairwise(taken)} <= {4, 5}

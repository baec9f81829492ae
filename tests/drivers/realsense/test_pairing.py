"""Colour and depth that were taken together find each other, whatever is lost, late or out of order
between the two.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.perception.stamp_clock import Domain
from drivers.realsense.sdk import Kind, RawImage
from drivers.realsense.stream import Pairing, Taken

MS = 1_000_000
PERIOD = 20 * MS
TOLERANCE = PERIOD // 2


def image(kind: Kind, number: int, stamp_ns: int) -> Taken:
    no_frame: Any = None
    return Taken(
        stamp_ns,
        0,
        RawImage(kind, number, stamp_ns, Domain.HARDWARE, np.zeros((1, 1), np.uint8), no_frame),
    )


def test_two_that_were_taken_together_are_a_pair_whichever_comes_first() -> None:
    pairing = Pairing(TOLERANCE)
    assert pairing.add(image("depth", 1, 0)) is None
    pair = pairing.add(image("color", 1, 3 * MS))
    assert pair is not None
    assert [each.image.kind for each in pair] == ["color", "depth"]
    assert pairing.add(image("color", 2, 23 * MS)) is None
    pair = pairing.add(image("depth", 2, 20 * MS))
    assert pair is not None
    assert [each.image.kind for each in pair] == ["color", "depth"]
    assert pairing.unpaired == 0


def test_a_lost_image_costs_its_pair_and_no_other() -> None:
    pairing, pairs = Pairing(TOLERANCE), []
    for number in range(10):
        if number != 4:
            pairing.add(image("depth", number, number * PERIOD))
        pair = pairing.add(image("color", number, number * PERIOD + 2 * MS))
        pairs += [] if pair is None else [tuple(each.image.number for each in pair)]
    assert pairs == [(number, number) for number in range(10) if number != 4]
    assert pairing.unpaired == 1


def test_one_stream_alone_is_no_pair_and_does_not_pile_up() -> None:
    pairing = Pairing(TOLERANCE)
    assert not any(pairing.add(image("color", number, number * PERIOD)) for number in range(100))
    assert sum(len(waiting) for waiting in pairing._waiting.values()) <= 2
    assert pairing.unpaired >= 98


@given(
    st.lists(
        st.tuples(st.booleans(), st.booleans(), st.booleans(), st.integers(-8, 8)),
        min_size=1,
        max_size=40,
    ),
)
def test_pairs_are_of_one_instant_and_every_image_is_used_once(
    instants: list[tuple[bool, bool, bool, int]],
) -> None:
    pairing, used, given_images = Pairing(TOLERANCE), [], 0
    for number, (has_color, has_depth, color_first, apart_ms) in enumerate(instants):
        taken = [image("color", number, number * PERIOD)] if has_color else []
        taken += [image("depth", number, number * PERIOD + apart_ms * MS)] if has_depth else []
        given_images += len(taken)
        pairs = [pairing.add(each) for each in (taken if color_first else reversed(taken))]
        for pair in pairs:
            if pair is not None:
                assert abs(pair[0].stamp_ns - pair[1].stamp_ns) <= TOLERANCE
                used.append((pair[0].image.number, pair[1].image.number))
        if has_color and has_depth:
            assert used and used[-1] == (number, number)
    assert len({color for color, _ in used}) == len({depth for _, depth in used}) == len(used)
    waiting = sum(len(each) for each in pairing._waiting.values())
    assert given_images == 2 * len(used) + pairing.unpaired + waiting

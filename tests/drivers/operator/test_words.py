"""What is said to D1 as JSON: every kind of statement is understood, and what is none is refused by
name.
"""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from drivers.operator.interfaces import BearingTold, Chosen, PlaceTold, Question, RegionTold, Shown
from drivers.operator.words import MOST_BYTES, WordsError, decode, encode_question
from path.observations import Box

NOW_NS = 50_000_000_000
QUESTION = Question(
    3,
    NOW_NS - 250_000_000,
    (Shown(7, Box(1.0, 2.0, 30.0, 40.0), (4.0, 1.5, -0.1), (0.3, 0.4, 0.0), 0.7),),
)


def said(words: Any) -> Any:
    return decode(json.dumps(words).encode(), NOW_NS)


def test_a_place_is_one_at_an_instant_with_its_error() -> None:
    told = said({"place": [4.2, -1.5], "error_m": 0.3, "age_s": 0.5})
    assert told == PlaceTold(NOW_NS - 500_000_000, (4.2, -1.5, 0.0), 0.3)
    told = said(
        {"place": [4, 1], "error_m": 1, "down_m": -2.5, "velocity_mps": [0.2, 0.1], "holds_s": 3}
    )
    assert told == PlaceTold(NOW_NS, (4.0, 1.0, -2.5), 1.0, True, (0.2, 0.1), 3.0)


def test_a_direction_edges_an_answer_and_a_hello() -> None:
    assert said({"bearing_deg": 90, "from": [1, 2], "error_deg": 5}) == BearingTold(
        NOW_NS, (1.0, 2.0), 0.5 * math.pi, math.radians(5.0)
    )
    assert said({"region": [[2, -1], [6, -1], [6, 1]]}) == RegionTold(
        NOW_NS, ((2.0, -1.0), (6.0, -1.0), (6.0, 1.0))
    )
    assert said({"question": 3, "number": 0}) == Chosen(3, 0)
    assert said({"hello": True}) is None


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ({"place": [4.2], "error_m": 0.3}, "place: "),
        ({"place": [4.2, "1"], "error_m": 0.3}, "place: "),
        ({"place": [4.2, 1e9], "error_m": 0.3}, "place: "),
        ({"place": [4.2, 1.0]}, "error_m: None"),
        ({"place": [4.2, 1.0], "error_m": 0}, "error_m: 0 is no number from 0.01"),
        ({"place": [4.2, 1.0], "error_m": True}, "error_m: True"),
        ({"place": [4.2, 1.0], "error_m": 0.3, "age_s": -1}, "age_s: -1"),
        ({"place": [4.2, 1.0], "error_m": 0.3, "colour": "red"}, "colour: not a word"),
        ({"bearing_deg": 400, "from": [0, 0], "error_deg": 5}, "bearing_deg: 400"),
        ({"bearing_deg": 40, "error_deg": 5}, "from: None"),
        ({"region": [[2, -1], [6, -1]]}, "region: not 3 to 64"),
        ({"question": 3}, "number: None"),
        ({"question": 3, "number": -1}, "number: -1"),
        ({"question": 3, "number": 1.5}, "number: 1.5"),
        ({}, "says none of"),
        ([1, 2], "no JSON object"),
    ],
)
def test_what_says_nothing_is_refused_by_what_is_wrong(words: Any, why: str) -> None:
    with pytest.raises(WordsError, match=why):
        said(words)


@pytest.mark.parametrize("line", [b"", b"\xff\x00", b"{", b'{"place": [NaN, 1], "error_m": 1}'])
def test_what_is_no_json_is_refused(line: bytes) -> None:
    with pytest.raises(WordsError, match="no JSON"):
        decode(line, NOW_NS)


def test_a_question_says_numbers_places_and_how_old_its_frame_is_and_its_picture_if_it_fits() -> (
    None
):
    asked = json.loads(encode_question(QUESTION, NOW_NS, b"jpeg"))
    assert (asked["asks"], asked["age_s"]) == (3, 0.25)
    assert asked["objects"] == [
        {
            "number": 7,
            "box": [1.0, 2.0, 30.0, 40.0],
            "north_m": 4.0,
            "east_m": 1.5,
            "speed_mps": 0.5,
            "share": 0.7,
        }
    ]
    assert asked["jpeg"] == "anBlZw=="
    large = encode_question(QUESTION, NOW_NS, bytes(MOST_BYTES))
    assert len(large) < 1000
    assert json.loads(encode_question(None, NOW_NS, None)) == {"asks": None}

"""The lines on a role program's standard output: its parent understands them, and skips a library's
own.
"""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flight.harness.flights import Progress, RoleResult, decode_event, encode_event
from flight.outcome import Outcome
from path.messages import Role

finite = st.floats(allow_nan=False)
roles = st.sampled_from(Role)
progresses = st.builds(
    Progress,
    role=roles,
    stamp_ns=st.integers(0, 2**63),
    phase=st.text(),
    count=st.integers(0, 1000),
    needed=st.integers(0, 1000),
    iou=st.none() | finite,
    tau=st.none() | finite,
    separation_m=st.none() | finite,
    link_bytes_per_s=finite,
    responsible=st.booleans(),
    note=st.text(),
    evidence=st.none() | st.tuples(finite, finite),
)
results = st.builds(
    RoleResult,
    role=roles,
    outcome=st.sampled_from(Outcome),
    detail=st.text(),
    responsible=st.booleans(),
    landed=st.booleans(),
)
PROGRESS = Progress(Role.SENDER, 5, "verify", 1, 350, 0.7, 0.3, None, 0.0, True, "note")


@given(progresses | results)
def test_an_event_survives_its_line(event: Progress | RoleResult) -> None:
    line = encode_event(event)
    assert "\n" not in line
    assert decode_event(line) == event
    assert decode_event(line.encode() + b"\n") == event


@given(st.text() | st.binary())
def test_what_is_no_event_is_none(line: str | bytes) -> None:
    assert decode_event(line) is None


@pytest.mark.parametrize(
    "line",
    [
        "",
        "null",
        "[]",
        "3",
        '"result"',
        "{}",
        '{"event": "progress"}',
        '{"event": "progress", "role": "sender"}',
        '{"event": "result", "role": "sender"}',
        '{"event": "result", "role": "pilot", "outcome": "committed"}',
        '{"event": "result", "role": {}, "outcome": []}',
        "[10:47:33|Info ] System discovered (system_impl.cpp:228)",
        b"\xff\xfe\x00",
        "[" * 100_000,
    ],
)
def test_lines_of_libraries_and_cut_off_lines_are_none(line: str | bytes) -> None:
    assert decode_event(line) is None


@pytest.mark.parametrize("cut", [1, 20, -1, -2])
def test_a_line_cut_off_is_none(cut: int) -> None:
    assert decode_event(encode_event(PROGRESS)[:cut]) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"event": "results"},
        {"outcome": "fine"},
        {"outcome": []},
        {"landed_m": 3},
        {"role": "pilot"},
    ],
)
def test_an_event_of_another_version_is_none(changes: dict[str, object]) -> None:
    record = json.loads(encode_event(RoleResult(Role.SENDER, Outcome.GUARD, "", False, True)))
    assert decode_event(json.dumps(record)) is not None
    assert decode_event(json.dumps({**record, **changes})) is None

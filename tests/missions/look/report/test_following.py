"""D1 behind its target, in truth: how far past its place, how far off it, and how long without the
target.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from drivers.log.mcap_log import LogRecord
from missions.look.report.following import following_of
from missions.look.report.records import Records, RunRecords
from missions.look.report.truth import truth_of

OFFSET_NS = 5_000_000_000  # of D1's clock from the world's
BEHIND_M = 1.5
_UNIT: dict[str, Any] = {"t": [0.0, 0.0, 0.0], "q": [1.0, 0.0, 0.0, 0.0]}
_CAMERA = {
    "width": 320,
    "height": 240,
    "fx": 300.0,
    "fy": 300.0,
    "cx": 160.0,
    "cy": 120.0,
    "distortion": [0.0] * 5,
}


def _record(topic: str, stamp_ns: int, record: dict[str, Any]) -> LogRecord:
    return LogRecord(topic=topic, stamp_ns=stamp_ns, record=record)


def _world(along_m: Callable[[float], float], heading_deg: float) -> Records:
    """D1 flies along the heading, ``along_m(s)`` from the start; the target stands 4 m from
    there.
    """
    ahead = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    scene = {
        "target_id": 3,
        "min_separation_m": 0.7,
        "boxes": [{"c": [0.0, 0.0, 0.1], "s": [0.3, 0.2, 0.2]}],
        "clock_offset_ns": {"sender": OFFSET_NS, "receiver": 0},
        "cameras": dict.fromkeys(("sender", "receiver"), _CAMERA),
        "mounts": {"sender": {"T_b_c": _UNIT, "T_b_v": _UNIT}, "receiver": {"T_b_c": _UNIT}},
    }
    target = {"id": 3, "t": [4.0 * ahead[0], 4.0 * ahead[1], 0.0], "yaw": 0.0}
    truth = [
        {
            "sender": {
                **_UNIT,
                "t": [ahead[0] * along_m(0.1 * k), ahead[1] * along_m(0.1 * k), 1.5],
                "in_air": True,
            },
            "receiver": {**_UNIT, "in_air": False},
            "objects": [target],
        }
        for k in range(200)
    ]
    return {
        "/scene": [_record("/scene", 0, scene)],
        "/truth": [_record("/truth", k * 100_000_000, each) for k, each in enumerate(truth)],
    }


def _sender(heading_deg: float, missed_s: tuple[float, float] = (0.0, 0.0)) -> Records:
    def own_ns(seconds: float) -> int:
        return OFFSET_NS + round(seconds * 1e9)

    phases = ((0.0, "acquire"), (5.0, "follow"), (12.0, "verify"), (15.0, "depart"))
    setup = {"mission": {"heading_deg": heading_deg, "follow": {"behind_m": BEHIND_M}}}
    boxes = [
        (k * 0.1, None if missed_s[0] <= k * 0.1 <= missed_s[1] else [0, 0, 9, 9])
        for k in range(50, 150)
    ]
    return {
        "/setup": [_record("/setup", own_ns(0.0), setup)],
        "/phase": [_record("/phase", own_ns(at_s), {"phase": name}) for at_s, name in phases],
        "/target": [_record("/target", own_ns(at_s), {"box": box}) for at_s, box in boxes],
    }


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, -30.0])
def test_a_drone_past_its_place_has_overshot_in_any_heading(heading_deg: float) -> None:
    # it is at 2.5 m, its place, after 5 s, and 0.2 m past it for a second
    def along_m(at_s: float) -> float:
        return 0.5 * at_s if at_s < 5.0 else (2.7 if 8.0 < at_s < 9.0 else 2.5)

    run = RunRecords(None, _sender(heading_deg), {}, _world(along_m, heading_deg))
    followed = following_of(run, truth_of(run.world))
    assert followed is not None
    assert followed.overshoot_m == pytest.approx(0.2, abs=1e-6)
    assert followed.off_m[:, 1] == pytest.approx(0.0, abs=1e-6)
    assert sorted(set(followed.errors_m.round(6).tolist())) == [0.0, 0.2]


def test_the_heading_is_the_one_it_was_told_before_it_followed() -> None:
    """It found its target from another side than its mission names."""
    sender = _sender(0.0)
    told = [
        _record("/setpoint", OFFSET_NS + round(at_s * 1e9), {"yaw_rad": yaw_rad})
        for at_s, yaw_rad in ((4.9, 0.5 * math.pi), (15.1, 1.0))
    ]
    sender = {**sender, "/setpoint": told}
    run = RunRecords(None, sender, {}, _world(lambda _: 2.4, 90.0))
    followed = following_of(run, truth_of(run.world))
    assert followed is not None
    assert followed.errors_m == pytest.approx(0.1, abs=1e-6)


def test_the_way_to_the_place_is_no_error_of_following() -> None:
    def along_m(at_s: float) -> float:  # acquired 1 m before its place
        return 1.5 if at_s < 7.0 else 2.4

    run = RunRecords(None, _sender(0.0), {}, _world(along_m, 0.0))
    followed = following_of(run, truth_of(run.world))
    assert followed is not None
    assert followed.overshoot_m == 0.0
    assert followed.errors_m == pytest.approx(0.1, abs=1e-6)


def test_the_longest_time_without_the_target_is_told() -> None:
    run = RunRecords(None, _sender(0.0, missed_s=(8.05, 9.95)), {}, _world(lambda _: 2.5, 0.0))
    followed = following_of(run, truth_of(run.world))
    assert followed is not None
    assert followed.unseen_s == pytest.approx(2.0, abs=0.01)


def test_a_run_that_never_followed_or_has_no_truth_tells_nothing() -> None:
    sender, world = _sender(0.0), _world(lambda _: 2.5, 0.0)
    assert following_of(RunRecords(None, sender, {}, {}), None) is None
    on_the_ground = {**sender, "/phase": sender["/phase"][:1]}
    assert following_of(RunRecords(None, on_the_ground, {}, world), truth_of(world)) is None

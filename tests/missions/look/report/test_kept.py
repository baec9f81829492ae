"""A target that is lost soon after it was taken over, or another one that is followed then, is told
and counted.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.log.mcap_log import LogRecord
from missions.look.report.command import series_table, show, summarize_many
from missions.look.report.kept import kept_of
from missions.look.report.records import Records, RunRecords, load_run
from missions.look.report.summary import summarize
from missions.look.report.truth import truth_of

TAKEN_S, LANDS_S = 20.0, 26.0
UNIT: dict[str, Any] = {"t": [0.0, 0.0, 0.0], "q": [1.0, 0.0, 0.0, 0.0]}
CAMERA = {
    "width": 320,
    "height": 240,
    "fx": 300.0,
    "fy": 300.0,
    "cx": 160.0,
    "cy": 120.0,
    "distortion": [0.0] * 5,
}
# 2 m below the camera, and a metre beside that
TARGET_PX, OTHER_PX = (160.0, 120.0), (310.0, 120.0)


def record(topic: str, seconds: float, what: dict[str, Any]) -> LogRecord:
    return LogRecord(topic, round(seconds * 1e9), what)


def world() -> Records:
    scene = {
        "target_id": 0,
        "min_separation_m": 0.7,
        "boxes": [{"c": [0.0, 0.0, 0.0], "s": [0.3, 0.2, 0.2]}],
        "clock_offset_ns": {"sender": 0, "receiver": 0},
        "cameras": dict.fromkeys(("sender", "receiver"), CAMERA),
        "mounts": {"sender": {"T_b_c": UNIT, "T_b_v": UNIT}, "receiver": {"T_b_c": UNIT}},
    }
    things = [{"id": k, "t": [float(k), 0.0, 2.0], "yaw": 0.0} for k in (0, 1)]
    body = {**UNIT, "in_air": True}
    truth = {"sender": body, "receiver": body, "objects": things}
    return {
        "/scene": [record("/scene", 0.0, scene)],
        "/truth": [record("/truth", 0.5 * k, truth) for k in range(80)],
    }


def receiver(box_at: Callable[[float], tuple[float, float] | None]) -> Records:
    seen: list[LogRecord] = []
    for k in range(round(25.0 * LANDS_S)):
        pixel = box_at(k / 25.0)
        box = None if pixel is None else [pixel[0] - 10.0, pixel[1] - 10.0, 20.0, 20.0]
        seen.append(record("/track", k / 25.0, {"box": box, "reason": None}))
    phases = ((10.0, "verify"), (TAKEN_S, "follow"), (LANDS_S, "land"))
    return {
        "/track": seen,
        "/phase": [record("/phase", at_s, {"phase": name}) for at_s, name in phases],
    }


@pytest.mark.parametrize("knows_truth", [True, False])
@pytest.mark.parametrize(
    ("seen_until_s", "lost", "kept_s"),
    [
        (LANDS_S, False, 6.0),
        (25.0, False, 5.0),  # a miss at the end is no loss yet
        (22.0, True, 2.0),
        (0.0, True, 0.0),
    ],
    ids=["kept", "missed at the end", "lost", "never seen"],
)
def test_a_target_without_boxes_at_the_end_is_lost(
    seen_until_s: float, lost: bool, kept_s: float, knows_truth: bool
) -> None:
    def box_at(seconds: float) -> tuple[float, float] | None:
        return TARGET_PX if seconds < seen_until_s else None

    run = RunRecords(None, {}, receiver(box_at), world())
    kept = kept_of(run, truth_of(run.world) if knows_truth else None)
    assert kept is not None
    assert kept.lost is lost
    assert kept.seconds == pytest.approx(kept_s, abs=0.1)


def test_a_drone_that_goes_over_to_another_object_has_lost_its_target() -> None:
    run = RunRecords(None, {}, receiver(lambda s: TARGET_PX if s < 21.0 else OTHER_PX), world())
    kept = kept_of(run, truth_of(run.world))
    assert kept is not None
    assert kept.lost
    assert kept.seconds == pytest.approx(1.0, abs=0.1)


def test_without_a_hand_over_there_is_nothing_to_keep() -> None:
    assert kept_of(RunRecords(None, {}, {}, world()), truth_of(world())) is None


def test_lost_ones_are_counted_in_the_table_of_many_runs(make_run: Callable[..., Path]) -> None:
    good = summarize(load_run(make_run()))
    series = summarize_many(
        [{**good, "lost_after_taking_over": lost} for lost in (True, False, None)], "x"
    )
    assert series["lost_after_taking_over"] == 1
    shown = io.StringIO()
    show(series_table(series), shown)
    assert "lost after taking over     1" in shown.getvalue()

"""The records hold fields that ``drivers.log.topics`` lists, for those who report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.log.mcap_log import McapLog, read_log
from drivers.log.topics import TOPICS
from flight.frame.records import (
    Answer,
    OwnFrame,
    agreement_record,
    box_record,
    candidate_record,
    marker_record,
    target_record,
)
from flight.rendezvous.marker_view import MarkerFix
from flight.tracking.association import Sighting
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior
from path.cycle.sender import PairVerdict
from path.gate.agreement import Agreed
from path.gate.evidence import make_gate
from path.gate.window import Evidence
from path.geometry.rigid import rigid, transform_back
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Pose
from path.messages import Candidate, Target
from path.observations import Box, Depth, Detection, MarkerDetection, Missed, MissReason, Region

CAMERA = CameraModel(640, 480, 615.0, 615.0, 320.0, 240.0, (0.1, -0.2, 0.0, 0.0, 0.05))
BOX = Box(10.0, 20.0, 30.0, 40.0)
TARGET = Target(1, 2, 3, 77, 123, (0.1, 0.2, 0.3), (0.0, -1.0, 0.0), 0.02)
FOUND = Candidate(1, 2, 3, 5, 77, 456, BOX, None, (0.0, 0.1, 1.2), (1.0, 0.0, 0.0, 0.0), 0.01)
NONE = Candidate(
    1, 2, 3, 6, 77, 457, None, MissReason.NO_CANDIDATE, (0.0, 0.1, 1.2), (1.0, 0.0, 0.0, 0.0), 0.01
)
MISSED = Missed(MissReason.NO_MARKER)
POSE = Pose(R_from_rpy(0.2, -0.4, 1.0), np.array([0.3, -0.1, 1.4]))
COVARIANCE = np.diag([1e-4, 2e-4, 3e-4, 1e-6, 1e-6, 1e-6])
FIX = MarkerFix(
    POSE, COVARIANCE, 24.0, (MarkerDetection(0, np.arange(8.0).reshape(4, 2), np.eye(8)),)
)
GATE = make_gate(MethodConfig())
PRIOR = Prior(
    CAMERA.project_point((0.2, 0.1, 2.0)),
    2.0,
    (4.0, 0.0, 4.0),
    Region(1.0, 2.0, 3.0, 4.0),
    77,
    rigid(POSE),
    0.01,
    transform_back(rigid(POSE), (0.2, 0.1, 2.0)),
)


def check(topic: str, record: dict[str, Any]) -> None:
    assert set(record) <= set(TOPICS[topic].fields)
    json.loads(msgspec.json.encode(record, enc_hook=lambda value: value.tolist()))


def test_a_target_that_was_sent() -> None:
    record = target_record(OwnFrame(9, 123, Sighting(BOX, Depth(1.5, 0.02)), TARGET), 130)
    check("/target", record)
    assert (record["sequence"], record["capture_ns"], record["judged_ns"]) == (77, 123, 130)
    assert (record["box"], record["beside"]) == ([10.0, 20.0, 30.0, 40.0], [])
    assert (record["depth_m"], record["depth_sigma_m"]) == (1.5, 0.02)
    assert (record["point_v_m"], record["reason"]) == ((0.1, 0.2, 0.3), None)


def test_a_box_without_a_point_says_why() -> None:
    record = target_record(OwnFrame(9, 123, Sighting(BOX, None), Missed(MissReason.NO_DEPTH)), 130)
    check("/target", record)
    assert (record["box"], record["depth_m"], record["point_v_m"]) == (
        [10.0, 20.0, 30.0, 40.0],
        None,
        None,
    )
    assert record["reason"] == "no_depth"


def test_a_frame_without_a_target_says_why_it_was_not_seen_and_has_a_number() -> None:
    seen = MissReason.AMBIGUOUS_TARGET
    record = target_record(OwnFrame(65536 + 9, 123, seen, Missed(MissReason.NO_TARGET)), 130)
    check("/target", record)
    assert record == {
        "frame_id": 65545,
        "sequence": 9,
        "capture_ns": 123,
        "judged_ns": 130,
        "box": None,
        "depth_m": None,
        "depth_sigma_m": None,
        "beside": None,
        "point_v_m": None,
        "gravity_v": None,
        "sigma_m": None,
        "reason": "ambiguous_target",
    }


def test_an_agreement() -> None:
    verdict = Agreed(iou=0.7, tau=0.3, count=12)
    record = agreement_record(
        PairVerdict(FOUND, 456, verdict, BOX, Box(11.0, 21.0, 30.0, 40.0), 0.3), GATE, 350, 3
    )
    check("/agreement", record)
    assert (record["agreed"], record["counted"], record["reason"]) == (True, True, None)
    assert (record["iou"], record["tau"], record["count"], record["needed"]) == (0.7, 0.3, 12, 350)
    assert (record["sequence"], record["target_sequence"], record["target_id"]) == (5, 77, 3)
    assert record["mapped_box"] == [11.0, 21.0, 30.0, 40.0]


def test_an_agreement_of_the_gate_that_goes_by_evidence() -> None:
    pair = PairVerdict(FOUND, 456, Agreed(0.7, 0.3, 12, Evidence(3.7, 4.3)), BOX, BOX)
    record = agreement_record(pair, GATE, 30, 3)
    check("/agreement", record)
    assert (record["evidence"], record["evidence_needed"], record["epoch"]) == (
        3.7,
        4.3,
        FOUND.epoch,
    )


@pytest.mark.parametrize(("ignored", "counted"), [(True, False), (False, True)])
def test_a_miss_counts_unless_it_was_no_evidence_at_all(ignored: bool, counted: bool) -> None:
    verdict = Missed(MissReason.LOW_IOU, iou=0.1, ignored=ignored)
    record = agreement_record(PairVerdict(FOUND, 456, verdict, BOX, None), GATE, 350, 3)
    check("/agreement", record)
    assert (record["agreed"], record["counted"], record["reason"]) == (False, counted, "low_iou")
    assert (record["iou"], record["tau"], record["mapped_box"]) == (0.1, None, None)


def test_a_gap_in_the_answers_has_no_candidate() -> None:
    record = agreement_record(
        PairVerdict(None, 456, Missed(MissReason.LINK_SILENT), None, None), GATE, 350, 3
    )
    check("/agreement", record)
    assert (record["sequence"], record["target_sequence"]) == (None, None)


def test_a_candidate_with_its_prior() -> None:
    record = candidate_record(Answer(FOUND, PRIOR, [Detection(BOX, 0.9)]))
    check("/candidate", record)
    assert record["region"] == [1.0, 2.0, 3.0, 4.0]
    assert record["box"] == [10.0, 20.0, 30.0, 40.0]
    # the point in D2's camera, carried back to the marker's frame
    assert POSE.apply(np.array(record["point_v_m"])) == pytest.approx(
        np.array([0.2, 0.1, 2.0]), abs=1e-9
    )


def test_a_candidate_without_a_prior_says_why() -> None:
    record = candidate_record(Answer(NONE, MISSED, []))
    check("/candidate", record)
    assert (record["reason"], record["box"]) == ("no_candidate", None)
    assert (record["prior_px"], record["region"], record["point_v_m"]) == (None, None, None)


def test_markers_seen_and_missed() -> None:
    seen = marker_record(5, FIX)
    check("/marker", seen)
    assert (seen["reason"], seen["side_px"]) == (None, 24.0)
    assert seen["position_v_m"] == pytest.approx(tuple(POSE.inverse().t), abs=1e-12)
    assert seen["sigma_m"] == pytest.approx(np.sqrt(2e-4))
    missed = marker_record(6, MISSED)
    assert missed == {
        "capture_ns": 6,
        "position_v_m": None,
        "corners_px": None,
        "reason": "no_marker",
        "cause": None,
    }


def test_no_box_is_null() -> None:
    assert box_record(None) is None


def test_the_records_survive_the_log(tmp_path: Path) -> None:
    with McapLog(tmp_path / "x.mcap") as log:
        log.write("/marker", 5, marker_record(5, FIX))
        log.write("/candidate", 6, candidate_record(Answer(FOUND, PRIOR, [Detection(BOX, 0.9)])))
        assert log.failed is None
    marker, candidate = read_log(tmp_path / "x.mcap")
    assert marker.record["corners_px"][6:] == [6.0, 7.0]
    assert candidate.record["region"] == [1.0, 2.0, 3.0, 4.0]

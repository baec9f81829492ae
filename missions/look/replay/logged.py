"""Values as they were before they were logged."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from drivers.log.mcap_log import encode_other
from path.camera.model import CameraModel
from path.camera.thinning import Thinning
from path.geometry.transforms import Matrix, Pose
from path.messages import Candidate, Target
from path.observations import Box, MissReason

Record = Mapping[str, Any]
NINE = 9  # numbers of a doubt
NAN3 = (math.nan, math.nan, math.nan)


def as_logged(record: Record) -> dict[str, Any]:
    """Return a record as it comes back from a log."""
    return msgspec.json.decode(msgspec.json.encode(record, enc_hook=encode_other))


def camera_of(record: Record) -> CameraModel:
    """Logs of earlier versions tell neither doubts nor left-out pixels: there were none, as far as
    the log goes.
    """
    doubts = record.get("doubts") or ()
    thin = record.get("thinning")
    values: dict[str, Any] = {
        **record,
        "distortion": tuple(record["distortion"]),
        "doubts": tuple(tuple(doubts[k : k + NINE]) for k in range(0, len(doubts), NINE)),
        "thinning": None
        if thin is None
        else Thinning(thin["kept"], thin["of"], (thin["begins"][0], thin["begins"][1])),
    }
    return CameraModel(**values)


def box_of(box: Any) -> Box | None:
    return None if box is None else Box(*box)


def _numbers(values: Any) -> Any:
    """Return numbers as they were before the log: what was not finite is null in it."""
    return tuple(math.nan if value is None else value for value in values)


def candidate_of(record: Record) -> Candidate:
    return Candidate(
        record["handoff_id"],
        record["epoch"],
        record["target_id"],
        record["sequence"],
        record["target_sequence"],
        record["peer_capture_ns"],
        None if record["box"] is None else Box(*_numbers(record["box"])),
        None if record["reason"] is None else MissReason(record["reason"]),
        _numbers(record["position_v_m"]),
        _numbers(record["rotation_v_c2"]),
        math.nan if record["sigma_m"] is None else record["sigma_m"],
    )


def target_of(record: Record) -> Target:
    return Target(
        record["handoff_id"],
        record["epoch"],
        record["target_id"],
        record["sequence"],
        record["peer_capture_ns"],
        _numbers(record["point_v_m"]),
        _numbers(record["gravity_v"]),
        math.nan if record["sigma_m"] is None else record["sigma_m"],
    )


def pose_of(rows: Any) -> Pose:
    """A pose from the upper three rows of its matrix, one after another."""
    matrix: Matrix = np.reshape(np.array(rows, float), (3, 4))
    return Pose(np.ascontiguousarray(matrix[:, :3]), matrix[:, 3].copy())

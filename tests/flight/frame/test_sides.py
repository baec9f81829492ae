"""Both sides of an attempt, frame by frame: what one says, the other answers, and what comes of
it.
"""

from __future__ import annotations

import numpy as np

from flight.frame.receiver import ReceiverSide
from flight.frame.records import AttemptId
from flight.frame.sender import PairCameras, SenderSide
from flight.rendezvous.marker_view import MarkerFix
from flight.tracking.association import Sighting
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior
from path.geometry.transforms import Pose
from path.messages import Target
from path.observations import Box, Depth, Detection, Missed, MissReason

CAMERA = CameraModel(160, 160, 600.0, 600.0, 80.0, 80.0)
T_V_C1 = Pose(np.eye(3), np.array([0.1, 0.2, 0.3]))
CAMERAS = PairCameras(CAMERA, CAMERA, T_V_C1)
ATTEMPT = AttemptId(7, 2, 3)
BOX, DEPTH, DOWN = Box(60.0, 60.0, 40.0, 40.0), Depth(2.0, 0.02), (0.0, 0.6, 0.8)
SEEN_FROM_D1S_PLACE = MarkerFix(T_V_C1.inverse(), 1e-6 * np.eye(6), 40.0, ())
FRAME_NS = 20_000_000


def test_what_d1_says_is_answered_by_d2_and_judged_by_d1() -> None:
    method = MethodConfig()
    sender, receiver = SenderSide(CAMERAS, method, ATTEMPT), ReceiverSide(CAMERAS, method, ATTEMPT)
    own = sender.observe(1, FRAME_NS, Sighting(BOX, DEPTH), DOWN)
    assert isinstance(own.message, Target)
    assert (own.message.handoff_id, own.message.epoch, own.message.target_id) == ATTEMPT
    assert receiver.hear(own.message, FRAME_NS, FRAME_NS) is None
    prior = receiver.prior(SEEN_FROM_D1S_PLACE, FRAME_NS + 1)
    assert isinstance(prior, Prior)
    answer = receiver.answer(1, FRAME_NS + 1, (Detection(BOX, 1.0),), prior)
    assert answer is not None and answer.candidate.box == BOX
    assert sender.hear(answer.candidate, FRAME_NS + 1, FRAME_NS + 2) is None
    assert sender.judge(FRAME_NS + 2) == []  # D1 has no frame after it yet
    sender.observe(2, 2 * FRAME_NS, Sighting(BOX, DEPTH), DOWN)
    (pair,) = sender.judge(2 * FRAME_NS)
    record = sender.record(pair)
    assert record["agreed"] and record["target_id"] == ATTEMPT.target_id


def test_a_frame_without_the_target_is_a_miss_and_its_reason_is_the_trackers() -> None:
    own = SenderSide(CAMERAS, MethodConfig(), ATTEMPT).observe(
        1, FRAME_NS, MissReason.AMBIGUOUS_TARGET, DOWN
    )
    assert own.seen is MissReason.AMBIGUOUS_TARGET
    assert isinstance(own.message, Missed) and own.message.reason is MissReason.NO_TARGET


def test_a_marker_that_was_not_seen_goes_out_as_the_answers_reason_and_a_frame_is_answered_once() -> (
    None
):
    receiver = ReceiverSide(CAMERAS, MethodConfig(), ATTEMPT)
    prior = receiver.prior(Missed(MissReason.NO_MARKER), FRAME_NS)
    answer = receiver.answer(1, FRAME_NS, (), prior)
    assert answer is not None and answer.candidate.reason is MissReason.NO_MARKER
    assert receiver.answer(1, FRAME_NS, (), prior) is None

"""Compile, or load from numba's cache, what both cycles compute, before a flight needs it."""

from __future__ import annotations

import numpy as np

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.receiver import ReceiverCycle
from path.cycle.sender import SenderCycle
from path.geometry.transforms import Pose
from path.messages import Candidate, Target
from path.observations import Box, Depth, Detection, Missed
from path.target.place import registered_depth
from path.target.rivals import SEEN_TIMES, Rival

CAMERA = CameraModel(160, 160, 600.0, 600.0, 80.0, 80.0)
BOX = Box(60.0, 60.0, 40.0, 40.0)
DEPTH = Depth(2.0, 0.02)
DOWN = (0.0, 0.6, 0.8)
FRAME_NS = 20_000_000


def warm_up_cycles() -> None:
    """Run one pair of frames that agree, with something beside the target.

    Raises RuntimeError when they do not.
    """
    if registered_depth(np.full((160, 160), 2000, np.uint16), BOX, MethodConfig()) is None:
        raise RuntimeError("a flat surface has no depth: reinstall numba")
    T_v_c = Pose(np.eye(3), np.array([0.1, 0.2, 0.3]))
    config = MethodConfig()
    sender = SenderCycle(CAMERA, CAMERA, T_v_c, config, handoff_id=1, epoch=1, target_id=1)
    receiver = ReceiverCycle(CAMERA, config, handoff_id=1, epoch=1, target_id=1)
    beside = (Rival(Box(10.0, 60.0, 40.0, 40.0), DEPTH),)
    candidate: Candidate | Missed | None = None
    for frame in range(1, SEEN_TIMES + 2):
        stamp_ns = frame * FRAME_NS
        if isinstance(candidate, Candidate):
            sender.offer(candidate, candidate.capture_ns, stamp_ns)
        target = sender.observe(frame, stamp_ns, BOX, DEPTH, DOWN, beside)
        if isinstance(target, Target):
            receiver.on_target(target, stamp_ns, stamp_ns)
        prior = receiver.prior(T_v_c.inverse(), 1e-6 * np.eye(6), stamp_ns + 1)
        candidate = receiver.candidate(
            frame, stamp_ns + 1, (Detection(BOX, 1.0), Detection(BOX, 0.5)), prior
        )
    pairs = sender.evaluate_ready(SEEN_TIMES * FRAME_NS + FRAME_NS)
    if not sender.agreed or pairs[-1].offsets is None or not pairs[-1].offsets.rivals_m:
        raise RuntimeError("two boxes of the same place do not agree: reinstall numba")

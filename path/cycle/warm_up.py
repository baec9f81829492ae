"""Compile, or load from numba's cache, what both cycles compute, before a flight needs it."""

from __future__ import annotations

import numpy as np

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.sender import SenderCycle
from path.geometry.transforms import Pose
from path.messages import Candidate, Vec3
from path.observations import Box, Depth
from path.target.rivals import SEEN_TIMES, Rival

CAMERA = CameraModel(160, 160, 600.0, 600.0, 80.0, 80.0)
BOX, DEPTH, DOWN = Box(60.0, 60.0, 40.0, 40.0), Depth(2.0, 0.02), (0.0, 0.6, 0.8)
FRAME_NS = 20_000_000


def warm_up_cycles() -> None:
    """One pair of frames that agree, with something beside the target. Raises RuntimeError when they do not."""
    T_v_c = Pose(np.eye(3), np.array([0.1, 0.2, 0.3]))
    sender = SenderCycle(CAMERA, CAMERA, T_v_c, MethodConfig(), handoff_id=1, epoch=1, target_id=1)
    beside = (Rival(Box(10.0, 60.0, 40.0, 40.0), DEPTH),)
    frames = range(1, SEEN_TIMES + 2)
    for frame in frames:
        sender.observe(frame, frame * FRAME_NS, BOX, DEPTH, DOWN, beside)
    stamp_ns = frames[-2] * FRAME_NS + FRAME_NS // 2
    at: Vec3 = (0.1, 0.2, 0.3)
    candidate = Candidate(1, 1, 1, 1, frames[-2], stamp_ns, BOX, None, at, (1.0, 0.0, 0.0, 0.0), 0.01)
    sender.offer(candidate, stamp_ns, frames[-1] * FRAME_NS)
    pairs = sender.evaluate_ready(frames[-1] * FRAME_NS)
    if not sender.agreed or pairs[0].offsets is None:
        raise RuntimeError("two boxes of the same place do not agree: reinstall numba")

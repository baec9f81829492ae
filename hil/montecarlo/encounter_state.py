"""What an encounter in one kernel is made of: what does not change, what both cameras gave, what is carried on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.montecarlo.encounter_method import SAMPLE, Rules
from hil.montecarlo.encounter_pose import Limits, Print
from hil.montecarlo.encounter_relative import Believes, Filter, Reports, fresh_filter
from hil.montecarlo.encounter_window import fresh_window

SENDER_FRAME, TARGET_HEARD, RECEIVER_FRAME, CANDIDATE_HEARD = 0, 1, 2, 3
TARGET = 7  # values of a target as D2 keeps it: point, gravity, standard deviation
# Columns of a candidate: box, standard deviation of the pose, whose box.
POSE_SIGMA_2, WHOSE_2 = 4, 5
CANDIDATE = 6
MAX_PENDING = 64
# Counters of a play.
NEXT, FRAMES, TARGETS, PENDING, ENTRIES, DONE = 0, 1, 2, 3, 4, 5
COUNTERS = 6
# Columns of an entry, whole numbers and others.
KIND, REASON, NOW, SEQUENCE, CAPTURE, OWN_FRAMES, RIGHT, SAME = 0, 1, 2, 3, 4, 5, 9, 10
ENTRY_INTS = 11
IOU, Z_M, SIGMA_M = 0, 2, 3
ENTRY_FLOATS = 4


class Setup(NamedTuple):
    """What does not change between attempts, as both drones believe it."""

    rules: Rules
    limits: Limits
    printed: Print
    lens_1: np.ndarray
    lens_2: np.ndarray
    mount: np.ndarray  # (3, 4) T_v_c1
    R_b_v: np.ndarray
    reach_m: float  # of the marker, where it is looked for
    believes: Believes


class Seen(NamedTuple):
    """What both cameras gave: see ``hil.montecarlo.encounter_sight``; numbers and stamps of the frames.

    ``gravity_v``, ``gravity_c``: (n, 3) as each drone believes; ``R_n_c``: of D2's camera, (n, 3, 3).
    ``own_moves``, ``peer_moves``: what both vehicles report; ``heard``: (n,) how many of D1's reports D2 has by a frame
    (of its own, one for each frame); ``peer_yaw``: of D1 in each of its reports.
    """

    number_1: np.ndarray
    stamp_1: np.ndarray
    own: np.ndarray
    gravity_v: np.ndarray
    number_2: np.ndarray
    stamp_2: np.ndarray
    markers: np.ndarray
    found: np.ndarray
    many: np.ndarray
    gravity_c: np.ndarray
    R_n_c: np.ndarray
    shift_c: np.ndarray
    turn: np.ndarray  # (3, 3), of D2's pose
    own_moves: Reports
    peer_moves: Reports
    peer_yaw: np.ndarray
    heard: np.ndarray


class State(NamedTuple):
    """Everything that a play carries on: made by ``fresh``."""

    counters: np.ndarray
    window: np.ndarray
    valid_1: np.ndarray
    samples: np.ndarray
    target_number: np.ndarray
    target_stamp: np.ndarray
    target_valid: np.ndarray
    target_values: np.ndarray
    pending: np.ndarray
    candidate: np.ndarray
    candidate_reason: np.ndarray
    answered: np.ndarray
    pose_R: np.ndarray
    pose_t: np.ndarray
    size_1m: np.ndarray
    searched: np.ndarray
    filter: Filter
    ints: np.ndarray
    floats: np.ndarray


def fresh(frames_1: int, frames_2: int) -> State:
    window = fresh_window()
    entries = frames_1 + frames_2
    return State(
        np.zeros(COUNTERS, np.int64), window, np.zeros(frames_1, np.bool_), np.zeros((frames_1, SAMPLE)),
        np.zeros(frames_1, np.int64), np.zeros(frames_1, np.int64), np.ones(frames_1, np.bool_),
        np.zeros((frames_1, TARGET)), np.zeros(MAX_PENDING, np.int64), np.zeros((frames_2, CANDIDATE)),
        np.zeros(frames_2, np.int64), np.zeros(frames_2, np.int64), np.zeros((frames_2, 3, 3)),
        np.zeros((frames_2, 3)), np.zeros(2), np.zeros(1, np.int64), fresh_filter(),
        np.zeros((entries, ENTRY_INTS), np.int64), np.zeros((entries, ENTRY_FLOATS)),
    )  # fmt: skip

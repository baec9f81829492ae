"""D1's true place behind its target, from the frame that acquired it until it gave the target
away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.log.mcap_log import LogRecord
from missions.look.report.records import RunRecords, first
from missions.look.report.truth import Truth
from path.arrays import Array, Whole
from path.messages import Role
from path.values import frozen

FOLLOWING = ("follow", "verify")
# across the ground, from its place: until it was so near it was still on its way there
SETTLED_M = 0.35


@frozen
class Following:
    """Rows are instants of truth.

    Attributes:
        stamps_ns: of the world's clock.
        off_m: (n, 2), ahead of its place and right of it, in the heading it follows in.
        unseen_s: the longest time without a box of the target.
    """

    stamps_ns: Whole
    off_m: Array
    unseen_s: float

    @property
    def overshoot_m(self) -> float:
        """Return how far it was past its place at most: towards the target, and the target out of
        the image below.
        """
        return max(0.0, float(self.off_m[:, 0].max()))

    @property
    def errors_m(self) -> Array:
        """Distances from its place, once it had come there; empty when it never did."""
        distances = np.hypot(self.off_m[:, 0], self.off_m[:, 1])
        there = np.flatnonzero(distances < SETTLED_M)
        return distances[there[0] :] if len(there) else distances[:0]


def following_of(run: RunRecords, truth: Truth | None) -> Following | None:
    """None where D1 never followed, or nobody knows where it was meant to be."""
    setup = first(run.sender, "/setup")
    phases = run.sender.get("/phase", ())
    begin = next((r.stamp_ns for r in phases if r.record["phase"] in FOLLOWING), None)
    if truth is None or setup is None or begin is None:
        return None
    end = next(
        (r.stamp_ns for r in phases if r.stamp_ns > begin and r.record["phase"] not in FOLLOWING),
        None,
    )
    if end is None:
        end = max(topic[-1].stamp_ns for topic in run.sender.values())
    stamps_ns, offset_m = truth.way_to(Role.SENDER, truth.scene.target_id)
    begin_ns = truth.to_world_ns(Role.SENDER, begin)
    end_ns = truth.to_world_ns(Role.SENDER, end)
    within = (stamps_ns >= begin_ns) & (stamps_ns <= end_ns) & np.isfinite(offset_m[:, 0])
    if not within.any():
        return None
    mission = setup["mission"]
    heading = _heading_rad(
        run.sender.get("/setpoint", ()),
        begin,
        math.radians(mission["heading_deg"]),
    )
    forward = np.array([math.sin(heading), math.cos(heading)])  # east, north
    right = np.array([math.cos(heading), -math.sin(heading)])
    to_target = offset_m[within, :2]
    off_m = np.stack(
        [mission["follow"]["behind_m"] - to_target @ forward, -(to_target @ right)], axis=1
    )
    return Following(stamps_ns[within], off_m, _unseen_s(run.sender.get("/target", ()), begin, end))


def _heading_rad(
    told: Sequence[LogRecord],
    begin_ns: int,
    stated_rad: float,
) -> float:
    """The heading it follows in: as it was last told before it began to, or as stated where it was
    told nothing.
    """
    before = [r.record["yaw_rad"] for r in told if r.stamp_ns <= begin_ns]
    return float(before[-1]) if before else stated_rad


def _unseen_s(
    frames: Sequence[LogRecord],
    begin_ns: int,
    end_ns: int,
) -> float:
    seen = [
        r.stamp_ns
        for r in frames
        if r.record["box"] is not None and begin_ns <= r.stamp_ns <= end_ns
    ]
    return float(np.diff([begin_ns, *seen, end_ns]).max()) * 1e-9

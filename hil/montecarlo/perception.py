"""The views of both cameras in a Monte-Carlo hand-over: placed many at once, and asked one by one
as in flight.

What is asked of them ``hil.geometric.perception`` answers, with its noise and its rules.
"""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.camera.capture import Capture
from hil.geometric.kernels import BOX_COLUMNS, EXTENT_COLUMNS, FRAME_COLUMNS, X0, X1, Y0, Y1, place
from hil.geometric.perception import GeometricView, Sensor
from hil.geometric.scene import Placed, parts_of
from hil.geometric.targets import SEEN_COLUMNS, SHARE, outlines
from hil.world.snapshot import DroneTruth, Snapshot, TargetKind
from path.arrays import Whole
from path.compiled import kernel
from path.geometry.transforms import Pose
from path.messages import Role
from path.observations import Box

NOBODY = -1
BLOCK = 25  # frames placed at a time


class CameraPath(NamedTuple):
    """Frames of one drone: number (n,), poses of both drones in the world, everything on the ground
    (n, m, 4).
    """

    frame: Whole
    R: np.ndarray
    t: np.ndarray
    other_R: np.ndarray
    other_t: np.ndarray
    things: np.ndarray


@kernel
def place_frames(
    first, last, R_b_c, t_b_c, lens, target, drone, flown, boxes, extents, frames, seen, ids, counts
):
    """Put everything before the camera in frames ``first`` to ``last``; arguments from ``boxes``
    on are filled.

    Args:
        R_b_c, t_b_c: of the camera on its drone. lens: as in ``hil.geometric.kernels``.
        target, drone: boxes of a target and of the other drone.
        ids, counts: (n, m) which thing each outline is of, and (n,) how many there are.
    """
    things = np.empty((flown.things.shape[1], 4))
    for k in range(first, last):
        row = k - first
        count = 0
        for i in range(flown.things.shape[1]):
            if not math.isnan(flown.things[k, i, 0]):
                things[count] = flown.things[k, i]
                ids[row, count] = i
                count += 1
        counts[row] = count
        bodies = boxes[row, : count * target.shape[0] + drone.shape[0]]
        bounds = extents[row, : count + 1]
        place(
            flown.R[k], flown.t[k], R_b_c, t_b_c, lens, things[:count], target, flown.other_R[k], flown.other_t[k],
            drone, drone[:0], bodies, bounds, frames[row],
        )  # fmt: skip
        outlines(bodies, bounds, target.shape[0], lens, seen[row, :count])


@kernel
def nearest_outline(seen, ids, u, v):
    """Return whose outline has its middle the nearest to a pixel, of those that are visible;
    NOBODY for none.
    """
    best = np.inf
    who = NOBODY
    for k in range(seen.shape[0]):
        off = math.hypot(
            0.5 * (seen[k, X0] + seen[k, X1]) - u, 0.5 * (seen[k, Y0] + seen[k, Y1]) - v
        )
        if seen[k, SHARE] > 0.0 and off < best:
            best = off
            who = ids[k]
    return who


class HandoverView(GeometricView):
    """A view whose bodies have been placed."""

    def __init__(
        self,
        capture: Capture[Snapshot],
        sensor: Sensor,
        placed: Placed,
        seen: np.ndarray,
        ids: np.ndarray,
    ):
        super().__init__(capture, sensor)
        self._placed = self._placed_for_depth = placed  # both images are of one instant
        self._outlines = seen
        self._ids = ids

    def whose(self, box: Box) -> int:
        """The thing that a box is of: that whose outline is the nearest."""
        return nearest_outline(self._outlines, self._ids, *box.center)


class HandoverCamera:
    """One camera as it truly is, and what is before it in every frame. Views are asked for in the
    order of frames.
    """

    def __init__(self, sensor: Sensor, kind: TargetKind, flown: CameraPath) -> None:
        setup = sensor.setup
        shape = parts_of(kind)
        most = flown.things.shape[1]
        self._sensor = sensor
        self._flown = flown
        self._shape = shape
        self._kind: TargetKind = kind
        # of a camera that looks for no marker
        self._alone = [
            Snapshot(0.0, {}, (), depth_holes=holes, kind=kind) for holes in (False, True)
        ]
        self._boxes = np.empty((BLOCK, most * len(shape) + len(setup.other), BOX_COLUMNS))
        self._extents, self._frames = (
            np.empty((BLOCK, most + 1, EXTENT_COLUMNS)),
            np.empty((BLOCK, FRAME_COLUMNS)),
        )
        self._seen, self._ids = (
            np.empty((BLOCK, most, SEEN_COLUMNS)),
            np.empty((BLOCK, most), np.int64),
        )
        self._counts = np.empty(BLOCK, np.int64)
        self._first = self._last = 0  # frames that have been placed

    def view(
        self, k: int, stamp_ns: int, *, marker_hidden: bool = False, depth_holes: bool = False
    ) -> HandoverView:
        """The view of a frame."""
        if k >= self._last:
            self._place_from(k)
        flown = self._flown
        row = k - self._first
        count = int(self._counts[row])
        per_object = len(self._shape)
        boxes = self._boxes[row, : count * per_object + len(self._sensor.setup.other)]
        placed = Placed(boxes, self._extents[row, : count + 1], self._frames[row], per_object)
        if self._sensor.markers:
            sender = DroneTruth(
                Pose(flown.other_R[k], flown.other_t[k]), (0.0, 0.0, 0.0), 0.0, armed=True
            )
            snapshot = Snapshot(
                0.0, {Role.SENDER: sender}, (), marker_hidden, depth_holes, kind=self._kind
            )
        else:
            snapshot = self._alone[depth_holes]
        capture = Capture(stamp_ns, int(flown.frame[k]), snapshot)
        return HandoverView(
            capture, self._sensor, placed, self._seen[row, :count], self._ids[row, :count]
        )

    def _place_from(self, k: int) -> None:
        setup = self._sensor.setup
        self._first, self._last = k, min(k + BLOCK, len(self._flown.frame))
        place_frames(
            self._first, self._last, setup.T_b_c.R, setup.T_b_c.t, setup.lens, self._shape, setup.other, self._flown,
            self._boxes, self._extents, self._frames, self._seen, self._ids, self._counts,
        )  # fmt: skip

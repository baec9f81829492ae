"""The marker's pose as flown, timed on photographs of boards: what drawn frames never ask of a fit,
every real camera and print does.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import busy_ns
from drivers.interfaces import PartError
from missions.trials.cost.compute.rounds import median_ms, one_thread, p99_ms
from missions.trials.real.board import BoardSeen, SetSeen, look_at_set
from missions.trials.real.set import RealSet, read_set
from path.camera.model import CameraModel
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.marker.layout import DICTIONARIES, MarkerLayout, single_marker
from path.marker.photometric.known import Memory
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from path.marker.search.find import search
from path.observations import Region

BOARD_TO_MARKER = np.diag([1.0, -1.0, -1.0])
# by which a marker is elsewhere than expected, per axis: across and along the line of sight
OFF_PX = 1.0
OFF_SHARE = 0.005
OFF_RAD = 0.005
DOWN_V = (0.0, -1.0, 0.0)
ROOM_PX = 12.0

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PhotographTimes:
    """Times of one set.

    Attributes:
        us: of every look at a marker that was seen in an earlier photograph.
        search_us: of looking for one marker in each whole photograph.
        opencv_us: of OpenCV's detector on each whole photograph.
        poses: share of the looks that gave a pose.
    """

    name: str
    camera: CameraModel
    us: Array
    search_us: Array
    opencv_us: Array
    poses: float

    def summary(self) -> dict[str, float | int]:
        return {
            "width": self.camera.width,
            "height": self.camera.height,
            "looks": len(self.us),
            "poses": self.poses,
            "median_ms": median_ms(self.us),
            "p99_ms": p99_ms(self.us),
            "search_median_ms": median_ms(self.search_us),
            "opencv_median_ms": median_ms(self.opencv_us),
        }


def time_photographs(file: Path, photographs: Path | None, seed: int) -> PhotographTimes:
    """Look at each marker of a set by itself, its photographs taken as a film.

    Raises:
        PartError: the set has no markers of a dictionary that a rig can name, or none in two views.
    """
    own = read_set(file, photographs)
    if own.dictionary is None or own.file.dictionary not in DICTIONARIES:
        raise PartError(
            f"{file.name}: dictionary: a rig cannot name {own.file.dictionary!r}",
            "name a set whose markers are of one of OpenCV's dictionaries",
        )
    seen = look_at_set(own, own.images)
    rng = np.random.default_rng([seed, 9])
    detector = cv2.aruco.ArucoDetector(own.dictionary)
    times: list[int] = []
    searches: list[int] = []
    opencv: list[int] = []
    wanted = single_marker(own.file.side_m, 0.0, min(own.markers), own.file.dictionary)
    poses = 0
    memory: Memory = {}
    with one_thread():
        for view, shot in enumerate(seen.photographs):
            begun = busy_ns()
            detector.detectMarkers(shot.grey)
            opencv.append(busy_ns() - begun)
            begun = busy_ns()
            search(shot.grey, wanted)
            searches.append(busy_ns() - begun)
            for marker_id in seen.starts[view]:
                T_c_v = _pose(own, seen.boards[view], marker_id)
                known = marker_id in memory
                took, is_pose = _look(own, seen, view, marker_id, T_c_v, memory, rng)
                if known:
                    times.append(took)
                    poses += is_pose
    if not times:
        raise PartError(
            f"{file.name}: images: no marker is seen in two photographs", "name more of them"
        )
    return PhotographTimes(
        own.name,
        seen.camera,
        np.array(times) / 1e3,
        np.array(searches) / 1e3,
        np.array(opencv) / 1e3,
        poses / len(times),
    )


def _pose(own: RealSet, board: BoardSeen, marker_id: int) -> Pose:
    T_o_m = Pose(BOARD_TO_MARKER, own.markers[marker_id].corners_o.mean(axis=0))
    return board.pose_at(T_o_m) if own.file.flat else board.pose_under(T_o_m, own.file.side_m)


def _look(
    own: RealSet,
    seen: SetSeen,
    view: int,
    marker_id: int,
    T_c_v: Pose,
    memory: Memory,
    rng: np.random.Generator,
) -> tuple[int, bool]:
    """Nanoseconds of one look, and whether it gave a pose."""
    camera = seen.camera
    layout = single_marker(own.file.side_m, 0.0, marker_id, own.file.dictionary)
    px_m = T_c_v.t[2] / camera.fx
    off_m = rng.normal(0.0, (OFF_PX * px_m, OFF_PX * px_m, OFF_SHARE * T_c_v.t[2]))
    expected = Pose(rotation.exp(rng.normal(0.0, OFF_RAD, 3)) @ T_c_v.R, T_c_v.t + off_m)
    region = _around(expected, layout, camera)
    x, y, z = (T_c_v.R @ np.array(DOWN_V)).tolist()
    known = expected if marker_id in memory else None
    grey = seen.photographs[view].grey
    begun = busy_ns()
    found = detect_markers(grey, region, layout, camera, expected=known, memory=memory)
    pose = estimate_pose(found, layout, camera, DOWN_V, (x, y, z), PoseSettings())
    return busy_ns() - begun, isinstance(pose, MarkerPose)


def _around(T_c_v: Pose, layout: MarkerLayout, camera: CameraModel) -> Region:
    corners = camera.project(T_c_v.apply(layout.markers[0].corners_v))
    (u0, v0), (u1, v1) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    room = ROOM_PX + 0.5 * (u1 - u0)
    return Region(u0 - room, v0 - room, u1 + room, v1 + room)

"""The cost of one frame for a role's program on this computer, by stage: the mission's own parts on
a drawn picture.

``python -m missions.ground.pace RIG ROLE SIZES`` prints it as JSON, SIZES ``own`` or ``all``: a
process of its own, whose caches and threads are those of a role. Times are of the processor, so
that neighbours do not count.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from drivers.clock import busy_ns
from drivers.interfaces import Detector, Frame
from drivers.link.wire import KEY_LENGTH, Codec, introduce
from drivers.log.mcap_log import McapLog
from drivers.perception.pixels import PixelView
from drivers.realsense.registration import DepthRegistration
from drivers.rig.parts import PartSpec, Rig, create, decode_part, part_context
from flight.frame.records import (
    OwnFrame,
    heard_candidate_record,
    heard_target_record,
    marker_record,
    target_record,
)
from flight.rendezvous.marker_view import MarkerFix, MarkerView, VehicleMotions
from flight.tracking.association import Sighting
from missions.ground import rig_library
from missions.ground.journal import frame_record
from missions.ground.rig_library import mission_of
from path.arrays import Image
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.messages import Candidate, Role, Target
from path.observations import Box, MarkerDetection, Missed, Region
from path.values import frozen

STAGE_S = 0.4  # that each stage is measured for, at least
FEWEST = 10  # times
SIZES = ((640, 480), (848, 480), (1280, 720))
# in 480 rows
MARKER_PX = 40
CAR_PX = (72, 48)
R_N_C = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # level, to the north
_DOWN_C = (0.0, 1.0, 0.0)


TARGET = Target(1, 1, 1, 1, 1_000_000_000, (0.1, -0.3, 1.2), (0.0, -1.0, 0.0), 0.01)
BOX = Box(250.5, 180.25, 80.0, 60.0)
LOOKED = (1.0, 0.0, 0.0, 0.0)
CANDIDATE = Candidate(1, 1, 1, 1, 1, 1_000_000_000, BOX, None, (0.4, 0.1, 1.0), LOOKED, 0.004)
MARKER = MarkerDetection(
    0,
    np.array([[300.0, 220.0], [340.0, 220.0], [340.0, 260.0], [300.0, 260.0]]),
    np.eye(8),
)
FIX = MarkerFix(Pose(np.eye(3), np.array([0.4, 0.1, 1.0])), 1.6e-5 * np.eye(6), 40.0, (MARKER,))


def detector_of(perception: PartSpec) -> tuple[PartSpec, float | None] | None:
    """The detector within a perception, and the rate of its camera as far as the rig sets it."""
    _, config = decode_part(perception)
    detector: Any = getattr(config, "detector", None)
    if not isinstance(detector, PartSpec):
        return None
    camera: Any = getattr(config, "camera", None)
    options = decode_part(camera)[1] if isinstance(camera, PartSpec) else None
    return detector, getattr(options, "rate_hz", getattr(options, "fps", None))


@frozen
class Stage:
    """Processor time of one stage, ms: in the mean, and what 99 of 100 stay below."""

    mean_ms: float
    p99_ms: float


@frozen
class Pace:
    """The time of a frame of one size, by stage, and of a look at the whole image for what was
    lost.
    """

    size: tuple[int, int]
    stages: dict[str, Stage]
    search: Stage

    @property
    def frame_ms(self) -> float:
        return sum(stage.mean_ms for stage in self.stages.values())


def measure(
    rig: Rig,
    role: Role,
    *,
    own_only: bool = False,
) -> Iterator[Pace]:
    """Yield the rig's own size first, then the usual ones."""
    cv2.setNumThreads(1)  # as in flight
    own = rig.role(role).camera
    sizes = [(own.width, own.height)]
    if not own_only:
        sizes += [size for size in SIZES if size not in sizes]
    with tempfile.TemporaryDirectory() as folder:
        for size in sizes:
            bench = _Bench(rig, role, scaled(own, size))
            yield Pace(
                size,
                dict(_stages(bench, Path(folder) / f"{size[0]}.mcap")),
                _search_time(bench),
            )


def scaled(camera: CameraModel, size: tuple[int, int]) -> CameraModel:
    """The camera with the same lens for another size."""
    factor = size[1] / camera.height
    middle = 0.5 * (size[0] - 1), 0.5 * (size[1] - 1)
    if size == (camera.width, camera.height):
        return camera
    return replace(
        camera,
        width=size[0],
        height=size[1],
        fx=factor * camera.fx,
        fy=factor * camera.fy,
        cx=middle[0],
        cy=middle[1],
    )


class _Bench:
    """The mission's own parts of one role over a drawn picture, which is a new frame each time."""

    def __init__(
        self,
        rig: Rig,
        role: Role,
        camera: CameraModel,
    ) -> None:
        self.rig = rig
        self.role = role
        self.camera = camera
        self.color, self.car = picture(rig, camera)
        self.depth_mm = np.full(self.color.shape[:2], 1500, np.uint16)
        context = replace(part_context(rig, role), camera=camera)
        spec = detector_of(rig.role(role).perception)
        self._detector: Detector = create(spec[0], context) if spec is not None else _Blind()
        self._number = 0

    def view(self) -> PixelView:
        self._number += 1
        frame = Frame(self._number * 33_000_000, self._number, self.color, self.depth_mm)
        return PixelView(frame, self.camera, self.rig.layout, self._detector, self.rig.method)


def _stages(bench: _Bench, file: Path) -> Iterator[tuple[str, Stage]]:
    rig = bench.rig
    role = bench.role
    camera = bench.camera
    car = bench.car
    if "RealSense" in str(rig.role(role).perception.options.get("camera", "")):
        flat = replace(camera, distortion=(0.0,) * 5)
        registration = DepthRegistration(
            flat,
            camera,
            Pose(np.eye(3), np.array([0.015, 0.0, 0.0])),
            1e-3,
            (0.3, 6.0),
        )
        yield "frame", timed(lambda: (np.array(bench.color), registration.register(bench.depth_mm)))
    u, v = car.center
    around = Region(u - car.w, v - car.w, u + car.w, v + car.w)
    yield "detector", timed(lambda: bench.view().targets(around))
    if role is Role.SENDER:
        yield "depth", timed(lambda: bench.view().depth(car))
    else:
        yield "pose", _pose_time(rig, camera, bench.view)
    yield "log", _log_time(role, bench.view(), car, file)
    yield "link", _link_time(role)


def _search_time(bench: _Bench) -> Stage:
    """The longest thing that setpoints wait for: D1's look for the target, D2's for the marker,
    everywhere.
    """
    # one look, as on a slow computer
    everywhere = Region(0.0, 0.0, bench.camera.width, bench.camera.height)
    if bench.role is Role.SENDER:
        return timed(lambda: bench.view().targets(None))
    return timed(lambda: bench.view().markers(everywhere))


def _pose_time(
    rig: Rig,
    camera: CameraModel,
    view: Callable[[], PixelView],
) -> Stage:
    finder = MarkerView(rig.layout, camera, rig.receiver.mount, rig.method, mission_of(rig))
    marker = rig.layout.markers[0]
    R_v_c = marker.T_v_m.R @ np.diag((1.0, -1.0, -1.0))  # the marker faces the camera
    x, y, z = (R_v_c @ _DOWN_C).tolist()
    # the nose of the drone that carries the marker
    ahead_n = R_N_C @ R_v_c.T @ rig.sender.mount.T_b_v.R[0]
    yaw_rad = math.atan2(ahead_n[1], ahead_n[0])
    still = (0.0, 0.0, 0.0)

    def look() -> MarkerFix | Missed:
        seen = view()
        finder.note_motion(VehicleMotions(seen.stamp_ns, still, seen.stamp_ns, still, yaw_rad))
        return finder.look(seen, R_N_C, (x, y, z), _DOWN_C)

    looks = [look() for _ in range(FEWEST)]
    if not isinstance(looks[-1], MarkerFix):
        raise RuntimeError(f"the drawn marker is not found: {looks[-1]}")
    return timed(look)


def _log_time(
    role: Role,
    view: PixelView,
    car: Box,
    file: Path,
) -> Stage:
    with McapLog(file, role.value) as log:

        def write() -> None:
            stamp_ns = time.monotonic_ns()
            log.write("/frame", stamp_ns, frame_record(view, stamp_ns))
            if role is Role.SENDER:
                own = OwnFrame(view.frame_id, stamp_ns, Sighting(car, None), TARGET)
                log.write("/target", stamp_ns, target_record(own, stamp_ns))
                log.write("/heard_candidate", stamp_ns, heard_candidate_record(CANDIDATE, stamp_ns))
            else:
                log.write("/marker", stamp_ns, marker_record(stamp_ns, FIX))
                log.write("/heard_target", stamp_ns, heard_target_record(TARGET, stamp_ns))

        return timed(write)


def _link_time(role: Role) -> Stage:
    """A message of each kind: one that is sent, and one that is heard. Signed."""
    codecs = {each: Codec(each, bytes(KEY_LENGTH)) for each in Role}
    introduce(*codecs.values())
    own = codecs[role]
    peer = codecs[Role.RECEIVER if role is Role.SENDER else Role.SENDER]
    sent, heard = (TARGET, CANDIDATE) if role is Role.SENDER else (CANDIDATE, TARGET)
    packets = [peer.encode(heard) for _ in range(4000)]

    def both() -> None:
        own.encode(sent)
        own.decode(packets.pop(0) if packets else b"")

    return timed(both, most=len(packets))


def timed(call: Callable[[], object], most: int = 1 << 30) -> Stage:
    """The time of a call, repeated. The first ones load what they need and are left out."""
    for _ in range(3):
        call()
    took: list[float] = []
    end_s = time.perf_counter() + STAGE_S
    while len(took) < FEWEST or (time.perf_counter() < end_s and len(took) < most - 3):
        start_ns = busy_ns()
        call()
        took.append((busy_ns() - start_ns) * 1e-6)
    return Stage(float(np.mean(took)), float(np.percentile(took, 99)))


def picture(rig: Rig, camera: CameraModel) -> tuple[Image, Box]:
    """A marker of the rig in the middle of a grainy floor, (h, w, 3) BGR, and an orange car with
    its box.
    """
    height = camera.height
    width = camera.width
    rng = np.random.default_rng(1)
    scale = height / 480.0
    color = cv2.GaussianBlur(rng.integers(70, 150, (height, width, 3), np.uint8), (0, 0), 1.5)
    marker = rig.layout.markers[0]
    side = round(MARKER_PX * scale)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, rig.layout.dictionary))
    printed = cv2.aruco.generateImageMarker(dictionary, marker.id, 8 * side)
    border = 8 * (side // 4)
    framed = cv2.copyMakeBorder(
        printed,
        border,
        border,
        border,
        border,
        cv2.BORDER_CONSTANT,
        value=(255,),
    )
    drawn = cv2.resize(framed, None, fx=1 / 8, fy=1 / 8, interpolation=cv2.INTER_AREA)
    x = round(camera.cx - drawn.shape[1] / 2)
    y = round(camera.cy - drawn.shape[0] / 2)
    color[y : y + drawn.shape[0], x : x + drawn.shape[1]] = (30.0 + 0.65 * drawn)[..., None]
    w, h = (round(side * scale) for side in CAR_PX)
    x = round(0.15 * width)
    y = round(0.7 * height)
    color[y : y + h, x : x + w] = (20, 120, 235)
    seen = cv2.GaussianBlur(color, (0, 0), 0.6) + rng.normal(0.0, 2.0, color.shape)
    return np.clip(seen, 0, 255).astype(np.uint8), Box(x, y, w, h)


class _Blind:
    """In the place of a detector, for a perception that has none."""

    def detect(self, image: object, region: object) -> tuple[()]:
        return ()


if __name__ == "__main__":
    _, file_name, role_name, sizes_asked = sys.argv
    measured = measure(rig_library.load(file_name), Role(role_name), own_only=sizes_asked == "own")
    sys.stdout.write(msgspec.json.encode(list(measured)).decode())

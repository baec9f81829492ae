"""The short test of a role's perception: frames for two seconds, and what is found in the last of
them.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import field

import numpy as np

from drivers.interfaces import Capability, Clock, Detector, Perception, View, lacking
from drivers.rig.part_check import Enough, Finding, examined, rate_finding, rate_of
from drivers.rig.parts import Rig
from path.arrays import Image
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.marker.instead import grey_of, seen_instead
from path.marker.layout import MarkerLayout
from path.marker.pose import PoseSettings, estimate_pose
from path.marker.size_check import MEASURE, SizeCheck
from path.messages import Vec3
from path.observations import Box, MarkerDetection, Missed, MissReason
from path.values import frozen

SETTLE_S = 0.5
SAMPLE_S = 2.0
FRAME_S = 2.0
KEPT = 6  # frames that are looked into
LEAST_LOOKS = 3  # of them, at a marker with depth on it
FRAMES = Enough(0.95, 0.8)  # of the rate that the rig sets: a hand-over counts each of them
MANY_MISSED = 0.05
OLD_MS = 500.0
# mean grey level; share of pixels at their limit
DARK = 40.0
BLACK = 8.0
GLARING = 0.2
WHITE = 250
# side of a marker: always found; found two times in three
SURE_PX = 20.0
SMALLEST_PX = 12.0
# how level each drone stands, so that a turn of 45 degrees is beyond doubt
HELD_RAD = math.radians(3.0)
LEVEL_FIX = "stand both drones level, and look again; then mend the plate, or the mounts in the rig"
STREAM_FIX = (
    "a USB 3 port and cable, no other load on this computer, more light if its exposure is long"
)


@frozen
class FrameSample:
    """Frames as they came: instants and ages in ns of the role's clock, and the last few of
    them.
    """

    stamps_ns: tuple[int, ...]
    ids: tuple[int, ...]
    ages_ns: tuple[int, ...]
    last: tuple[View, ...]

    @property
    def seconds(self) -> float:
        return (self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9


@frozen
class WantedMarker:
    """The markers that a role must see, and down in both frames while both drones stand level."""

    layout: MarkerLayout
    down_v: Vec3
    down_c: Vec3
    method: MethodConfig = field(default_factory=MethodConfig)

    @classmethod
    def of(cls, rig: Rig) -> WantedMarker:
        """Return what the receiver of a rig must see."""
        return cls(
            rig.layout, _down(rig.sender.mount.T_b_v), _down(rig.receiver.mount.T_b_c), rig.method
        )


def _down(T_b: Pose) -> Vec3:
    x, y, z = T_b.R[2].tolist()
    return x, y, z


async def check_perception(
    perception: Perception, clock: Clock, wanted: WantedMarker | None
) -> AsyncIterator[Finding]:
    """Open, look, close. ``wanted``: the markers that this role must see; None when it needs none.

    Raises PartError for what ends the test.
    """
    start_ns = clock.now_ns()
    async with perception:
        await perception.view(FRAME_S)
        yield Finding(
            "ok", "opens", f"first frame after {(clock.now_ns() - start_ns) * 1e-9:.1f} s"
        )
        sample = await _sampled(perception, clock)
        yield rate(sample, rate_of(perception))
        yield missed(sample)
        yield age(sample)
        for own in await examined(perception):
            yield own
        for finding in _pictures(perception, sample):
            yield finding
        yield _targets(sample, rate_of(perception), clock)
        if wanted is not None:
            found = [view.markers(None) for view in sample.last]
            yield markers(found, wanted.layout, sample.last[-1].image())
            turned = marker_turned(found, wanted, perception.model)
            if turned is not None:
                yield turned
            size = marker_size(sample.last, found, wanted, perception.model)
            if size is not None:
                yield size


async def _sampled(perception: Perception, clock: Clock) -> FrameSample:
    # what waited since it was opened, and automatic exposure
    await _frames(perception, clock, SETTLE_S)
    return await _frames(perception, clock, SAMPLE_S)


async def _frames(perception: Perception, clock: Clock, seconds: float) -> FrameSample:
    loop = asyncio.get_running_loop()
    end_s = loop.time() + seconds
    stamps: list[int] = []
    ids: list[int] = []
    ages: list[int] = []
    last: deque[View] = deque(maxlen=KEPT)
    while loop.time() < end_s or len(stamps) < 2:
        view = await perception.view(FRAME_S)
        stamps.append(view.stamp_ns)
        ids.append(view.frame_id)
        ages.append(clock.now_ns() - view.stamp_ns)
        last.append(view)
    return FrameSample(tuple(stamps), tuple(ids), tuple(ages), tuple(last))


def rate(sample: FrameSample, wanted_hz: float | None) -> Finding:
    """Frames that came in a second, against what the rig sets."""
    found_hz = (len(sample.ids) - 1) / sample.seconds
    if wanted_hz is None:
        return Finding("ok", "rate", f"{found_hz:.1f} frames a second")
    return rate_finding("rate", found_hz, wanted_hz, STREAM_FIX, FRAMES)


def missed(sample: FrameSample) -> Finding:
    """Frames that the camera counted and that never came, or came too late to be the newest."""
    given = sample.ids[-1] - sample.ids[0]
    lost = given - (len(sample.ids) - 1)
    gap_ms = float(np.max(np.diff(sample.stamps_ns))) * 1e-6
    detail = f"{lost} of {given} ({100.0 * lost / given:.0f} %), longest gap {gap_ms:.0f} ms"
    return (
        Finding("note", "missed", detail, STREAM_FIX)
        if lost > MANY_MISSED * given
        else Finding("ok", "missed", detail)
    )


def age(sample: FrameSample) -> Finding:
    """Find how old frames are when they come: below zero or very old means that another clock
    stamped them.
    """
    median_ms = float(np.median(sample.ages_ns)) * 1e-6
    most_ms = max(sample.ages_ns) * 1e-6
    detail = f"frames are {median_ms:.0f} ms old when they come, {most_ms:.0f} ms at most"
    if median_ms < 0.0 or median_ms > OLD_MS:
        return Finding(
            "fault",
            "stamps",
            detail,
            "the camera's clock is not this computer's: let its clock be set first",
        )
    return Finding("ok", "stamps", detail)


def _pictures(perception: Perception, sample: FrameSample) -> Iterator[Finding]:
    view = sample.last[-1]
    if (image := view.image()) is not None:
        model = perception.model
        yield Finding(
            "ok",
            "size",
            f"{image.shape[1]}x{image.shape[0]}, as its calibration {model.width}x{model.height}",
        )
        yield brightness(image)
    if Capability.RANGE not in lacking(perception):
        yield _range(view, perception.model)


def brightness(image: Image) -> Finding:
    """Find whether there is a picture at all, and light enough to see by. ``image``: (h, w, 3)
    BGR.
    """
    grey = float(image.mean())
    glaring = float((image.max(axis=2) >= WHITE).mean())
    detail = f"mean {grey:.0f} of 255, {100.0 * glaring:.0f} % overexposed"
    if grey < BLACK:
        return Finding("fault", "brightness", detail, "take the lens cap off, or put the light on")
    if grey < DARK:
        return Finding("note", "brightness", detail, "more light, or a longer exposure")
    if glaring > GLARING:
        return Finding(
            "note", "brightness", detail, "a shorter exposure, or turn away from the light"
        )
    return Finding("ok", "brightness", detail)


def _range(view: View, model: CameraModel) -> Finding:
    third = Box(model.width / 3, model.height / 3, model.width / 3, model.height / 3)
    depth = view.depth(third)
    if depth is None:
        return Finding(
            "note",
            "range",
            "none in the middle of the image",
            "point it at something within its limits, and look again",
        )
    return Finding("ok", "range", f"{depth.z_m:.2f} m in the middle of the image")


def markers(
    found: Sequence[Sequence[MarkerDetection]],
    layout: MarkerLayout,
    image: Image | None,
) -> Finding:
    """The largest marker in each of some frames: which, and how large; else what is in the last
    image instead.
    """
    largest = [max(each, key=side_px) for each in found if each]
    wanted = ", ".join(str(marker.id) for marker in layout.markers)
    if not largest:
        detail = f"no marker of this rig (id {wanted}) in {len(found)} frames"
        instead = None if image is None else seen_instead(grey_of(image), layout)
        if instead is not None:
            return Finding(
                "note",
                "marker",
                f"{detail}; {instead}",
                "print what the rig says, or correct the rig",
            )
        return Finding(
            "note", "marker", detail, "hold the sender's marker into its view, and look again"
        )
    side = float(np.median([side_px(each) for each in largest]))
    ids = ", ".join(str(number) for number in sorted({each.marker_id for each in largest}))
    detail = f"id {ids} in {len(largest)} of {len(found)} frames, side {side:.0f} px"
    if side >= SURE_PX:
        return Finding("ok", "marker", detail)
    need = f"it is always found from {SURE_PX:.0f} px on, below {SMALLEST_PX:.0f} px mostly not: come nearer"
    return Finding("note", "marker", detail, need)


def marker_turned(
    found: Sequence[Sequence[MarkerDetection]], wanted: WantedMarker, camera: CameraModel
) -> Finding | None:
    """Return what is wrong with how the marker hangs, as far as gravity tells; None where nothing
    is.

    Both drones are taken to stand level, or to be held so: only what is far off is told.
    """
    settings = PoseSettings(attitude_v_sigma_rad=HELD_RAD, attitude_c_sigma_rad=HELD_RAD)
    for each in reversed(found):
        pose = estimate_pose(each, wanted.layout, camera, wanted.down_v, wanted.down_c, settings)
        if isinstance(pose, Missed) and pose.reason is MissReason.MARKER_TURNED:
            return Finding("note", "marker turned", pose.cause or "", LEVEL_FIX)
    return None


def marker_size(
    views: Sequence[View],
    found: Sequence[Sequence[MarkerDetection]],
    wanted: WantedMarker,
    camera: CameraModel,
) -> Finding | None:
    """Hold the marker's size in the rig against depth measured on it; None where there is no
    marker, or no depth on it.

    Both drones are taken to stand level, or to be held so.
    """
    settings = PoseSettings(attitude_v_sigma_rad=HELD_RAD, attitude_c_sigma_rad=HELD_RAD)
    check = SizeCheck(wanted.layout, wanted.method, LEAST_LOOKS)
    for view, each in zip(views, found, strict=True):
        pose = estimate_pose(each, wanted.layout, camera, wanted.down_v, wanted.down_c, settings)
        if not isinstance(pose, Missed):
            check.look(pose.T_c_v, pose.covariance, each, view.depth)
    contradiction = check.contradiction()
    if contradiction is not None:
        return Finding("fault", "marker size", str(contradiction), MEASURE)
    fits = check.by_depth_m()
    return (
        None
        if fits is None
        else Finding("ok", "marker size", f"{1000.0 * fits:.1f} mm by depth measured on it")
    )


def side_px(marker: MarkerDetection) -> float:
    """Mean length of its four sides in the image."""
    corners = marker.corners_px
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())


def check_detector(
    detector: Detector, model: CameraModel, rate_hz: float | None, clock: Clock
) -> Finding:
    """Times the detector on a grey image of the camera's size: it takes that at least.

    The first one loads things and is left out.

    How long it takes for what the camera sees is told with its frames.
    """
    image = np.full((model.height, model.width, 3), 128, np.uint8)
    took_ms: list[float] = []
    for _ in range(1 + KEPT):
        start_ns = clock.now_ns()
        detector.detect(image, None)
        took_ms.append((clock.now_ns() - start_ns) * 1e-6)
    median = float(np.median(took_ms[1:]))
    return _timed(
        "time", f"{median:.1f} ms for a grey image of {model.width}x{model.height}", median, rate_hz
    )


def _targets(sample: FrameSample, rate_hz: float | None, clock: Clock) -> Finding:
    """Count what the detector finds in the last frames, whole, and times it."""
    took_ms: list[float] = []
    counts: list[int] = []
    for view in sample.last:
        start_ns = clock.now_ns()
        counts.append(len(view.targets(None)))
        took_ms.append((clock.now_ns() - start_ns) * 1e-6)
    median = float(np.median(took_ms))
    seen = f"{min(counts)} to {max(counts)}" if max(counts) else "none"
    detail = f"{seen} in each of {len(counts)} whole frames, {median:.1f} ms"
    return _timed("targets", detail, median, rate_hz)


def _timed(name: str, detail: str, median_ms: float, rate_hz: float | None) -> Finding:
    if rate_hz is not None and median_ms > 1000.0 / rate_hz:
        fix = "a smaller model, more `threads`, or a lower frame rate; with a search region it may still keep up"
        return Finding(
            "note", name, f"{detail}: more than a frame's {1000.0 / rate_hz:.0f} ms", fix
        )
    return Finding("ok", name, detail)

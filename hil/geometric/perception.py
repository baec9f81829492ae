"""The perception of level ``sim``: observations straight from the truth's geometry, with measured
noise; no pixels.

On each capture the truth is looked at; what a mission then asks of the view is worked out when it
asks: the visible outlines of the cars, the corners of the markers, rays over a box for its depth
(``hil.geometric.scene``), each with noise from a generator that depends on the run's seed, the
role, the frame and the question alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from functools import cached_property
from typing import Annotated, Self

import numpy as np

from drivers.interfaces import CameraError
from drivers.perception.freshness import Freshness
from drivers.rig.parts import PartContext
from hil.camera.capture import (
    Capture,
    CaptureTicker,
    CaptureTiming,
    timing_of,
    true_camera,
)
from hil.geometric.kernels import X0, X1, Y0, Y1, fold, fold_both
from hil.geometric.markers import marker
from hil.geometric.noise import ObservationNoise, noise_in
from hil.geometric.scene import Array, CameraSetup, Placed, outlines, place
from hil.geometric.spells import Spells
from hil.geometric.targets import DETECTION_COLUMNS, SHARE, DepthSettings, depth_over, detections
from hil.world.detector import PERFECT
from hil.world.errors import SensorErrors
from hil.world.seam import harness_of
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from path.bounds import Bounds
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box, Depth, Detection, MarkerDetection, Region
from path.values import frozen

EVERYWHERE = Region(-math.inf, -math.inf, math.inf, math.inf)
# questions, for the random numbers
TARGETS = 1
MARKERS = 2
DEPTH = 3
SLOW_TARGETS = 4
SLOW_MARKERS = 5
ALIKE = np.eye(8)  # covariance of corners that err alike, in squares of their error
SLOW_FRAMES = 10  # for so many frames lasts what goes wrong for a while


@frozen
class GeometricPerceptionConfig:
    """
    Attributes:
        rate_hz, phase_s, latency_s: when frames are taken (see ``hil.camera.capture.timing_of``).
        method: of the method's settings, those about depth.
        max_old_frames: this many repeated frames in a row are a fault of the camera.
    """

    rate_hz: Annotated[float, Bounds(1.0, 300.0)] = 50.0
    phase_s: Annotated[float | None, Bounds(0.0, 10.0)] = None
    latency_s: Annotated[float, Bounds(0.0, 2.0)] = 0.0
    method: MethodConfig = field(default_factory=MethodConfig)
    max_old_frames: Annotated[int, Bounds(1, 10000, "frames")] = 30

    def __post_init__(self) -> None:
        CaptureTiming(self.rate_hz, self.phase_s or 0.0, self.latency_s)

    def timing(self, role: Role) -> CaptureTiming:
        return timing_of(role, self.rate_hz, self.phase_s, self.latency_s)


class GeometricPerception:
    """Implements ``drivers.interfaces.Perception`` for a rig whose harness is a
    ``PartHarness``.
    """

    Config = GeometricPerceptionConfig

    def __init__(
        self,
        config: GeometricPerceptionConfig,
        context: PartContext,
        noise: ObservationNoise | None = None,
    ) -> None:
        harness = harness_of(context.harness, "a geometric perception", CameraError)
        true = true_camera(context, harness.built)
        setup = CameraSetup(context.role, true.camera, true.T_b_c, true.T_b_v, true.layout)
        noise = noise or noise_in(true.scene)
        stated = None if harness.built is None else harness.built.rig.depth
        if stated is not None:
            noise = noise.with_depth(stated.sigma_at_1m_m)
        self._model = context.camera
        self._sensor = Sensor(setup, noise, config.method, harness.seed, true.errors)
        name = f"the {context.role.value}'s geometric perception"
        self._ticker: CaptureTicker[Snapshot] = CaptureTicker(
            name, config.timing(context.role), context.role, context.clock, harness, _keep
        )
        self._freshness = Freshness(config.max_old_frames)
        self._open = False

    @property
    def model(self) -> CameraModel:
        return self._model

    @property
    def dropped(self) -> int:
        """Frames that came again and were not given on."""
        return self._freshness.dropped

    async def __aenter__(self) -> Self:
        self._open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self._open = False
        self._ticker.close()

    async def view(self, timeout_s: float) -> GeometricView:
        """The newest view not yet given. Raises CameraError when none came in time."""
        if not self._open:
            raise CameraError("the geometric perception is not open", "open it with `async with`")
        return GeometricView(await self._freshness.next(self._ticker.next, timeout_s), self._sensor)


def _keep(snapshot: Snapshot, frame_id: int) -> Snapshot:
    del frame_id
    return snapshot


class Sensor:
    """A camera and the perception behind it; the same for all its views."""

    def __init__(
        self,
        setup: CameraSetup,
        noise: ObservationNoise,
        method: MethodConfig,
        seed: int,
        errors: SensorErrors | None = None,
    ) -> None:
        self.setup = setup
        self.noise = noise
        self.errors = errors or SensorErrors()
        self.boxes = {
            "car": noise.targets.shifted(self.errors.edges_px),
            "person": noise.people.shifted(self.errors.edges_px),
            "drone": noise.drones.shifted(self.errors.edges_px),
        }
        self.seed = fold(fold(seed, 7), list(Role).index(setup.role))
        self.spells = Spells(int(fold(self.seed, 6)))
        self.depth = DepthSettings(
            method.min_depth_m,
            method.max_depth_m,
            method.depth_center_fraction,
            method.min_depth_valid,
            float(method.min_depth_pixels),
            method.max_depth_spread_m,
            method.depth_sigma_at_1m_m,
        )
        self.depth_noise = (noise.depth_sigma_at_1m_m, noise.depth_common_sigma_at_1m_m)
        self.markers = [(m.id, setup.T_b_v.apply(m.corners_v)) for m in setup.layout.markers]
        if setup.role is Role.SENDER:
            self.markers = []  # it carries them


class GeometricView:
    """Implements ``drivers.interfaces.View`` on one snapshot. The same question has the same
    answer.
    """

    def __init__(self, capture: Capture[Snapshot], sensor: Sensor) -> None:
        self.stamp_ns = capture.stamp_ns
        self.frame_id = capture.frame_id
        self._snapshot = snapshot = capture.content
        self._sensor = sensor
        self._missed: tuple[int, ...] = ()
        self._invented: Detection | None = None
        if snapshot.detector is not PERFECT and snapshot.detector != PERFECT:
            spells = sensor.spells
            detector = snapshot.detector
            self._missed = spells.missed(self.frame_id, self._sides_px(), detector)
            self._invented = spells.invented(self.frame_id, sensor.setup.camera, detector)

    @cached_property
    def _placed(self) -> Placed:
        return place(self._sensor.setup, self._snapshot)

    @cached_property
    def _placed_for_depth(self) -> Placed:
        late_s = self._sensor.errors.depth_late_s
        return place(self._sensor.setup, self._snapshot, late_s) if late_s else self._placed

    @cached_property
    def _outlines(self) -> Array:
        return outlines(self._sensor.setup, self._placed)

    def _sides_px(self) -> list[float]:
        """Return the longer side of what is visible of each object; 1 where nothing is."""
        if not self._snapshot.detector.by_size:
            return [1.0] * len(self._snapshot.objects)
        seen = self._outlines
        return np.maximum(seen[:, X1] - seen[:, X0], seen[:, Y1] - seen[:, Y0]).clip(1.0).tolist()

    def _key(self, question: int, frames: int = 1) -> int:
        """A key for random numbers that stay the same for so many frames."""
        return fold_both(self._sensor.seed, self.frame_id // frames, question)

    def targets(self, region: Region | None) -> Sequence[Detection]:
        """The cars a detector would find, with box centre in ``region``, best score first."""
        sensor = self._sensor
        seen = self._outlines
        boxes = sensor.boxes[self._snapshot.kind]
        off_px = self._snapshot.detector.edge_px
        if off_px:
            boxes = boxes.shifted((off_px, off_px, off_px, off_px))
        if self._missed:
            seen = seen.copy()
            seen[list(self._missed), SHARE] = 0.0
        found = np.empty((len(seen), DETECTION_COLUMNS))
        keys = self._key(TARGETS), self._key(SLOW_TARGETS, SLOW_FRAMES)
        count = detections(seen, sensor.setup.lens, _row(region), boxes, *keys, found)
        rows = sorted(found[:count].tolist(), key=lambda row: -row[4])
        detected = [Detection(Box(x, y, w, h), score) for x, y, w, h, score in rows]
        invented = self._invented
        if invented is not None and (region is None or region.contains(*invented.box.center)):
            detected.append(invented)
        return detected

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        """The markers on the sender that would be found in ``region``, with corner covariance."""
        sensor = self._sensor
        snapshot = self._snapshot
        sender = snapshot.drones.get(Role.SENDER)
        if sender is None or snapshot.marker_hidden or not sensor.markers:
            return ()
        setup = sensor.setup
        placed = self._placed
        area = _row(region)
        key = self._key(MARKERS)
        slow_key = self._key(SLOW_MARKERS, SLOW_FRAMES)
        truth = sender.T_w_b
        detected: list[MarkerDetection] = []
        for marker_id, corners_b in sensor.markers:
            found = np.empty(9)
            if marker(
                placed.boxes,
                placed.extents,
                placed.per_object,
                placed.frame,
                setup.lens,
                truth.R,
                truth.t,
                corners_b,
                area,
                sensor.noise.marker,
                fold(key, marker_id),
                fold(slow_key, marker_id),
                found,
            ):
                detected.append(
                    MarkerDetection(marker_id, found[:8].reshape(4, 2), found[8] ** 2 * ALIKE)
                )
        return detected

    def depth(self, box: Box) -> Depth | None:
        """Return the depth that ``path.target.place.registered_depth`` would make of the depth
        image.
        """
        sensor = self._sensor
        placed = self._placed_for_depth
        setup = sensor.setup
        errors = sensor.errors
        key = fold_both(self._key(DEPTH), int(16.0 * box.x), int(16.0 * box.y))
        z_m, sigma_m = depth_over(
            placed.boxes,
            placed.extents,
            placed.per_object,
            placed.frame,
            setup.lens,
            self._snapshot.depth_holes,
            # one compiled version for all numbers
            (float(box.x), float(box.y), float(box.w), float(box.h)),
            sensor.depth,
            sensor.depth_noise,
            key,
        )
        return Depth(errors.depth * z_m + errors.depth_bias_m, sigma_m) if z_m > 0.0 else None

    def image(self) -> None:
        """Return None: there are no pixels."""
        return None


def warm_up() -> None:
    """Compile the kernels or load them from numba's cache: some seconds the first time, so once
    before processes fly.

    Asks every question of a view of one car and one marker.
    """
    camera = CameraModel(64, 48, 60.0, 60.0, 31.5, 23.5)
    level = Pose(np.eye(3), np.zeros(3))
    down = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.5]))
    setup = CameraSetup(Role.RECEIVER, camera, level, level, single_marker())
    drones = {role: DroneTruth(down, (0.0, 0.0, 0.0), 0.0, True) for role in Role}
    snapshot = Snapshot(0.0, drones, (ObjectTruth(0, (0.0, 0.0, 0.0), 0.0, 0.0),))
    view = GeometricView(
        Capture(0, 0, snapshot), Sensor(setup, ObservationNoise(), MethodConfig(), 0)
    )
    view.targets(None)
    view.markers(None)
    view.depth(Box(20.0, 12.0, 24.0, 24.0))


def _row(region: Region | None) -> Array:
    region = region or EVERYWHERE
    return np.array((region.x0, region.y0, region.x1, region.y1))

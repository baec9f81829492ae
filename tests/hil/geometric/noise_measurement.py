"""The measurement of the numbers in ``hil.geometric.noise``: the real perception on rendered
frames, against geometry.

``collect`` asks a view of a scene what a mission would and compares it with the exact geometry.
Done with rendered frames it gives what ``measure_noise`` fits; done with the geometric perception
it shows whether that is as noisy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from drivers.interfaces import Frame, View
from drivers.perception.pixels import PixelView
from flight.harness.measured import MEASURED
from hil.camera.capture import Capture
from hil.geometric.noise import EXACT, ObservationNoise
from hil.geometric.perception import GeometricView, Sensor
from hil.geometric.scene import Array, CameraSetup, outlines, place
from hil.geometric.targets import CONTACT, DEPTH_CELLS, SHARE
from hil.render.renderer import Renderer
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot, TargetKind
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import iou
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box, MarkerDetection, Region
from path.target.place import MEDIAN_TO_MEAN

NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SLANT = math.sqrt(0.5)
CAMERA = CameraModel(640, 480, 615.2, 615.9, 322.1, 241.3, (0.112, -0.236, 0.0006, -0.0004, 0.095))
T_B_C = Pose(
    np.array([[0.0, -SLANT, SLANT], [1.0, 0.0, 0.0], [0.0, SLANT, SLANT]]),
    np.array([0.10, 0.0, 0.02]),
)
T_B_V = Pose(
    np.array([[0.0, SLANT, -SLANT], [1.0, 0.0, 0.0], [0.0, -SLANT, -SLANT]]),
    np.array([-0.18, 0.0, -0.06]),
)
SAME_IOU = 0.3
SEARCH_PX = 12.0  # around a marker, as a mission searches for it
MARGIN_PX = 2.0
# a marker of this side that is not found is missed for another reason than its size
SURELY_FOUND_PX = 14.0


def setup(role: Role) -> CameraSetup:
    """The camera that everything is measured with, the one of the simulated rigs."""
    return CameraSetup(role, CAMERA, T_B_C, T_B_V, single_marker())


def scenes(seed: int, count: int, kind: TargetKind = "car") -> Iterator[Snapshot]:
    """Moments of a mission: D1 behind and above the target, D2 at all distances that it looks at
    the marker from.

    What flies hangs as high as the rigs have it while it waits.
    """
    rng = np.random.default_rng(seed)
    low_m = 0.8 if kind == "drone" else 0.0
    for _ in range(count):
        sender = _posed(
            rng,
            np.array([0.0, -1.55, 1.5 + low_m]) + rng.normal(0.0, 0.15, 3),
            rng.normal(0.0, 0.15),
        )
        plate = sender @ T_B_V
        below, aside = math.radians(rng.uniform(28.0, 60.0)), rng.normal(0.0, 0.4)
        back = np.array(
            [math.cos(below) * math.sin(aside), -math.cos(below) * math.cos(aside), math.sin(below)]
        )
        receiver = _posed(
            rng, plate.t + rng.uniform(0.7, 2.9) * back, -aside + rng.normal(0.0, 0.15)
        )
        first, radius = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.8, 1.5)
        around = [first + 2.0 * math.pi * k / 3 for k in range(3)]
        places = [(0.0, 0.0), *((radius * math.cos(a), radius * math.sin(a)) for a in around)]
        yield Snapshot(
            0.0,
            {
                Role.SENDER: DroneTruth(sender, (0.0, 0.0, 0.0), rng.uniform(0.0, 6.0), True),
                Role.RECEIVER: DroneTruth(receiver, (0.0, 0.0, 0.0), rng.uniform(0.0, 6.0), True),
            },
            tuple(
                ObjectTruth(k, (e, n, low_m), rng.uniform(0.0, 2.0 * math.pi), 0.0)
                for k, (e, n) in enumerate(places)
            ),
            kind=kind,
        )


def _posed(rng: np.random.Generator, position_w: Array, heading: float) -> Pose:
    R_n_b = R_from_rpy(float(rng.normal(0.0, 0.05)), float(rng.normal(0.0, 0.05)), heading)
    return Pose(NED_TO_ENU @ R_n_b, position_w)


Perceive = Callable[[Snapshot, Role, int], View]


def rendered(seed: int, method: MethodConfig | None = None) -> Perceive:
    """The whole perception on rendered frames."""
    detector, method, layout = (
        ColorDetector(ColorDetectorConfig()),
        method or MethodConfig(),
        single_marker(),
    )
    renderers = {
        role: Renderer(CAMERA, T_B_C, T_B_V, layout, seed=seed, imaging=MEASURED) for role in Role
    }

    def perceive(snapshot: Snapshot, role: Role, frame_id: int) -> View:
        color, depth_mm = renderers[role].render(snapshot, role, frame_id)
        return PixelView(
            Frame(frame_id, frame_id, color, depth_mm), CAMERA, layout, detector, method
        )

    return perceive


def geometric(
    seed: int, noise: ObservationNoise | None = None, method: MethodConfig | None = None
) -> Perceive:
    """The geometric perception; with ``EXACT`` noise the truth."""
    noise, method = noise or ObservationNoise(), method or MethodConfig()
    sensors = {role: Sensor(setup(role), noise, method, seed) for role in Role}

    def perceive(snapshot: Snapshot, role: Role, frame_id: int) -> View:
        return GeometricView(Capture(frame_id, frame_id, snapshot), sensors[role])

    return perceive


@dataclass(slots=True)
class Residuals:
    """The errors of a perception against the truth; one entry an observation.

    Attributes:
        edges_px: left, top, right, bottom of boxes of cars in full view; ``cars`` of them there
            were.
        scores: of these boxes.
        sides_px, found: shortest side of each marker in view, and whether it was found, in a region
            and in the whole image.
        corners_px: (u, v) x 4 of those found in a region, ``corner_sides_px`` their sides,
            ``claimed_px`` the standard deviation they claim.
        depths: error over depth squared in 1/m; ``claimed_depths`` the standard deviation claimed,
            likewise; ``no_depth`` counts boxes without any where there should be one.
    """

    edges_px: list[list[float]] = field(default_factory=list[list[float]])
    scores: list[float] = field(default_factory=list[float])
    cars: int = 0
    sides_px: list[float] = field(default_factory=list[float])
    found: list[bool] = field(default_factory=list[bool])
    corners_px: list[Array] = field(default_factory=list[Array])
    corner_sides_px: list[float] = field(default_factory=list[float])
    claimed_px: list[float] = field(default_factory=list[float])
    depths: list[float] = field(default_factory=list[float])
    claimed_depths: list[float] = field(default_factory=list[float])
    no_depth: int = 0


def edges_off(box: Box, true: Box) -> list[float]:
    """Left, top, right, bottom of a box against the true outline, px."""
    right, bottom = box.x + box.w - true.x - true.w, box.y + box.h - true.y - true.h
    return [box.x - true.x, box.y - true.y, right, bottom]


def collect(perceive: Perceive, moments: Iterator[Snapshot]) -> Residuals:
    """Ask for cars, depth and markers in every moment, for both drones."""
    residuals, exact = Residuals(), geometric(0, EXACT)
    for frame_id, snapshot in enumerate(moments):
        for role in Role:
            view, truth = perceive(snapshot, role, frame_id), exact(snapshot, role, frame_id)
            _collect_cars(residuals, view, truth, _in_full_view(snapshot, role))
            for marker in truth.markers(None):
                _collect_marker(residuals, view, marker)
    return residuals


def _in_full_view(snapshot: Snapshot, role: Role) -> list[Box]:
    """True boxes of the cars that nothing hides, touches or cuts."""
    camera = setup(role)
    boxes: list[Box] = []
    for row in outlines(camera, place(camera, snapshot)):
        x0, y0, x1, y1 = row[:4].tolist()
        inside = (
            x0 > MARGIN_PX
            and y0 > MARGIN_PX
            and x1 < CAMERA.width - MARGIN_PX
            and y1 < CAMERA.height - MARGIN_PX
        )
        if row[SHARE] == 1.0 and row[CONTACT] == 0.0 and inside:
            boxes.append(Box(x0, y0, x1 - x0, y1 - y0))
    return boxes


def _collect_cars(residuals: Residuals, view: View, truth: View, boxes: list[Box]) -> None:
    detections = view.targets(None)
    for box in boxes:
        residuals.cars += 1
        best = max(detections, key=lambda d: iou(d.box, box), default=None)
        if best is not None and iou(best.box, box) > SAME_IOU:
            a = best.box
            residuals.edges_px.append(edges_off(a, box))
            residuals.scores.append(best.score)
        depth, right = view.depth(box), truth.depth(box)
        if right is not None and depth is not None:
            residuals.depths.append((depth.z_m - right.z_m) / right.z_m**2)
            residuals.claimed_depths.append(depth.sigma_m / right.z_m**2)
        elif right is not None:
            residuals.no_depth += 1


def _collect_marker(residuals: Residuals, view: View, truth: MarkerDetection) -> None:
    corners = truth.corners_px
    side = float(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).min())
    (u0, v0), (u1, v1) = corners.min(axis=0) - SEARCH_PX, corners.max(axis=0) + SEARCH_PX
    for region in (Region(u0, v0, u1, v1), None):
        found = [m for m in view.markers(region) if m.marker_id == truth.marker_id]
        residuals.sides_px.append(side)
        residuals.found.append(bool(found))
        if found and region is not None:
            residuals.corners_px.append((found[0].corners_px - corners).ravel())
            residuals.corner_sides_px.append(side)
            residuals.claimed_px.append(math.sqrt(float(np.trace(found[0].covariance_px2)) / 8.0))


def measure_noise(residuals: Residuals) -> ObservationNoise:
    """The noise model's numbers from residuals; what they do not show (cars that touch or hide)
    stays as it is.
    """
    default = ObservationNoise()
    edges, scores = np.array(residuals.edges_px), np.array(residuals.scores)
    bias, spread = np.median(edges, axis=0), float(_spread(edges).mean())
    off = np.abs(edges - bias) > 6.0 * spread
    odd = scores < 0.5
    targets = default.targets._replace(
        bias_left_px=float(bias[0]),
        bias_top_px=float(bias[1]),
        bias_right_px=float(bias[2]),
        bias_bottom_px=float(bias[3]),
        edge_sigma_px=spread,
        outlier_rate=float(off.any(axis=1).mean()),
        outlier_sigma_px=float(np.sqrt(np.mean(edges[off] ** 2))) if off.any() else 0.0,
        miss_rate=1.0 - len(edges) / residuals.cars,
        score=float(np.median(scores[~odd])),
        score_sigma=float(_spread(scores[~odd])),
        odd_rate=float(odd.mean()),
    )
    side = np.array(residuals.sides_px)
    found = np.array(residuals.found)
    small = side < SURELY_FOUND_PX
    half, slope = _logistic(side[small], found[small])
    sides, claimed = np.array(residuals.corner_sides_px), np.array(residuals.claimed_px)
    rms = np.sqrt(np.mean(np.array(residuals.corners_px) ** 2, axis=1))
    coarse = claimed > 0.25
    scale, floor, extra = _corner_law(sides[~coarse], rms[~coarse])
    marker = default.marker._replace(
        half_side_px=half,
        side_slope_per_px=slope,
        lapse_rate=float(1.0 - found[~small].mean()),
        corner_sigma_px2=scale,
        corner_floor_px=floor,
        corner_spread=extra,
        claimed_factor=float(np.median(claimed[~coarse] / np.hypot(scale / sides[~coarse], floor))),
        coarse_rate=float(coarse.mean()),
        coarse_sigma_px=float(np.sqrt(np.mean(rms[coarse] ** 2))) if coarse.any() else 0.0,
    )
    pixel = default.depth_sigma_at_1m_m
    # residual of a pixel's noise over a box when none err together
    alone = MEDIAN_TO_MEAN * pixel / DEPTH_CELLS
    common = math.sqrt(max(0.0, float(_spread(np.array(residuals.depths))) ** 2 - alone**2))
    return ObservationNoise(targets, default.drones, default.people, marker, pixel, common)


def _spread(values: Array) -> Array:
    """Half the central 68 % along the first axis: the standard deviation without the tails."""
    low, high = np.percentile(values, [16.0, 84.0], axis=0)
    return 0.5 * (high - low)


def _logistic(x: Array, hit: Array) -> tuple[float, float]:
    """Returns where the chance of a hit is 1/2, and how fast its logit grows: maximum likelihood by
    Newton's method.
    """
    middle = float(x.mean())
    design, weights = np.stack((np.ones_like(x), x - middle), axis=1), np.zeros(2)
    for _ in range(25):
        chance = 1.0 / (1.0 + np.exp(-np.clip(design @ weights, -30.0, 30.0)))
        curvature = design.T @ (design * (chance * (1.0 - chance))[:, None]) + 1e-6 * np.eye(2)
        weights = weights + np.linalg.solve(curvature, design.T @ (hit - chance))
    return middle - float(weights[0] / weights[1]), float(weights[1])


def _corner_law(side: Array, rms: Array) -> tuple[float, float, float]:
    """sigma = hypot(a / side, b) and its log-normal spread, from the rms of eight coordinates
    each.
    """
    typical = rms / 0.958  # median of the rms of eight normal numbers
    terms = np.stack((1.0 / side**2, np.ones_like(side)), axis=1)
    a2, b2 = float(np.median(typical[side < 15.0] * side[side < 15.0])) ** 2, 0.0
    large = side > 20.0
    if large.any():
        b2 = max(0.0, float(np.median(typical[large] ** 2 - a2 / side[large] ** 2)))
    logs = np.log(typical / np.sqrt(terms @ np.array([a2, b2])))
    return math.sqrt(a2), math.sqrt(b2), math.sqrt(max(0.0, float(_spread(logs)) ** 2 - 0.255**2))

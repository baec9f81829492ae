"""Shots of the static experiment: both cameras' images, and what the project's own detectors see in
them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from flight.harness.renderer import (
    DepthNoise,
    FrameRenderer,
    Imaging,
    RenderedInstant,
    RendererSetup,
    Shot,
)
from missions.trials.pose.static.stage import CAMERA, SIDE_M, SIDE_SIGMA_M, STANDS, Mounts, stage_of
from path.config import MethodConfig
from path.geometry.transforms import Pose, Vector
from path.marker.detect import Refine, detect_markers
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box, Depth, MarkerDetection, Region
from path.target.place import back_project, registered_depth
from path.values import frozen

LAYOUT = single_marker(SIDE_M, SIDE_SIGMA_M)
DEPTH = DepthNoise(sigma_at_1m_m=0.005, correlation_px=2.0)
REFINES: tuple[Refine, ...] = ("subpix", "photometric")
DETECTOR = ColorDetectorConfig(max_side_px=500.0)
METHOD = MethodConfig()  # as it flies
# of a target 170 to 300 px wide: a few stereo windows
NARROW = MethodConfig(depth_center_fraction=0.08)
STREAM = 1  # first of the seeds of a stage; errors use others


@frozen
class StaticSeries:
    """Some sessions of one configuration, with one kind of cameras.

    Attributes:
        renderer: the class of the renderer.
        imaging: of each drone's camera.
        configuration: its number in ``STANDS``.
        sessions: their numbers.
    """

    renderer: type[FrameRenderer]
    mounts: Mounts
    imaging: Mapping[Role, Imaging]
    seed: int
    configuration: int
    sessions: tuple[int, ...]


@frozen
class SenderObservation:
    """D1's observation of the target.

    Attributes:
        depth: over the middle of its box, as in flight; ``narrow_depth`` over a smaller part.
        point_c1_m: the point of the surface that the box centre truly shows, in D1's camera.
    """

    box: Box
    depth: Depth
    narrow_depth: Depth | None
    point_c1_m: Vector


@frozen
class StaticMeasurement:
    """One measurement: the truth, and what both drones saw.

    Attributes:
        T_c2_v: the true pose of the marker frame in D2's camera.
        gravity_b1, gravity_b2: true direction of gravity in each body.
        markers: the only detection of D2's marker by kind of corners; None when it was not found,
            or found twice.
        target: None when D1's detector or depth camera did not see it.
    """

    configuration: int
    session: int
    T_c2_v: Pose
    gravity_b1: Vector
    gravity_b2: Vector
    markers: dict[str, MarkerDetection | None]
    target: SenderObservation | None


def shoot(shooting: StaticSeries) -> list[StaticMeasurement]:
    """A piece of work. The stages depend on seed, configuration and session, not on the camera."""
    renderers = {role: renderer_of(shooting, role) for role in Role}
    return [_sighting(shooting, renderers, session) for session in shooting.sessions]


def renderer_of(shooting: StaticSeries, role: Role) -> FrameRenderer:
    """One drone's camera."""
    return _studio_renderer(
        shooting.renderer, shooting.mounts, shooting.imaging[role], shooting.seed, role
    )


@lru_cache(maxsize=2)
def _studio_renderer(
    kind: type[FrameRenderer], mounts: Mounts, imaging: Imaging, seed: int, role: Role
) -> FrameRenderer:
    """Kept: to make one takes longer than to use it for a measurement."""
    return kind(
        RendererSetup(CAMERA, mounts.T_b_c(role), mounts.T_b_v, LAYOUT, imaging, depth=DEPTH), seed
    )


def stage_in(shooting: StaticSeries, session: int) -> RenderedInstant:
    rng = np.random.default_rng([shooting.seed, STREAM, shooting.configuration, session])
    heading = float(rng.uniform(-math.pi, math.pi))
    return stage_of(STANDS[shooting.configuration], shooting.mounts, heading, rng)


def shot_seed(shooting: StaticSeries, session: int) -> int:
    return 10_000 * shooting.configuration + session


def _sighting(
    shooting: StaticSeries, renderers: dict[Role, FrameRenderer], session: int
) -> StaticMeasurement:
    stage = stage_in(shooting, session)
    mounts = shooting.mounts
    shots = {
        role: renderer.shoot(stage, role, shot_seed(shooting, session))
        for role, renderer in renderers.items()
    }
    T_w_b1 = stage.T_w_b[Role.SENDER]
    T_w_b2 = stage.T_w_b[Role.RECEIVER]
    return StaticMeasurement(
        shooting.configuration,
        session,
        (T_w_b2 @ mounts.T_b_c2).inverse() @ T_w_b1 @ mounts.T_b_v,
        -T_w_b1.R[2],
        -T_w_b2.R[2],
        find_marker(shots[Role.RECEIVER]),
        _target(shots[Role.SENDER], renderers[Role.SENDER], stage),
    )


def find_marker(shot: Shot) -> dict[str, MarkerDetection | None]:
    """D2's marker, looked for in the whole image, with both kinds of corners.

    OpenCV's corners are taken in a region around it, enlarged: so they start better than they would
    in the whole.
    """
    found = detect_markers(shot.color, None, LAYOUT, CAMERA)
    if len(found) != 1:
        return dict.fromkeys(REFINES)
    (u0, v0), (u1, v1) = (
        found[0].corners_px.min(axis=0).tolist(),
        found[0].corners_px.max(axis=0).tolist(),
    )
    room = 1.5 * max(u1 - u0, v1 - v0)
    region = Region(u0 - room, v0 - room, u1 + room, v1 + room)
    again = detect_markers(shot.color, region, LAYOUT, CAMERA, refine="subpix")
    return {"photometric": found[0], "subpix": again[0] if len(again) == 1 else None}


def _target(
    shot: Shot, renderer: FrameRenderer, stage: RenderedInstant
) -> SenderObservation | None:
    """D1's target: its best detection, and the depth over it."""
    found = ColorDetector(DETECTOR).detect(shot.color, None)
    depth = registered_depth(shot.depth_mm, found[0].box, METHOD) if found else None
    if depth is None:
        return None
    u, v = found[0].box.center
    true_m = renderer.true_depth_m(stage, Role.SENDER, u, v)
    if true_m is None:
        return None
    narrow = registered_depth(shot.depth_mm, found[0].box, NARROW)
    return SenderObservation(
        found[0].box, depth, narrow, np.array(back_project(CAMERA, u, v, true_m))
    )

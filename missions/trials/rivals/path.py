"""PATH on one pair of frames: what D1 and D2 believe of themselves, and their own cycles on the
pixels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from drivers.interfaces import Detector, Frame
from drivers.perception.pixels import PixelView
from drivers.rig.parts import Mount
from flight.camera_pose import gravity_in
from flight.frame.receiver import ReceiverSide
from flight.frame.records import AttemptId
from flight.frame.sender import PairCameras, SenderSide
from flight.harness.errors import DepthError, DrawnErrors
from flight.harness.renderer import Shot
from flight.rendezvous.marker_view import MarkerFix
from flight.tracking.association import Sighting
from missions.trials.rivals.stage import CAMERAS, DrawnStage, marker_mount
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior
from path.gate.agreement import Agreed
from path.geometry import rotation
from path.geometry.transforms import Matrix, Pose
from path.marker.layout import MarkerLayout
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from path.messages import Role, Target, Vec3
from path.observations import Box, MissReason, Region
from path.target.monocular import TargetSize
from path.values import frozen

STAMP_NS = 1_000_000_000
ATTEMPT = AttemptId(1, 1, 1)
# of clean boxes at known distances, any heading: for D2 without depth
SHIRT = TargetSize(0.65, 0.13, longest_m=0.95)
REGION_ERROR_PX = 10.0
REGION_MARGIN_PX = 60.0


@frozen
class Beliefs:
    """The drones' beliefs."""

    camera1: CameraModel
    camera2: CameraModel
    layout: MarkerLayout
    T_v_c1: Pose
    gravity_v: Vec3
    gravity_c2: Vec3
    marker_region: Region  # where D2 expects D1's marker, from the frames before
    depth: Mapping[Role, DepthError]


@frozen
class PathAnswer:
    """PATH's answer to a pair of frames.

    Attributes:
        box: D2's candidate; None when it found none.
        reason: why there is none.
        agreed: D1 mapped the candidate back and the IoU was enough.
        prior: where D2 expected the target, when it came to that.
        mapped: the candidate in D1's image.
    """

    box: Box | None
    reason: MissReason | None
    agreed: bool = False
    prior: Prior | None = None
    mapped: Box | None = None


def beliefs(
    scene: DrawnStage,
    drawn: DrawnErrors,
    rng: np.random.Generator,
) -> Beliefs:
    """The drones' beliefs with the errors that were drawn for this stage, and the noise of its
    attitudes.
    """
    believed = Mount(drawn.T_b_c[Role.SENDER], drawn.T_b_v)
    return Beliefs(
        drawn.cameras[Role.SENDER],
        drawn.cameras[Role.RECEIVER],
        drawn.layout,
        believed.T_v_c,
        gravity_in(_attitude(scene, Role.SENDER, drawn, rng) @ drawn.T_b_v.R),
        gravity_in(_attitude(scene, Role.RECEIVER, drawn, rng) @ drawn.T_b_c[Role.RECEIVER].R),
        _marker_region(scene, marker_mount(scene.side), rng),
        drawn.depth,
    )


def run_path(
    beliefs: Beliefs,
    config: MethodConfig,
    shots: dict[Role, Shot],
    box1: Box | None,
    detector: Detector,
    *,
    depth2: bool = True,
) -> PathAnswer:
    """One pair of frames, taken at one instant, through the project's own cycles of both drones.

    Args:
        box1: what D1 tracks.
        depth2: D2's camera has depth, as D1's has.
    """
    one, two = (
        PixelView(
            Frame(
                STAMP_NS,
                1,
                shots[role].color,
                beliefs.depth[role].measured_mm(shots[role].depth_mm)
                if role is Role.SENDER or depth2
                else None,
            ),
            beliefs.camera1 if role is Role.SENDER else beliefs.camera2,
            beliefs.layout,
            detector,
            config,
            size=SHIRT,
        )
        for role in (Role.SENDER, Role.RECEIVER)
    )
    cameras = PairCameras(beliefs.camera1, beliefs.camera2, beliefs.T_v_c1)
    sender = SenderSide(cameras, config, ATTEMPT)
    receiver = ReceiverSide(cameras, config, ATTEMPT)
    seen = MissReason.NO_TARGET if box1 is None else Sighting(box1, one.depth(box1))
    message = sender.observe(1, STAMP_NS, seen, beliefs.gravity_v).message
    if not isinstance(message, Target):
        return PathAnswer(None, message.reason)
    receiver.hear(message, STAMP_NS, STAMP_NS)
    settings = PoseSettings(
        max_incidence_rad=math.radians(config.max_incidence_deg),
        max_sigma_m=config.max_pose_sigma_m,
    )
    pose = estimate_pose(
        two.markers(beliefs.marker_region),
        beliefs.layout,
        beliefs.camera2,
        receiver.gravity_v(STAMP_NS),
        beliefs.gravity_c2,
        settings,
    )
    fix = MarkerFix(pose.T_c_v, pose.covariance, 0.0, ()) if isinstance(pose, MarkerPose) else pose
    prior = receiver.prior(fix, STAMP_NS)
    answer = receiver.look(two, prior)
    assert answer is not None  # this is the only frame
    candidate = answer.candidate
    known = prior if isinstance(prior, Prior) else None
    if candidate.box is None:
        return PathAnswer(None, candidate.reason, prior=known)
    sender.hear(candidate, STAMP_NS, STAMP_NS)
    (pair,) = sender.judge(STAMP_NS)
    return PathAnswer(
        candidate.box,
        None if isinstance(pair.verdict, Agreed) else pair.verdict.reason,
        isinstance(pair.verdict, Agreed),
        known,
        pair.mapped_box,
    )


def _attitude(
    scene: DrawnStage,
    role: Role,
    drawn: DrawnErrors,
    rng: np.random.Generator,
) -> Matrix:
    """``R_n_b`` as the drone's own estimate has it."""
    R_n_w = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    tilt = np.array(drawn.tilt_bias_rad[role]) + rng.normal(0.0, drawn.tilt_noise_rad, 2)
    return rotation.exp(np.array([*tilt, 0.0])) @ R_n_w @ scene.stage.T_w_b[role].R


def _marker_region(
    scene: DrawnStage,
    T_b_v: Pose,
    rng: np.random.Generator,
) -> Region:
    """Return where a D2 that has seen the marker before looks for it: off by some pixels, with
    room around.
    """
    T_c_v = scene.T_w_c(Role.RECEIVER).inverse() @ scene.stage.T_w_b[Role.SENDER] @ T_b_v
    x, y, z = T_c_v.t.tolist()
    camera = CAMERAS[Role.RECEIVER]
    u, v = np.array(camera.project_point((x, y, z))) + rng.normal(0.0, REGION_ERROR_PX, 2)
    half = 0.75 * scene.wanted.marker_side_m * camera.fx / z + REGION_MARGIN_PX
    return Region(u - half, v - half, u + half, v + half)

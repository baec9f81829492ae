"""The table of errors: what a careful crew leaves between what the rig says and what is true, drawn
once a flight.

A rig says how its cameras, mounts, markers and sensors are; the drones' programs believe it. The
world is built with errors on top (``as_built``): it draws, projects and stamps with them, and truth
is scored with them. The sizes are standard deviations; ``careless`` has three times those of
``careful``, which is the default, and ``exact`` none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, fields, replace
from typing import Literal

import numpy as np

from drivers.rig.parts import Mount, Rig, RoleRig
from flight.harness.errors import DepthError
from path.arrays import Depths
from path.camera.model import CameraModel
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout
from path.messages import Role
from path.values import frozen

Generator = np.random.Generator

ErrorLevel = Literal["exact", "careful", "careless"]
TIMES: Mapping[ErrorLevel, float] = {"exact": 0.0, "careful": 1.0, "careless": 3.0}
LONGEST_S = 0.02  # of an exposure and of reading a picture out: a period of 50 frames a second


@frozen
class ErrorSizes:
    """Standard deviations; the defaults are what a careful crew leaves. Where they come from is in
    ``SOURCES``.

    Attributes:
        focal: of both focal lengths together, relative.
        centre_px: of the principal point, per axis.
        distortion_px: displacement in the corner of the image that the distortion's error makes,
            per axis.
        side: of a marker's printed side, relative.
        mount_m, mount_deg: of each camera and of the marker on its drone, per axis.
        tilt_bias, yaw_bias, attitude_noise: of the attitude estimates, as times those in
            ``[world.estimator]``.
        depth, depth_bias_m: too far or near, relative and constant.
        depth_stamp_s: from the instant of colour to that of the depth registered to it.
        attitude_stamp_s: of a frame's stamp against those of the attitude.
        stamp_jitter_s: of a frame's stamp, new in every frame.
        edge_px: of each edge of a detector's boxes (at level ``sim``; elsewhere there are real
            detectors).
        exposure_s, readout_s: of a colour camera, none of them standard deviations: an exposure is
            drawn evenly from a third to five thirds of it, what lies between first and last row
            from two thirds to four thirds; neither is longer than ``LONGEST_S``.
        home_m: of the place where a drone was put down, from where the rig says it stands, per
            axis.
    """

    focal: float = 0.002
    centre_px: float = 1.0
    distortion_px: float = 0.5
    side: float = 0.0025
    mount_m: float = 0.002
    mount_deg: float = 0.3
    tilt_bias: float = 1.0
    yaw_bias: float = 1.0
    attitude_noise: float = 1.0
    depth: float = 0.01
    depth_bias_m: float = 0.003
    depth_stamp_s: float = 0.005
    attitude_stamp_s: float = 0.005
    stamp_jitter_s: float = 0.002
    edge_px: float = 1.5
    exposure_s: float = 0.006
    readout_s: float = 0.015
    home_m: float = 0.05


SOURCES: Mapping[str, str] = {
    "focal": "`calibrate camera` on good sets; weak public ones reach 0.5-2 %",
    "centre_px": "`calibrate camera` on good sets",
    "distortion_px": "assumed, about what goes with 0.2 % of focal length",
    "side": "assumed: 0.1 mm of 40 mm, measured with a caliper",
    "mount_m": "assumed, measured with a ruler",
    "mount_deg": "assumed, measured with a protractor",
    "tilt_bias": "[world.estimator]: 0.5 degrees, as PX4 and ArduCopter in docs/conformance.md",
    "yaw_bias": "[world.estimator]: 2 degrees, assumed",
    "attitude_noise": "[world.estimator]: 0.2 degrees, 0.3 in yaw, assumed",
    "depth": "assumed, half of what the D415's data sheet allows at 2 m",
    "depth_bias_m": "assumed",
    "depth_stamp_s": "assumed",
    "attitude_stamp_s": "assumed",
    "stamp_jitter_s": "assumed",
    "edge_px": "assumed: where detectors put an edge is a matter of their training",
    "exposure_s": "assumed: 2 to 10 ms, from a bright day to a lit room",
    "readout_s": "assumed: 10 to 20 ms, most of a period of 50 frames a second; three times that is cut to all of it",
    "home_m": "assumed: measured with a tape from where the target's place was measured",
}


@frozen
class ErrorsConfig:
    """The ``[world.errors]`` table of a rig."""

    level: ErrorLevel = "careful"

    @property
    def sizes(self) -> ErrorSizes:
        return sizes_of(self.level)


def sizes_of(level: ErrorLevel) -> ErrorSizes:
    careful = ErrorSizes()
    times = TIMES[level]
    return ErrorSizes(*(times * getattr(careful, each.name) for each in fields(careful)))


def level_of(rig: Rig) -> ErrorLevel:
    """Return the level of errors that the world of a rig is drawn with."""
    return rig.world.get("errors", {}).get("level", ErrorsConfig().level)


@frozen
class SensorErrors:
    """The errors of one drone's camera for one flight; none by default.

    Attributes:
        depth: factor on every depth; ``depth_bias_m`` comes on top.
        depth_late_s: the depth is of an instant this much after that of colour.
        stamp_late_s, stamp_jitter_s: a frame's stamp less the instant at which it was taken, and
            how that varies.
        edges_px: on the left, top, right and bottom edge of the detector's boxes.
        exposure_s: of a frame; ``readout_s``: from its first row to its last. A frame's instant is
            the middle of the exposure of its middle row.
        seed: of what is new in every frame.
    """

    depth: float = 1.0
    depth_bias_m: float = 0.0
    depth_late_s: float = 0.0
    stamp_late_s: float = 0.0
    stamp_jitter_s: float = 0.0
    edges_px: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    exposure_s: float = 0.0
    readout_s: float = 0.0
    seed: int = 0

    def measured_mm(self, depth_mm: Depths) -> Depths:
        """A depth image with these errors; 0, where there is none, stays 0."""
        return self.depth_error.measured_mm(depth_mm)

    @property
    def depth_error(self) -> DepthError:
        return DepthError(self.depth, self.depth_bias_m)


@frozen
class Built:
    """The rig as it truly is, for one flight: its cameras, mounts and markers, and its sensors by
    role.
    """

    rig: Rig
    sensors: Mapping[Role, SensorErrors] = field(
        default_factory=lambda: dict.fromkeys(Role, SensorErrors())
    )


class StampErrors:
    """The errors of one camera's stamps, frame after frame. Never so much that they would run
    backwards.
    """

    def __init__(self, sensor: SensorErrors, rate_hz: float) -> None:
        self._sensor = sensor
        self._most_s = 0.45 / rate_hz
        self._random = np.random.default_rng(sensor.seed)

    def next_ns(self) -> int:
        """Return the next frame's stamp less the instant at which it was taken."""
        sensor = self._sensor
        jitter_s = (
            sensor.stamp_jitter_s * self._random.standard_normal() if sensor.stamp_jitter_s else 0.0
        )
        return round(1e9 * (sensor.stamp_late_s + min(max(jitter_s, -self._most_s), self._most_s)))


def as_built(
    rig: Rig,
    seed: int,
    drones: Mapping[Role, int] | None = None,
) -> Built:
    """Return a rig as a flight's errors make it, by its level and seed.

    Args:
        drones: number of the drone in each role, where there are more than two: each has errors of
            its own.
    """
    sizes = sizes_of(level_of(rig))
    drones = drones or {role: k for k, role in enumerate(Role)}
    streams = {
        role: [np.random.default_rng([seed, 0x6572726F, drones[role], k]) for k in range(4)]
        for role in Role
    }
    T_b_v = other_mount(rig.sender.mount.T_b_v, sizes, streams[Role.SENDER][2])
    sender, receiver = (_own(rig.role(role), T_b_v, sizes, streams[role]) for role in Role)
    layout = other_print(
        rig.layout,
        sizes,
        np.random.default_rng([seed, 0x7072696E, drones[Role.SENDER]]),
    )
    built = replace(rig, sender=sender, receiver=receiver, layout=layout)
    return Built(built, {role: draw_sensor(sizes, streams[role][3]) for role in Role})


def _own(
    own: RoleRig,
    T_b_v: Pose,
    sizes: ErrorSizes,
    streams: list[Generator],
) -> RoleRig:
    mount = Mount(other_mount(own.mount.T_b_c, sizes, streams[1]), T_b_v)
    return replace(own, camera=other_lens(own.camera, sizes, streams[0]), mount=mount)


def put_down(
    said_m: tuple[float, float],
    sizes: ErrorSizes,
    seed: int,
    drone: int,
) -> tuple[float, float]:
    """Return where a drone truly stands, east and north, that the crew put down at a place.
    ``drone``: its number.
    """
    east, north = (
        sizes.home_m * np.random.default_rng([seed, 0x686F6D65, drone]).standard_normal(2)
    ).tolist()
    return said_m[0] + east, said_m[1] + north


def other_lens(
    camera: CameraModel,
    sizes: ErrorSizes,
    rng: Generator,
) -> CameraModel:
    """The camera as it is: its lens bends rays a little differently, most in the corners, and two
    ways at once.
    """
    scale = 1.0 + sizes.focal * rng.standard_normal()
    u, v = (sizes.centre_px * rng.standard_normal(2)).tolist()
    bends = [
        size * draw
        for size, draw in zip(_bends(camera, sizes), rng.standard_normal(4).tolist(), strict=True)
    ]
    k1, k2, p1, p2, k3 = camera.distortion
    return replace(
        camera, fx=camera.fx * scale, fy=camera.fy * scale, cx=camera.cx + u, cy=camera.cy + v,
        distortion=(k1 + bends[0], k2 + bends[1], p1 + bends[2], p2 + bends[3], k3),
    )  # fmt: skip


def doubted(camera: CameraModel, sizes: ErrorSizes) -> CameraModel:
    """Return a camera whose calibration states these sizes, as ``calibrate camera`` does; it is as
    it was.
    """
    bends = _bends(camera, sizes)
    sigmas = (sizes.centre_px, sizes.centre_px, *bends)
    causes = [(sizes.focal * camera.fx, sizes.focal * camera.fy, *(0.0,) * 7)]
    causes += [(*(0.0,) * (2 + k), sigma, *(0.0,) * (6 - k)) for k, sigma in enumerate(sigmas)]
    return replace(camera, doubts=tuple(causes))


def _bends(camera: CameraModel, sizes: ErrorSizes) -> tuple[float, float, float, float]:
    """Standard deviations of ``(k1, k2, p1, p2)``: radially and tangentially two terms share the
    corner's error.
    """
    radius = 0.5 * math.hypot(camera.width / camera.fx, camera.height / camera.fy)
    corner = sizes.distortion_px / camera.fx / math.sqrt(2.0)
    return (
        corner / radius**3,
        corner / radius**5,
        corner / (3.0 * radius**2),
        corner / (3.0 * radius**2),
    )


def other_mount(
    T: Pose,
    sizes: ErrorSizes,
    rng: Generator,
) -> Pose:
    """Return the true pose of a part on its drone."""
    turn = exp(math.radians(sizes.mount_deg) * rng.standard_normal(3))
    return Pose(T.R @ turn, T.t + sizes.mount_m * rng.standard_normal(3))


def other_print(
    layout: MarkerLayout,
    sizes: ErrorSizes,
    rng: Generator,
) -> MarkerLayout:
    """The markers as they were printed, each by itself."""
    sides = 1.0 + sizes.side * rng.standard_normal(len(layout.markers))
    printed = [
        Marker(each.id, each.side_m * side, each.side_sigma_m, each.T_v_m)
        for each, side in zip(layout.markers, sides.tolist(), strict=True)
    ]
    return replace(layout, markers=tuple(printed))


def draw_sensor(sizes: ErrorSizes, rng: Generator) -> SensorErrors:
    """Return the errors of one camera, its depth and its detector for a whole flight."""
    depth, bias, depth_late, stamp_late, *edges = rng.standard_normal(8).tolist()
    left, top, right, bottom = (sizes.edge_px * edge for edge in edges)
    seed = int(rng.integers(1 << 62))
    exposure, readout = rng.uniform(-1.0, 1.0, 2).tolist()
    return SensorErrors(
        depth=1.0 + sizes.depth * depth,
        depth_bias_m=sizes.depth_bias_m * bias,
        depth_late_s=sizes.depth_stamp_s * depth_late,
        stamp_late_s=sizes.attitude_stamp_s * stamp_late,
        stamp_jitter_s=sizes.stamp_jitter_s,
        edges_px=(left, top, right, bottom),
        exposure_s=min(LONGEST_S, sizes.exposure_s * (1.0 + 2.0 / 3.0 * exposure)),
        readout_s=min(LONGEST_S, sizes.readout_s * (1.0 + readout / 3.0)),
        seed=seed,
    )

"""The renderer of trials: implements ``flight.harness.renderer.FrameRenderer`` with that of the
simulated world.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from flight.harness.renderer import (
    DepthNoise,
    Imaging,
    PlacedBoard,
    Printing,
    RenderedInstant,
    RendererSetup,
    Shot,
    Thing,
)
from hil.camera.pipeline import develop, is_plain
from hil.render.bodies.people import person
from hil.render.bodies.prints import marker_print
from hil.render.mosaic import is_quick
from hil.render.renderer import Renderer
from hil.render.scene import (
    ROTOR,
    Body,
    Model,
    car,
    drone,
    flying,
    lying,
    marked_drone,
    printed_board,
    standing,
)
from hil.render.sensor import SensorNoise, mixed
from path.arrays import Array, Image
from path.geometry.transforms import Pose
from path.marker.photometric.texture import cells
from path.messages import Role

FARTHEST_M = 400.0  # as far as the ground is drawn
CAR = car()
PLAIN_DRONE = drone()
LIGHTS = 8  # different shadows and blades; every shot has one of them


class CameraRenderer:
    """One camera. Call it from one thread at a time.

    Raises:
        ValueError: a setting that cannot be, or a camera with pixels without a ray.
    """

    def __init__(self, setup: RendererSetup, seed: int) -> None:
        self._setup = setup
        self._seed = seed
        noise = _sensor_noise(setup.imaging, setup.depth)
        quick = setup.imaging if is_quick(setup.imaging) else None
        self._direct = quick is not None or is_plain(setup.imaging)
        self._renderer = Renderer(
            setup.camera,
            setup.T_b_c,
            setup.T_b_v,
            setup.layout,
            noise,
            seed,
            imaging=quick,
        )
        self._blank = marked_drone(setup.T_b_v, setup.layout, hidden=True)
        self._marked: dict[int, Model] = {}

    def shoot(
        self,
        stage: RenderedInstant,
        role: Role,
        shot_seed: int,
    ) -> Shot:
        """Return the image that the role's camera delivers. The drone of the role must be on the
        stage.
        """
        key = self._renderer.key(role, shot_seed)
        light, depth = self._renderer.draw(
            stage.T_w_b[role],
            self._bodies(stage, role, key % LIGHTS),
            key,
        )
        kept = self._renderer.thinned(depth)
        if self._direct:
            return Shot(self._renderer.expose(light, key), kept)
        return Shot(
            self._renderer.thinned(develop(light, self._setup.imaging, np.random.default_rng(key))),
            kept,
        )

    def true_depth_m(
        self,
        stage: RenderedInstant,
        role: Role,
        u: float,
        v: float,
    ) -> float | None:
        """Exact depth along the optical axis of what is seen at a pixel, rotors excepted; None for
        the sky.
        """
        x, y = self._setup.camera.ray(u, v)
        if not math.isfinite(x):
            return None
        ray = np.array([x, y, 1.0])
        T_w_c = stage.T_w_b[role] @ self._setup.T_b_c
        down = -float(T_w_c.R[2] @ ray)
        nearest = float(T_w_c.t[2]) / down if down > 0.0 else math.inf
        T_c_w = T_w_c.inverse()
        for body in self._bodies(stage, role):
            nearest = min(nearest, _depth_of(body.model, T_c_w @ body.T_w_body, ray))
        return nearest if 0.0 < nearest <= FARTHEST_M else None

    def _sender(self, hidden: bool, light: int) -> Model:
        """The drone that carries the markers. ``light`` selects where shadow and blade lie."""
        setup = self._setup
        if hidden:
            return self._blank
        if setup.printing.shadow == "none" and not setup.printing.blade:
            light = 0
        if light not in self._marked:
            prints: tuple[Image, ...] = ()
            if setup.printing != Printing():
                prints = tuple(
                    marker_print(
                        cells(setup.layout.dictionary, marker.id),
                        marker.side_m,
                        setup.printing,
                        np.random.default_rng(mixed(self._seed, number)),
                        np.random.default_rng(mixed(self._seed, number, light)),
                    )
                    for number, marker in enumerate(setup.layout.markers)
                )
            self._marked[light] = marked_drone(
                setup.T_b_v,
                setup.layout,
                hidden=False,
                prints=prints,
            )
        return self._marked[light]

    def _bodies(
        self,
        stage: RenderedInstant,
        role: Role,
        light: int = 0,
    ) -> list[Body]:
        """Everything on the stage but the drone of the role."""
        drones = [
            flying(
                self._sender(stage.marker_hidden, light) if other is Role.SENDER else PLAIN_DRONE,
                T_w_b,
                stage.rotor_phase_rad,
                turning=True,
            )
            for other, T_w_b in stage.T_w_b.items()
            if other is not role
        ]
        return drones + _standing(stage.things) + [_board(board) for board in stage.boards]


def _standing(things: Sequence[Thing]) -> list[Body]:
    return [
        standing(
            CAR if thing.kind == "car" else person(thing.variant),
            thing.position_w_m,
            thing.yaw_rad,
        )
        for thing in things
    ]


def _board(board: PlacedBoard) -> Body:
    return lying(printed_board(board.print_shades, board.side_m, board.light), board.T_w_o)


def _sensor_noise(imaging: Imaging, depth: DepthNoise) -> SensorNoise:
    return SensorNoise(
        blur_sigma_px=imaging.blur_sigma_px,
        read_sigma=imaging.read_sigma,
        shot_gain=imaging.shot_gain,
        depth_sigma_at_1m_m=depth.sigma_at_1m_m,
        depth_correlation_px=depth.correlation_px,
        depth_hole_rate=depth.hole_rate,
        min_depth_m=depth.min_m,
        max_depth_m=depth.max_m,
    )


class _Solid(NamedTuple):
    """Faces of a model but its rotors, in its frame, and the ball around it.

    Attributes:
        p0, normal: (n, 3) corners, normals away from the viewer.
        reach: (n,) normal times corner.
        across, down: (n, 3) sides, each divided by its squared length.
    """

    p0: Array
    normal: Array
    reach: Array
    across: Array
    down: Array
    center: Array
    radius2: float


@lru_cache(maxsize=64)
def _solid(model: Model) -> _Solid:
    corners = model.corners[model.kinds != ROTOR]
    p0 = corners[:, :3]
    e1 = corners[:, 3:6]
    e2 = corners[:, 6:9]
    normal = np.cross(e1, e2)
    points = np.concatenate((p0, p0 + e1, p0 + e2, p0 + e1 + e2))
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius2 = float(((points - center) ** 2).sum(axis=1).max()) * (1.0 + 1e-9)
    across, down = (e / (e * e).sum(axis=1, keepdims=True) for e in (e1, e2))
    return _Solid(p0, normal, (normal * p0).sum(axis=1), across, down, center, radius2)


def _depth_of(
    model: Model,
    T_c_body: Pose,
    ray: Array,
) -> float:
    """Depth of the nearest face that a ray (x, y, 1) meets from its front; inf when it meets
    none.
    """
    solid = _solid(model)
    # in the model's frame
    eye = -T_c_body.t @ T_c_body.R
    direction = ray @ T_c_body.R
    apart = solid.center - eye
    along = float(apart @ direction)
    if float(apart @ apart) - along * along / float(direction @ direction) > solid.radius2:
        return math.inf  # most bodies of a stage are not even near
    reach = solid.reach - solid.normal @ eye
    with np.errstate(divide="ignore", invalid="ignore"):
        z = reach / (solid.normal @ direction)
        offset = eye + z[:, None] * direction - solid.p0
        u = (offset * solid.across).sum(axis=1)
        v = (offset * solid.down).sum(axis=1)
        hit = (reach > 0.0) & (z > 0.0) & (u >= 0.0) & (u <= 1.0) & (v >= 0.0) & (v <= 1.0)
    return float(z[hit].min()) if hit.any() else math.inf

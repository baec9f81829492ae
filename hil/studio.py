"""A studio that renders: implements ``drivers.studio.Studio`` with the renderer of the simulated world."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.studio import DepthNoise, Imaging, Printing, Shot, Stage, StudioSetup, Thing
from hil.camera_pipeline import develop, is_plain
from hil.render.bodies import Body, flying, standing
from hil.render.people import person
from hil.render.prints import marker_print
from hil.render.renderer import Renderer
from hil.render.scene import ROTOR, Model, car, drone, marked_drone
from hil.render.sensor import SensorNoise, mixed
from path.geometry import Pose
from path.marker.texture import cells
from path.messages import Role

FARTHEST_M = 400.0  # as far as the ground is drawn
CAR, PLAIN_DRONE = car(), drone()
LIGHTS = 8  # different shadows and blades; every shot has one of them


class Studio:
    """One camera. Call it from one thread at a time.

    Raises:
        ValueError: a setting that cannot be, or a camera with pixels without a ray.
    """

    def __init__(self, setup: StudioSetup, seed: int) -> None:
        self._setup = setup
        self._seed = seed
        noise = _sensor_noise(setup.imaging, setup.depth)
        self._renderer = Renderer(setup.camera, setup.T_b_c, setup.T_b_v, setup.layout, noise, seed)
        self._blank = marked_drone(setup.T_b_v, setup.layout, hidden=True)
        self._marked: dict[int, Model] = {}

    def shoot(self, stage: Stage, role: Role, shot_seed: int) -> Shot:
        """What the role's camera delivers. The drone of the role must be on the stage."""
        key = self._renderer.key(role, shot_seed)
        light, depth = self._renderer.draw(stage.T_w_b[role], self._bodies(stage, role, key % LIGHTS), key)
        if is_plain(self._setup.imaging):
            return Shot(self._renderer.expose(light, key), depth)
        return Shot(develop(light, self._setup.imaging, np.random.default_rng(key)), depth)

    def true_depth_m(self, stage: Stage, role: Role, u: float, v: float) -> float | None:
        """Exact depth along the optical axis of what is seen at a pixel, rotors excepted; None for the sky."""
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
            prints: tuple[NDArray[np.uint8], ...] = ()
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
            self._marked[light] = marked_drone(setup.T_b_v, setup.layout, hidden=False, prints=prints)
        return self._marked[light]

    def _bodies(self, stage: Stage, role: Role, light: int = 0) -> list[Body]:
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
        return drones + _standing(stage.things)


def _standing(things: Sequence[Thing]) -> list[Body]:
    return [
        standing(CAR if thing.kind == "car" else person(thing.variant), thing.position_w_m, thing.yaw_rad)
        for thing in things
    ]


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


def _depth_of(model: Model, T_c_body: Pose, ray: NDArray[np.float64]) -> float:
    """Depth of the nearest face that a ray (x, y, 1) meets from its front; inf when it meets none."""
    solid = model.kinds != ROTOR
    corners = model.corners[solid]
    p0 = T_c_body.apply(corners[:, :3])
    e1, e2 = corners[:, 3:6] @ T_c_body.R.T, corners[:, 6:9] @ T_c_body.R.T
    normal = np.cross(e1, e2)  # away from the viewer
    along, reach = normal @ ray, np.einsum("ij,ij->i", normal, p0)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = reach / along
        offset = z[:, None] * ray - p0
        u = np.einsum("ij,ij->i", offset, e1) / np.einsum("ij,ij->i", e1, e1)
        v = np.einsum("ij,ij->i", offset, e2) / np.einsum("ij,ij->i", e2, e2)
        hit = (reach > 0.0) & (z > 0.0) & (u >= 0.0) & (u <= 1.0) & (v >= 0.0) & (v <= 1.0)
    return float(z[hit].min()) if hit.any() else math.inf

"""The whole picture against a slow ray caster that shares only the scene's rectangles with the
renderer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.render.primitives import AMBIENT, DIFFUSE
from hil.render.renderer import SUN_W, Renderer
from hil.render.scene import INK, MARKER, PAPER, PLATE_SCALE, ROTOR, Model, car, marked_drone
from hil.render.sensor import NOISE_FREE
from hil.world.snapshot import Snapshot
from path.geometry.rotation import R_from_yaw
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from tests.hil.render.views import SMALL, TAIL, at, drone, hovering, mount, scene

Array = NDArray[np.float64]

GRID = 4  # samples per pixel and axis
LAYOUT = single_marker(0.06)


def instances(snapshot: Snapshot, role: Role) -> list[tuple[Model, Pose]]:
    found: list[tuple[Model, Pose]] = []
    for other, truth in snapshot.drones.items():
        if other is not role:
            assert other is Role.SENDER
            found.append((marked_drone(TAIL, LAYOUT, hidden=False), truth.T_w_b))
    for thing in snapshot.objects:
        found.append((car(), Pose(R_from_yaw(thing.yaw_rad), np.array(thing.position_w_m))))
    return found


def cast(snapshot: Snapshot, role: Role, T_w_c: Pose, rays: Array) -> tuple[Array, Array]:
    """Nearest opaque face of each ray (n, 3): its colour (n, 3), NaN where there is none, and its z
    (n,).
    """
    with np.errstate(divide="ignore"):
        ground_z = np.divide(-T_w_c.t[2], rays @ T_w_c.R[2])
    nearest = np.where(ground_z > 0.0, ground_z, np.inf)
    color = np.full((len(rays), 3), np.nan)
    for model, T_w_body in instances(snapshot, role):
        T_c_body = T_w_c.inverse() @ T_w_body
        for i, kind in enumerate(model.kinds):
            p0 = T_c_body.apply(model.corners[i, :3])
            e1, e2 = T_c_body.R @ model.corners[i, 3:6], T_c_body.R @ model.corners[i, 6:9]
            normal = -np.cross(e1, e2)
            if kind == ROTOR or normal @ p0 >= 0.0:
                continue
            with np.errstate(divide="ignore", invalid="ignore"):
                z = (normal @ p0) / (rays @ normal)
                offset = rays * z[:, None] - p0
                u, v = offset @ e1 / (e1 @ e1), offset @ e2 / (e2 @ e2)
                hit = (z > 0) & (z < nearest) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
            sun = float(T_w_c.R @ normal @ SUN_W) / float(np.linalg.norm(normal))
            light = AMBIENT + DIFFUSE * max(0.0, sun)
            face = np.tile(model.colors[i] * light, (int(hit.sum()), 1))
            if kind == MARKER:
                face[is_black(model, u[hit], v[hit])] *= INK[0] / PAPER[0]
            color[hit] = face
            nearest[hit] = z[hit]
    return color, nearest


def is_black(model: Model, u: Array, v: Array) -> NDArray[np.bool_]:
    side = int(model.cells_per_side[0])
    columns = np.floor(((u - 0.5) * PLATE_SCALE + 0.5) * side).astype(int)
    rows = np.floor(((v - 0.5) * PLATE_SCALE + 0.5) * side).astype(int)
    inside = (columns >= 0) & (columns < side) & (rows >= 0) & (rows < side)
    return inside & (model.cells[0][np.clip(rows, 0, side - 1), np.clip(columns, 0, side - 1)] == 0)


def rotor_pixels(snapshot: Snapshot, role: Role, T_w_c: Pose, rays: Array) -> NDArray[np.bool_]:
    """Returns which rays (n, 3) come near a rotor's disc."""
    near = np.zeros(len(rays), bool)
    for model, T_w_body in instances(snapshot, role):
        T_c_body = T_w_c.inverse() @ T_w_body
        for corners in model.corners[model.kinds == ROTOR]:
            p0, e1, e2 = (
                T_c_body.apply(corners[:3]),
                T_c_body.R @ corners[3:6],
                T_c_body.R @ corners[6:9],
            )
            uv = np.linalg.solve(np.column_stack((e1, e2, p0)), rays.T)
            near |= np.hypot(uv[0] / uv[2] - 0.5, uv[1] / uv[2] - 0.5) < 0.6
    return near


def test_every_pixel_is_what_a_ray_caster_finds() -> None:
    near = {
        Role.SENDER: drone(hovering(-0.1, 0.0, 1.4, 0.5)),
        Role.RECEIVER: drone(hovering(0.1, -0.42, 1.75, -0.2)),
    }
    for snapshot in (scene(), Snapshot(0.0, near, (at(0, 0.1, 1.2, 0.4),))):
        T_b_c = mount(42.0)
        T_w_c = snapshot.drones[Role.RECEIVER].T_w_b @ T_b_c
        renderer = Renderer(SMALL, T_b_c, TAIL, LAYOUT, NOISE_FREE)
        color, depth = renderer.render(snapshot, Role.RECEIVER, 0)
        bare = Snapshot(0.0, {Role.RECEIVER: snapshot.drones[Role.RECEIVER]}, ())
        ground = renderer.render(bare, Role.RECEIVER, 0)[0].astype(float)

        steps = (np.arange(GRID) + 0.5) / GRID - 0.5
        columns, rows = np.meshgrid(np.arange(SMALL.width), np.arange(SMALL.height))
        mean = np.zeros((SMALL.height, SMALL.width, 3))
        for dv in steps:
            for du in steps:
                pixels = np.column_stack((columns.ravel() + du, rows.ravel() + dv))
                rays = np.column_stack((SMALL.rays(pixels), np.ones(len(pixels))))
                sample = cast(snapshot, Role.RECEIVER, T_w_c, rays)[0].reshape(mean.shape)
                mean += np.where(np.isnan(sample), ground, sample) / GRID**2
        pixels = np.column_stack((columns.ravel(), rows.ravel())).astype(float)
        rays = np.column_stack((SMALL.rays(pixels), np.ones(len(pixels))))
        z_mm = 1000.0 * cast(snapshot, Role.RECEIVER, T_w_c, rays)[1].reshape(columns.shape)

        clear = ~rotor_pixels(snapshot, Role.RECEIVER, T_w_c, rays).reshape(columns.shape)
        assert clear.mean() > 0.7
        difference = np.abs(color - mean).max(axis=2)[clear]
        drawn = np.abs(mean - ground).max(axis=2)[clear] > 0.5
        assert drawn.sum() > 150
        # a corner that one of the two sample patterns just misses
        assert np.mean(difference[~drawn] > 1.0) < 0.005
        assert difference[drawn].mean() < 4.0
        # two patterns of 16 samples, at worst on a slanted edge of high contrast
        assert difference.max() < 50.0
        inside = clear & (z_mm > 301.0) & (z_mm < 5999.0)
        # ties between faces that hide each other
        assert np.mean(np.abs(depth - z_mm)[inside] > 0.51) < 2e-4

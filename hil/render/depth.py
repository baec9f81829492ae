"""A depth camera of its own beside a rendered colour camera: its own place, lens and noise, and no
colour.
"""

from __future__ import annotations

import numpy as np

from hil.render import kernels, sensor
from hil.render.ground import ground_depth, ground_plane
from hil.render.renderer import SUN_W, Renderer, lens_of, sense_depth, set_up
from hil.world.snapshot import Snapshot
from path.arrays import Depths
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.messages import Role


class DepthRenderer:
    """Measures depth as ``Renderer.render`` does, but from its own camera. The same arguments give
    the same bytes.
    """

    def __init__(
        self,
        renderer: Renderer,
        camera: CameraModel,
        T_color_depth: Pose,
    ) -> None:
        """``renderer`` is that of the colour camera: the bodies, the noise model and the seed are
        its.
        """
        self._renderer = renderer
        self._T_color_depth = T_color_depth
        self._lens = lens_of(camera)
        rng = np.random.default_rng(sensor.mixed(renderer.seed, 1))
        shape = camera.height, camera.width
        self._pool = sensor.noise_pool(rng, *shape, renderer.noise.depth_correlation_px)
        self._inverse_z = np.empty(shape, np.float32)
        self._owner = np.empty(shape, np.int16)
        self._edges = np.empty(shape, np.uint8)

    def render(
        self,
        snapshot: Snapshot,
        role: Role,
        frame_seed: int,
    ) -> Depths:
        """Depth, shape (h, w), z along the depth camera's axis in millimetres, 0 where there is
        none.
        """
        renderer = self._renderer
        inverse_z = self._inverse_z
        owner = self._owner
        edges = self._edges
        T_w_d = renderer.T_w_c(snapshot, role) @ self._T_color_depth
        x, y = self._lens.rays[:2]
        owner.fill(-1)
        edges.fill(kernels.INTERIOR)
        ground_depth(ground_plane(T_w_d), x, y, inverse_z)
        sun = T_w_d.R.T @ SUN_W
        faces, tags, count, _ = set_up(
            renderer.bodies(snapshot, role),
            T_w_d.inverse(),
            sun,
            self._lens.view,
        )
        kernels.draw_faces(faces, tags, count, x, y, inverse_z, owner, edges)
        depth = np.empty(owner.shape, np.uint16)
        key = renderer.key(role, frame_seed)
        sense_depth(
            inverse_z,
            owner,
            tags,
            edges,
            snapshot.depth_holes,
            renderer.noise,
            self._pool,
            key,
            depth,
        )
        return depth


def warm_up() -> None:
    """Compile the one kernel that a colour camera does not use; ``hil.render.renderer.warm_up``
    does the others.
    """
    row = np.zeros((1, 1), np.float32)
    ground_depth(np.zeros((3, 3)), row, row, row.copy())

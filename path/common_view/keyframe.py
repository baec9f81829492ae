"""A keyframe: what of one look of an RGB-D camera is kept, or sent to the other drone.

Corners with binary descriptors of their surface as seen from straight before it, and depth in a
coarse grid, both with the camera's attitude as its drone knows it: gravity well, heading roughly.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from path.arrays import Array, Singles
from path.common_view.surface_kernels import planes
from path.values import frozen

Bits = NDArray[np.uint8]

DESCRIPTOR_BYTES = 32


@frozen(eq=False)
class DepthGrid:
    """Depth in an even grid of directions, and the planes in it.

    Attributes:
        depth: (h, w) along the optical axis, m; 0: unknown.
        lens: (4,) ``fx, fy, cx, cy`` of the grid, in cells.
        points: (h * w, 3) in the camera's frame, on the plane of each cell; z is 0 where there is
            none.
        normals: (h * w, 3) unit vectors towards the camera.
    """

    depth: Singles
    lens: Array
    points: Array = field(init=False, repr=False)
    normals: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        height, width = self.depth.shape
        rows, columns = np.mgrid[0:height, 0:width]
        cells = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
        # A plane needs some four percent of the image's width to be told from an edge.
        reach = max(1, round(0.02 * width))
        depths, normals = planes(self.depth, self.lens, cells, reach, 2 * reach * (reach + 1) + 1)
        points = np.empty((len(cells), 3))
        points[:, 0] = (cells[:, 0] - self.lens[2]) / self.lens[0] * depths
        points[:, 1] = (cells[:, 1] - self.lens[3]) / self.lens[1] * depths
        points[:, 2] = depths
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "normals", normals)


@frozen(eq=False)
class Keyframe:
    """One look of an RGB-D camera.

    Attributes:
        R_l_c: (3, 3) from the camera's frame to its levelled one: z down by the drone's gravity, x
            north by its heading.
        grid: depth.
        points_c: (n, 3) corners in the camera's frame, m.
        descriptors: (n, 32) bits.
        patch_m: side of the surface that a descriptor describes.
        depth_sigma_at_1m_m: standard deviation of depth at 1 m; it grows with its square.
        gravity_sigma_rad: of each of the two tilts of ``R_l_c``.
    """

    R_l_c: Array
    grid: DepthGrid
    points_c: Array
    descriptors: Bits
    patch_m: float
    depth_sigma_at_1m_m: float
    gravity_sigma_rad: float

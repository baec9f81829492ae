"""The bodies that synthetic cameras see: flat rectangles in the frames of the bodies, and bodies at
poses in the world.

Geometry is in metres. Faces that lie on each other keep at least 1 mm apart. Only what can be a
target is saturated orange.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from path.arrays import Array, Image, Whole
from path.geometry.rotation import R_from_yaw
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.marker.photometric.texture import cells as marker_cells
from path.values import frozen

Color = tuple[float, float, float]  # BGR under full light

SOLID = 0
MARKER = 1
ROTOR = 2
# both show a table of shades; a pixel of a print is sampled as often as one of a marker
PATTERN = 3
PRINT = 4

PLATE_SCALE = 1.5  # side of the white plate over the side of the marker on it
PAPER: Color = (228.0, 228.0, 228.0)
INK: Color = (26.0, 26.0, 26.0)
ORANGE: Color = (24.0, 118.0, 245.0)
TIRE: Color = (42.0, 40.0, 40.0)
FRAME: Color = (62.0, 58.0, 56.0)
SHELL: Color = (108.0, 88.0, 74.0)
MOTOR: Color = (88.0, 86.0, 84.0)
BLADE: Color = (46.0, 46.0, 48.0)
GAP_M = 0.001
STILL = np.array([1.0, 0.0, 0.0])

CAR_BOXES: tuple[tuple[tuple[float, float, float], tuple[float, float, float], Color], ...] = (
    # centre, size (x forward, y left, z up), colour
    ((0.0, 0.0, 0.070), (0.32, 0.160, 0.070), ORANGE),
    ((-0.03, 0.0, 0.133), (0.16, 0.140, 0.054), ORANGE),
    ((0.095, 0.0955, 0.037), (0.072, 0.029, 0.072), TIRE),
    ((0.095, -0.0955, 0.037), (0.072, 0.029, 0.072), TIRE),
    ((-0.095, 0.0955, 0.037), (0.072, 0.029, 0.072), TIRE),
    ((-0.095, -0.0955, 0.037), (0.072, 0.029, 0.072), TIRE),
)
ROTOR_ARM_M = 0.11  # rotor axes at (+-arm, +-arm)
ROTOR_RADIUS_M = 0.064
DRONE_HALF_M = (0.085, 0.048, 0.024)


@frozen(eq=False)
class Model:
    """Rectangles of one kind of body, in its frame; n of them.

    Attributes:
        corners: (n, 9): corner P0 and sides E1, E2; a point is P0 + u E1 + v E2 with u, v in 0..1.
            To who sees it u runs right and v down: E1 x E2 points away from the viewer. From behind
            it is not drawn, except rotor discs (the circle inscribed in the rectangle).
        colors: (n, 3) BGR.
        kinds: (n,) SOLID, MARKER, ROTOR, PATTERN or PRINT.
        cells: (m, s, s) marker cells, 1 = white; the i-th MARKER rectangle shows ``cells[i]``.
        cells_per_side: (m,).
        seconds: (n, 3) BGR, the other colour of a PATTERN or PRINT.
        shades: the i-th PATTERN or PRINT rectangle shows ``shades[i]``, (rows, columns) over v and
            u: share of its first colour, 0..255, the rest is the second.
    """

    corners: Array
    colors: Array
    kinds: Whole
    cells: Image
    cells_per_side: Whole
    seconds: Array
    shades: tuple[Image, ...]


class Face(NamedTuple):
    """One rectangle of a model."""

    corner: Array
    e1: Array
    e2: Array
    color: Color
    kind: int = SOLID
    second: Color = (0.0, 0.0, 0.0)
    shades: Image | None = None


def box(
    center: Sequence[float] | Array,
    size: Sequence[float],
    color: Color,
    axes: Array | None = None,
) -> list[Face]:
    """Six outward faces of a box; ``axes`` holds its axes in columns (default: those of the
    body).
    """
    frame = np.eye(3) if axes is None else axes
    faces: list[Face] = []
    for axis, sign in product(range(3), (1.0, -1.0)):
        normal = sign * frame[:, axis]
        first = frame[:, (axis + 1) % 3]
        second = np.cross(first, normal)
        e1 = first * size[(axis + 1) % 3]
        e2 = second * size[(axis + 2) % 3]
        middle = np.asarray(center, float) + normal * (0.5 * size[axis])
        faces.append(Face(middle - 0.5 * (e1 + e2), e1, e2, color))
    return faces


@cache
def car() -> Model:
    """The target and its look-alikes: x forward, z up, origin on the ground below the middle."""
    return model_of(
        [face for center, size, color in CAR_BOXES for face in box(center, size, color)]
    )


def drone() -> Model:
    """A quadrotor in body FRD, without marker."""
    return model_of(_airframe())


def printed_board(
    shades: Image,
    side_m: float,
    light: tuple[float, float] = (INK[0], PAPER[0]),
) -> Model:
    """A flat print of square cells: origin at its top-left corner, x right, y down, z away from the
    viewer.

    ``shades``: (rows, columns) of the paper, 255 is white and 0 ink. ``light``: of ink and paper,
    0..255.
    """
    rows, columns = shades.shape
    e1 = np.array([columns * side_m, 0.0, 0.0])
    e2 = np.array([0.0, rows * side_m, 0.0])
    ink, paper = light
    return model_of(
        [Face(np.zeros(3), e1, e2, (paper, paper, paper), PRINT, (ink, ink, ink), shades)]
    )


def marked_drone(
    T_b_v: Pose,
    layout: MarkerLayout,
    *,
    hidden: bool,
    prints: Sequence[Image] = (),
) -> Model:
    """A quadrotor that carries the plates of a marker layout.

    Args:
        hidden: the plates are blank.
        prints: what the plates show instead of ideal markers, one each: shades of ``PAPER``.
    """
    faces = [*_airframe()]
    cells: list[Image] = []
    for number, marker in enumerate(layout.markers):
        T_b_m = T_b_v @ marker.T_v_m
        kind = SOLID if hidden else PRINT if prints else MARKER
        front, *backing = _plate(T_b_m, PLATE_SCALE * marker.side_m, kind)
        faces += [front._replace(shades=prints[number]) if kind == PRINT else front, *backing]
        faces += _strut(T_b_m)
        if kind == MARKER:
            cells.append(marker_cells(layout.dictionary, marker.id).astype(np.uint8))
    return model_of(faces, cells)


@cache
def _airframe() -> Sequence[Face]:
    faces = box((0.0, 0.0, 0.0), tuple(2.0 * half for half in DRONE_HALF_M), SHELL)
    faces += box((0.015, 0.0, -DRONE_HALF_M[2] - GAP_M - 0.009), (0.09, 0.05, 0.018), FRAME)
    below = DRONE_HALF_M[2] + GAP_M + 0.006
    top = -0.004
    c = float(np.sqrt(0.5))
    for turn in (1.0, -1.0):
        axes = np.array([[c, -turn * c, 0.0], [turn * c, c, 0.0], [0.0, 0.0, 1.0]])
        faces += box((0.0, 0.0, below), (2.0 * ROTOR_ARM_M / c, 0.022, 0.012), FRAME, axes)
    for x, y in product((ROTOR_ARM_M, -ROTOR_ARM_M), repeat=2):
        bottom = below - 0.006 - GAP_M
        faces += box((x, y, 0.5 * (top + bottom)), (0.020, 0.020, bottom - top), MOTOR)
        faces.append(_rotor((x, y, top - 0.008)))
    return faces


def _rotor(center: tuple[float, float, float]) -> Face:
    e1 = np.array([2.0 * ROTOR_RADIUS_M, 0.0, 0.0])
    e2 = np.array([0.0, 2.0 * ROTOR_RADIUS_M, 0.0])
    return Face(np.asarray(center) - 0.5 * (e1 + e2), e1, e2, BLADE, ROTOR)


def _plate(
    T_b_m: Pose,
    side_m: float,
    kind: int,
) -> list[Face]:
    """White plate with its marker, and 1 mm behind it a slightly smaller backing."""
    right, up, out = T_b_m.R.T
    e1 = right * side_m
    e2 = -up * side_m
    front = Face(T_b_m.t - 0.5 * (e1 + e2), e1, e2, PAPER, kind)
    inner = side_m - 2.0 * GAP_M
    return [front, *box(T_b_m.t - out * (GAP_M + 0.001), (inner, inner, 0.002), FRAME, T_b_m.R)]


def _strut(T_b_m: Pose) -> list[Face]:
    """A rod from the airframe to the back of a plate; none when the plate touches the airframe."""
    end = T_b_m.t - T_b_m.R[:, 2] * 0.006
    distance = float(np.linalg.norm(end))
    if distance == 0.0:
        return []
    direction = end / distance
    start = min(
        half / abs(d) if abs(d) > 1e-9 else np.inf
        for half, d in zip(DRONE_HALF_M, direction, strict=True)
    )
    length = distance - start - GAP_M
    if length <= 0.0:
        return []
    across = np.asarray(np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))]), float)
    across /= np.linalg.norm(across)
    axes: Array = np.column_stack((direction, across, np.cross(direction, across)))
    middle = direction * (start + GAP_M + 0.5 * length)
    return box(middle, (length, 0.012, 0.012), FRAME, axes)


def model_of(faces: Sequence[Face], cells: Sequence[Image] = ()) -> Model:
    """``cells``: of the MARKER faces, in their order."""
    side = max((len(cell) for cell in cells), default=1)
    table = np.zeros((max(len(cells), 1), side, side), np.uint8)
    for entry, cell in zip(table, cells, strict=False):
        entry[: len(cell), : len(cell)] = cell
    return Model(
        corners=np.array([np.concatenate((face.corner, face.e1, face.e2)) for face in faces]),
        colors=np.array([face.color for face in faces]),
        kinds=np.array([face.kind for face in faces], np.int64),
        cells=table,
        cells_per_side=np.array([len(cell) for cell in cells] or [1], np.int64),
        seconds=np.array([face.second for face in faces]),
        shades=tuple(
            np.ascontiguousarray(face.shades) for face in faces if face.shades is not None
        ),
    )


# --- in the world


@frozen(eq=False)
class Body:
    """A model at its pose in the world.

    Attributes:
        motion: (3,): cosine and sine of the blades' angle, 1 when they turn.
        target: it is of the kind that is tracked: depth may be missing over it.
        velocity_w, rates_w: (3,) of its frame's origin, m/s, and about the world's axes, rad/s.
    """

    model: Model
    T_w_body: Pose
    motion: Array
    target: bool
    velocity_w: Array = field(default_factory=lambda: np.zeros(3))
    rates_w: Array = field(default_factory=lambda: np.zeros(3))


def flying(
    model: Model,
    T_w_b: Pose,
    rotor_phase_rad: float,
    turning: bool,
) -> Body:
    """A drone."""
    return Body(
        model,
        T_w_b,
        np.array([math.cos(rotor_phase_rad), math.sin(rotor_phase_rad), float(turning)]),
        target=False,
    )


def lying(model: Model, T_w_o: Pose) -> Body:
    """Something that neither moves nor is tracked, at any pose."""
    return Body(model, T_w_o, STILL, target=False)


def standing(
    model: Model,
    position_w_m: tuple[float, float, float],
    yaw_rad: float,
) -> Body:
    """A car or a person, upright. ``yaw_rad``: counter-clockwise from east."""
    return Body(model, Pose(R_from_yaw(yaw_rad), np.array(position_w_m)), STILL, target=True)

"""The marker's plate as it hangs on D1, drawn for whoever screws it on.

Two drawings in mm on paper: the print as one sees it who stands before it, and D1 from its right
side, to scale.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from drivers.rig.parts import Rig
from missions.field.calibrate.marker_print import black_cells
from path.camera.model import CameraModel
from path.geometry.transforms import Pose, Vector
from path.marker.layout import DICTIONARIES, QUIET_CELLS, Marker

UP_B = np.array([0.0, 0.0, -1.0])
NOSE_B = np.array([1.0, 0.0, 0.0])
PLATE_MM = 22.0
SIDE_MM = (84.0, 30.0)
BODY_MM = 40.0
FLAT = 0.2  # a direction of which less lies in a plane tells nothing there
_SIDES = (
    "forwards", "forwards to the right", "to the right", "backwards to the right",
    "backwards", "backwards to the left", "to the left", "forwards to the left",
)  # fmt: skip
_EDGES = ("upper", "left", "lower", "right")


def faces(T_b_v: Pose) -> str:
    """Return in words which way a plate faces, and which edge of the print is where."""
    ahead, right, down = T_b_v.R[:, 2].tolist()
    said: list[str] = []
    if math.hypot(ahead, right) > FLAT:
        said.append(_SIDES[round(math.degrees(math.atan2(right, ahead)) / 45.0) % 8])
    tilt_deg = math.degrees(math.asin(max(-1.0, min(1.0, -down))))
    if abs(tilt_deg) >= 1.0:
        said.append(f"{abs(tilt_deg):.0f}° {'up' if tilt_deg > 0.0 else 'down'}")
    turned_deg = math.degrees(turned(T_b_v))
    quarter = round(turned_deg / 90.0)
    rest_deg = abs(turned_deg - 90.0 * quarter)
    where = "on top" if _reference(T_b_v) is UP_B else "towards the nose"
    slant = f", but for {rest_deg:.0f}°" if rest_deg >= 1.0 else ""
    return f"It faces {', '.join(said)}. The print's {_EDGES[quarter % 4]} edge is {where}{slant}."


def turned(T_b_v: Pose) -> float:
    """Return by how much the print is turned clockwise for who stands before it, rad."""
    x, y, _ = (T_b_v.R.T @ _reference(T_b_v)).tolist()
    return -math.atan2(x, y)


def _reference(T_b_v: Pose) -> Vector:
    """Return what is up for who stands before a plate: up, or the nose of one that lies flat."""
    return UP_B if math.hypot(*(T_b_v.R.T @ UP_B)[:2]) > FLAT else NOSE_B


def sizes(rig: Rig) -> Iterator[str]:
    """Yield what is measured on the plate."""
    for marker in rig.layout.markers:
        side_mm = 1e3 * marker.side_m
        border_mm = 1e3 * QUIET_CELLS * _cell_m(marker, rig.layout.dictionary)
        yield f"id {marker.id}: black frame {side_mm:.1f} mm, {border_mm:.1f} mm of white around it"
    x, y, z = (1e3 * rig.sender.mount.T_b_v.t).tolist()
    ahead = f"{abs(x):.0f} mm {'ahead of' if x > 0.0 else 'behind'}"
    above = f"{abs(z):.0f} mm {'below' if z > 0.0 else 'above'}"
    across = f", {abs(y):.0f} mm {'right' if y > 0.0 else 'left'} of" if abs(y) >= 0.5 else ""
    yield f"its middle is {ahead}{across}, {above} D1's ({rig.layout.dictionary})"


def draw_print(rig: Rig) -> str:
    """Return the plate with its white border from before it, as SVG."""
    dictionary = rig.layout.dictionary
    corners = _corners(rig)[:, :2]
    low = corners.min(axis=0)
    span = corners.max(axis=0) - low
    scale = PLATE_MM / float(span.max())
    x0, y0 = (-0.5 * scale * span).tolist()
    parts = [f'<rect x="{x0:.2f}" y="{y0:.2f}" width="{-2 * x0:.2f}" height="{-2 * y0:.2f}"/>']
    for marker in rig.layout.markers:
        x, y = (scale * (marker.T_v_m.t[:2] - low - 0.5 * span)).tolist()
        own_deg = -math.degrees(math.atan2(marker.T_v_m.R[1, 0], marker.T_v_m.R[0, 0]))
        left = -0.5 * scale * marker.side_m
        cells = black_cells(dictionary, marker.id, left, left, scale * _cell_m(marker, dictionary))
        place = f"translate({x:.2f} {-y:.2f}) rotate({own_deg:.1f})"
        parts.append(f'<g transform="{place}">{"".join(cells)}</g>')
    parts.append(f'<text y="{y0 - 1.0:.2f}" text-anchor="middle">▲ upper edge ▲</text>')
    angle_deg = math.degrees(turned(rig.sender.mount.T_b_v))
    return _svg((PLATE_MM + 8.0, PLATE_MM + 8.0), f'<g transform="rotate({angle_deg:.1f})">', parts)


def draw_side(rig: Rig, diameter_m: float) -> str:
    """Return D1 from its right side: its body, its camera with what it sees, the plate."""
    mount = rig.sender.mount
    corners = mount.T_b_v.apply(_corners(rig))
    reach_m = max(0.5 * diameter_m, float(np.abs(corners).max()))
    scale = 0.5 * BODY_MM / reach_m
    body_mm = scale * 0.5 * diameter_m
    camera = _flat(scale * mount.T_b_c.t)
    plate = _flat(scale * mount.T_b_v.t)
    normal = _flat(11.0 * mount.T_b_v.R[:, 2])
    ends = [f"{x:.2f},{y:.2f}" for x, y in (_flat(scale * corner) for corner in corners)]
    sight = [
        f"M{_xy(camera)}l{_xy(_flat(17.0 * ray))}" for ray in _rim(rig.sender.camera, mount.T_b_c)
    ]
    parts = [
        f'<ellipse rx="{body_mm:.2f}" ry="1.4"/>',
        f'<text x="{body_mm + 1.5:.2f}" y="1">nose →</text>',
        f'<path d="{"".join(sight)}"/>',
        f'<text x="{camera[0] - 2.0:.2f}" y="{camera[1] + 4.5:.2f}" text-anchor="end">camera</text>',
        f'<polygon points="{" ".join(ends)}" stroke-width="1.2"/>',
        f'<path d="M{_xy(plate)}l{_xy(normal)}" marker-end="url(#tip)"/>',
        f'<text x="{-0.5 * SIDE_MM[0]:.2f}" y="{plate[1] + normal[1]:.2f}">the print faces</text>',
    ]
    return _svg(SIDE_MM, f"<g>{_TIP}", parts)


_TIP = (
    '<marker id="tip" markerWidth="6" markerHeight="6" refX="5" refY="3" orient="auto">'
    '<path d="M0 0L6 3L0 6z" fill="#000"/></marker>'
)


def _svg(
    size_mm: tuple[float, float],
    begin: str,
    parts: list[str],
) -> str:
    wide, high = size_mm
    box = f'width="{wide}mm" height="{high}mm" viewBox="{-0.5 * wide} {-0.5 * high} {wide} {high}"'
    return f"<svg {box}>{begin}{''.join(parts)}</g></svg>"


def _flat(point_b: Vector) -> tuple[float, float]:
    """Return a point, or a direction, as one sees it from the right: nose to the right, down."""
    return float(point_b[0]), float(point_b[2])


def _xy(point: tuple[float, float]) -> str:
    return f"{point[0]:.2f} {point[1]:.2f}"


def _corners(rig: Rig) -> Vector:
    """Return the corners of all markers with their white borders in ``v``, shape (n, 3)."""
    found = [
        marker.T_v_m.t
        + (1.0 + 2.0 * QUIET_CELLS * _cell_m(marker, rig.layout.dictionary) / marker.side_m)
        * (marker.corners_v - marker.T_v_m.t)
        for marker in rig.layout.markers
    ]
    return np.concatenate(found)


def _cell_m(marker: Marker, dictionary: str) -> float:
    return marker.side_m / (DICTIONARIES[dictionary][0] + 2)


def _rim(camera: CameraModel, T_b_c: Pose) -> Iterator[Vector]:
    """Yield the directions of the upper and the lower border of an image, in the body's frame."""
    for edge in (-camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy):
        yield T_b_c.R @ np.array([0.0, edge, 1.0]) / math.hypot(edge, 1.0)

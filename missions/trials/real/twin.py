"""A set's rendered twin: the same board before the same camera, at the same places, in the same
light.

The harness's own renderer draws it. Its imaging is what edges of the board say of the camera
(``missions.trials.real.response``), its light what they say of black and white. Its ink lies where
all views agree that it does (``missions.trials.real.paper``). Nothing else is taken from the errors
of markers: those the twin is to predict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path

import cv2
import numpy as np

from flight.harness.renderer import (
    FrameRenderer,
    Imaging,
    PlacedBoard,
    RenderedInstant,
    RendererSetup,
)
from missions.trials.pose.calibration.views import HERE, T_W_C, grey
from missions.trials.real.board import BoardSeen, SetSeen
from missions.trials.real.errors import MethodPoses
from missions.trials.real.paper import CELL_PX, Print, as_seen, ink_moves, pixel_m
from missions.trials.real.response import (
    TOP,
    BoardEdge,
    CameraResponse,
    coarser,
    edge_of,
    fitted,
    levels_of,
    measure_response,
    noise_beside,
    scatter_at,
    see_edges,
    with_noise,
)
from missions.trials.real.set import RealSet
from path.arrays import Array, Image
from path.calibration.board import print_cells
from path.calibration.edges import mean_edge
from path.camera.model import CameraModel, sensor_of
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.values import frozen

GRID_CELLS = 800  # a grid's pitch: its markers' side is what it is, and fits no coarser print
BORDER = 0.6  # of the pitch, white around a grid
PLAIN = Imaging(read_sigma=0.0, shot_gain=0.0)
PASSES = 6
PASS_VIEWS = 4
COARSER = 1.5  # power of the scatter at edges with which steps of compression grow, for a pass
# times the scatter; share by which noise may differ
CLEARLY = 1.05
ALIKE = 0.1
NEARER = 0.8  # of what edges are off, which a pass may leave to be worth another
LEAST_LIGHT = 0.5


def render_twin(
    own: RealSet, seen: SetSeen, measured: MethodPoses | None, images: Sequence[Path], renderer: type[FrameRenderer],
    seed: int, out: Path,
) -> tuple[tuple[Path, ...], CameraResponse] | None:  # fmt: skip
    """Draw every photograph of a set again, into files, and tell with what response.

    None when its camera's response cannot be measured.

    Args:
        measured: its markers, which tell where their ink lies. ``images``: the set's files.
        out: a folder for the twin's.
    """
    response = measure_response(own, seen, images)
    if response is None:
        return None
    pairs = zip(seen.photographs, seen.boards, strict=True)
    edges = {shot.name: see_edges(own, shot, board) for shot, board in pairs}
    printed = _print_of(own, seen).finer(CELL_PX * pixel_m(seen))
    moves = ink_moves(own, seen, measured)
    pairs = zip(seen.photographs, seen.boards, strict=True)
    prints = {shot.name: as_seen(printed, moves, board) for shot, board in pairs}
    drawing = _Drawing(own, prints, edges, renderer, seed)
    drawing = replace(drawing, turned=drawing.measure_turned(seen))
    imaging = _like_it(drawing, seen, response)
    out.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    for shot, image in zip(seen.photographs, drawing.images(seen, imaging), strict=True):
        files.append(out / f"{Path(shot.name).stem}.png")
        cv2.imwrite(str(files[-1]), image)
    return tuple(files), replace(response, imaging=imaging)


@frozen(eq=False)
class _Drawing:
    """The drawing of a set's twin.

    Attributes:
        prints: where ink lies, and ``edges``: of each photograph, by its name.
        turned: by photograph, the share of its light that a board has which is turned away from the
            renderer's sun.
    """

    own: RealSet
    prints: Mapping[str, Print]
    edges: Mapping[str, Sequence[BoardEdge]]
    renderer: type[FrameRenderer]
    seed: int
    turned: Mapping[str, float] = field(default_factory=dict[str, float])

    def measure_turned(self, seen: SetSeen) -> dict[str, float]:
        """Draw the boards in plain light, and see how much of it their paper has."""
        shares: dict[str, float] = {}
        for shot, board, image in zip(
            seen.photographs,
            seen.boards,
            self.images(seen, PLAIN),
            strict=True,
        ):
            wanted = self.edges[shot.name]
            got = see_edges(self.own, replace(shot, grey=image), board)
            shares[shot.name] = _white(got) / _white(wanted) if wanted and got else 1.0
        return shares

    def images(self, seen: SetSeen, imaging: Imaging) -> list[Image]:
        """Every photograph of ``seen`` again, in its own light."""
        camera, sensor_imaging = _sensor(seen.camera, imaging)
        made = self.renderer(
            RendererSetup(camera, HERE, HERE, single_marker(), imaging=sensor_imaging), self.seed
        )
        drawn: list[Image] = []
        for number, (shot, board) in enumerate(zip(seen.photographs, seen.boards, strict=True)):
            lit = _placed(board, self.prints[shot.name], self.edges[shot.name], imaging.gamma)
            share = self.turned.get(shot.name, 1.0)
            placed = replace(lit, light=(lit.light[0] / share, lit.light[1] / share))
            color = made.shoot(
                RenderedInstant({Role.SENDER: T_W_C}, boards=(placed,)),
                Role.SENDER,
                number,
            ).color
            drawn.append(_image_of(grey(color), seen.camera, imaging))
        return drawn


def _sensor(camera: CameraModel, imaging: Imaging) -> tuple[CameraModel, Imaging]:
    """The camera to render for, and its imaging: its sensor's image, before pixels are left out and
    compressed.
    """
    thinning = camera.thinning
    if thinning is None:
        return camera, imaging
    finer = thinning.of / thinning.kept
    blur_px = finer * imaging.blur_sigma_px
    sharpen_px = finer * imaging.sharpen_sigma_px
    coarse = replace(imaging, blur_sigma_px=blur_px, sharpen_sigma_px=sharpen_px, jpeg_quality=None)
    return sensor_of(camera), coarse


def _image_of(
    drawn: Image,
    camera: CameraModel,
    imaging: Imaging,
) -> Image:
    """The camera's image of what the renderer drew."""
    thinning = camera.thinning
    if thinning is None:
        return drawn
    columns, rows = (
        thinning.sensor_pixels(n, k) for k, n in enumerate((camera.width, camera.height))
    )
    image = np.ascontiguousarray(drawn[np.ix_(rows, columns)])
    if imaging.jpeg_quality is None:
        return image
    _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, imaging.jpeg_quality])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8)


def _like_it(
    drawing: _Drawing,
    seen: SetSeen,
    response: CameraResponse,
) -> Imaging:
    """The imaging with which the twin's edges and noise, measured alike, are the photographs'.

    What the measurement itself does to an edge is seen on the twin, whose imaging is known, and
    taken off, for as long as that brings the edges nearer; so is what sharpening and compression do
    to noise. Where the light scatters more at edges than the twin's does, a camera compressed its
    images more than their files.
    """
    few = slice(None, None, max(1, len(seen.boards) // PASS_VIEWS))
    some = replace(seen, photographs=seen.photographs[few], boards=seen.boards[few])
    scatter = scatter_at(
        [[edge.seen for edge in drawing.edges[shot.name]] for shot in some.photographs]
    )
    imaging = response.imaging
    least = math.inf
    best = imaging
    nearing = True
    for _ in range(PASSES):
        pairs = zip(drawing.images(some, imaging), some.photographs, some.boards, strict=True)
        views = [
            [edge.seen for edge in see_edges(drawing.own, replace(shot, grey=image), board)]
            for image, shot, board in pairs
        ]
        edges = [edge for view in views for edge in view]
        if not edges:
            break
        levels = levels_of(edges)
        got = noise_beside(edges)
        edge = mean_edge(edges)
        off = float(np.nanmean((edge - response.edge) ** 2))
        nearing = nearing and off < NEARER * least
        if nearing:
            least = off
            best = imaging
        scattered = scatter_at(views)
        more = scatter / scattered if scattered > 0.0 else 1.0
        noisy = max(abs(w / max(g, 0.1) - 1.0) for w, g in zip(response.noise, got, strict=True))
        if not nearing and off < least / NEARER and more < CLEARLY and noisy < ALIKE:
            break
        light = [
            _light_sigma(imaging, level) * w / max(g, 0.1)
            for level, w, g in zip(levels, response.noise, got, strict=True)
        ]
        optics = (
            fitted(response.edge + edge_of(imaging, *levels) - edge, *levels)[0]
            if nearing
            else best
        )
        quality = (
            coarser(imaging.jpeg_quality, more**COARSER) if more > CLEARLY else imaging.jpeg_quality
        )
        imaging = with_noise(replace(optics, jpeg_quality=quality), levels, light)
    return imaging


def _white(edges: Sequence[BoardEdge]) -> float:
    return levels_of([edge.seen for edge in edges])[1]


def _light_sigma(imaging: Imaging, level: float) -> float:
    """Deviation of the light at a grey level."""
    light = TOP * (level / TOP) ** imaging.gamma
    return float(np.sqrt(imaging.read_sigma**2 + imaging.shot_gain * light))


def _placed(
    board: BoardSeen,
    printed: Print,
    edges: Sequence[BoardEdge],
    gamma: float,
) -> PlacedBoard:
    """The print in the light of one photograph: black and white change evenly across the board."""
    shades = printed.shades
    cell_m = printed.cell_m
    corner_o = printed.corner_o
    rows, columns = shades.shape
    x = corner_o[0] + (np.arange(columns) + 0.5) * cell_m
    y = corner_o[1] + (np.arange(rows) + 0.5) * cell_m
    dark, bright = (_light(edges, name, x, y, gamma) for name in ("black", "white"))
    low = float(dark.min())
    high = float(bright.max())
    lit = dark + (bright - dark) * (shades / TOP)
    levels = np.round(TOP * (lit - low) / (high - low)).astype(np.uint8)
    T_w_o = T_W_C @ board.T_c_o @ Pose(np.eye(3), np.array([*corner_o, 0.0]))
    return PlacedBoard(T_w_o, cell_m, levels, (low, high))


def _light(
    edges: Sequence[BoardEdge],
    name: str,
    x: Array,
    y: Array,
    gamma: float,
) -> Array:
    """Light of one side of the edges over the board, (rows, columns): a plane through all that were
    seen.
    """
    middles = np.stack([e.middle_o for e in edges])
    levels = np.array([getattr(e.seen, name) for e in edges])
    design = np.column_stack([np.ones(len(edges)), middles])
    plane = np.linalg.lstsq(design, levels, rcond=None)[0]
    seen = np.clip(
        plane[0] + plane[1] * x[None, :] + plane[2] * y[:, None],
        levels.min(),
        levels.max(),
    )
    return np.maximum(TOP * (seen / TOP) ** gamma, LEAST_LIGHT)


def _print_of(own: RealSet, seen: SetSeen) -> Print:
    if own.board is not None:
        shades, cell_m = print_cells(own.board)
        return Print(shades, cell_m, np.array([-own.board.square_m, -own.board.square_m]))
    cell_m = own.file.pitch_m / GRID_CELLS
    side_m = float(np.median([_side(shot.points_o) for shot in seen.photographs]))
    columns, rows = (
        round((n - 1 + 2.0 * BORDER) * GRID_CELLS) + GRID_CELLS
        for n in (own.file.columns, own.file.rows)
    )
    shades = np.full((rows, columns), 255, np.uint8)
    corner_o = np.array([-1.0, -1.0]) * (BORDER + 0.5) * own.file.pitch_m
    for marker in own.markers.values():
        inner = marker.pattern[1:-1, 1:-1]
        first = marker.corners_o[:, :2].mean(axis=0) - 0.5 * side_m - corner_o
        size, (column, row) = round(side_m / cell_m), np.round(first / cell_m).astype(int)
        big = cv2.resize(
            255 * inner.astype(np.uint8),
            (size, size),
            interpolation=cv2.INTER_NEAREST_EXACT,
        )
        shades[row : row + size, column : column + size] = big
    return Print(shades, cell_m, corner_o)


def _side(points_o: Array) -> float:
    quads = points_o.reshape(-1, 4, 3)
    return float(np.median(np.linalg.norm(quads[:, 1] - quads[:, 0], axis=1)))

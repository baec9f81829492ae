"""A camera's response and a set's twin, where the camera is known: photographs that are rendered
themselves.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from flight.harness.renderer import Imaging, PlacedBoard, RenderedInstant, RendererSetup
from hil.camera.pictures import CameraRenderer
from missions.ground.options.proofs import TrialOptions
from missions.trials.pose.calibration.views import HERE, T_W_C, grey
from missions.trials.pose.corners.methods import FoundMarker
from missions.trials.real.board import SetSeen, look_at_set
from missions.trials.real.cells import inner_edges
from missions.trials.real.corners import by_photometry, starts
from missions.trials.real.errors import MethodPoses, SeenMarker
from missions.trials.real.paper import InkMoves, Print, as_seen
from missions.trials.real.response import (
    coarser,
    edge_of,
    jpeg_quality,
    levels_of,
    mean_edge,
    measure_response,
    scatter_at,
    see_edges,
)
from missions.trials.real.set import RealSet, read_set
from missions.trials.real.twin import render_twin
from missions.trials.run import run
from path.arrays import Array
from path.calibration.board import Board, print_cells
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from tests.missions.trials.real.test_trial import TEXT
from tests.path.calibration.rendered import Held, photographs, poses

PRINTED = Board("charuco", 8, 6, 0.030, 0.0225)
CAMERA = Imaging(
    blur_sigma_px=0.7, read_sigma=3.0, shot_gain=0.03, sharpen=0.9, sharpen_sigma_px=1.0, gamma=1.3
)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("twin")
    (folder / "views").mkdir()
    for number, color in enumerate(
        photographs(PRINTED, list(poses(PRINTED, Held(), 4, 87)), 3, CAMERA)
    ):
        cv2.imwrite(str(folder / "views" / f"{number}.jpg"), color, (cv2.IMWRITE_JPEG_QUALITY, 85))
    (folder / "known.toml").write_text(TEXT.format(more=""))
    return folder / "known.toml"


@pytest.fixture(scope="module")
def seen(file: Path) -> tuple[RealSet, SetSeen]:
    own = read_set(file)
    return own, look_at_set(own, own.images)


def test_edges_of_a_known_camera_are_measured(seen: tuple[RealSet, SetSeen]) -> None:
    own, views = seen
    response = measure_response(own, views, own.images)
    assert response is not None
    pairs = zip(views.photographs, views.boards, strict=True)
    levels = levels_of([edge.seen for shot, board in pairs for edge in see_edges(own, shot, board)])
    true, plain, fitted = (
        edge_of(imaging, *levels) for imaging in (CAMERA, Imaging(), response.imaging)
    )
    assert np.max(np.abs(fitted - true)) < 0.04 < 0.5 * np.max(np.abs(plain - true))
    assert response.misfit < 0.02
    assert response.imaging.jpeg_quality == pytest.approx(85, abs=1)


def test_a_twin_draws_edges_and_noise_as_its_photographs_do(
    seen: tuple[RealSet, SetSeen], tmp_path: Path
) -> None:
    own, views = seen
    twin = render_twin(own, views, None, own.images, CameraRenderer, 0, tmp_path)
    assert twin is not None
    images, drawn_with = twin
    assert [path.stem for path in images] == [path.stem for path in own.images]
    again = look_at_set(own, images)
    pairs = zip(again.photographs, again.boards, strict=True)
    edges = [edge.seen for shot, board in pairs for edge in see_edges(own, shot, board)]
    assert np.nanmax(np.abs(mean_edge(edges) - drawn_with.edge)) < 0.04
    response = measure_response(own, again, images)
    assert response is not None
    assert response.noise == pytest.approx(drawn_with.noise, rel=0.15)
    pairs = zip(views.photographs, views.boards, strict=True)
    assert levels_of(edges) == pytest.approx(
        levels_of([edge.seen for shot, board in pairs for edge in see_edges(own, shot, board)]),
        rel=0.06,
        abs=4.0,
    )


def test_ink_lies_where_the_photographs_show_it(seen: tuple[RealSet, SetSeen]) -> None:
    """A marker that is printed 0.3 mm off, on a board that is seen a pixel off at its ends."""
    own, views = seen
    bent = np.zeros_like(views.boards[0].bend)
    bent[3:5] = [[0.4, -0.3], [-0.6, 0.5]]  # x and x y
    board = replace(views.boards[0], bend=bent)
    corners, off = (
        own.markers[5].corners_o[:, :2],
        np.array([[3e-4, 1e-4], [3e-4, 1e-4], [3e-4, 0.0], [3e-4, 0.0]]),
    )
    shades, cell_m = print_cells(PRINTED)
    flat = Print(shades, cell_m, np.full(2, -PRINTED.square_m)).finer(2e-4)
    moved = as_seen(flat, InkMoves((np.empty((0, 2)), np.empty((0, 2))), ((corners, off),)), board)
    light = PlacedBoard(
        T_W_C @ board.T_c_o @ Pose(np.eye(3), np.array([*flat.corner_o, 0.0])),
        flat.cell_m,
        moved.shades,
    )
    camera = CameraRenderer(RendererSetup(board.camera, HERE, HERE, single_marker()), 1)
    drawn = grey(
        camera.shoot(RenderedInstant({Role.SENDER: T_W_C}, boards=(light,)), Role.SENDER, 0).color
    )
    found = by_photometry(own, drawn, starts(own, drawn), board.camera)
    errors = {
        i: one.corners_px
        - board.pixels(
            own.markers[i].corners_o + (np.pad(off, ((0, 0), (0, 1))) if i == 5 else 0.0)
        )
        for i, one in found.items()
    }
    assert 5 in errors and len(errors) > 10
    assert max(float(np.sqrt(np.mean(error**2))) for error in errors.values()) < 0.08


def test_cells_that_are_printed_off_are_seen_and_drawn(seen: tuple[RealSet, SetSeen]) -> None:
    own, views = seen
    nothing = np.zeros((4, 2))
    off = {i: 0.08 * np.random.default_rng(i).standard_normal((2, 5)) for i in sorted(own.markers)}
    moves = InkMoves(
        (np.empty((0, 2)), np.empty((0, 2))),
        tuple((own.markers[i].corners_o[:, :2], nothing) for i in off),
        tuple(off.values()),
    )
    shades, cell_m = print_cells(PRINTED)
    flat = Print(shades, cell_m, np.full(2, -PRINTED.square_m)).finer(2e-4)
    camera = CameraRenderer(RendererSetup(views.camera, HERE, HERE, single_marker()), 1)
    shots = []
    for number, (shot, board) in enumerate(zip(views.photographs, views.boards, strict=True)):
        place = T_W_C @ board.T_c_o @ Pose(np.eye(3), np.array([*flat.corner_o, 0.0]))
        placed = PlacedBoard(
            place, flat.cell_m, as_seen(flat, moves, replace(board, bend=0.0 * board.bend)).shades
        )
        drawn = camera.shoot(
            RenderedInstant({Role.SENDER: T_W_C}, boards=(placed,)), Role.SENDER, number
        ).color
        shots.append(replace(shot, grey=grey(drawn)))
    again = replace(
        views,
        photographs=tuple(shots),
        boards=tuple(replace(board, bend=0.0 * board.bend) for board in views.boards),
    )
    exact = {i: np.zeros((4, 3)) for i in off}
    everywhere = tuple(_seen_at(view, i) for view in range(len(shots)) for i in off)
    # too few views tell no print
    assert not inner_edges(own, again, MethodPoses(everywhere, 0.0, {}))
    told = inner_edges(own, again, MethodPoses(everywhere, 0.0, exact))
    left, there = (
        np.stack([one[i] for i in off]) for one in ({i: told[i] - off[i] for i in off}, told)
    )
    assert np.mean(there != 0.0) > 0.9  # a line between rows that are alike cannot be seen
    assert float(np.sqrt(np.mean(left[there != 0.0] ** 2))) < 0.02 < 0.4 * off_by(off)


def _seen_at(view: int, marker_id: int) -> SeenMarker:
    none = np.zeros((4, 2))
    return SeenMarker(view, marker_id, FoundMarker(none), none, none, np.zeros((4, 2, 2)), none)


def test_a_photograph_that_was_compressed_before_its_file_scatters_more_at_edges(
    seen: tuple[RealSet, SetSeen],
) -> None:
    own, views = seen
    pairs = list(zip(views.photographs, views.boards, strict=True))

    def scatter(quality: int) -> float:
        packed = [
            cv2.imencode(".jpg", shot.grey, (cv2.IMWRITE_JPEG_QUALITY, quality))[1]
            for shot, _ in pairs
        ]
        images = [np.asarray(cv2.imdecode(one, cv2.IMREAD_GRAYSCALE), np.uint8) for one in packed]
        return scatter_at(
            [[e.seen for e in see_edges(own, replace(shot, grey=image), board)]
             for image, (shot, board) in zip(images, pairs, strict=True)]
        )  # fmt: skip

    assert 1.2 * scatter(90) < scatter(40) < 0.9 * scatter(15)
    assert (
        coarser(90, 5.0) == 50
        and coarser(50, 2.0) == 25
        and coarser(25, 0.5) == 50
        and coarser(None, 10.0) == 50
    )


def test_what_shows_no_edges_has_no_twin(seen: tuple[RealSet, SetSeen], tmp_path: Path) -> None:
    own, views = seen
    flat = [replace(shot, grey=np.full_like(shot.grey, 128)) for shot in views.photographs]
    assert (
        render_twin(
            own,
            replace(views, photographs=tuple(flat)),
            None,
            own.images,
            CameraRenderer,
            0,
            tmp_path,
        )
        is None
    )


@pytest.mark.parametrize("quality", [40, 75, 95])
def test_the_quality_of_a_jpeg_is_read_from_its_table(tmp_path: Path, quality: int) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (64, 64), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.jpg"), noise, (cv2.IMWRITE_JPEG_QUALITY, quality))
    cv2.imwrite(str(tmp_path / "a.png"), noise)
    assert jpeg_quality(tmp_path / "a.jpg") == pytest.approx(quality, abs=2)
    assert jpeg_quality(tmp_path / "a.png") is None


@pytest.fixture(scope="module")
def out(file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the trial with this set."""
    folder = tmp_path_factory.mktemp("out")
    # of four photographs all
    assert run(TrialOptions("real", out=folder, set=((file,),), quick=True, jobs=1)) == 0
    return folder


def test_page_and_summary_hold_the_twin_against_its_photographs(out: Path) -> None:
    own = json.loads((out / "summary.json").read_text())["sets"]["known"]["twin"]
    assert own["ratios"]["corners_px"] == pytest.approx(1.0, abs=0.3)
    assert own["ratios"]["d2_mean_m"] == pytest.approx(1.0, abs=0.35)
    assert own["imaging"]["jpeg_quality"] == pytest.approx(85, abs=1)
    assert "twin over photographs" in (out / "index.html").read_text()
    assert len(list((out / "twins" / "known").glob("*.png"))) == 4


def test_the_command_writes_summary_and_page(out: Path) -> None:
    own = json.loads((out / "summary.json").read_text())["sets"]["known"]
    for name in (
        "d2_mean_m",
        "d2_median_m",
        "d2_p95_m",
        "rotation_median_deg",
        "chi2_pose",
        "chi2_corners",
    ):
        assert own[f"{name}_interval"][0] <= own[name] <= own[f"{name}_interval"][1]
    assert own["flips"] == 0
    assert own["corners"]["photometric"]["robust_px"] < own["corners"]["subpix"]["robust_px"]
    assert (out / "real.png").read_bytes()[:4] == b"\x89PNG"
    assert "--set" in (out / "index.html").read_text()


def off_by(inner: Mapping[int, Array]) -> float:
    """By how much inner edges are off, rms in cells; 0 without any."""
    return (
        float(np.sqrt(np.mean(np.concatenate([own.ravel() for own in inner.values()]) ** 2)))
        if inner
        else 0.0
    )

"""A camera that leaves out pixels: it is told by straight edges, and its twin leaves out the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from flight.harness.renderer import Imaging
from hil.camera.pictures import CameraRenderer
from missions.trials.calibration.views import photographs
from missions.trials.real.board import look_at_set
from missions.trials.real.response import PLACES, mean_edge, measure_response, see_edges
from missions.trials.real.set import read_set
from missions.trials.real.thinning import Thinning, pixel_offsets
from missions.trials.real.twin import render_twin
from tests.missions.trials.real.test_trial import TEXT
from tests.missions.trials.real.test_twin import PRINTED
from tests.path.calibration.rendered import CAMERA, Held, grey, poses

THINNED = Thinning(3, 5, (1, 2))


def test_pixels_that_are_kept_are_those_nearest_to_their_places() -> None:
    assert Thinning(3, 5, (0, 0)).offsets_px(0) == pytest.approx([-0.2, 0.0, 0.2])
    assert Thinning(1, 2, (0, 0)).offsets_px(1) == pytest.approx([0.25])
    for thinning in (THINNED, Thinning(2, 3, (0, 1)), Thinning(4, 5, (3, 0))):
        for axis in (0, 1):
            sensor = thinning.sensor_pixels(24, axis)
            offsets = np.resize(thinning.offsets_px(axis), 24)
            assert sensor[0] == 0
            assert sensor[-1] == pytest.approx(23 * thinning.of / thinning.kept, abs=1.0)
            places = [thinning.sensor_place(k + offset, axis) for k, offset in enumerate(offsets)]
            assert places == pytest.approx(sensor)


def test_a_camera_that_leaves_out_pixels_is_told_and_drawn_again(tmp_path: Path) -> None:
    """The sensor's image is drawn, and three of five rows and columns kept."""
    size = (CAMERA.width, CAMERA.height)
    columns, rows = (THINNED.sensor_pixels(n, axis) for axis, n in enumerate(size))
    cx, cy = (THINNED.sensor_place(c, axis) for axis, c in enumerate((CAMERA.cx, CAMERA.cy)))
    sensor = replace(
        CAMERA, width=int(columns[-1]) + 1, height=int(rows[-1]) + 1, fx=CAMERA.fx * 5 / 3, fy=CAMERA.fy * 5 / 3,
        cx=cx, cy=cy,
    )  # fmt: skip
    (tmp_path / "views").mkdir()
    where = list(poses(PRINTED, Held(), 2, 87))
    for number, color in enumerate(photographs(CameraRenderer, sensor, PRINTED, where, 3, Imaging(blur_sigma_px=0.9))):
        cv2.imwrite(str(tmp_path / "views" / f"{number}.png"), grey(color)[np.ix_(rows, columns)])
    (tmp_path / "thin.toml").write_text(TEXT.format(more=""))
    own = read_set(tmp_path / "thin.toml")
    seen = look_at_set(own, own.images)
    response = measure_response(own, seen, own.images)
    assert response is not None
    assert response.thinning == THINNED
    twin = render_twin(own, seen, own.images, CameraRenderer, 0, tmp_path / "twin")
    assert twin is not None
    again = look_at_set(own, twin.images)
    pairs = zip(again.photographs, again.boards, strict=True)
    edges = [edge for shot, board in pairs for edge in see_edges(own, shot, board)]
    assert edges[0].levels.shape == edges[0].pixels[:, 0].shape
    offsets = pixel_offsets(edges, PLACES, mean_edge(edges), 3)
    assert offsets is not None
    assert offsets == pytest.approx(np.stack([THINNED.offsets_px(axis) for axis in (0, 1)]), abs=0.05)

"""A camera that leaves out pixels: it is told by straight edges, and its twin leaves out the
same.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from flight.harness.renderer import Imaging
from hil.camera.pictures import CameraRenderer
from missions.trials.pose.calibration.views import photographs
from missions.trials.real.board import look_at_set
from missions.trials.real.set import read_set
from missions.trials.real.twin import render_twin
from path.camera.model import sensor_of
from path.camera.thinning import Thinning
from tests.missions.trials.real.test_trial import TEXT
from tests.missions.trials.real.test_twin import PRINTED
from tests.path.calibration.rendered import CAMERA, Held, grey, poses

THINNED = Thinning(3, 5, (1, 2))


def test_a_camera_that_leaves_out_pixels_is_told_and_drawn_again(tmp_path: Path) -> None:
    """The sensor's image is drawn, and three of five rows and columns kept."""
    size = (CAMERA.width, CAMERA.height)
    columns, rows = (THINNED.sensor_pixels(n, axis) for axis, n in enumerate(size))
    sensor = sensor_of(replace(CAMERA, thinning=THINNED))
    (tmp_path / "views").mkdir()
    where = list(poses(PRINTED, Held(), 2, 87))
    for number, color in enumerate(
        photographs(CameraRenderer, sensor, PRINTED, where, 3, Imaging(blur_sigma_px=0.9))
    ):
        cv2.imwrite(str(tmp_path / "views" / f"{number}.png"), grey(color)[np.ix_(rows, columns)])
    (tmp_path / "thin.toml").write_text(TEXT.format(more=""))
    own = read_set(tmp_path / "thin.toml")
    seen = look_at_set(own, own.images)
    assert seen.camera.thinning == THINNED
    assert seen.camera.fx == pytest.approx(CAMERA.fx, rel=3e-3)
    twin = render_twin(own, seen, None, own.images, CameraRenderer, 0, tmp_path / "twin")
    assert twin is not None
    images, _ = twin
    again = look_at_set(own, images)
    assert again.camera.thinning == THINNED

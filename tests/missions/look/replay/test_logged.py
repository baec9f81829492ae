"""What a replay makes of logged values."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.log.topics import camera_record
from missions.look.replay.logged import as_logged, camera_of
from path.camera.model import CameraModel
from path.camera.thinning import Thinning

PLAIN = CameraModel(640, 480, 612.5, 613.0, 320.5, 240.25, (0.1, -0.2, 0.0006, -0.0004, 0.09))
DOUBTS = tuple(tuple(0.1 * cause + 0.01 * k for k in range(9)) for cause in (1, 2))


@pytest.mark.parametrize("more", [{}, {"doubts": DOUBTS}, {"thinning": Thinning(3, 5, (1, 2))}])
def test_a_camera_comes_back_as_it_was_logged(more: dict[str, Any]) -> None:
    numbers = {
        name: getattr(PLAIN, name)
        for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion")
    }
    camera = CameraModel(**numbers, **more)
    assert camera_of(as_logged(camera_record(camera))) == camera


def test_a_log_of_an_earlier_version_tells_no_more_than_intrinsics() -> None:
    record = as_logged(camera_record(PLAIN))
    del record["doubts"]
    assert camera_of(record) == PLAIN

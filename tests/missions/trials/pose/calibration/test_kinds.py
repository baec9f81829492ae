"""Sets of views as people bring them: a calibration that states its errors, or a refusal that says
what is wrong.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.camera.pictures import CameraRenderer
from missions.trials.pose.calibration.kinds import (
    CHARUCO,
    CHESSBOARD,
    KindResult,
    calibrate_kind,
    curled,
    kind_findings,
    kind_table,
)
from path.calibration.board import Board
from path.calibration.judge import BadSet
from path.geometry.transforms import Pose


def test_a_curled_board_gives_a_camera_within_its_stated_errors() -> None:
    end = calibrate_kind(CameraRenderer, "ChArUco 640x480, 17 views", 0)
    assert end.grade == "good"
    assert end.expected and end.within
    assert end.focal[0] < 0.0015


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD], ids=lambda b: b.pattern)
def test_a_curled_print_is_whole(board: Board) -> None:
    """Its strips begin where the ones before them end, and all shades are there."""
    strips = curled(board, Pose(np.eye(3), np.array([0.0, 0.0, 0.5])), 0.001)
    ends = [s.T_w_o.apply(np.array([s.print_shades.shape[1] * s.side_m, 0.0, 0.0])) for s in strips]
    for end, after in zip(ends[:-1], strips[1:], strict=True):
        assert np.abs(end - after.T_w_o.t).max() < 2e-6
    across = ends[-1] - strips[0].T_w_o.t
    assert np.linalg.norm(across) == pytest.approx((board.columns + 2) * board.square_m, rel=1e-3)
    middle = strips[len(strips) // 2].T_w_o.t
    assert abs(middle[2] - strips[0].T_w_o.t[2]) == pytest.approx(0.001, rel=0.1)


def test_what_ends_otherwise_or_beyond_its_errors_falls_short() -> None:
    good = KindResult("a", "good", (), (0.1, -1.9, 0.3, 0.0), (1e-4, 1e-3), True)
    refused = KindResult(
        "b", None, (BadSet.NO_BOARD.value,), (), (float("nan"), float("nan")), True
    )
    assert [f.verdict for f in kind_findings([good, refused])] == ["met", "met"]
    off = replace(good, off=(0.1, -2.1, 0.3, 0.0))
    assert [f.ours for f in kind_findings([good, off, refused])] == ["3 of 3", "1 of 2"]
    assert [f.verdict for f in kind_findings([good, off, refused])] == ["met", "short"]
    assert [f.verdict for f in kind_findings([replace(refused, expected=False)])] == [
        "short",
        "met",
    ]
    assert kind_table([refused]).rows[0][1:3] == ("refused", "no_board")

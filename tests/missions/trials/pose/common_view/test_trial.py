"""The trial of relative poses without the marker, on frames that are drawn here."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from flight.common_view import KEYFRAME_S
from missions.ground.options.proofs import TrialOptions
from missions.trials.pose.common_view import trial
from missions.trials.pose.common_view.sequence import levelled, pairs_between, read_sequence
from missions.trials.pose.common_view.trial import Answer
from missions.trials.run import command, names_of
from tests.path.common_view.drawn import LENS, around, drawn, room

ANGLES = (0.0, 20.0, 40.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a sequence of three frames of a drawn room, registered already."""
    where = tmp_path_factory.mktemp("room")
    rng = np.random.default_rng(0)
    np.savetxt(where / "camera-intrinsics.txt", LENS.K)
    np.savetxt(where / "gravity-direction.txt", [0.0, 0.0, 1.0])
    for number, angle in enumerate(ANGLES):
        R, t = around(angle)
        grey, depth = drawn(room(1), R, t, rng)
        stem = where / f"frame-{number:06d}"
        T = np.eye(4)
        T[:3, :3] = R
        T[:3, 3] = t
        np.savetxt(f"{stem}.pose.txt", T)
        cv2.imwrite(f"{stem}.color.png", grey)
        cv2.imwrite(f"{stem}.depth.png", np.asarray(1000.0 * depth, np.uint16))
    return where


def test_pairs_are_apart_by_angle_and_distance_and_have_enough_in_common(folder: Path) -> None:
    sequence = read_sequence(folder)
    rng = np.random.default_rng(0)
    pairs = pairs_between(sequence, (15.0, 30.0), (0.5, 1.5), 0.2, 10, rng)
    assert {(pair.first, pair.second) for pair in pairs} == {(0, 1), (1, 0), (1, 2), (2, 1)}
    assert not pairs_between(sequence, (15.0, 30.0), (0.5, 1.5), 0.99, 10, rng)


def test_a_direction_down_is_turned_to_z() -> None:
    down = np.array([0.1, 0.9, 0.4])
    R = levelled(down)
    np.testing.assert_allclose(R @ down, np.array([0.0, 0.0, math.sqrt(0.98)]), atol=1e-12)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_what_a_folder_lacks_is_named(tmp_path: Path) -> None:
    with pytest.raises(PartError, match=r"camera-intrinsics\.txt"):
        read_sequence(tmp_path)


def test_a_pose_that_is_far_off_is_wrong_only_when_it_was_given() -> None:
    given = Answer("", 0.5, 1.0, 1.0, 1.0, 1)
    assert given.wrong
    assert not given.right
    withheld = Answer("ambiguous", 0.5, 1.0, 1.0, 1.0, 1)
    assert not withheld.wrong
    close = Answer("", 0.05, 1.0, 1.0, 1.0, 1)
    assert close.right
    summary = trial._summary([given, withheld, close], 3)
    assert summary["wrong_accepted"] == 1
    assert summary["right"] == pytest.approx(1.0 / 3.0)
    assert summary["dont_know"] == pytest.approx(1.0 / 3.0)
    assert summary["why"] == {"ambiguous": 1}
    assert math.isclose(summary["d2_median_m"], 0.275)


def test_a_pair_of_the_drawn_room_is_answered_right(folder: Path) -> None:
    sequence = read_sequence(folder)
    camera = replace(sequence.camera, color=LENS, T_color_depth=None)
    registered = replace(sequence, camera=camera)
    pair = trial.Pair(0, 1, 20.0)
    answer = trial.answer_pair(registered, pair, np.random.default_rng(1))
    assert answer.right
    assert 128 < answer.sent <= 12_000 * KEYFRAME_S


def test_naming_a_sequence_asks_for_this_alone() -> None:
    options = TrialOptions("pose", common_view=Path("frames"), seed=3)
    assert names_of(options) == ("common-view",)
    assert command(options, "common-view") == (
        "path-handoff trial pose --only common-view --seed 3 --common-view frames"
    )

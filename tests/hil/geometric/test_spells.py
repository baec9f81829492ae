"""A detector's misses and inventions at level ``sim``: how many, for how long, and the same by
seed.
"""

from __future__ import annotations

import numpy as np
import pytest

from hil.camera.capture import Capture
from hil.geometric.noise import ObservationNoise
from hil.geometric.perception import GeometricView, Sensor
from hil.geometric.scene import CameraSetup
from hil.geometric.spells import Spells
from hil.world.detector import DetectorConfig
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Region

CAMERA = CameraModel(640, 480, 600.0, 600.0, 319.5, 239.5)
LEVEL = Pose(np.eye(3), np.zeros(3))
DOWN = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.8]))
FRAMES = 40_000


def lengths(on: np.ndarray) -> np.ndarray:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], on.astype(int), [0]))))
    return np.diff(edges)[::2]


@pytest.mark.parametrize(("recall", "frames"), [(0.9, 5.0), (0.7, 15.0), (0.99, 1.0)])
def test_things_are_missed_as_often_and_for_as_long_as_said(recall: float, frames: float) -> None:
    spells, config = Spells(11), DetectorConfig(recall, frames)
    missed = [spells.missed(frame, [1.0, 1.0], config) for frame in range(FRAMES)]
    first, second = (np.array([k in each for each in missed]) for k in (0, 1))
    for on in (first, second):
        assert np.mean(on) == pytest.approx(1.0 - recall, rel=0.15)
        assert np.mean(lengths(on)) == pytest.approx(frames, rel=0.15)
    both = float(np.mean(first & second))
    assert both == pytest.approx((1.0 - recall) ** 2, abs=0.02)  # each by itself


def test_the_same_seed_misses_the_same_and_frames_may_be_left_out() -> None:
    config = DetectorConfig(0.8, 4.0)
    all_frames, some = Spells(5), Spells(5)
    by_frame = {frame: all_frames.missed(frame, [1.0], config) for frame in range(400)}
    for frame in range(0, 400, 3):
        assert some.missed(frame, [1.0], config) == by_frame[frame]
    assert {frame: Spells(6).missed(frame, [1.0], config) for frame in range(400)} != by_frame


def test_an_invention_stays_where_it_is_for_its_spell() -> None:
    spells, config = Spells(3), DetectorConfig(miss_frames=5.0, false_positives=0.05)
    found = [spells.invented(frame, CAMERA, config) for frame in range(FRAMES)]
    on = np.array([each is not None for each in found])
    assert np.mean(on) == pytest.approx(0.05, rel=0.15)
    assert np.mean(lengths(on)) == pytest.approx(5.0, rel=0.15)
    places = {each.box for each in found if each is not None}
    assert len(places) == len(lengths(on))


def view(frame: int, sensor: Sensor, detector: DetectorConfig) -> GeometricView:
    drones = {role: DroneTruth(DOWN, (0.0, 0.0, 0.0), 0.0, True) for role in Role}
    things = (ObjectTruth(0, (0.0, 0.0, 0.0), 0.0, 0.0), ObjectTruth(1, (0.6, 0.0, 0.0), 0.0, 0.0))
    return GeometricView(
        Capture(frame, frame, Snapshot(0.0, drones, things, detector=detector)), sensor
    )


def sensor() -> Sensor:
    setup = CameraSetup(Role.RECEIVER, CAMERA, LEVEL, LEVEL, single_marker())
    return Sensor(setup, ObservationNoise(), MethodConfig(), 4)


def test_a_view_lacks_what_was_missed_and_has_what_was_invented() -> None:
    blind = view(1, sensor(), DetectorConfig(recall=0.0))
    assert blind.targets(None) == []
    own, keen = sensor(), DetectorConfig(false_positives=0.5)
    assert {len(view(frame, own, keen).targets(None)) for frame in range(60)} == {2, 3}


def test_an_invention_outside_the_region_is_not_seen() -> None:
    own, config = sensor(), DetectorConfig(false_positives=0.5, miss_frames=3.0)
    for frame in range(60):
        seen = view(frame, own, config)
        for found in seen.targets(Region(0.0, 0.0, 50.0, 50.0)):
            u, v = found.box.center
            assert 0.0 <= u < 50.0 and 0.0 <= v < 50.0


def test_a_bias_moves_every_box() -> None:
    plain = view(7, sensor(), DetectorConfig()).targets(None)
    moved = view(7, sensor(), DetectorConfig(edge_px=4.0)).targets(None)
    assert [each.box.x + 4.0 for each in plain] == pytest.approx([each.box.x for each in moved])
    assert [each.box.y + 4.0 for each in plain] == pytest.approx([each.box.y for each in moved])


def test_small_things_are_missed_more_often_where_that_was_measured() -> None:
    spells = Spells(7)
    config = DetectorConfig(miss_frames=4.0, by_size=((20.0, 0.2), (80.0, 0.9)))
    missed = [spells.missed(frame, [10.0, 40.0, 300.0], config) for frame in range(FRAMES)]
    shares = [np.mean([k in each for each in missed]) for k in range(3)]
    assert shares == pytest.approx([0.8, 0.45, 0.1], rel=0.1)


def test_a_view_asks_for_each_things_own_size() -> None:
    all_seen = DetectorConfig(by_size=((1.0, 0.0), (5.0, 0.0), (6.0, 1.0)))
    assert len(view(1, sensor(), all_seen).targets(None)) == 2
    none_seen = DetectorConfig(by_size=((5000.0, 0.0), (6000.0, 1.0)))
    assert view(1, sensor(), none_seen).targets(None) == []


@pytest.mark.parametrize("by_size", [((40.0, 0.5), (20.0, 0.6)), ((0.0, 0.5),), ((20.0, 85.0),)])
def test_sizes_that_cannot_be_are_refused(by_size: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ValueError, match="by_size"):
        DetectorConfig(by_size=by_size)

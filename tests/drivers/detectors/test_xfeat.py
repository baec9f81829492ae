"""XFeat: what is refused, what the graph leaves out, and the network itself when its weights are
there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.detectors import xfeat
from drivers.detectors.xfeat import XFeat
from drivers.interfaces import PartError
from path.baselines.matching import MatchConfig, accepted, nearest
from tests.drivers.detectors.onnx_graphs import identity_network

BESIDE = sorted(Path(__file__).parents[4].glob("*/models/xfeat.onnx"))
needs_weights = pytest.mark.skipif(not BESIDE, reason="no models/xfeat.onnx beside the repository")


@pytest.fixture(scope="module")
def network() -> XFeat:
    return XFeat(BESIDE[0])


def test_a_missing_file_is_refused_with_where_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(PartError, match=r"xfeat\.onnx: there is no such file") as caught:
        XFeat(tmp_path / "xfeat.onnx")
    assert "accelerated_features" in caught.value.remedy


def test_a_file_that_is_no_network_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "weights.onnx"
    file.write_bytes(b"not a network")
    with pytest.raises(
        PartError,
        match=r"weights\.onnx: expected a network in ONNX, found a file that cannot be read",
    ):
        XFeat(file)


def test_another_network_is_refused_with_expected_and_found(tmp_path: Path) -> None:
    file = tmp_path / "other.onnx"
    file.write_bytes(identity_network((1, 3, 416, 416)))
    with pytest.raises(
        PartError, match=r"expected 1x3x640x640 -> .*1x65x80x80.* found 1x3x416x416 -> 1x3x416x416"
    ):
        XFeat(file)


def test_a_heatmap_has_each_cells_pixels_in_reading_order() -> None:
    logits = np.zeros((65, 80, 80), np.float32)
    logits[2 * 8 + 5, 10, 20] = 9.0
    heatmap = xfeat._heatmap(logits)
    v, u = np.unravel_index(int(heatmap.argmax()), heatmap.shape)
    assert (u, v) == (20 * 8 + 5, 10 * 8 + 2)
    assert heatmap[v, u] == pytest.approx(np.exp(9.0) / (np.exp(9.0) + 64.0), rel=1e-5)
    assert heatmap[0, 0] == pytest.approx(1.0 / 65.0)


def test_keypoints_are_local_maxima_above_the_threshold_in_the_image_itself() -> None:
    heatmap = np.zeros((640, 640), np.float32)
    for u, v, p in (
        (100, 50, 0.9),
        (102, 51, 0.8),
        (105, 50, 0.3),
        (300, 300, 0.04),
        (630, 20, 0.9),
        (20, 630, 0.9),
    ):
        heatmap[v, u] = p
    points, scores = xfeat._keypoints(heatmap, np.full((80, 80), 0.5, np.float32), 600, 620)
    assert points.tolist() == [[100.0, 50.0], [105.0, 50.0]]
    assert scores == pytest.approx([0.45, 0.15])
    nothing, none = xfeat._keypoints(
        np.zeros((640, 640), np.float32), np.zeros((80, 80), np.float32), 640, 640
    )
    assert nothing.shape == (0, 2)
    assert none.shape == (0,)


def cubic(d: float) -> float:
    a, d = -0.75, abs(d)
    if d <= 1.0:
        return (a + 2.0) * d**3 - (a + 3.0) * d**2 + 1.0
    return a * d**3 - 5.0 * a * d**2 + 8.0 * a * d - 4.0 * a if d < 2.0 else 0.0


def test_descriptors_are_sampled_bicubically_with_zeros_around_the_map() -> None:
    rng = np.random.default_rng(2)
    maps = rng.standard_normal((64, 80, 80)).astype(np.float32)
    points = np.array([[0, 0], [639, 639], [3, 320], [320.5, 17.25], [4, 4]], np.float32)
    sampled = xfeat._sample(maps, points)
    unit = maps / np.linalg.norm(maps, axis=0)
    for point, row in zip(points.astype(float), sampled, strict=True):
        x, y = point * 80 / 639 - 0.5
        wanted = sum(
            cubic(x - i) * cubic(y - j) * unit[:, j, i]
            for j in range(max(0, int(y) - 3), min(80, int(y) + 4))
            for i in range(max(0, int(x) - 3), min(80, int(x) + 4))
        )
        assert row == pytest.approx(wanted / np.linalg.norm(wanted), abs=2e-5)


def texture(height: int, width: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    coarse = np.random.default_rng(4).integers(
        0, 256, (height // 12 + 1, width // 12 + 1, 3), np.uint8
    )
    return np.kron(coarse, np.ones((12, 12, 1), np.uint8))[:height, :width]


@needs_weights
def test_a_shifted_image_gives_shifted_features(network: XFeat) -> None:
    image = texture(640, 660)
    a, b = network.extract(image[:, :640].copy()), network.extract(image[:, 16:656].copy())
    pairs = accepted(nearest(a, b, "cosine"), "cosine", MatchConfig(ratio=1.0, min_cosine=0.82))
    assert len(pairs) > 300
    shift = a.points_px[pairs[:, 0]] - b.points_px[pairs[:, 1]]
    assert np.median(shift, axis=0).tolist() == [16.0, 0.0]
    assert np.mean(np.abs(shift - [16.0, 0.0]).max(axis=1) < 2.0) > 0.9
    assert np.linalg.norm(a.descriptors, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert np.all(np.diff(a.scores) <= 0.0)


@needs_weights
def test_an_image_of_another_size_gives_features_in_its_own_pixels(network: XFeat) -> None:
    small = texture(200, 320)
    found = network.extract(small)
    assert len(found) > 50
    assert np.all((found.points_px >= 0.0) & (found.points_px < [320.0, 200.0]))
    # twice too large
    large = np.asarray(np.kron(texture(400, 640), np.ones((2, 2, 1), np.uint8)), np.uint8)
    seen = network.extract(large).points_px
    assert seen.max(axis=0) == pytest.approx([1280.0, 800.0], rel=0.1)
    assert np.all(seen < [1280.0, 800.0])


@needs_weights
def test_at_most_the_best_ones_are_kept() -> None:
    few = XFeat(BESIDE[0], top_k=40).extract(texture(640, 640))
    assert len(few) == 40

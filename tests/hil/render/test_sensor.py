"""The sensor's blur and noise are of the size their settings say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.render.renderer import Renderer
from hil.render.sensor import NOISE_FREE, SensorNoise, blur_taps, mixed, noise_pool
from hil.world.snapshot import Snapshot
from path.marker.layout import single_marker
from path.messages import Role
from tests.hil.render.views import LEVEL, TAIL, VGA, drone, hovering, looking_at, mount, scene


def view(noise: SensorNoise, snapshot: Snapshot, frame_seed: int = 0, pitch_deg: float = 45.0):
    renderer = Renderer(VGA, mount(pitch_deg), TAIL, single_marker(), noise, 5)
    return renderer.render(snapshot, Role.RECEIVER, frame_seed)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("read_sigma", -1.0),
        ("shot_gain", float("nan")),
        ("depth_hole_rate", 1.5),
        ("blur_sigma_px", 6.0),
        ("max_depth_m", 0.2),
        ("max_depth_m", 70.0),
    ],
)
def test_impossible_settings_are_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        SensorNoise(**{field: value})


@pytest.mark.parametrize("sigma_px", [0.0, 0.4, 0.6, 1.3, 5.0])
def test_blur_keeps_the_light_and_has_its_width(sigma_px: float) -> None:
    taps = blur_taps(sigma_px).astype(float)
    whole = np.concatenate((taps[:0:-1], taps))
    assert whole.sum() == pytest.approx(1.0, abs=1e-6)
    if sigma_px >= 0.6:
        offsets = np.arange(len(whole)) - len(taps) + 1
        assert np.sqrt(whole @ offsets**2) == pytest.approx(sigma_px, rel=0.02)


def test_blur_is_the_gaussian_of_the_sharp_image() -> None:
    sigma_px = 1.2
    sharp, _ = view(NOISE_FREE, scene())
    blurred, _ = view(replace(NOISE_FREE, blur_sigma_px=sigma_px), scene())
    offsets = np.arange(-8, 9)
    kernel = np.exp(-0.5 * (offsets / sigma_px) ** 2)
    kernel /= kernel.sum()
    padded = np.pad(sharp.astype(float), ((8, 8), (8, 8), (0, 0)), mode="edge")
    rows = np.sum([kernel[k] * padded[k : k + 480] for k in range(17)], axis=0)
    expected = np.sum([kernel[k] * rows[:, k : k + 640] for k in range(17)], axis=0)
    assert np.abs(blurred - expected).max() <= 1.0


def test_noise_of_the_colour_grows_with_the_light() -> None:
    noise = replace(NOISE_FREE, read_sigma=2.0, shot_gain=0.05)
    clean = view(NOISE_FREE, scene())[0].astype(float)
    renderer = Renderer(VGA, mount(45.0), TAIL, single_marker(), noise, 5)
    noisy = np.stack(
        [
            renderer.render(scene(), Role.RECEIVER, frame_seed)[0].astype(float)
            for frame_seed in range(6)
        ]
    )
    residual = noisy - clean
    for low, high in ((30, 60), (90, 120), (180, 220)):
        chosen = (clean >= low) & (clean < high)
        assert chosen.sum() > 300
        expected = np.sqrt(2.0**2 + 0.05 * clean[chosen].mean() + 1.0 / 12.0)
        assert residual[:, chosen].std() == pytest.approx(expected, rel=0.08)
        assert residual[:, chosen].mean() == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("height_m", [0.8, 1.6, 3.2])
def test_noise_of_the_depth_grows_with_its_square(height_m: float) -> None:
    noise = replace(NOISE_FREE, depth_sigma_at_1m_m=0.005)
    looking_down = Snapshot(0.0, {Role.RECEIVER: drone(hovering(0.0, 0.0, height_m))}, ())
    exact, noisy = (view(n, looking_down, 3, 90.0)[1].astype(float) for n in (NOISE_FREE, noise))
    z_m = exact.mean() / 1000.0
    assert (noisy - exact).std() == pytest.approx(5.0 * z_m**2, rel=0.05)
    assert (noisy - exact).mean() == pytest.approx(0.0, abs=0.4 * z_m**2)


def test_depth_ends_at_its_limits() -> None:
    noise = replace(NOISE_FREE, min_depth_m=1.0, max_depth_m=2.5)
    exact, limited = view(NOISE_FREE, scene())[1], view(noise, scene())[1]
    inside = (exact > 1000) & (exact < 2500)
    outside = (exact < 1000) | (exact > 2500)
    assert np.array_equal(limited[inside], exact[inside])
    assert not limited[outside].any()
    assert outside.any()


def test_holes_are_where_the_depth_steps() -> None:
    noise = replace(NOISE_FREE, depth_hole_rate=0.4)
    exact, holed = view(NOISE_FREE, scene())[1], view(noise, scene())[1]
    holes = (exact > 0) & (holed == 0)
    assert holes.sum() > 200
    padded = np.pad(exact.astype(float), 3, mode="edge")
    around = np.stack([padded[i : i + 480, j : j + 640] for i in range(7) for j in range(7)])
    steps = (around.max(axis=0) - around.min(axis=0)) / around.max(axis=0)
    assert np.all(steps[holes] > 0.02)
    assert np.array_equal(exact[~holes], holed[~holes])
    assert np.any(view(noise, scene(), 1)[1] != holed)


def test_depth_noise_hangs_together() -> None:
    def neighbour_correlation(correlation_px: float) -> float:
        noise = replace(NOISE_FREE, depth_sigma_at_1m_m=0.01, depth_correlation_px=correlation_px)
        snapshot = Snapshot(0.0, {Role.RECEIVER: drone(hovering(0.0, 0.0, 1.5))}, ())
        residual = (
            view(noise, snapshot, 0, 90.0)[1].astype(float) - view(NOISE_FREE, snapshot, 0, 90.0)[1]
        )
        return float(np.corrcoef(residual[:, 1:].ravel(), residual[:, :-1].ravel())[0, 1])

    assert abs(neighbour_correlation(0.0)) < 0.05
    assert neighbour_correlation(1.5) > 0.6


def test_pool_is_unit_noise() -> None:
    pool = noise_pool(np.random.default_rng(0), 200, 300, 0.0).astype(float) / 32.0
    assert pool.std() == pytest.approx(1.0, abs=0.02)
    assert pool.mean() == pytest.approx(0.0, abs=0.02)


def test_hash_is_the_same_for_ever() -> None:
    """Logged seeds must reproduce their noise."""
    assert mixed(0) == 0xE220A8397B1DCDAF  # splitmix64's first output for seed 0
    assert mixed(1, 2) != mixed(2, 1)
    assert 0 <= mixed(-5, 3) < 1 << 64


def test_no_sky_in_the_depth() -> None:
    renderer = Renderer(VGA, LEVEL, TAIL, single_marker(), SensorNoise())
    _, depth = renderer.render(looking_at(hovering(0.0, 0.0, 300.0)), Role.RECEIVER, 0)
    assert not depth[:200].any()

"""Ink, black, shadows and blades change what the plate looks like by as much as they say, and not
where it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from flight.harness.renderer import Imaging, Printing, RenderedInstant, RendererSetup
from hil.camera.pictures import LIGHTS, CameraRenderer
from hil.render.bodies.prints import SHADED, marker_print
from hil.render.scene import INK, PAPER, PLATE_SCALE
from path.marker.layout import single_marker
from path.marker.photometric.texture import cells
from path.messages import Role
from tests.hil.render.views import TAIL, VGA, hovering, mount

SIDE_M = 0.040
CELLS = cells("DICT_4X4_50", 0)
QUIET = Imaging(read_sigma=0.0, shot_gain=0.0)
STAGE = RenderedInstant(
    {Role.SENDER: hovering(0.0, 0.0, 1.4), Role.RECEIVER: hovering(0.1, -0.8, 1.9, -0.1)}
)
BLACK = 255.0 * INK[0] / PAPER[0]


def plate(printing: Printing, cells_shown: NDArray[np.float64] = CELLS) -> NDArray[np.float64]:
    rngs = np.random.default_rng([0, 0]), np.random.default_rng([0, 1])
    return marker_print(cells_shown, SIDE_M, printing, *rngs).astype(float)


def texel_m(shades: NDArray[np.float64]) -> float:
    return PLATE_SCALE * SIDE_M / len(shades)


def shot(printing: Printing, shot_seed: int = 0, imaging: Imaging = QUIET) -> NDArray[np.float64]:
    setup = RendererSetup(VGA, mount(45.0), TAIL, single_marker(), imaging, printing)
    return CameraRenderer(setup, 0).shoot(STAGE, Role.RECEIVER, shot_seed).color.astype(float)


def test_a_print_without_faults_is_the_ideal_marker() -> None:
    """Drawn from a table of shades, edges are where they are without one."""
    almost = Printing(black_spread=1e-6)
    assert np.abs(shot(almost) - shot(Printing())).max() <= 1.0
    shades = plate(almost)
    assert sorted(np.unique(shades)) == [round(BLACK), 255.0]
    inner = shades[len(shades) // 6 : -len(shades) // 6]
    assert inner[:, len(shades) // 2].min() == round(BLACK)


@pytest.mark.parametrize("spread_m", [0.00005, 0.0002, 0.0005])
def test_ink_moves_every_edge_by_its_spread(spread_m: float) -> None:
    nominal, spread = plate(Printing()), plate(Printing(ink_spread_m=spread_m))
    size = len(nominal)
    row = size // 6 + size // 18  # through the black frame only
    width_m = [
        (255.0 - shades[row]).sum() / (255.0 - BLACK) * texel_m(shades)
        for shades in (nominal, spread)
    ]
    assert width_m[0] == pytest.approx(SIDE_M, rel=3e-3)  # of 8-bit shades
    assert width_m[1] - width_m[0] == pytest.approx(2.0 * spread_m, abs=6e-6)
    inside = slice(size // 6 + size // 9, -(size // 6 + size // 9))
    assert np.all(spread[inside, inside] <= nominal[inside, inside])  # white cells shrink too


def test_black_differs_from_cell_to_cell_and_stays_with_the_print() -> None:
    shades = plate(Printing(black_spread=6.0))
    n = len(CELLS)
    border, per_cell = len(shades) // 6, round(len(shades) / (PLATE_SCALE * n))
    middles = border + per_cell * np.arange(n) + per_cell // 2
    levels = shades[np.ix_(middles, middles)][CELLS == 0.0] * PAPER[0] / 255.0
    assert levels.std() == pytest.approx(6.0, rel=0.45)
    assert levels.mean() == pytest.approx(INK[0], abs=4.0)
    uneven = Printing(black_spread=6.0, blade=True)
    plates = [
        marker_print(
            0.0 * CELLS, SIDE_M, uneven, np.random.default_rng(0), np.random.default_rng(light)
        ).astype(float)
        for light in range(2)
    ]
    middle = slice(len(shades) // 6, -(len(shades) // 6))  # without the white border
    # everywhere but under the two blades
    assert np.mean(plates[0][middle, middle] == plates[1][middle, middle]) > 0.5


def test_cells_of_a_picture_of_few_pixels_end_with_whole_ones_and_the_frame_stays() -> None:
    """As OpenCV draws a marker of 16 pixels: six cells of 3, 3, 2, 3, 3 and 2 pixels."""
    checked = (np.indices(CELLS.shape).sum(axis=0) % 2).astype(float)
    exact, coarse = plate(Printing(), checked), plate(Printing(picture_px=16), checked)
    border, per_cell = len(exact) // 6, len(exact) // 9
    row = coarse[border + per_cell // 4, border:-border]
    ends = (np.flatnonzero(np.diff(row)) + 1) / len(row) * 16.0
    assert ends == pytest.approx([3.0, 6.0, 8.0, 11.0, 14.0], abs=0.03)
    for shades in (exact, coarse):
        assert np.all(shades[: border - 1] == 255.0) and np.all(shades[:, : border - 1] == 255.0)


@pytest.mark.parametrize(
    ("kind", "narrowest_m", "widest_m"), [("soft", 0.02, 0.045), ("hard", 0.0005, 0.0015)]
)
def test_a_shadow_takes_light_away_over_its_own_width(
    kind: str, narrowest_m: float, widest_m: float
) -> None:
    light = plate(Printing(shadow=kind), np.ones_like(CELLS)) / 255.0  # type: ignore[arg-type]
    assert light.max() == pytest.approx(1.0, abs=0.02)
    assert light.min() == pytest.approx(SHADED, abs=0.05)
    area = np.mean((light > SHADED + 0.05) & (light < 0.95)) * (PLATE_SCALE * SIDE_M) ** 2
    assert narrowest_m < area / (PLATE_SCALE * SIDE_M) < widest_m


def test_a_blade_is_a_dark_bar_across_the_plate() -> None:
    through = plate(Printing(blade=True)) / plate(Printing())
    white = plate(Printing()) == 255.0
    under = white & (through < 0.75)
    assert 0.03 < under.sum() / white.sum() < 0.35
    assert through[under].min() == pytest.approx(0.56, abs=0.02)  # of 0.55 opacity over dark grey
    assert np.abs(through[white & ~under] - 1.0).min() == 0.0


def test_shadows_and_blades_lie_elsewhere_in_other_shots() -> None:
    for printing in (Printing(shadow="hard"), Printing(blade=True)):
        different = {shot(printing, seed).tobytes() for seed in range(6)}
        assert 2 <= len(different) <= LIGHTS


def test_faults_of_the_print_change_the_plate_only() -> None:
    ideal = shot(Printing())
    bad = shot(Printing(0.0003, 6.0, "hard", blade=True))
    changed = np.argwhere(np.abs(ideal - bad).max(axis=2) > 1.0)
    assert len(changed) > 300
    assert np.ptp(changed, axis=0).max() < 70  # the plate is about 50 px
    assert np.array_equal(shot(replace(Printing(), blade=True), 3), shot(Printing(blade=True), 3))

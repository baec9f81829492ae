"""The picture: it shows what the records hold, and can be drawn of any run, however little it
holds.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from missions.look.report.palette import COUNT, MAPPED_BOX, MARKER, OWN_BOX, PHASES, PRIOR
from missions.look.report.picture import draw_run
from missions.look.report.records import load_run
from missions.look.report.summary import summarize

MakeRun = Callable[..., Path]


def drawn(folder: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    run = load_run(folder)
    draw_run(run, summarize(run), folder / "run.png")
    image = cv2.imread(str(folder / "run.png"))
    assert image is not None
    return np.asarray(image[:, :, ::-1], np.uint8)


def pixels_of(image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], color: str) -> int:
    wanted = np.round(255 * np.array(to_rgb(color)))
    return int(np.sum(np.all(np.abs(image.astype(int) - wanted) <= 2, axis=2)))


@pytest.mark.parametrize("images", [True, False])
def test_a_run_is_drawn_with_phases_count_and_all_that_is_in_the_views(
    make_run: MakeRun, images: bool
) -> None:
    image = drawn(make_run(images=images))
    for color in (PHASES["verify"], COUNT, MARKER, OWN_BOX, MAPPED_BOX, PRIOR):
        assert pixels_of(image, color) > 30, color


def test_a_run_without_world_commit_or_receiver_is_drawn_too(make_run: MakeRun) -> None:
    folder = make_run(world=False, committed=False)
    (folder / "receiver.mcap").unlink()
    (folder / "run.json").unlink()
    image = drawn(folder)
    assert pixels_of(image, COUNT) > 30
    assert pixels_of(image, MARKER) == 0


def test_a_run_that_ended_on_the_ground_is_drawn_too(make_run: MakeRun) -> None:
    folder = make_run()
    for name in ("sender.mcap", "receiver.mcap"):
        (folder / name).write_bytes((folder / name).read_bytes()[:600])
    image = drawn(folder)
    assert pixels_of(image, PHASES["preflight"]) > 30
    assert pixels_of(image, COUNT) == 0


def test_a_run_whose_programs_never_began_is_drawn_too(make_run: MakeRun) -> None:
    folder = make_run()
    for name in ("sender.mcap", "receiver.mcap"):
        (folder / name).unlink()
    image = drawn(folder)
    assert pixels_of(image, PHASES["verify"]) == 0

"""Views of a board from a folder of images, a recording, or a camera as it runs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from drivers.interfaces import Camera, CameraError, PartError
from drivers.recordings.recording import (
    IMAGE_SUFFIXES,
    RecordingError,
    RecordingOptions,
    open_recording,
    read_image,
)
from missions.ground.work import Bars
from path.arrays import Image
from path.calibration.board import Board, BoardView, find_board
from path.calibration.judge import empty_places
from path.values import frozen

SAMPLE_NS = 200_000_000  # frames of a recording closer than this are not looked at
# of the image's diagonal: the board moved less since the frame before, so it is held still
STILL = 0.004
MOST_OTHERS = 5  # images that are no views and are kept
DIFFERENT = 0.04  # of the diagonal: a new view differs from each other one by more


@frozen(eq=False)
class CollectedImage:
    """One image that was looked at. ``view`` is None where no board was found, and then the image
    is not kept.
    """

    name: str
    size: tuple[int, int]
    view: BoardView | None
    grey: Image | None = None


@dataclass(slots=True)
class Collected:
    """The views that a source gave.

    ``sample``: an image for pictures. ``others``: the first images that are no views, for telling
    what else is in them.
    """

    looks: list[CollectedImage] = field(default_factory=list[CollectedImage])
    sample: Image | None = None
    others: list[Image] = field(default_factory=list[Image])
    serial: str = ""

    def add(
        self,
        name: str,
        grey: Image,
        view: BoardView | None,
    ) -> None:
        size = grey.shape[1], grey.shape[0]
        self.looks.append(CollectedImage(name, size, view, None if view is None else grey))
        if view is None:
            self.add_other(grey)
        else:
            self.sample = grey

    def add_other(self, grey: Image) -> None:
        """Keep an image that is no view; beyond a few there is nothing new in them."""
        self.sample = grey if self.sample is None else self.sample
        if len(self.others) < MOST_OTHERS:
            self.others.append(grey)


def from_images(
    folder: Path,
    board: Board,
    bars: Bars,
) -> Collected:
    """Every image of a folder. Raises PartError when there is none."""
    files = image_files(folder)
    collected = Collected()
    with bars.bar("images", len(files)) as advance:
        for file in files:
            grey = cv2.cvtColor(read_image(file), cv2.COLOR_BGR2GRAY)
            collected.add(
                file.name,
                np.asarray(grey, np.uint8),
                find_board(np.asarray(grey, np.uint8), board),
            )
            advance()
    return collected


def image_files(folder: Path) -> list[Path]:
    """The images of a folder by name. Raises PartError when there are none."""
    files = (
        sorted(f for f in folder.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES)
        if folder.is_dir()
        else []
    )
    if not files:
        raise PartError(
            f"{folder}: there are no images in it", "name a folder of .png or .jpg files"
        )
    return files


class Chooser:
    """Takes still views that differ from all it has, from frames in order."""

    def __init__(self, board: Board, wanted: int) -> None:
        self._board = board
        self._wanted = wanted
        self._before: BoardView | None = None
        self.chosen: list[BoardView] = []

    @property
    def done(self) -> bool:
        return len(self.chosen) >= self._wanted

    def offer(self, grey: Image) -> BoardView | None:
        """The board in a frame when it is taken as a view."""
        view = find_board(grey, self._board)
        before = self._before
        self._before = view
        if view is None or before is None:
            return None
        diagonal = float(np.hypot(*grey.shape))
        if _apart(view, before) > STILL * diagonal:
            return None
        if any(_apart(view, other) < DIFFERENT * diagonal for other in self.chosen):
            return None
        self.chosen.append(view)
        return view


def _apart(a: BoardView, b: BoardView) -> float:
    """Rms distance in px of the corners that both views have; inf when they share none."""
    _, i, j = np.intersect1d(a.ids, b.ids, return_indices=True)
    if len(i) == 0:
        return float("inf")
    return float(np.sqrt(((a.corners_px[i] - b.corners_px[j]) ** 2).sum(axis=1).mean()))


def from_recording(
    file: Path,
    board: Board,
    wanted: int,
    bars: Bars,
) -> Collected:
    """Chosen views of a recording. Raises PartError when it cannot be played."""
    recording = open_recording(file, RecordingOptions(rate_hz=5.0 if file.is_dir() else 30.0))
    chooser = Chooser(board, wanted)
    collected = Collected()
    last_ns: int | None = None
    with bars.bar("views", wanted) as advance:
        for frame in recording.frames():
            if last_ns is not None and frame.stamp_ns - last_ns < SAMPLE_NS:
                continue
            last_ns = frame.stamp_ns
            grey = np.asarray(cv2.cvtColor(frame.load().color, cv2.COLOR_BGR2GRAY), np.uint8)
            view = chooser.offer(grey)
            if view is not None:
                collected.add(frame.name, grey, view)
                advance()
            else:
                collected.add_other(grey)
            if chooser.done:
                break
    return collected


async def from_camera(
    camera: Camera,
    board: Board,
    wanted: int,
    seconds: float,
    folder: Path,
    say: Callable[[str], None],
) -> Collected:
    """Views of a camera as it runs, each kept in ``folder``. Ends with the recording when it plays
    one.

    Raises:
        CameraError: the camera gives no frames.
    """
    loop = asyncio.get_running_loop()
    chooser = Chooser(board, wanted)
    collected = Collected()
    async with camera:
        collected.serial = getattr(camera, "serial", "")
        end = loop.time() + seconds
        while not chooser.done and loop.time() < end:
            try:
                frame = await camera.read(5.0)
            except CameraError:
                if collected.looks:  # what there is may be enough; what is missing will be named
                    break
                raise
            grey = np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_BGR2GRAY), np.uint8)
            view = await asyncio.to_thread(chooser.offer, grey)
            if view is None:
                collected.add_other(grey)
                continue
            name = f"view-{len(chooser.chosen):03d}.png"
            _keep(folder / name, frame.color)
            collected.add(name, grey, view)
            empty = empty_places(chooser.chosen, (grey.shape[1], grey.shape[0]))
            say(
                f"view {len(chooser.chosen)}/{wanted}"
                + (f"; still empty: {', '.join(empty)}" if empty else "")
            )
    return collected


def _keep(file: Path, image: Image) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(file), image):
        raise RecordingError(f"cannot write {file}", "name another place with --out")

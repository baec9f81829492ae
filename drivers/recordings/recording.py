"""Recordings of a camera as frames with stamps: a video file, a folder of images, or a log of PATH
with images in it.

A recording is opened once to see that it can be played at all, and then gives its frames in order
as often as it is asked. Nothing is decoded before a frame is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from drivers.log.frames import is_frames
from drivers.log.mcap_log import LogRecord, decode_image, read_log
from drivers.log.video import recorded_frames
from drivers.recordings.ros_bag import refuse_ros
from drivers.recordings.stamps import RecordingError, frame_stamps, natural, stamped_files
from drivers.recordings.video_file import (
    VIDEO_SUFFIXES,
    Damage,
    RateMissing,
    VideoError,
    video_frames,
)
from path.arrays import Depths, Image
from path.values import frozen

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
REALSENSE_SUFFIXES = (".db3", ".bag")
SEARCHED = 5000  # records of a log in which its kinds of images are looked for
REMEDY = "name a video file, a folder of images, or an .mcap log with images"


@frozen
class Loaded:
    """Pixels of a frame: BGR, and depth in mm registered to it, if it was recorded."""

    color: Image
    depth_mm: Depths | None = None


@frozen
class RecordedFrame:
    """One frame, not decoded yet. ``stamp_ns``: of the recording's own clock. ``load`` raises
    RecordingError.
    """

    name: str
    stamp_ns: int
    load: Callable[[], Loaded]


class Recording(Protocol):
    """A recording's frames. ``count``: their number, None when that is not known before they are
    read.
    """

    @property
    def name(self) -> str: ...

    @property
    def count(self) -> int | None: ...

    @property
    def damage(self) -> str:
        """What of it gave no frame, when it was read to its end; "" when nothing did."""
        ...

    def frames(self) -> Iterator[RecordedFrame]:
        """Yield the frames from the beginning. Raises RecordingError where it is damaged."""
        ...


@frozen
class RecordingOptions:
    """
    Attributes:
        rate_hz: of images without stamps, and of a bare video stream, which has none; None: they
            are refused.
        stamps: CSV with columns ``file`` and ``stamp_ns`` or ``stamp_s``; None: ``stamps.csv`` in
            the folder if there is one, or else the names of the files when they are times. Of a
            video file: one of the latter columns, and a line for each frame; None: its presentation
            times.
        depth: folder with a 16-bit image in mm of the same name for each image; None: no depth. Of
            a video file: with one for each frame, in the order of their names.
        topic: of a log, which images; "" when it has only one kind.
    """

    rate_hz: float | None = None
    stamps: Path | None = None
    depth: Path | None = None
    topic: str = ""

    def __post_init__(self) -> None:
        if self.rate_hz is not None and not self.rate_hz > 0.0:
            raise ValueError(f"rate_hz: {self.rate_hz!r} is not positive")


def open_recording(file: Path, options: RecordingOptions | None = None) -> Recording:
    """A recording by what it is.

    Raises:
        RecordingError: there is none, of no known kind, empty or damaged at its first frame; with
            what was found.
    """
    options = options or RecordingOptions()
    if not file.exists():
        raise RecordingError(f"{file}: there is no such file or folder", REMEDY)
    refuse_ros(file)
    if file.is_dir():
        recording: Recording = Folder(file, options)
    elif file.suffix.lower() == ".mcap" and is_frames(file):
        recording = RecordedFrames(file)
    elif file.suffix.lower() == ".mcap":
        recording = RecordedLog(file, options.topic)
    elif file.suffix.lower() in VIDEO_SUFFIXES:
        recording = Video(file, options)
    elif file.suffix.lower() in REALSENSE_SUFFIXES:
        raise RecordingError(
            f"{file} is a RealSense recording, and these are looked at as images",
            f"write it out with `path-handoff export {file}`, and name the folder that it makes",
        )
    else:
        raise RecordingError(f"{file}: a recording of kind '{file.suffix}' is not known", REMEDY)
    first = next(recording.frames(), None)
    if first is None:
        torn = f": {recording.damage}" if recording.damage else ""
        raise RecordingError(f"{file}: there are no frames in it{torn}", REMEDY)
    first.load()
    return recording


class Video:
    """A video file, read with FFmpeg; its stamps are the presentation times of the frames, or those
    of a table.

    Depth images, if there are any, and the table's lines are one for each frame.
    """

    count: int | None = None

    @property
    def damage(self) -> str:
        return self._damage.text

    def __init__(self, file: Path, options: RecordingOptions) -> None:
        self.name = str(file)
        self._file = file
        self._options = options
        self._damage = Damage()
        self._stamps = None if options.stamps is None else frame_stamps(options.stamps)
        self._depth = None if options.depth is None else images_of(options.depth)

    def frames(self) -> Iterator[RecordedFrame]:
        number = 0
        stamps = self._stamps
        depth = self._depth
        size: tuple[int, ...] | None = None

        def load(name: str, pixels: Callable[[], Image], behind: Path | None) -> Loaded:
            nonlocal size
            loaded = _with_depth(pixels, behind)
            size = size or loaded.color.shape
            _check_one_size(f"{self._file}, {name}", loaded.color, size)
            return loaded

        try:
            # Whoever has a table of stamps needs no rate: its stamps are not looked at.
            rate_hz = self._options.rate_hz or (1.0 if stamps is not None else None)
            shown = video_frames(self._file, rate_hz, self._damage)
            for shown_ns, pixels in shown:
                if any(given is not None and number >= len(given) for given in (stamps, depth)):
                    self._check_counts(number + 1 + sum(1 for _ in shown))
                stamp_ns = shown_ns if stamps is None else stamps[number]
                behind = None if depth is None else depth[number]
                name = f"frame {number}"
                yield RecordedFrame(name, stamp_ns, partial(load, name, pixels, behind))
                number += 1
        except RateMissing as error:
            raise RecordingError(
                f"{self._file}: {error}",
                "give its rate: rate_hz in a rig or films file, --rate-hz of detect (30 of a Tello)",
            ) from error
        except VideoError as error:
            raise RecordingError(
                f"{self._file}: {error}" + (f" after {number} frames" if number else ""),
                "is the file whole? `ffmpeg -i FILE -c copy OUT.mkv` often mends one; a bare stream "
                "needs a key frame with its headers in it",
            ) from error
        self._check_counts(number)

    def _check_counts(self, frames: int) -> None:
        """Raise RecordingError when there are not as many stamps or depth images as frames."""
        for given, where, what in (
            (self._stamps, self._options.stamps, "stamps"),
            (self._depth, self._options.depth, "depth images"),
        ):
            if given is not None and len(given) != frames:
                raise RecordingError(
                    f"{where}: {len(given)} {what} for {self._file}, which has {frames} frames",
                    "there must be one for each frame",
                )


class Folder:
    """Images in a folder, in the order of their stamps. All must be of one size, which is seen when
    they are loaded.
    """

    damage = ""

    def __init__(self, folder: Path, options: RecordingOptions) -> None:
        self.name = str(folder)
        self._folder = folder
        self._depth = options.depth
        files = images_of(folder)
        self._stamped = (
            stamped_files(folder, files, options.stamps, options.rate_hz) if files else []
        )

    @property
    def count(self) -> int | None:
        return len(self._stamped)

    def frames(self) -> Iterator[RecordedFrame]:
        size: tuple[int, ...] | None = None

        def load(file: Path) -> Loaded:
            nonlocal size
            color = read_image(file)
            size = size or color.shape
            _check_one_size(str(file), color, size)
            return Loaded(
                color,
                None
                if self._depth is None
                else _read_depth(self._depth / f"{file.stem}.png", color),
            )

        for stamp_ns, file in self._stamped:
            yield RecordedFrame(file.name, stamp_ns, lambda file=file: load(file))


class RecordedLog:
    """Images in a log of PATH (MCAP), with the stamps they were logged with."""

    count: int | None = None
    damage = ""

    def __init__(self, file: Path, topic: str) -> None:
        self.name = str(file)
        self._file = file
        topics = sorted(
            {r.topic for r in islice(self._records(), SEARCHED) if r.record.get("format") == "jpeg"}
        )
        if not topics:
            raise RecordingError(f"{file}: there are no images in this log", REMEDY)
        if topic not in topics and (topic or len(topics) > 1):
            found = f"images at '{topic}'" if topic else "one kind of images"
            raise RecordingError(
                f"{file}: expected {found}, found {', '.join(topics)}", "name one as topic"
            )
        self._topic = topic or topics[0]

    def _records(self) -> Iterator[LogRecord]:
        try:
            yield from read_log(self._file)
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._file}: {error}", REMEDY) from error

    def frames(self) -> Iterator[RecordedFrame]:
        for number, record in enumerate(
            each for each in self._records() if each.topic == self._topic
        ):
            yield RecordedFrame(
                f"image {number}", record.stamp_ns, lambda record=record: self._load(record)
            )

    def _load(self, record: LogRecord) -> Loaded:
        try:
            return Loaded(decode_image(record.record))
        except (KeyError, ValueError) as error:
            raise RecordingError(
                f"{self._file}: {self._topic} at {record.stamp_ns} ns: {error}", REMEDY
            ) from error


class RecordedFrames:
    """Every frame of a camera as a program of PATH has recorded them beside its log, with depth."""

    count: int | None = None
    damage = ""

    def __init__(self, file: Path) -> None:
        self.name = str(file)
        self._file = file

    def frames(self) -> Iterator[RecordedFrame]:
        try:
            for frame in recorded_frames(self._file):
                loaded = Loaded(frame.color, frame.depth_mm)
                yield RecordedFrame(
                    f"frame {frame.frame_id}", frame.stamp_ns, lambda loaded=loaded: loaded
                )
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._file}: {error}", REMEDY) from error


def read_image(file: Path) -> Image:
    """BGR pixels (h, w, 3) of an image file. Raises RecordingError."""
    pixels = cv2.imread(str(file), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        raise RecordingError(
            f"{file}: this is no image that can be read", "remove it, or record it again"
        )
    return np.asarray(pixels, np.uint8)


def _check_one_size(name: str, color: Image, size: tuple[int, ...]) -> None:
    """Raise RecordingError where an image is not as large as those before it."""
    if color.shape != size:
        raise RecordingError(
            f"{name}: {color.shape[1]}x{color.shape[0]} px, the images before it have "
            f"{size[1]}x{size[0]} px",
            "put images of one camera at one size into a recording of their own",
        )


def _with_depth(pixels: Callable[[], Image], depth: Path | None) -> Loaded:
    color = pixels()
    return Loaded(color, None if depth is None else _read_depth(depth, color))


def images_of(folder: Path) -> list[Path]:
    """The images of a folder in the order of their names. Raises RecordingError."""
    if not folder.is_dir():
        raise RecordingError(f"{folder}: there is no such folder", "name the folder of the images")
    return sorted((f for f in folder.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES), key=natural)


def _read_depth(file: Path, color: Image) -> Depths:
    pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise RecordingError(
            f"{file}: there is no depth image",
            "each image needs one of the same name, as 16-bit PNG",
        )
    if pixels.dtype != np.uint16 or pixels.shape != color.shape[:2]:
        raise RecordingError(
            f"{file}: expected 16-bit depth of {color.shape[1]}x{color.shape[0]} px, found {pixels.dtype} of "
            f"{pixels.shape[1]}x{pixels.shape[0]} px",
            "write depth registered to the colour image, in millimetres, as 16-bit PNG",
        )
    return np.asarray(pixels, np.uint16)

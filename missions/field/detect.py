"""``path-handoff detect``: a detector on a recording. What it finds, and how long it takes."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np

from drivers.clock import busy_ns, stopwatch_ns
from drivers.interfaces import Detector, PartError
from drivers.recordings.labels import read_labels
from drivers.recordings.recording import RecordedFrame, Recording, images_of, read_image
from drivers.rig.file import load_rig
from drivers.rig.parts import PartContext, PartSpec, create, decode_part, part_context
from missions.field.frames import open_frames, write_picture, write_table
from missions.field.measured_detector import Measured
from missions.ground.options.field import DetectOptions
from missions.ground.rigs import FOLDER
from missions.ground.run_folder import claim_folder, unless_refused
from missions.ground.work import Bars
from path.messages import Role
from path.observations import Detection
from path.values import frozen

BOXES = "boxes.csv"
MEASURED = "measured.json"
COLUMNS = ("frame", "stamp_s", "x", "y", "w", "h", "score")
GREEN = (80, 230, 60)


@frozen
class Timing:
    """The time that a detector took for each frame, ms: on the wall's clock, and of this thread on
    a core.
    """

    wall_ms: tuple[float, ...]
    busy_ms: tuple[float, ...]

    def line(self, name: str) -> str:
        """One line: median, 95th and 99th percentile. The first frame, in which things are loaded,
        is left out.
        """
        wall = self.wall_ms[1:] or self.wall_ms
        busy = self.busy_ms[1:] or self.busy_ms
        median, p95, p99 = np.percentile(wall, (50, 95, 99))
        return (
            f"{name}: {median:.1f} ms median, {p95:.1f} p95, {p99:.1f} p99 ({1000.0 / max(median, 1e-3):.0f} Hz); "
            f"{float(np.median(busy)):.1f} ms of one core; {len(wall)} frames"
        )


def run(options: DetectOptions, out: TextIO | None = None) -> int:
    """The command; 0 when every frame was looked at. Raises PartError with what is wrong and what
    to do.
    """
    stream = out or sys.stdout
    name, detector = _detector(options)
    if options.measure is not None:
        return _measure(options, name, detector, options.measure, stream)
    recording = open_frames(options.frames, options.rate_hz)
    if options.out is None:
        return _look(name, detector, recording, None, stream)
    with unless_refused(options.out) as folder:
        claim_folder(folder, BOXES, "frame,stamp_s")
        _write(folder / BOXES, ())  # whose folder it is, from now on
        return _look(name, detector, recording, folder, stream)


def _look(
    name: str,
    detector: Detector,
    recording: Recording,
    folder: Path | None,
    stream: TextIO,
) -> int:
    found: list[tuple[RecordedFrame, Sequence[Detection]]] = []
    wall_ms: list[float] = []
    busy: list[float] = []
    with Bars(sys.stderr if stream is sys.stdout else stream).bar(
        "frames", recording.count or 0
    ) as advance:
        for frame in recording.frames():
            color = frame.load().color
            begun = stopwatch_ns()
            worked = busy_ns()
            boxes = detector.detect(color, None)
            wall_ms.append((stopwatch_ns() - begun) / 1e6)
            busy.append((busy_ns() - worked) / 1e6)
            found.append((frame, boxes))
            if folder is not None:
                _draw(folder / f"{len(found) - 1:06d}.jpg", color, boxes)
            if recording.count:
                advance()
    with_some = sum(bool(boxes) for _, boxes in found)
    stream.write(
        f"{len(found)} frames, {with_some} with something, {sum(len(b) for _, b in found)} boxes\n"
    )
    if recording.damage:
        stream.write(f"{recording.damage}\n")
    stream.write(f"{Timing(tuple(wall_ms), tuple(busy)).line(name)}\n")
    if folder is not None:
        _write(folder / BOXES, found)
        stream.write(f"{folder}: {BOXES}, and every frame with its boxes\n")
    return 0


def _measure(
    options: DetectOptions,
    name: str,
    detector: Detector,
    source: Path,
    stream: TextIO,
) -> int:
    """Judge the detector by labels; return 0 when at least one picture had some."""
    labels = read_labels(source, options.labels)
    files = images_of(options.frames)
    measured = Measured()
    progress = Bars(sys.stderr if stream is sys.stdout else stream)
    with progress.bar("pictures", len(files)) as advance:
        for file in files:
            told = labels.of(file.name)
            if told is not None:
                measured.look(read_image(file), told, detector.detect, options.regions, file.stem)
            advance()
    if not measured.pictures:
        raise PartError(
            f"{source}: none of the {len(files)} pictures in {options.frames} is labelled in it",
            "labels go with pictures by their files' names",
        )
    where = "each object in a region of its own" if options.regions else "whole pictures"
    stream.write(f"{name}, {where}: {measured.pictures} pictures\n")
    left_out = len(files) - measured.pictures
    if left_out:
        stream.write(f"{left_out} pictures without labels were left out\n")
    stream.write("".join(f"{line}\n" for line in measured.lines()))
    if options.out is not None:
        _keep(options.out, {"detector": name, "regions": options.regions, **measured.record()})
        stream.write(f"{options.out}: {MEASURED}\n")
    return 0


def _keep(out: Path, record: dict[str, Any]) -> None:
    with unless_refused(out) as folder:
        claim_folder(folder, MEASURED, "least_iou")
        (folder / MEASURED).write_text(json.dumps(record, indent=2) + "\n", "utf-8")


def _detector(options: DetectOptions) -> tuple[str, Detector]:
    """The detector asked for, and its name. Raises PartError."""
    rig = load_rig(options.rig, [FOLDER])
    role = Role(options.role)
    context: PartContext = part_context(rig, role)
    if options.model is not None:
        table: dict[str, Any] = {
            "model": str(options.model.absolute()),
            "classes": list(options.classes),
            "min_score": options.min_score,
        }
        spec = PartSpec("drivers.detectors.yolox:YoloxDetector", table, "--model", None)
    else:
        _, perception = decode_part(rig.role(role).perception)
        spec = getattr(perception, "detector", None)
        if not isinstance(spec, PartSpec):
            raise PartError(
                f"{rig.role(role).perception.where}: it has no detector",
                "name another rig, or --model",
            )
    return spec.factory.rpartition(":")[2], create(spec, context)


def _draw(
    file: Path,
    color: Any,
    boxes: Sequence[Detection],
) -> None:
    picture = color.copy()
    for each in boxes:
        x = round(each.box.x + 0.5)
        y = round(each.box.y + 0.5)
        cv2.rectangle(picture, (x, y), (round(x + each.box.w), round(y + each.box.h)), GREEN, 2)
        cv2.putText(
            picture,
            f"{each.score:.2f}",
            (x, max(y - 4, 10)),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.45,
            GREEN,
            1,
        )
    write_picture(file, picture)


def _write(file: Path, found: Sequence[tuple[RecordedFrame, Sequence[Detection]]]) -> None:
    rows = [
        (
            frame.name,
            f"{frame.stamp_ns / 1e9:.6f}",
            *(f"{n:.2f}" for n in (each.box.x, each.box.y, each.box.w, each.box.h)),
            f"{each.score:.3f}",
        )
        for frame, boxes in found
        for each in boxes
    ]
    write_table(file, COLUMNS, rows)

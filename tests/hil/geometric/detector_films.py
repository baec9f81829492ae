"""The measurement of ``hil.world.detector.MEASURED``: detectors on films of a followed target, against geometry.

``python -m tests.hil.geometric.detector_films --model yolox_nano.onnx`` prints the table, scene by scene.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from drivers.detectors.yolox import YoloxDetector, YoloxDetectorConfig
from drivers.interfaces import Detector
from hil.geometric.scene import outlines, place
from hil.geometric.targets import CONTACT, SHARE, TOUCHED
from hil.render.renderer import Renderer
from hil.world.config import SCENES, SceneName
from hil.world.detector import MEASURED
from hil.world.snapshot import DroneTruth, Snapshot, TargetKind
from hil.world.targets import GroundVehicles, LookAlikeConfig, TargetConfig
from path.gate.agreement import iou
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box, around
from tests.hil.geometric.noise_measurement import CAMERA, NED_TO_ENU, T_B_C, T_B_V, Array, edges_off, setup

RATE_HZ, CAMERAS_HZ = 25.0, 50.0  # of a film, and of the cameras whose frames a spell is counted in
PLACES_M: dict[TargetKind, tuple[float, float]] = {"car": (1.55, 1.5), "person": (2.2, 3.5), "drone": (1.45, 2.2)}
"""Behind the target and above the ground: as the rigs have D1. D2 is a quarter farther off and 0.5 m higher."""
FOUND_IOU, NOTHING_IOU, IN_VIEW_SHARE = 0.4, 0.1, 0.5
BORDER_PX = 1.0
WHOLE_PX = 1300.0  # so far around a region the network sees: all of the image


@dataclass(frozen=True, slots=True)
class FilmFrame:
    """What a detector made of the target in one frame.

    Attributes:
        found: one of its boxes is the target's.
        edges_px: left, top, right, bottom of that box against the visible outline; None: not found, in part hidden or
            beside another one.
        contact: common border with another one in the image, over the box's width, as ``hil.geometric.targets`` has it.
        joined: that box is around both.
        inventions: boxes that are of nothing.
    """

    found: bool
    edges_px: Sequence[float] | None
    inventions: int
    contact: float = 0.0
    joined: bool = False


def detector_of(kind: TargetKind, model: Path | None) -> Detector:
    """The detector that one would use: of colour for what is orange, YOLOX for people."""
    if kind != "person":
        return ColorDetector(ColorDetectorConfig())
    assert model is not None, "people need a model: --model yolox_nano.onnx"
    return YoloxDetector(YoloxDetectorConfig(model, ("person",), min_score=0.05, max_side_px=WHOLE_PX))


def film(kind: TargetKind, seed: int, seconds: float) -> Iterator[Snapshot]:
    """Moments of a target that moves and of two drones that follow it, swaying."""
    rng = np.random.default_rng(seed)
    alike = LookAlikeConfig(min_distance_m=1.8, max_distance_m=3.0) if kind == "person" else LookAlikeConfig()
    traffic = GroundVehicles(
        TargetConfig(kind=kind, start_time_s=0.0), alike, [(0.0, 0.0), (1.5, -3.0)], np.random.SeedSequence(seed)
    )
    phase, first = rng.uniform(0.0, 2.0 * math.pi, 8), rng.uniform(0.0, 2.0 * math.pi)
    behind_m, height_m = PLACES_M[kind]
    for k in range(round(seconds * RATE_HZ)):
        time_s = 20.0 + k / RATE_HZ
        things = traffic.at(time_s)
        x, y, z = things[0].position_w_m
        drones: dict[Role, DroneTruth] = {}
        for i, role in enumerate(Role):
            bearing, back_m = first + 0.1 * k / RATE_HZ + 0.6 * i, behind_m * (1.0 + 0.25 * i)
            up_m = height_m + 0.5 * i + (z - 0.8 if kind == "drone" else z)
            sway = 0.05 * np.sin(0.7 * time_s + phase[3 * i : 3 * i + 3])
            place_w = np.array([x - back_m * math.sin(bearing), y - back_m * math.cos(bearing), up_m]) + sway
            roll, pitch = 0.03 * math.sin(1.3 * time_s + phase[6 + i]), 0.03 * math.sin(1.7 * time_s + phase[i])
            T_w_b = Pose(NED_TO_ENU @ R_from_rpy(roll, pitch, bearing), place_w)
            drones[role] = DroneTruth(T_w_b, (0.0, 0.0, 0.0), 7.0 * time_s % 6.0, True)
        yield Snapshot(time_s, drones, things, kind=kind)


def watched(
    detector: Detector, moments: Sequence[Snapshot], role: Role, seed: int, scene: SceneName
) -> list[FilmFrame]:
    """One camera's film, the whole image looked at, without frames in which the target is hidden or out of view."""
    renderer, frames = Renderer(CAMERA, T_B_C, T_B_V, single_marker(), seed=seed, scene=scene), list[FilmFrame]()
    for number, moment in enumerate(moments):
        seen = outlines(setup(role), place(setup(role), moment))
        if seen[0, SHARE] < IN_VIEW_SHARE:
            continue
        boxes = [each.box for each in detector.detect(renderer.render_color(moment, role, number), None)]
        things_by = [Box(s[0], s[1], s[2] - s[0], s[3] - s[1]) for s in seen.tolist()]
        things = [thing for thing, s in zip(things_by, seen, strict=True) if s[SHARE] > 0.0]
        target = things_by[0]
        best = max(boxes, key=lambda box: iou(box, target), default=None)
        found = best is not None and iou(best, target) >= FOUND_IOU
        inventions = sum(all(iou(box, thing) < NOTHING_IOU for thing in things) for box in boxes)
        contact, beside = float(seen[0, CONTACT]), int(seen[0, TOUCHED])
        alone = found and seen[0, SHARE] >= 1.0 and beside < 0 and _inside(target)
        both = None if beside < 0 else around((target, things_by[beside]))
        joined = both is not None and best is not None and iou(best, both) > max(iou(best, target), FOUND_IOU)
        edges = edges_off(best, target) if alone and best is not None else None
        frames.append(FilmFrame(found or joined, edges, inventions, contact, joined))
    return frames


def _inside(box: Box) -> bool:
    right, bottom = box.x + box.w, box.y + box.h
    return min(box.x, box.y) > BORDER_PX and right < CAMERA.width - 2 and bottom < CAMERA.height - 2


def spells(frames: Sequence[FilmFrame]) -> list[int]:
    """Lengths of the runs of frames in which it was missed."""
    lengths, run = list[int](), 0
    for frame in (*frames, FilmFrame(True, None, 0)):
        if frame.found and run:
            lengths.append(run)
        run = 0 if frame.found else run + 1
    return lengths


@dataclass(frozen=True, slots=True)
class DetectorFigures:
    """Rates of a detector on films. ``edges_px``: (n, 4) of those found in full view."""

    frames: int
    recall: float
    miss_frames: float
    false_positives: float
    edges_px: Array

    @property
    def bias_px(self) -> Array:
        return np.median(self.edges_px, axis=0)

    @property
    def sigma_px(self) -> Array:
        """Half of the middle 68 % of each edge."""
        low, high = np.percentile(self.edges_px, [16.0, 84.0], axis=0)
        return 0.5 * (high - low)


def figures_of(films: Sequence[Sequence[FilmFrame]]) -> DetectorFigures:
    frames = [frame for each in films for frame in each]
    lengths = [length for each in films for length in spells(each)]
    return DetectorFigures(
        len(frames),
        sum(frame.found for frame in frames) / len(frames),
        max(1.0, float(np.mean(lengths)) * CAMERAS_HZ / RATE_HZ) if lengths else 1.0,
        sum(frame.inventions > 0 for frame in frames) / len(frames),
        np.array([frame.edges_px for frame in frames if frame.edges_px is not None]).reshape(-1, 4),
    )


def measured(
    kind: TargetKind, scene: SceneName, seeds: Sequence[int], model: Path | None, seconds: float = 3.0
) -> DetectorFigures:
    """Both cameras' films of some seeds."""
    detector = detector_of(kind, model)
    films: list[list[FilmFrame]] = []
    for seed in seeds:
        moments = list(film(kind, seed, seconds))
        films += [watched(detector, moments, role, seed, scene) for role in Role]
    return figures_of(films)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, help="yolox_nano.onnx, for people")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--films", type=int, default=16)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.films)
    kinds: tuple[TargetKind, ...] = get_args(TargetKind)
    for kind, scene in product(kinds, SCENES):
        if (kind, scene) not in MEASURED or (kind == "person" and options.model is None):
            continue
        found = measured(kind, scene, seeds, options.model)
        edges = f"edges {found.bias_px.round(1)} +- {found.sigma_px.round(1)} px" if len(found.edges_px) else ""
        print(
            f"{kind:7}{scene:12} recall {found.recall:.3f} of {found.frames}, spells of {found.miss_frames:.1f}, "
            f"inventions in {found.false_positives:.4f}, {edges}",
            flush=True,
        )


if __name__ == "__main__":
    main()

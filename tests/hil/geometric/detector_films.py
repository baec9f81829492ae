"""The measurement of ``hil.world.detector.MEASURED``: detectors on pictures of a followed target,
against geometry.

``python -m tests.hil.geometric.detector_films --model yolox_nano.onnx --kind person --scene hall``
prints a line of the table, and the noise of the boxes. Pictures are taken far apart, so that each
counts; what is missed in one is followed back and on for as long as it is missed.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from drivers.detectors.yolox import YoloxDetector, YoloxDetectorConfig
from drivers.interfaces import Detector
from flight.harness.measured import MEASURED as IMAGING
from hil.geometric.scene import outlines, place
from hil.geometric.targets import SHARE, TOUCHED
from hil.render.renderer import Renderer
from hil.render.shutter import shutter_of
from hil.world.config import SCENES, SceneName
from hil.world.detector import MEASURED
from hil.world.errors import draw_sensor, sizes_of
from hil.world.snapshot import DroneTruth, Snapshot, TargetKind
from hil.world.targets import GroundVehicles, LookAlikeConfig, TargetConfig
from path.gate.agreement import iou
from path.geometry.rotation import R_from_rpy, log
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box, around
from tests.hil.geometric.noise_measurement import (
    CAMERA,
    NED_TO_ENU,
    T_B_C,
    T_B_V,
    Array,
    edges_off,
    setup,
)

# at which a spell is followed, and of the cameras in whose frames it is counted
RATE_HZ, CAMERAS_HZ = 25.0, 50.0
PLACES_M: dict[TargetKind, tuple[float, float]] = {
    "car": (1.55, 1.5),
    "person": (2.2, 3.5),
    "drone": (1.45, 2.2),
}
"""Behind the target and above the ground: as the rigs have D1. D2 is a quarter farther off and 0.5
m higher.
"""
FOUND_IOU, NOTHING_IOU, IN_VIEW_SHARE = 0.4, 0.1, 0.5
BORDER_PX = 1.0
# of the pictures of one walk; the last is for velocities
BEGINS_S, APART_S, STEP_S = 20.0, 2.3, 1e-3
PICTURES = 16  # of one walk and camera
# of a turn from one picture to the next: any number sees the target from all sides evenly
SIDES = 0.6180339887
FOLLOWED = 75  # a spell is followed for so many frames each way, at most
FOLLOWED_EACH = 3  # one in so many pictures is followed, where the target is missed in it
FAR_OFF_PX = 10.0  # an edge that is off by more is off for another reason than noise
NORMAL_95 = 1.96


@dataclass(frozen=True, slots=True)
class SeenTarget:
    """What a detector made of the target in one picture.

    Attributes:
        found: one of its boxes is the target's.
        inventions: boxes that are of nothing.
        edges_px: left, top, right, bottom of that box against the visible outline; None: not found,
            in part hidden or beside another one.
        height_px: of the visible outline.
        touches: another one in the image; ``joined``: that box is around both.
        spell: frames in a row in which it was missed, this one among them; 0: found.
        left: of these, this one and those after it.
    """

    found: bool
    inventions: int = 0
    edges_px: Sequence[float] | None = None
    height_px: float = 0.0
    touches: bool = False
    joined: bool = False
    spell: int = 0
    left: int = 0


def detector_of(kind: TargetKind, model: Path | None) -> Detector:
    """The detector that one would use: of colour for what is orange, YOLOX for people."""
    if kind != "person":
        return ColorDetector(ColorDetectorConfig())
    assert model is not None, "people need a model: --model yolox_nano.onnx"
    return YoloxDetector(YoloxDetectorConfig(model, ("person",), min_score=0.05))


class Walk:
    """A target that moves and two drones that follow it, swaying, from a side that every picture
    has anew.
    """

    def __init__(self, kind: TargetKind, seed: int) -> None:
        alike = (
            LookAlikeConfig(min_distance_m=1.8, max_distance_m=3.0)
            if kind == "person"
            else LookAlikeConfig()
        )
        target = TargetConfig(kind=kind, start_time_s=0.0)
        self._traffic = GroundVehicles(
            target, alike, [(0.0, 0.0), (1.5, -3.0)], np.random.SeedSequence(seed)
        )
        self._phase = np.random.default_rng(seed).uniform(0.0, 2.0 * math.pi, 8)
        self._kind: TargetKind = kind
        self._seed = seed

    def at(self, picture: int, late_s: float = 0.0) -> Snapshot:
        """The moment of a picture, or one shortly after or before it."""
        begins_s = BEGINS_S + picture * APART_S
        behind = 0.5 * math.pi - self._traffic.at(begins_s)[0].yaw_rad
        first = behind + 2.0 * math.pi * ((self._seed * PICTURES + picture) * SIDES % 1.0)
        time_s, drones = begins_s + late_s, dict[Role, DroneTruth]()
        for i, role in enumerate(Role):
            now, after = (
                self._hung(i, time_s + by_s, first + 0.1 * late_s + 0.6 * i)
                for by_s in (0.0, STEP_S)
            )
            vx, vy, vz = ((after.t - now.t) / STEP_S).tolist()
            wx, wy, wz = (log(now.R.T @ after.R) / STEP_S).tolist()
            drones[role] = DroneTruth(now, (vx, vy, vz), 7.0 * time_s % 6.0, True, (wx, wy, wz))
        return Snapshot(time_s, drones, self._traffic.at(time_s), kind=self._kind)

    def _hung(self, i: int, time_s: float, bearing: float) -> Pose:
        (x, y, z), (behind_m, height_m) = (
            self._traffic.at(time_s)[0].position_w_m,
            PLACES_M[self._kind],
        )
        back_m, up_m = (
            behind_m * (1.0 + 0.25 * i),
            height_m + 0.5 * i + (z - 0.8 if self._kind == "drone" else z),
        )
        sway = 0.05 * np.sin(0.7 * time_s + self._phase[3 * i : 3 * i + 3])
        place_w = (
            np.array([x - back_m * math.sin(bearing), y - back_m * math.cos(bearing), up_m]) + sway
        )
        roll, pitch = (
            0.03 * math.sin(1.3 * time_s + self._phase[6 + i]),
            0.03 * math.sin(1.7 * time_s + self._phase[i]),
        )
        return Pose(NED_TO_ENU @ R_from_rpy(roll, pitch, bearing), place_w)


class Watcher:
    """One camera that flies, exposed and read out for as long as a careful crew's may be, and a
    detector behind it.
    """

    def __init__(self, detector: Detector, role: Role, seed: int, scene: SceneName) -> None:
        errors = draw_sensor(
            sizes_of("careful"), np.random.default_rng([seed, list(Role).index(role)])
        )
        self._renderer = Renderer(
            CAMERA,
            T_B_C,
            T_B_V,
            single_marker(),
            seed=seed,
            scene=scene,
            imaging=IMAGING,
            shutter=shutter_of(errors),
        )
        self._detector, self._role = detector, role

    def sees(self, moment: Snapshot) -> SeenTarget | None:
        """The whole image looked at; None: the target is hidden or out of view."""
        seen = outlines(setup(self._role), place(setup(self._role), moment))
        if seen[0, SHARE] < IN_VIEW_SHARE:
            return None
        image = self._renderer.render_color(moment, self._role, round(1e3 * moment.time_s))
        boxes = [each.box for each in self._detector.detect(image, None)]
        things_by = [Box(s[0], s[1], s[2] - s[0], s[3] - s[1]) for s in seen.tolist()]
        things = [thing for thing, s in zip(things_by, seen, strict=True) if s[SHARE] > 0.0]
        target, beside = things_by[0], int(seen[0, TOUCHED])
        best = max(boxes, key=lambda box: iou(box, target), default=None)
        found = best is not None and iou(best, target) >= FOUND_IOU
        inventions = sum(all(iou(box, thing) < NOTHING_IOU for thing in things) for box in boxes)
        alone = found and seen[0, SHARE] >= 1.0 and beside < 0 and _inside(target)
        both = None if beside < 0 else around((target, things_by[beside]))
        joined = (
            both is not None
            and best is not None
            and iou(best, both) > max(iou(best, target), FOUND_IOU)
        )
        edges = edges_off(best, target) if alone and best is not None else None
        return SeenTarget(found or joined, inventions, edges, target.h, beside >= 0, joined)

    def spell(self, walk: Walk, picture: int, way: int) -> int:
        """The number of frames after one, or before it (``way`` -1), for which the target is missed
        on.
        """
        for k in range(1, FOLLOWED + 1):
            seen = self.sees(walk.at(picture, way * k / RATE_HZ))
            if seen is None or seen.found:
                return k - 1
        return FOLLOWED


def _inside(box: Box) -> bool:
    right, bottom = box.x + box.w, box.y + box.h
    return min(box.x, box.y) > BORDER_PX and right < CAMERA.width - 2 and bottom < CAMERA.height - 2


@dataclass(frozen=True)
class DetectorFigures:
    """Rates of a detector, of walks that each were seen a number of times."""

    walks: Sequence[Sequence[SeenTarget]]

    @cached_property
    def pictures(self) -> Sequence[SeenTarget]:
        return [picture for walk in self.walks for picture in walk]

    @property
    def recall(self) -> tuple[float, float]:
        """The share of pictures in which the target was found, and half of its 95 % interval."""
        return _share([[picture.found for picture in walk] for walk in self.walks])

    @property
    def false_positives(self) -> tuple[float, float]:
        """The share of pictures with an invention, likewise."""
        return _share([[picture.inventions > 0 for picture in walk] for walk in self.walks])

    @property
    def spells(self) -> Array:
        """Lengths in frames of the cameras of the spells that pictures fell into: the longer, the
        more fell into it.
        """
        return (
            np.array([picture.spell for picture in self.pictures if picture.spell])
            * CAMERAS_HZ
            / RATE_HZ
        )

    @property
    def mean_spell(self) -> float:
        """The mean length of a spell, each counted once."""
        return max(1.0, 1.0 / float(np.mean(1.0 / self.spells))) if len(self.spells) else 1.0

    @property
    def mean_left(self) -> float:
        """The mean number of frames, of the cameras, for which one that is missed now is missed."""
        left = [picture.left for picture in self.pictures if picture.left]
        return max(1.0, float(np.mean(left)) * CAMERAS_HZ / RATE_HZ) if left else 1.0

    @property
    def edges_px(self) -> Array:
        """(n, 5): left, top, right and bottom edge of the boxes in full view, and the height of the
        outline.
        """
        alone = [picture for picture in self.pictures if picture.edges_px is not None]
        return np.array([(*(each.edges_px or ()), each.height_px) for each in alone]).reshape(-1, 5)

    @property
    def joined(self) -> tuple[int, int]:
        """The number of those that touched another one, and how many of them were one box with
        it.
        """
        touching = [picture for picture in self.pictures if picture.touches]
        return len(touching), sum(picture.joined for picture in touching)


def _share(walks: Sequence[Sequence[bool]]) -> tuple[float, float]:
    """The share of pictures that are so, and half of its 95 % interval: whole walks are what is
    independent.
    """
    hits, counts = (
        np.array([sum(walk) for walk in walks], float),
        np.array([len(walk) for walk in walks], float),
    )
    share = float(hits.sum() / counts.sum())
    spread = float(np.sum((hits - share * counts) ** 2)) * len(walks) / max(1, len(walks) - 1)
    return share, NORMAL_95 * math.sqrt(spread) / float(counts.sum())


@dataclass(frozen=True, slots=True)
class EdgeNoise:
    """Noise of the edges of boxes.

    Attributes:
        bias_px: median; ``sigma_px``: half of the middle 68 %; both of boxes that leave out no top.
        cut_rate, deep_cut_rate: share of boxes that leave out the top, by ``FAR_OFF_PX`` and by
            twice that.
        far_rate: share of the others with an edge that is far off, by ``far_px`` (root mean
            square).
    """

    bias_px: Array
    sigma_px: Array
    cut_rate: float
    deep_cut_rate: float
    far_rate: float
    far_px: float


def edge_noise(edges_px: Array) -> EdgeNoise:
    """The noise of the edges (n, 4) of boxes."""
    left_out = edges_px[:, 1] - np.median(edges_px[:, 1])
    whole = edges_px[left_out <= FAR_OFF_PX]
    low, bias, high = np.percentile(whole, [16.0, 50.0, 84.0], axis=0)
    off = np.abs(whole - bias)
    far = off > FAR_OFF_PX
    rms = float(np.sqrt(np.mean(off[far] ** 2))) if far.any() else 0.0
    cut, deep = (float(np.mean(left_out > least_px)) for least_px in (FAR_OFF_PX, 2.0 * FAR_OFF_PX))
    return EdgeNoise(bias, 0.5 * (high - low), cut, deep, float(far.any(axis=1).mean()), rms)


def measured(
    kind: TargetKind,
    scene: SceneName,
    seeds: Sequence[int],
    model: Path | None,
    pictures: int = PICTURES,
    *,
    follow: bool = True,
) -> DetectorFigures:
    """Both cameras' pictures of some walks. ``follow``: also how long a spell lasts."""
    detector, walks = detector_of(kind, model), list[list[SeenTarget]]()
    for seed in seeds:
        walk, seen = Walk(kind, seed), list[SeenTarget]()
        for role in Role:
            watcher = Watcher(detector, role, seed, scene)
            for number in range(pictures):
                picture = watcher.sees(walk.at(number))
                if (
                    picture is not None
                    and not picture.found
                    and follow
                    and number % FOLLOWED_EACH == 0
                ):
                    left = 1 + watcher.spell(walk, number, 1)
                    picture = replace(
                        picture, left=left, spell=left + watcher.spell(walk, number, -1)
                    )
                if picture is not None:
                    seen.append(picture)
        walks.append(seen)
    return DetectorFigures(walks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, help="yolox_nano.onnx, for people")
    parser.add_argument("--kind", choices=get_args(TargetKind))
    parser.add_argument("--scene", choices=SCENES, help="also one that is not in the table")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--walks", type=int, default=50)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.walks)
    kinds: tuple[TargetKind, ...] = (options.kind,) if options.kind else get_args(TargetKind)
    for kind, scene in product(kinds, (options.scene,) if options.scene else SCENES):
        if (not options.scene and (kind, scene) not in MEASURED) or (
            kind == "person" and options.model is None
        ):
            continue
        print(
            f"{kind:7}{scene:12} {described(measured(kind, scene, seeds, options.model))}",
            flush=True,
        )


def described(figures: DetectorFigures) -> str:
    """A line of the table, spells by their lengths, and the boxes by size, in thirds."""
    (recall, recall_95), (invented, invented_95), spells = (
        figures.recall,
        figures.false_positives,
        figures.spells,
    )
    lines = [f"found {recall:.3f} +- {recall_95:.3f} of {len(figures.pictures)}"]
    lines[0] += f", invented in {invented:.4f} +- {invented_95:.4f}"
    if len(spells):
        p50, p90, p99 = np.percentile(spells, [50.0, 90.0, 99.0])
        lines.append(
            f"a spell lasts {figures.mean_spell:.1f} frames, from a picture on {figures.mean_left:.1f}"
        )
        lines.append(
            f"{len(spells)} pictures fell into spells of median {p50:.0f}, 90 % {p90:.0f}, 99 % {p99:.0f}"
        )
    lines.append("{} touched another one, {} of them in one box with it".format(*figures.joined))
    edges = figures.edges_px
    if len(edges):
        low, high = np.percentile(edges[:, 4], [100.0 / 3.0, 200.0 / 3.0])
        for least, most in ((0.0, math.inf), (0.0, low), (low, high), (high, math.inf)):
            own = edges[(edges[:, 4] >= least) & (edges[:, 4] < most)]
            noise, heights = edge_noise(own[:, :4]), own[:, 4]
            lines.append(
                f"outlines {heights.min():.0f} to {heights.max():.0f} px high, {len(own)}: edges "
            )
            lines[-1] += f"{noise.bias_px.round(1)} +- {noise.sigma_px.round(1)} px"
            lines[-1] += (
                f", top left out in {noise.cut_rate:.3f}, by twice that in {noise.deep_cut_rate:.3f}"
            )
            lines[-1] += f", far off in {noise.far_rate:.3f} of the others by {noise.far_px:.1f} px"
    return "\n    ".join(lines)


if __name__ == "__main__":
    main()

"""The true owner of each pixel in an image, by the exact depth of what it sees, people in front
included.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from flight.harness.renderer import FrameRenderer, Thing
from missions.trials.rivals.stage import (
    CAMERAS,
    PERSON_HEIGHT_M,
    SHIRT_ACROSS_M,
    SHIRT_HEIGHTS_M,
    DrawnStage,
)
from path.messages import Role
from path.observations import Box
from path.values import frozen

BODY_M = 0.45  # a surface this near to a person's axis, and nearest to it, is that person
GROUND_M = 0.04
BOX_COLUMNS = 5
BOX_ROWS = 5
# forward and to the side, arms included; heights
SHIRT_HALF_M = (0.17, 0.33)
SHIRT_ENDS_M = (0.91, 1.45)


@frozen
class TrueView:
    """Asks the renderer what one camera really sees."""

    renderer: FrameRenderer
    scene: DrawnStage
    role: Role

    def who(self, u: float, v: float) -> tuple[int | None, float]:
        """Index of the person seen at a pixel (None: no person), and the depth there (inf: nothing
        in reach).
        """
        depth = self.renderer.true_depth_m(self.scene.stage, self.role, u, v)
        if depth is None:
            return None, math.inf
        x, y = CAMERAS[self.role].ray(u, v)
        east, north, up = (
            self.scene.T_w_c(self.role).apply(np.array([x * depth, y * depth, depth])).tolist()
        )
        if not GROUND_M < up < PERSON_HEIGHT_M + 0.1:
            return None, depth
        away = [
            math.dist(thing.position_w_m[:2], (east, north)) for thing in self.scene.stage.things
        ]
        nearest = int(np.argmin(away))
        return (nearest if away[nearest] < BODY_M else None), depth

    def in_box(self, box: Box) -> Counter[int | None]:
        """Return how many of the pixels of a grid over a box show which person (None: none)."""
        seen: Counter[int | None] = Counter()
        for v in np.linspace(box.y + 0.06 * box.h, box.y + 0.94 * box.h, BOX_ROWS).tolist():
            for u in np.linspace(box.x + 0.08 * box.w, box.x + 0.92 * box.w, BOX_COLUMNS).tolist():
                if CAMERAS[self.role].contains(u, v):
                    seen[self.who(u, v)[0]] += 1
        return seen

    def owner(self, box: Box) -> int | None:
        """The person that most of the people's pixels in a box are of; None when there is none."""
        seen = self.in_box(box)
        del seen[None]
        return seen.most_common(1)[0][0] if seen else None

    def share(self, box: Box, person: int) -> float:
        """Share of a person, 0..1, among the people's pixels in a box."""
        seen = self.in_box(box)
        del seen[None]
        return seen[person] / max(1, seen.total())

    def shirt(self, person: int) -> tuple[float, float]:
        """Share of a person's shirt, 0..1, that the image shows, and share that other people hide.

        The rest is outside the image, or behind the other drone.
        """
        thing = self.scene.stage.things[person]
        T_c_w = self.scene.T_w_c(self.role).inverse()
        across = self.scene.T_w_c(self.role).R[:, 0]
        shown = behind = asked = 0
        for height in SHIRT_HEIGHTS_M:
            for aside in SHIRT_ACROSS_M:
                x, y, z = T_c_w.apply(
                    np.array(thing.position_w_m) + aside * across + np.array([0, 0, height])
                ).tolist()
                if not CAMERAS[self.role].sees((x, y, z)):
                    asked += 1
                    continue
                who, depth = self.who(*CAMERAS[self.role].project_point((x, y, z)))
                past = depth > z and who != person  # the pixel sees past the shirt
                asked += not past
                shown += who == person
                behind += who is not None and who != person and not past
        return shown / max(1, asked), behind / max(1, asked)


def shirt_box(
    scene: DrawnStage,
    role: Role,
    person: int,
) -> Box:
    """Return about the box of a person's shirt, which is what the detector finds, when nothing
    hides it.
    """
    thing: Thing = scene.stage.things[person]
    T_w_c = scene.T_w_c(role)
    c = math.cos(thing.yaw_rad)
    s = math.sin(thing.yaw_rad)
    forward = SHIRT_HALF_M[0] * np.array([c, s, 0.0])
    left = SHIRT_HALF_M[1] * np.array([-s, c, 0.0])
    points = [
        np.array(thing.position_w_m) + i * forward + j * left + np.array([0.0, 0.0, height])
        for i in (-1.0, 1.0)
        for j in (-1.0, 1.0)
        for height in SHIRT_ENDS_M
    ]
    pixels = CAMERAS[role].project(T_w_c.inverse().apply(np.array(points)))
    (left, top), (right, bottom) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
    return Box(left, top, right - left, bottom - top)

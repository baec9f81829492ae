"""A world so many times as large is followed the same, frame by frame; so is one seen in so many
more pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from flight.config import FollowConfig, MissionConfig
from flight.guidance import Vec3
from flight.tracking.association import Sighting, follow
from flight.tracking.target_track import TargetTrack
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Detection, MarkerDetection, Region

FRAME_NS = 20_000_000
FRAMES = 400
WIDE_M, HIGH_M = 0.32, 0.26  # of a body's box
C = np.sqrt(0.5)
LOOKING_DOWN = np.array([[0.0, -C, C], [1.0, 0.0, 0.0], [0.0, C, C]])


@dataclass(frozen=True)
class World:
    """Everything that is a length is ``scale`` times as long, every image ``pixels`` times as
    fine.
    """

    scale: float = 1.0
    pixels: float = 1.0

    @property
    def camera(self) -> CameraModel:
        p = self.pixels
        return CameraModel(
            round(640 * p), round(480 * p), 615.0 * p, 615.0 * p, 319.5 * p, 239.5 * p
        )

    @property
    def T_n_c(self) -> Pose:
        return Pose(LOOKING_DOWN, self.scale * np.array([0.0, 0.0, -1.6]))

    @property
    def mission(self) -> MissionConfig:
        usual = FollowConfig()
        own = FollowConfig(
            behind_m=self.scale * usual.behind_m,
            height_m=self.scale * usual.height_m,
            target_accel_mps2=self.scale * 0.4,
        )
        return MissionConfig(follow=own)

    def track(self, place: Vec3) -> TargetTrack:
        north, east, down = (self.scale * each for each in place)
        return TargetTrack.of(self.mission, (north, east, down), 0)

    def view(self, k: int) -> Seen:
        """The target drives; another one comes past it so near that both are in one box; a miss now
        and then.
        """
        rng = np.random.default_rng([7, k])
        target = (1.7 + 0.001 * k, 0.0, -0.1)
        other = (1.95 + 0.001 * k, 0.9 - 0.006 * k, -0.1)
        noise = rng.normal(0.0, 1.0, (2, 2))
        if 300 < k < 310 or k % 37 == 0:
            return Seen(self, [other], noise, k, together=False)
        return Seen(self, [target, other], noise, k, together=abs(other[1]) < 0.28)


@dataclass
class Seen:
    world: World
    places: Sequence[Vec3]
    noise: NDArray[np.float64]
    frame_id: int
    together: bool

    @property
    def stamp_ns(self) -> int:
        return self.frame_id * FRAME_NS

    def _boxes(self) -> list[tuple[Box, float]]:
        camera, scale, found = self.world.camera, self.world.scale, list[tuple[Box, float]]()
        for place, off in zip(self.places, self.noise, strict=False):
            x, y, z = self.world.T_n_c.inverse().apply(scale * np.array(place)).tolist()
            u, v = camera.project_point((x, y, z))
            w, h = camera.fx * scale * WIDE_M / z, camera.fy * scale * HIGH_M / z
            du, dv = 1.2 * self.world.pixels * off
            found.append((Box(u + du - 0.5 * w, v + dv - 0.5 * h, w, h), z))
        if self.together and len(found) == 2:
            (a, z), (b, _) = found
            x0, y0 = min(a.x, b.x), min(a.y, b.y)
            x1, y1 = max(a.x + a.w, b.x + b.w), max(a.y + a.h, b.y + b.h)
            return [(Box(x0, y0, x1 - x0, y1 - y0), z)]
        return found

    def targets(self, region: Region | None) -> Sequence[Detection]:
        found = [Detection(box, 0.9) for box, _ in self._boxes()]
        return [each for each in found if region is None or region.contains(*each.box.center)]

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        return []

    def depth(self, box: Box) -> Depth | None:
        boxes = self._boxes()
        _, z = min(boxes, key=lambda each: np.hypot(*np.subtract(each[0].center, box.center)))
        return Depth(z, 0.01 * self.world.scale)

    def image(self) -> None:
        return None


def decisions(world: World) -> tuple[list[str], NDArray[np.float64]]:
    """What becomes of every frame, and where the track is, as a share of the world's size."""
    track = world.track((1.7, 0.0, -0.1))
    made: list[str] = []
    places: list[Vec3] = []
    for k in range(1, FRAMES):
        seen = follow(world.view(k), world.T_n_c, world.camera, track)
        made.append("sighting" if isinstance(seen, Sighting) else seen.value)
        places.append(track.position_n_m)
    return made, np.array(places) / world.scale


@pytest.fixture(scope="module")
def usual() -> tuple[list[str], NDArray[np.float64]]:
    made, places = decisions(World())
    assert {"sighting", "ambiguous_target"} <= set(made)
    return made, places


@pytest.mark.parametrize("scale", [0.2, 5.0, 20.0])
def test_a_world_so_many_times_as_large_is_followed_the_same(
    scale: float, usual: tuple[list[str], NDArray[np.float64]]
) -> None:
    made, places = decisions(World(scale=scale))
    assert made == usual[0]
    np.testing.assert_allclose(places, usual[1], atol=1e-6)


@pytest.mark.parametrize("pixels", [2.0, 4.0])
def test_a_camera_with_so_many_times_the_pixels_sees_no_worse(
    pixels: float, usual: tuple[list[str], NDArray[np.float64]]
) -> None:
    """Noise of boxes is stated in pixels: it is a smaller angle there, so that more can be told
    apart, not less.
    """
    made, _ = decisions(World(pixels=pixels))
    gained = [one for one, other in zip(made, usual[0], strict=True) if one != other]
    assert len(gained) <= 0.05 * FRAMES
    assert made.count("sighting") >= usual[0].count("sighting") - 0.02 * FRAMES

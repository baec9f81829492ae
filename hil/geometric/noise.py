"""The noise of level ``sim``: how what the real perception gives differs from the geometry, in
numbers.

They were measured on rendered frames (640x480, fx 615, the measured camera, ``ColorDetector`` and
the photometric marker finder as they are by default) by tests/hil/geometric/noise_measurement.py,
and a test holds them to that. The rare things (an edge that is off, an odd shape, a marker missed,
two cars taken for one) last for some frames: on rendered frames they go with the geometry, and come
back in half to none of the frames when bodies move by 2 mm to 1 cm. All else is new in every frame.
There are no false positives, as none was found on 1600 frames of ground.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hil.geometric.markers import MarkerNoise
from hil.geometric.targets import TargetNoise
from hil.world.config import SceneName
from path.values import frozen

TARGET_NOISE = TargetNoise(
    bias_left_px=0.10,
    bias_top_px=-0.08,
    bias_right_px=-0.16,
    bias_bottom_px=-0.41,
    edge_sigma_px=0.35,
    outlier_rate=0.024,
    outlier_sigma_px=4.9,
    cut_rate=0.0,
    cut_px=0.0,
    miss_rate=0.0,
    score=0.893,
    score_sigma=0.021,
    odd_rate=0.0005,
    odd_score=0.3,
    merge_contact=0.55,
    merge_slope=12.0,
    touching_odd_rate=0.05,
    hidden_share=0.15,
    occluded_sigma_px=3.0,
    occluded_odd_rate=0.25,
    border_score=0.2,
    min_side_px=10.0,
    max_side_px=300.0,
)

DRONE_NOISE = TARGET_NOISE._replace(
    bias_left_px=-3.8,
    bias_top_px=-1.6,
    bias_right_px=2.3,
    bias_bottom_px=0.09,
    edge_sigma_px=2.2,
    outlier_rate=0.018,
    outlier_sigma_px=17.3,
    score=0.894,
    score_sigma=0.045,
    odd_rate=0.032,
)
"""Of the hull of a micro-UAV. A motor or an arm in its box makes the edge wander, and now and then
puts it far off.
"""

PERSON_NOISE = TARGET_NOISE._replace(
    bias_left_px=-2.2,
    bias_top_px=-2.3,
    bias_right_px=2.6,
    bias_bottom_px=-0.7,
    edge_sigma_px=2.4,
    outlier_rate=0.07,
    outlier_sigma_px=20.0,
    cut_rate=0.12,
    cut_px=24.0,
    merge_contact=-0.3,
    max_side_px=1000.0,
)
"""Of a person, 190 to 290 px high from where the drones look, as YOLOX-nano finds one; it takes two
that touch for one, and now and then a person for one without a head.

By tests/hil/geometric/detector_films.py."""

MARKER_NOISE = MarkerNoise(
    half_side_px=10.2,
    side_slope_per_px=2.1,
    lapse_rate=0.0014,
    corner_sigma_px2=0.80,
    corner_floor_px=0.0,
    corner_spread=0.15,
    claimed_factor=0.95,
    coarse_rate=0.001,
    coarse_sigma_px=0.5,
    max_incidence_cos=0.17,
)


HEADLESS: Mapping[SceneName, float] = {"plain": 0.12, "overcast": 0.115, "hall": 0.26}
"""Share of the boxes of people that leave out a head, by scene."""


@frozen
class ObservationNoise:
    """All of it.

    Attributes:
        drones, people: as ``targets``, for objects of that kind.
        targets: Boxes against true visible outlines. ``bias_*``, ``edge_sigma_px``: of an edge; one
            edge of a share ``outlier_rate`` of the boxes is off by ``outlier_sigma_px`` instead. A
            share ``cut_rate`` of them leaves out the top, by ``cut_px`` (scale of a half-normal).
            ``score``, ``score_sigma``: of a whole vehicle; a share ``odd_rate`` of the boxes has
                its score multiplied by ``odd_score`` for no reason. Two cars that touch in
            the image are taken for one with a probability that is 1/2 at ``merge_contact`` (common
            border over box width), and for one odd one at ``touching_odd_rate``. A car of which no
            more than ``hidden_share`` is visible is not found; one that is partly hidden has edges
            off by ``occluded_sigma_px`` and is odd at ``occluded_odd_rate``. ``border_score``:
            factor when the image cuts it.
        marker: A marker is found with a probability that is 1/2 where its shortest side has
            ``half_side_px`` px, and whose logit grows by ``side_slope_per_px``; a share
            ``lapse_rate`` is missed at any size. Its corners are off by ``corner_sigma_px2`` / side
            and ``corner_floor_px`` (root of the sum of squares), independently, in one frame more
            than in another (log-normal, standard deviation ``corner_spread`` of the logarithm),
            and claim ``claimed_factor`` times that; at ``coarse_rate`` the photometric fit fails
            and they are off by ``coarse_sigma_px``.
        depth_sigma_at_1m_m: noise of one pixel of the depth camera at 1 m; it grows with the square
            of the depth.
        depth_common_sigma_at_1m_m: the part that is left of it over a box, as neighbours err
            together.
    """

    targets: TargetNoise = TARGET_NOISE
    drones: TargetNoise = DRONE_NOISE
    people: TargetNoise = PERSON_NOISE
    marker: MarkerNoise = MARKER_NOISE
    depth_sigma_at_1m_m: float = 0.005
    depth_common_sigma_at_1m_m: float = 0.0012

    def with_depth(self, sigma_at_1m_m: float) -> ObservationNoise:
        """Return this noise with another depth camera's: as the rig states it, neighbours err
        together as much.
        """
        common = sigma_at_1m_m * self.depth_common_sigma_at_1m_m / self.depth_sigma_at_1m_m
        return replace(self, depth_sigma_at_1m_m=sigma_at_1m_m, depth_common_sigma_at_1m_m=common)


def noise_in(scene: SceneName) -> ObservationNoise:
    """The noise in a scene: that of the plain one, but for what was measured to differ."""
    return ObservationNoise(
        people=PERSON_NOISE._replace(cut_rate=HEADLESS.get(scene, PERSON_NOISE.cut_rate))
    )


_EXACT_BOXES = TARGET_NOISE._replace(
    bias_left_px=0.0,
    bias_top_px=0.0,
    bias_right_px=0.0,
    bias_bottom_px=0.0,
    edge_sigma_px=0.0,
    outlier_rate=0.0,
    cut_rate=0.0,
    odd_rate=0.0,
    merge_contact=1e9,
    touching_odd_rate=0.0,
    occluded_sigma_px=0.0,
    occluded_odd_rate=0.0,
)
EXACT = ObservationNoise(
    _EXACT_BOXES,
    _EXACT_BOXES,
    _EXACT_BOXES._replace(max_side_px=PERSON_NOISE.max_side_px),
    MARKER_NOISE._replace(
        half_side_px=-1e9,
        lapse_rate=0.0,
        corner_sigma_px2=0.0,
        corner_floor_px=0.0,
        corner_spread=0.0,
        coarse_rate=0.0,
    ),
    0.0,
    0.0,
)
"""Geometry as it is: for tests, and what the noise is measured against."""

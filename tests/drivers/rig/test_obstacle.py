"""What stands in the way, as a crew measures it."""

from __future__ import annotations

import math

import pytest

from drivers.rig.facts import SiteFacts
from drivers.rig.obstacle import Obstacle
from drivers.rig.tables import RigError, decode_table

BOX = Obstacle((10.0, 0.0), (4.0, 2.0), 1.5, heading_deg=90.0)
ROUND = Obstacle((0.0, 0.0), (2.0, 2.0), 5.0, 3.0, round=True)


@pytest.mark.parametrize(
    ("obstacle", "place", "away_m"),
    [
        (BOX, (10.0, 1.9, -1.0), 0.0),  # its length lies east
        (BOX, (11.5, 0.0, -1.0), 0.5),
        (BOX, (10.0, 3.0, -1.0), 1.0),
        (BOX, (12.0, 3.0, -1.0), math.sqrt(2.0)),
        (BOX, (10.0, 0.0, -3.5), 2.0),
        (ROUND, (0.0, 3.0, -4.0), 2.0),
        (ROUND, (0.5, 0.0, -1.0), 2.0),  # below it
        (ROUND, (4.0, 0.0, -9.0), 5.0),
    ],
)
def test_a_distance_is_that_to_its_nearest_point(
    obstacle: Obstacle, place: tuple[float, float, float], away_m: float
) -> None:
    assert obstacle.distance_m(place) == pytest.approx(away_m)


def test_a_rigs_site_says_what_stands_in_it() -> None:
    table = {"obstacles": [{"place_m": [6.0, -1.5], "size_m": [4.2, 1.8], "top_m": 1.5}]}
    (stands,) = decode_table(table, SiteFacts, "rig.toml: site").obstacles
    assert stands == Obstacle((6.0, -1.5), (4.2, 1.8), 1.5)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"floor_m": 2.0}, "floor_m: 2.0 is not below top_m = 1.5"),
        ({"round": True}, "of a round one both are its diameter"),
        ({"radius_m": 1.0}, "unknown key 'radius_m'"),
    ],
)
def test_one_that_cannot_be_is_refused_by_name(wrong: dict[str, object], told: str) -> None:
    table = {"obstacles": [{"place_m": [6, 0], "size_m": [4.2, 1.8], "top_m": 1.5, **wrong}]}
    with pytest.raises(RigError) as refused:
        decode_table(table, SiteFacts, "rig.toml: site")
    assert told in str(refused.value)

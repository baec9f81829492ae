"""What is compiled before a flight: of images nothing for a drone that sees none."""

from __future__ import annotations

from typing import cast

import pytest

from flight.harness.flights import InProcess
from missions.fly.leg import opening
from missions.ground import rig_library

WORLD = cast(InProcess, object())


@pytest.mark.parametrize(
    ("rig", "harness", "images"),
    [
        ("sim", WORLD, False),
        ("team-sim", WORLD, False),
        ("sim-rendered", WORLD, True),
        ("sitl", None, True),
    ],
)
def test_images_are_prepared_for_where_there_is_a_camera(
    monkeypatch: pytest.MonkeyPatch, rig: str, harness: InProcess | None, images: bool
) -> None:
    asked: list[bool] = []

    def warm_up(images: bool) -> None:
        asked.append(images)

    monkeypatch.setattr(opening, "warm_up", warm_up)
    opening.warm_up_for(rig_library.load(rig).receiver, harness)
    assert asked == [images]

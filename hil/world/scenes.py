"""Scenes by name: the light and the ground that cameras of simulated drones see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from drivers.rig.parts import Rig

SceneName = Literal["plain", "outdoor-sun", "overcast", "low-sun", "dusk", "hall"]
SCENES: tuple[SceneName, ...] = get_args(SceneName)


@dataclass(frozen=True, slots=True)
class SceneConfig:
    """The ``[world.scene]`` table of a rig, for levels that draw frames.

    Attributes:
        name: of the scene (docs/scenes.md); "plain" is soil in a soft light without shadows.
    """

    name: SceneName = "plain"


def scene_of(rig: Rig) -> SceneName:
    """The scene that the cameras of a rig's world see."""
    return rig.world.get("scene", {}).get("name", SceneConfig().name)

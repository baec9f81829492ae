"""A method of somebody's own among the rivals: asked on the same frames, judged by the same truth.

    path-handoff trial rivals --method mine.py:Mine

It is made without arguments, and its ``choose(pair)`` says which box of D2's image shows the target
that D1 has in ``pair.box1``; None: none of them does. It is given what PATH is given, with the same
errors, and nothing of the truth.
"""

from __future__ import annotations

from typing import Any, Protocol

from drivers.interfaces import PartError
from drivers.rig.parts import import_factory
from path.arrays import Depths, Image
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.messages import Vec3
from path.observations import Box
from path.values import frozen

OPTION = "--method"


@frozen
class View:
    """One drone's frame and what it believes of its camera.

    Attributes:
        color: (h, w, 3) uint8 BGR.
        depth_mm: (h, w) uint16, registered to ``color``, 0 where there is none.
        camera: its calibration.
        gravity: unit vector down, for D1 in the marker's frame, for D2 in its camera's.
    """

    color: Image
    depth_mm: Depths
    camera: CameraModel
    gravity: Vec3


@frozen
class Pair:
    """Two frames of one instant.

    Attributes:
        sender, receiver: D1's view and D2's.
        box1: the target in D1's image, px.
        boxes2: what D2's detector finds, px, in no order.
        layout: the marker on D1. ``T_v_c1``: D1's camera to the marker's frame, in metres.
    """

    sender: View
    receiver: View
    box1: Box
    boxes2: tuple[Box, ...]
    layout: MarkerLayout
    T_v_c1: Pose


class Method(Protocol):
    """A method that takes part."""

    def choose(self, pair: Pair) -> Box | None: ...


def method_of(named: str) -> Method:
    """Return the method named ``file.py:Name`` or ``module:Name``. Raises PartError for what is
    none.
    """
    made: Any = import_factory(named, OPTION)()
    if not callable(getattr(made, "choose", None)):
        raise PartError(
            f"{OPTION} {named}: it has no choose(pair)",
            "give it `def choose(self, pair: Pair) -> Box | None` (docs/own-parts.md)",
        )
    return made


def chosen_by(named: str, pair: Pair) -> Box | None:
    """Return what a method chooses. Raises PartError for anything but a box."""
    method: Any = method_of(named)
    box = method.choose(pair)
    if box is None or isinstance(box, Box):
        return box
    raise PartError(
        f"{OPTION} {named}: choose(pair) returned {box!r:.80}",
        "return a Box of D2's image, or None",
    )

"""The part of a rig about a team: drones by name, targets by name, and the rules by which they share the air."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from flight.harness.relay import NamedTarget, RelayConfig
from path.bounds import Bounds


@dataclass(frozen=True, slots=True)
class TeamConfig(RelayConfig):
    """The ``[team]`` table of a rig with its ``[[drones]]`` and ``[[targets]]``; the rest is as in ``[relay]``.

    Attributes:
        targets: in the order in which they are counted.
        out_height_m: of the way from a home to a target; the way back is at ``return_height_m``.
        transit_mps: on either way.
        entry_m: behind the place from which a target is followed, where a drone that comes to it goes down.
        clear_route_m: between two ways that are flown at once, seen from above.
        area_m: around a target, within which its drones go up and down.
        point_s: from when a target is lost until a person points at it again.
        spacing_m: between the targets of a field that is laid out for more than the rig names.
    """

    targets: tuple[NamedTarget, ...] = ()
    out_height_m: Annotated[float, Bounds(0.3, 100.0)] = 4.5
    transit_mps: Annotated[float, Bounds(0.1, 15.0)] = 2.0
    entry_m: Annotated[float, Bounds(0.0, 50.0)] = 4.0
    clear_route_m: Annotated[float, Bounds(0.5, 100.0)] = 3.0
    area_m: Annotated[float, Bounds(1.0, 100.0)] = 6.0
    point_s: Annotated[float, Bounds(0.0, 3600.0)] = 5.0
    spacing_m: Annotated[float, Bounds(5.0, 1000.0)] = 30.0

    def __post_init__(self) -> None:
        RelayConfig.__post_init__(self)  # with slots there is no super() here
        names = [target.name for target in self.targets]
        if not names or len(set(names)) < len(names):
            raise ValueError("targets: at least one, each with a name of its own")

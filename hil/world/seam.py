"""The harness as the parts of one drone know it (``PartContext.harness`` at the sim levels): a world
in this process, and what is wrong with the drone at this moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol, cast

from drivers.interfaces import PartError
from hil.world.errors import Built
from hil.world.snapshot import Snapshot
from path.messages import Role

if TYPE_CHECKING:
    from hil.world.world import SimDrone  # whose configuration names a part that asks for this


class Freeze(Enum):
    """The failure of a camera: it gives nothing more, or its last frame again and again."""

    SILENT = "silent"
    REPEAT = "repeat"


class PartWorld(Protocol):
    """The world as the parts of one drone know it: their own vehicle, and what a pair of cameras
    can see.
    """

    @property
    def time_s(self) -> float: ...

    def drone(self, role: Role, /) -> SimDrone: ...

    def snapshot(self) -> Snapshot: ...


class PartHarness(Protocol):
    """The harness of one drone's parts; it changes what is wrong while the run goes on.

    ``world`` is at the loop's present whenever it is read. ``hub``: the link's
    (``hil.link.faulty.MemoryHub``). ``built``: how cameras, mounts and markers truly are; None when
    they are as the rig says. ``frozen_cameras``: those that fail; ``silent_vehicles``: those whose
    link to the flight controller is lost for their program; ``lost_vehicles``: for everybody.
    """

    @property
    def seed(self) -> int: ...

    @property
    def world(self) -> PartWorld: ...

    @property
    def hub(self) -> Any: ...

    @property
    def built(self) -> Built | None: ...

    @property
    def frozen_cameras(self) -> Mapping[Role, Freeze]: ...

    @property
    def silent_vehicles(self) -> set[Role]: ...

    @property
    def lost_vehicles(self) -> set[Role]: ...


def harness_of(
    harness: object | None,
    what: str,
    error: type[PartError],
) -> PartHarness:
    """Return the harness behind a part's context. Raises ``error`` where there is none."""
    if harness is None:
        raise error(
            f"{what} needs the simulated world in the same process",
            "use it in a rig of level sim or sim-rendered, with a harness such as hil.harness.sim",
        )
    return cast(PartHarness, harness)

"""The tables of a rig about many drones: ``[relay]``, or ``[team]`` with its ``[[drones]]`` and
``[[targets]]``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from drivers.rig.calibration_file import CameraTable
from drivers.rig.parts import Mount, PartSpec, Rig, RoleRig
from drivers.rig.tables import decode_table
from path.bounds import Bounds
from path.values import frozen

Point = tuple[float, float]


@frozen
class NamedDrone:
    """One drone of a relay or a team. What is not said here is as in the rig's ``[sender]``.

    Attributes:
        home_m: (E, N) in m, where it stands and comes back to.
        link: in either role; where it is not said, it is that of the role.
        battery: its charge at the beginning, 0..1.
    """

    name: str
    home_m: Annotated[Point, Bounds(-1000, 1000)]
    clock: PartSpec | None = None
    perception: PartSpec | None = None
    vehicle: PartSpec | None = None
    guard: PartSpec | None = None
    link: PartSpec | None = None
    camera: CameraTable | None = None
    heading_deg: Annotated[float, Bounds(-360.0, 360.0)] = 0.0
    battery: Annotated[float, Bounds(0.05, 1.0, "of 1")] = 1.0


@frozen
class RelayConfig:
    """The ``[relay]`` table of a rig.

    Attributes:
        harness: ``module:Class`` of a world with many drones.
        drones: in the order in which they are called for the first time.
        hours: for how long, when nothing else is asked for.
        reserve: of the charge; no drone may be below it before it has landed.
        endurance_s: how long a full battery carries a drone, as far as is known before it is seen
            to run down.
        swap_s: from landing until the drone stands ready with a full battery.
        keep_battery, check_s: a drone whose leg ended early by no fault of its own, and that lands
            with as much of its charge, keeps its battery: so long after landing it stands ready
            again.
        home_s: what a drone is granted for its way home and the landing.
        attempts: how many reliefs may fail, one after the other, before the target has to be given
            up.
        least_s: no relief takes off for less time than this: it could not take over before the
            other has to go home.
        return_height_m: of the way home, above everything that goes on below.
        follow_s: how long the drone that took over stays a receiver, for the other to hear that it
            did.
        clear_m, clear_s: how far, and how long after it was last heard, a relief that failed is
            kept away from.
    """

    harness: str
    drones: tuple[NamedDrone, ...]
    hours: Annotated[float, Bounds(0.0, 1000.0, above=True)] = 8.0
    reserve: Annotated[float, Bounds(0.05, 0.95, "of 1")] = 0.25
    endurance_s: Annotated[float, Bounds(10.0, 36000.0)] = 1080.0
    swap_s: Annotated[float, Bounds(0.0, 36000.0, above=True)] = 300.0
    keep_battery: Annotated[float, Bounds(0.05, 1.0, "of 1")] = 0.85
    check_s: Annotated[float, Bounds(0.0, 36000.0)] = 60.0
    home_s: Annotated[float, Bounds(1.0, 3600.0)] = 60.0
    attempts: Annotated[int, Bounds(1, 100, "times")] = 2
    least_s: Annotated[float, Bounds(0.0, 3600.0)] = 45.0
    return_height_m: Annotated[float, Bounds(0.3, 100.0)] = 4.0
    follow_s: Annotated[float, Bounds(0.0, 600.0)] = 6.0
    clear_m: Annotated[float, Bounds(0.0, 100.0)] = 1.5
    clear_s: Annotated[float, Bounds(0.0, 600.0)] = 20.0

    def __post_init__(self) -> None:
        names = [drone.name for drone in self.drones]
        if len(names) < 2 or len(set(names)) < len(names):
            raise ValueError("drones: at least two, each with a name of its own")
        if not 0.0 < self.reserve < 1.0:
            raise ValueError("reserve must be between 0 and 1")
        if min(self.endurance_s, self.swap_s, self.home_s) <= 0.0 or self.attempts < 1:
            raise ValueError("endurance_s, swap_s and home_s must be above 0, attempts at least 1")


@frozen
class NamedTarget:
    """One object that a team keeps observed.

    Attributes:
        place_m: (E, N) in m, where it is pointed at, and where it waits until somebody has come.
        named_at_s: when the team is told of it.
        drones: the names of those that may take it; all when there are none.
    """

    name: str
    place_m: Annotated[Point, Bounds(-1000, 1000)]
    named_at_s: Annotated[float, Bounds(0.0, 360000.0)] = 0.0
    drones: tuple[str, ...] = ()


@frozen
class TeamConfig(RelayConfig):
    """The ``[team]`` table of a rig with its ``[[drones]]`` and ``[[targets]]``; the rest is as in
    ``[relay]``.

    Attributes:
        targets: in the order in which they are counted.
        out_height_m: of the way from a home to a target; the way back is at ``return_height_m``.
        transit_mps: on either way.
        entry_m: behind the place from which a target is followed, where a drone that comes to it
            goes down.
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


def relay_of_rig(rig: Rig) -> RelayConfig:
    """Raise RigError."""
    return decode_table(rig.relay, RelayConfig, rig.where("[relay]"), rig.file.parent)


def team_of_rig(rig: Rig) -> TeamConfig:
    """Raise RigError."""
    tables = {**rig.team, "drones": list(rig.drones), "targets": list(rig.targets)}
    return decode_table(tables, TeamConfig, rig.where("team"), rig.file.parent)


def pair_of(
    rig: Rig,
    sender: NamedDrone,
    receiver: NamedDrone,
) -> Rig:
    """The rig of one leg: these two drones in these two roles."""
    return replace(
        rig,
        sender=_role(rig, sender, "sender"),
        receiver=_role(rig, receiver, "receiver"),
    )


def _role(
    rig: Rig,
    drone: NamedDrone,
    role: str,
) -> RoleRig:
    built = rig.sender
    camera = built.camera if drone.camera is None else drone.camera.model()
    mount = Mount(built.mount.T_b_c, built.mount.T_b_v)
    return replace(
        built,
        clock=drone.clock or built.clock,
        perception=drone.perception or built.perception,
        vehicle=drone.vehicle or built.vehicle,
        guard=drone.guard or built.guard,
        link=drone.link or (built.link if role == "sender" else rig.receiver.link),
        camera=camera,
        mount=mount,
    )

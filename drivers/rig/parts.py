"""A rig as values: the parts of both drones by name, and how a part is made from its name.

How a rig is written is ``drivers.rig.file``; what is checked before anything moves is
``drivers.rig.check``.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal

from drivers.beacons.log import Mounted
from drivers.interfaces import Clock, PartError
from drivers.rig.facts import (
    DepthFacts,
    DetectorFacts,
    DroneFacts,
    HeightFacts,
    LinkFacts,
    SiteFacts,
    TargetFacts,
)
from drivers.rig.own_file import ended_by, module_of
from drivers.rig.tables import RigError, decode_table, suggestion
from drivers.steady_clock import SteadyClock
from path.bounds import Bounds
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.messages import Role
from path.values import frozen

_FACTORY = re.compile(r"(?:[A-Za-z_][\w.]*|[^:]+\.py):[A-Za-z_]\w*")
GONE = {  # parts that rigs may still name: what to do instead
    "drivers.detectors.tracked:TrackedDetector": (
        "it cost more than the detector in it; put the table 'detector' in its place"
    ),
}
_SUCH_AS = (
    'such as "drivers.mavlink.vehicle:MavsdkVehicle", or "own.py:Name" of a file beside the rig'
)

Level = Literal["sim", "sim-rendered", "sitl", "hitl", "field"]


SHARED_WITH_THE_VEHICLE = ("height_from", "battery_id")
"""Options of a guard that are those of the vehicle that it watches: its table gives them where the
guard's does not.
"""


@frozen
class NoOptions:
    """The Config of a part that has no options."""


@frozen
class PartSpec:
    """A part by name: ``factory`` is ``module:Class`` or ``file.py:Class``; ``options`` are
    ``Class.Config``.

    May be a field of another part's Config (``[sender.perception.camera]``), which then opens it
    itself.
    """

    factory: str
    options: Mapping[str, Any]
    where: str
    base: Path | None = None  # relative paths in the options start here

    @classmethod
    def from_table(cls, table: Any, where: str, base: Path | None) -> PartSpec:
        """Used by ``decode_table``. Raises RigError when ``factory`` is missing or no
        ``module:Class``.
        """
        if not isinstance(table, Mapping):
            raise RigError([f"{where}: expected a table with a factory"])
        factory = table.get("factory")
        if factory is None:
            raise RigError([f"{where}: missing key 'factory', {_SUCH_AS}"])
        if not isinstance(factory, str) or not _FACTORY.fullmatch(factory):
            raise RigError([f"{where}.factory: {factory!r} is not module:Class, {_SUCH_AS}"])
        file, _, name = factory.rpartition(":")
        if file.endswith(".py") and base is not None:
            factory = f"{base / file}:{name}"
        return cls(
            factory, {key: value for key, value in table.items() if key != "factory"}, where, base
        )


@frozen
class Origin:
    """The zero of the mission's local frames (NED ``n`` and ENU ``w``)."""

    latitude_deg: Annotated[float, Bounds(-90.0, 90.0)]
    longitude_deg: Annotated[float, Bounds(-180.0, 180.0)]
    altitude_m: Annotated[float, Bounds(-500.0, 9000.0)]


@frozen
class Mount:
    """The mounts of camera and marker on their drone.

    Attributes:
        T_b_c: camera to body (FRD) of the role's own drone.
        T_b_v: marker frame to body (FRD) of the *sender*, for both roles.
    """

    T_b_c: Pose
    T_b_v: Pose

    @property
    def T_v_c(self) -> Pose:
        """``T_v_c1``, the sender's fixed mounting; without meaning for the receiver."""
        return self.T_b_v.inverse() @ self.T_b_c


@frozen
class PartContext:
    """The facts that a part may know of its role besides its own options.

    ``harness`` is the in-process substitute world at the sim levels (parts of ``hil`` cast it),
    else None. ``camera_serial``: as in ``RoleRig``.
    """

    role: Role
    clock: Clock
    camera: CameraModel
    mount: Mount
    layout: MarkerLayout
    origin: Origin
    harness: object | None = None
    camera_serial: str = ""


@frozen
class Reference:
    """The ultrasonic system that trials in flight measure against: its beacons, and who listens to
    them.

    Attributes:
        sender, receiver: with the lever in the drone's body (FRD).
        target: with the lever in the target's frame, x ahead and z up.
        beacons: a part that is a ``drivers.interfaces.Beacons``; None where a harness makes their
            records up.
        telemetry_late_s: what the vehicles' states, stamped on arrival, are late by as far as it is
            known.
    """

    sender: Mounted
    receiver: Mounted
    target: Mounted
    beacons: PartSpec | None = None
    telemetry_late_s: Annotated[float, Bounds(0.0, 0.5)] = 0.0

    def __post_init__(self) -> None:
        if len({own.address for own in self.mounted.values()}) < 3:
            raise ValueError("two beacons have the same address")

    @property
    def mounted(self) -> dict[str, Mounted]:
        return {"sender": self.sender, "receiver": self.receiver, "target": self.target}


@frozen
class RoleRig:
    """One drone of the rig. ``camera_serial``: of the camera that ``camera`` is the calibration of,
    "" if not known.
    """

    vehicle: PartSpec
    perception: PartSpec
    link: PartSpec
    clock: PartSpec
    camera: CameraModel
    mount: Mount
    camera_serial: str = ""
    guard: PartSpec | None = None  # the guard's own way to the vehicle, in a process of its own
    operator: PartSpec | None = None  # whoever the sender hears of which object is meant

    @property
    def parts(self) -> tuple[PartSpec, ...]:
        every = self.clock, self.vehicle, self.perception, self.link, self.guard, self.operator
        return tuple(part for part in every if part is not None)


@frozen
class Rig:
    """A whole rig.

    ``mission``, ``world``, ``relay``, ``team``, ``drones`` and ``targets`` stay tables: who uses
    them decodes them with ``decode_table``.

    ``trials`` names what trials measure against, ``module:name`` by purpose; ``reference`` is None
    without beacons; ``folders`` are where a rig that this one is like was looked up by name.

    ``target``, ``drone``, ``depth``, ``link``, ``height``, ``site`` and ``detector`` are what was measured
    (``drivers.rig.facts``); None where the rig says what follows from it by itself. ``named`` are
    the values of ``[method]`` and ``[mission]`` that
    the rig names, by dotted key.
    """

    name: str
    description: str
    level: Level
    harness: str | None
    origin: Origin
    method: MethodConfig
    mission: Mapping[str, Any]
    world: Mapping[str, Any]
    trials: Mapping[str, str]
    layout: MarkerLayout
    sender: RoleRig
    receiver: RoleRig
    file: Path
    reference: Reference | None = None
    relay: Mapping[str, Any] = field(default_factory=dict[str, Any])
    team: Mapping[str, Any] = field(default_factory=dict[str, Any])
    drones: tuple[Mapping[str, Any], ...] = ()
    targets: tuple[Mapping[str, Any], ...] = ()
    folders: tuple[Path, ...] = ()
    target: TargetFacts | None = None
    drone: DroneFacts | None = None
    site: SiteFacts | None = None
    depth: DepthFacts | None = None
    link: LinkFacts | None = None
    height: HeightFacts | None = None
    detector: DetectorFacts | None = None
    named: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def role(self, role: Role) -> RoleRig:
        return self.sender if role is Role.SENDER else self.receiver

    def where(self, table: str) -> str:
        """Return the name of a table of this rig, for messages."""
        return f"{self.file.name}: {table}"


def with_errors(rig: Rig, level: str | None) -> Rig:
    """The rig with another level of errors (``[world.errors]``), if one is given.

    Raises RigError for a rig that flies in the real world.
    """
    return _with_world(
        rig, "errors", level and {"level": level}, "world of its own to be drawn with errors"
    )


def with_scene(rig: Rig, name: str | None) -> Rig:
    """The rig with another scene (``[world.scene]``), if one is given.

    Raises RigError for a rig that flies in the real world.
    """
    return _with_world(
        rig, "scene", name and {"name": name}, "world of its own that could look otherwise"
    )


def with_slow(rig: Rig, share: float | None) -> Rig:
    """The rig with another share of a core for each role's program (``world.slow``), if one is
    given.

    Raises RigError for a rig whose programs nobody starts but their crews.
    """
    return _with_world(rig, "slow", share, "harness that could slow its programs down")


def _with_world(rig: Rig, key: str, value: object, needed: str) -> Rig:
    if value is None:
        return rig
    if rig.harness is None:
        raise RigError([f"rig {rig.name} has no {needed}"], f"leave out --{key}")
    return dataclasses.replace(rig, world={**rig.world, key: value})


def import_factory(factory: str, where: str) -> Any:
    """The class named ``module:Class`` or ``file.py:Class``. Raises RigError naming ``where``."""
    if not _FACTORY.fullmatch(factory):
        raise RigError([f"{where}: {factory!r} is not module:Class, {_SUCH_AS}"])
    if factory in GONE:
        raise RigError([f"{where}: {factory} is no longer offered: {GONE[factory]}"])
    module_name, _, class_name = factory.rpartition(":")
    try:
        own = module_name.endswith(".py")
        module = (
            module_of(Path(module_name), "part") if own else importlib.import_module(module_name)
        )
    except PartError as error:
        raise RigError([f"{where}: {error}"], error.remedy) from error
    except ImportError as error:
        raise RigError([f"{where}: cannot import {module_name}: {error}"]) from error
    except SystemExit as error:
        raise RigError([f"{where}: cannot import {module_name}: it {ended_by(error)}"]) from error
    except Exception as error:
        raise RigError(
            [f"{where}: cannot import {module_name}: {type(error).__name__}: {error}"]
        ) from error
    if not hasattr(module, class_name):
        classes = [name for name, value in vars(module).items() if hasattr(value, "Config")]
        hint = suggestion(class_name, classes)
        raise RigError([f"{where}: {module_name} has no {class_name}{hint}"])
    return getattr(module, class_name)


def decode_part(spec: PartSpec) -> tuple[Any, Any]:
    """The part's class and its decoded Config. Raises RigError."""
    kind = import_factory(spec.factory, f"{spec.where}.factory")
    config = getattr(kind, "Config", None)
    if config is None or not dataclasses.is_dataclass(config):
        raise RigError(
            [f"{spec.where}.factory: {spec.factory} is no part: it has no Config dataclass"]
        )
    return kind, decode_table(spec.options, config, spec.where, spec.base)  # type: ignore[arg-type]


def create(spec: PartSpec, context: PartContext) -> Any:
    """Make the part a spec names. Entering it, with ``async with``, is what opens it. Raises
    RigError.
    """
    kind, config = decode_part(spec)
    try:
        inspect.signature(kind).bind(config, context)
    except TypeError as error:
        made = f"{spec.factory} is made as {spec.factory.rpartition(':')[2]}(config, context), and cannot be: {error}"
        raise RigError([f"{spec.where}.factory: {made}"]) from error
    try:
        return kind(config, context)
    except SystemExit as error:
        raise RigError(
            [f"{spec.where}.factory: {spec.factory} cannot be made: it {ended_by(error)}"]
        ) from error


class _NoClock:
    """Stands in while the clock itself is made."""

    def now_ns(self) -> int:
        raise RuntimeError("the clock cannot be used while it is made")


def part_context(rig: Rig, role: Role, harness: object | None = None) -> PartContext:
    """The context of one role's parts, with its clock made, which goes on evenly if it is set.
    Raises RigError.
    """
    own = rig.role(role)
    early = PartContext(
        role,
        _NoClock(),
        own.camera,
        own.mount,
        rig.layout,
        rig.origin,
        harness,
        camera_serial=own.camera_serial,
    )
    return dataclasses.replace(early, clock=SteadyClock(create(own.clock, early)))

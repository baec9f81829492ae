"""A rig on disk: one TOML file that names the parts of both drones.

name = "sitl"
level = "sitl"
harness = "hil.harness.sitl:Sitl"            # left out in the field
[origin]                             # of the mission's local frame
[method]                             # path.config.MethodConfig
[mission]                            # decoded by the missions
[world]                              # decoded by the harness
[trials]                             # what trials measure against: renderer = "hil.camera.pictures:CameraRenderer", ...
[relay]                              # decoded by a relay: its drones, their batteries and homes
[team]                               # decoded by a team, with ...
[[drones]]                           # ... its drones by name: homes, parts, batteries
[[targets]]                          # ... and the targets that it keeps observed
[reference.sender], .receiver, .target   # beacons that trials measure against; [reference.beacons] is who listens
[target], [drone], [depth], [link], [height], [site], [detector]   # what was measured (drivers.rig.facts)
[[markers]]                          # the marker layout on the sender, in frame v
[sender.vehicle]                     # a part: its factory, and the options of its Config
factory = "drivers.mavlink.vehicle:MavsdkVehicle"
[sender.perception], [sender.link], [sender.clock], [sender.camera], [sender.mount.camera],
[sender.mount.marker]
[sender.guard]                       # may be left out: the guard's own link to the vehicle
[sender.operator]                    # may be left out: whoever says which object is meant while D1 is in the air
[receiver. ...]                      # the same, without mount.marker

``like``, ``drop`` and ``[both]`` are of ``drivers.rig.read``. Relative paths start at the folder of
the file that is flown.

A camera may be ``calibration = "d1.camera.toml"`` instead of its numbers, and so may
``[sender.mount.marker]``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from drivers.rig.calibration_file import (
    CalibrationError,
    CameraTable,
    MountCalibration,
    read_camera,
)
from drivers.rig.facts import (
    DepthFacts,
    DetectorFacts,
    DroneFacts,
    HeightFacts,
    LinkFacts,
    SiteFacts,
    TargetFacts,
)
from drivers.rig.mounts import CalibrationName, CameraMount, MarkerPlace, Vec3, axis_turn
from drivers.rig.parts import Level, Mount, Origin, PartSpec, Reference, Rig, RoleRig
from drivers.rig.read import find_rig, read_rig
from drivers.rig.tables import RigError, decode_table
from path.bounds import Bounds
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout
from path.values import frozen


@frozen
class _Camera:
    """Intrinsics, written out or from a file. ``serial``: of the camera they are of, "" when it is
    not known.
    """

    model: CameraModel
    serial: str

    @classmethod
    def from_table(
        cls,
        table: Any,
        where: str,
        base: Path | None,
    ) -> _Camera:
        """Used by ``decode_table``. Raises RigError."""
        try:
            if isinstance(table, Mapping) and "calibration" in table:
                file = read_camera(decode_table(table, CalibrationName, where, base).calibration)
                return cls(file.camera.model(), file.serial)
            return cls(decode_table(table, CameraTable, where, base).model(), "")
        except CalibrationError as error:
            raise RigError([f"{where}.calibration: {error}"], error.remedy) from error
        except ValueError as error:
            raise RigError([f"{where}: {error}"]) from error


@frozen
class _ReceiverMount:
    camera: CameraMount


@frozen
class _SenderMount(_ReceiverMount):
    marker: MarkerPlace


@frozen
class _Marker:
    """One fiducial of the layout: ``roll_deg`` turns it about its own normal, pitch and yaw about
    ``v``'s x and y.
    """

    id: Annotated[int, Bounds(0, 1023, "(an id)")]
    side_m: Annotated[float, Bounds(0.005, 2.0)]
    side_sigma_m: Annotated[float, Bounds(0.0, 0.1)] = 0.0001
    position_v_m: Annotated[Vec3, Bounds(-3.0, 3.0)] = (0.0, 0.0, 0.0)
    rpy_deg: Annotated[Vec3, Bounds(-180.0, 180.0)] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        self.marker()

    def marker(self) -> Marker:
        """Raises ValueError for a marker that cannot be."""
        roll, pitch, yaw = self.rpy_deg
        turn = axis_turn(1, yaw) @ axis_turn(0, pitch) @ axis_turn(2, roll)
        return Marker(
            self.id,
            self.side_m,
            self.side_sigma_m,
            Pose(turn, np.array(self.position_v_m)),
        )


@frozen
class _ReceiverTable:
    vehicle: PartSpec
    perception: PartSpec
    link: PartSpec
    clock: PartSpec
    camera: _Camera
    mount: _ReceiverMount
    guard: PartSpec | None = None


@frozen
class _SenderTable(_ReceiverTable):
    mount: _SenderMount
    operator: PartSpec | None = None


@frozen
class _RigTable:
    name: str
    level: Level
    origin: Origin
    markers: tuple[_Marker, ...]
    sender: _SenderTable
    receiver: _ReceiverTable
    description: str = ""
    harness: str | None = None
    marker_dictionary: str = "DICT_4X4_50"
    method: MethodConfig = field(default_factory=MethodConfig)
    mission: dict[str, Any] = field(default_factory=dict[str, Any])
    world: dict[str, Any] = field(default_factory=dict[str, Any])
    trials: dict[str, str] = field(default_factory=dict[str, str])
    reference: Reference | None = None
    relay: dict[str, Any] = field(default_factory=dict[str, Any])
    team: dict[str, Any] = field(default_factory=dict[str, Any])
    drones: tuple[dict[str, Any], ...] = ()
    targets: tuple[dict[str, Any], ...] = ()
    target: TargetFacts | None = None
    drone: DroneFacts | None = None
    site: SiteFacts | None = None
    depth: DepthFacts | None = None
    link: LinkFacts | None = None
    height: HeightFacts | None = None
    detector: DetectorFacts | None = None

    def __post_init__(self) -> None:
        self.layout()
        if self.sender.mount.marker.calibrated is not None:
            _check_mount(self.sender.mount.marker.calibrated, self)

    def layout(self) -> MarkerLayout:
        """Raises ValueError for a layout that cannot be."""
        return MarkerLayout(tuple(m.marker() for m in self.markers), self.marker_dictionary)


def _check_mount(mount: MountCalibration, rig: _RigTable) -> None:
    """Raises ValueError when a mount is of other markers or another camera, or less sure than the
    method is told.
    """
    here = "sender.mount.marker.calibration"
    printed = {m.id: m.side_m for m in rig.markers}
    calibrated = {m.id: m.side_m for m in mount.markers}
    if printed.keys() != calibrated.keys() or any(
        abs(printed[i] - calibrated[i]) > 1e-6 for i in printed
    ):
        raise ValueError(
            f"{here}: it is of the markers {_shown(calibrated)}, this rig has {_shown(printed)}"
        )
    if mount.serial and rig.sender.camera.serial and mount.serial != rig.sender.camera.serial:
        raise ValueError(
            f"{here}: it is of the camera with serial number {mount.serial}, "
            f"sender.camera.calibration of {rig.sender.camera.serial}"
        )
    position_m, angle_deg = mount.largest_sigmas
    if (
        position_m > rig.method.mount_sigma_m * 1.001
        or angle_deg > rig.method.mount_sigma_deg * 1.001
    ):
        raise ValueError(
            f"method: mount_sigma_m = {rig.method.mount_sigma_m:g} and mount_sigma_deg = "
            f"{rig.method.mount_sigma_deg:g} promise more than {here} has: {position_m:.2g} m and {angle_deg:.2g} deg"
        )


def _shown(markers: Mapping[int, float]) -> str:
    return ", ".join(f"{i} ({1000.0 * side:g} mm)" for i, side in sorted(markers.items()))


def load_rig(name_or_path: str | Path, search: Sequence[Path] = ()) -> Rig:
    """Read and decode a rig. Raises RigError with all that is wrong in the file itself."""
    path = find_rig(name_or_path, search)
    return rig_of(read_rig(path, search), path, search)


def rig_of(
    table: Mapping[str, Any],
    path: Path,
    search: Sequence[Path] = (),
) -> Rig:
    """Decode the tables of the rig at ``path``. Raises RigError."""
    written = decode_table(table, _RigTable, path.name, path.parent)
    T_b_v = written.sender.mount.marker.pose(written.sender.mount.camera.pose())
    own: dict[str, Any] = {
        "layout": written.layout(),
        "sender": _role_rig(written.sender, T_b_v),
        "receiver": _role_rig(written.receiver, T_b_v),
        "file": path,
        "folders": tuple(search),
        "named": _named(table),
    }
    return Rig(**_alike(written, Rig) | own)


def _alike(written: object, kind: type[Any]) -> dict[str, Any]:
    """Return what was written of the fields of a dataclass that are called alike."""
    names = (each.name for each in fields(kind) if hasattr(written, each.name))
    return {name: getattr(written, name) for name in names}


def _named(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of ``[method]`` and ``[mission]`` by dotted key."""
    named: dict[str, Any] = {}

    def note(within: Mapping[str, Any], prefix: str) -> None:
        for key, value in within.items():
            if isinstance(value, Mapping):
                note(value, f"{prefix}{key}.")
            else:
                named[f"{prefix}{key}"] = value

    for name in ("method", "mission"):
        note(table.get(name, {}), f"{name}.")
    return named


def _role_rig(written: _ReceiverTable, T_b_v: Pose) -> RoleRig:
    camera = written.camera
    mount = Mount(written.mount.camera.pose(), T_b_v)
    own: dict[str, Any] = {"camera": camera.model, "camera_serial": camera.serial, "mount": mount}
    return RoleRig(**_alike(written, RoleRig) | own)

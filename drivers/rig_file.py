"""A rig on disk: one TOML file that names the parts of both drones.

name = "sitl"
level = "sitl"
harness = "hil.sitl:Sitl"            # left out in the field
[origin]                             # of the mission's local frame
[method]                             # path.config.MethodConfig
[mission]                            # decoded by the missions
[world]                              # decoded by the harness
[trials]                             # what trials measure against: studio = "hil.studio:Studio", ...
[[markers]]                          # the marker layout on the sender, in frame v
[sender.vehicle]                     # a part: its factory, and the options of its Config
factory = "drivers.mavsdk_vehicle:MavsdkVehicle"
[sender.sight], [sender.link], [sender.clock], [sender.camera], [sender.mount.camera], [sender.mount.marker]
[receiver. ...]                      # the same, without mount.marker
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.rig import Level, Mount, Origin, PartSpec, Rig, RoleRig
from drivers.tables import RigError, decode_table, suggestion
from path.camera import CameraModel
from path.config import MethodConfig
from path.geometry import Matrix, Pose
from path.marker.layout import Marker, MarkerLayout

Vec3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class _Camera:
    """Intrinsics from a calibration at exactly this stream size; distortion is Brown–Conrady k1 k2 p1 p2 k3."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"the image size {self.width}x{self.height} must be positive")
        if self.fx <= 0 or self.fy <= 0:
            raise ValueError("fx and fy must be positive")
        if not (0 <= self.cx < self.width and 0 <= self.cy < self.height):
            raise ValueError(
                f"the principal point ({self.cx:g}, {self.cy:g}) is outside {self.width}x{self.height}: "
                "this calibration is of another stream size"
            )


@dataclass(frozen=True, slots=True)
class _CameraMount:
    """Camera looking forward along body x, turned by roll, then pitched down, then yawed."""

    position_b_m: Vec3
    pitch_down_deg: float
    roll_deg: float = 0.0
    yaw_deg: float = 0.0

    def pose(self) -> Pose:
        forward = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # columns: x right, y down, z ahead
        turn = _turn(self.roll_deg, -self.pitch_down_deg, self.yaw_deg)
        return Pose(turn @ forward, np.array(self.position_b_m))


@dataclass(frozen=True, slots=True)
class _MarkerMount:
    """Marker plate facing backwards, turned by roll, then tilted up, then yawed."""

    position_b_m: Vec3
    tilt_up_deg: float
    roll_deg: float = 0.0
    yaw_deg: float = 0.0

    def pose(self) -> Pose:
        backward = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # columns: x right, y up, z out
        turn = _turn(self.roll_deg, -self.tilt_up_deg, self.yaw_deg)
        return Pose(turn @ backward, np.array(self.position_b_m))


@dataclass(frozen=True, slots=True)
class _SenderMount:
    camera: _CameraMount
    marker: _MarkerMount


@dataclass(frozen=True, slots=True)
class _ReceiverMount:
    camera: _CameraMount


@dataclass(frozen=True, slots=True)
class _Marker:
    """One fiducial of the layout: ``roll_deg`` turns it about its own normal, pitch and yaw about ``v``'s x and y."""

    id: int
    side_m: float
    side_sigma_m: float = 0.0001
    position_v_m: Vec3 = (0.0, 0.0, 0.0)
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        self.marker()

    def marker(self) -> Marker:
        """Raises ValueError for a marker that cannot be."""
        roll, pitch, yaw = self.rpy_deg
        turn = _axis(1, yaw) @ _axis(0, pitch) @ _axis(2, roll)
        return Marker(self.id, self.side_m, self.side_sigma_m, Pose(turn, np.array(self.position_v_m)))


@dataclass(frozen=True, slots=True)
class _Sender:
    vehicle: PartSpec
    sight: PartSpec
    link: PartSpec
    clock: PartSpec
    camera: _Camera
    mount: _SenderMount


@dataclass(frozen=True, slots=True)
class _Receiver:
    vehicle: PartSpec
    sight: PartSpec
    link: PartSpec
    clock: PartSpec
    camera: _Camera
    mount: _ReceiverMount


@dataclass(frozen=True, slots=True)
class _RigTable:
    name: str
    level: Level
    origin: Origin
    markers: tuple[_Marker, ...]
    sender: _Sender
    receiver: _Receiver
    description: str = ""
    harness: str | None = None
    marker_dictionary: str = "DICT_4X4_50"
    method: MethodConfig = field(default_factory=MethodConfig)
    mission: dict[str, Any] = field(default_factory=dict[str, Any])
    world: dict[str, Any] = field(default_factory=dict[str, Any])
    trials: dict[str, str] = field(default_factory=dict[str, str])

    def __post_init__(self) -> None:
        self.layout()

    def layout(self) -> MarkerLayout:
        """Raises ValueError for a layout that cannot be."""
        return MarkerLayout(tuple(m.marker() for m in self.markers), self.marker_dictionary)


def _axis(axis: int, angle_deg: float) -> Matrix:
    a = math.radians(angle_deg)
    c, s = math.cos(a), math.sin(a)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def _turn(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Matrix:
    return _axis(2, yaw_deg) @ _axis(1, pitch_deg) @ _axis(0, roll_deg)


def find_rig(name_or_path: str | Path, search: Sequence[Path] = ()) -> Path:
    """The TOML file of a rig: a path, or a bare name looked up in the folders of ``search``. Raises RigError."""
    path = Path(name_or_path)
    if path.suffix == ".toml" or len(path.parts) > 1:
        if path.is_file():
            return path
        raise RigError([f"{path}: no such rig file"])
    for folder in search:
        if (folder / f"{path}.toml").is_file():
            return folder / f"{path}.toml"
    names = sorted(file.stem for folder in search for file in folder.glob("*.toml"))
    raise RigError(
        [f"no rig named '{path}'{suggestion(str(path), names)}; there are: {', '.join(names) or 'none'}"],
        "name one of these, or the path of a rig's .toml file",
    )


def load_rig(name_or_path: str | Path, search: Sequence[Path] = ()) -> Rig:
    """Read and decode a rig. Raises RigError with all that is wrong in the file itself."""
    path = find_rig(name_or_path, search)
    try:
        table = tomllib.loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RigError([f"{path.name}: {error}"]) from error
    written = decode_table(table, _RigTable, path.name, path.parent)
    T_b_v = written.sender.mount.marker.pose()
    return Rig(
        name=written.name,
        description=written.description,
        level=written.level,
        harness=written.harness,
        origin=written.origin,
        method=written.method,
        mission=written.mission,
        world=written.world,
        trials=written.trials,
        layout=written.layout(),
        sender=_role_rig(written.sender, T_b_v),
        receiver=_role_rig(written.receiver, T_b_v),
        file=path,
    )


def _role_rig(written: _Sender | _Receiver, T_b_v: Pose) -> RoleRig:
    c = written.camera
    camera = CameraModel(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.distortion)
    mount = Mount(written.mount.camera.pose(), T_b_v)
    return RoleRig(written.vehicle, written.sight, written.link, written.clock, camera, mount)

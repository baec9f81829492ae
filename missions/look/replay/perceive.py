"""The perception of a replay: a rig's own over the frames that a run recorded, with its detector or
another one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.interfaces import Frame, PartError
from drivers.log.frames import frames_of
from drivers.log.mcap_log import parts
from drivers.log.video import recorded_frames
from drivers.perception.pixels import PixelPerception
from drivers.rig.parts import PartContext, PartSpec, Rig, create
from drivers.rig.tables import RigError, decode_table
from flight.config import MissionConfig
from missions.ground import rig_library
from missions.look.replay.logged import camera_of
from missions.look.replay.perceivers import ReceiverPerceiver, RecordedViews, SenderPerceiver
from missions.look.replay.redecide import Open, Perceiver
from missions.look.report.records import load_facts
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.messages import Role
from path.values import frozen

PIXELS = "drivers.perception.pixels:PixelPerception"
_RECORDED = {"factory": "drivers.recordings.camera:RecordedCamera", "file": "none"}  # never opened
_REMEDY = 'fly with `[mission] record = "all"` in the rig'


@frozen
class PerceptionChange:
    """The perception to look with. ``rig``: its file or name, None: the one that was flown.

    ``detector``: another one's factory, or None. ``settings``: of the detector's options, by name.
    """

    rig: str | None = None
    detector: str | None = None
    settings: Mapping[str, Any] | None = None


def detector_settings(texts: Sequence[str]) -> dict[str, Any]:
    """The options of ``detector.NAME=VALUE``. Raises PartError."""
    found: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name.strip().removeprefix("detector.")] = tomllib.loads(f"value = {value}")[
                "value"
            ]
        except ValueError as error:
            raise PartError(
                f"--set {text}: no value of TOML", "such as --set detector.min_saturation=0.4"
            ) from error
    return found


def perceiver_of(
    folder: Path,
    drone: str,
    change: PerceptionChange,
) -> Open:
    """Open the perception of one drone's log in a run's folder. Raises PartError when it recorded
    no frames.
    """
    files = [frames_of(log) for log in parts(folder, drone) if frames_of(log).exists()]
    if not files:
        raise PartError(f"{folder}: {drone} recorded no frames", _REMEDY)
    rig = _rig_of(folder, change)
    frames = _frames(files)

    def opened(
        setup: Mapping[str, Any],
        begun_ns: int,
        method: MethodConfig,
    ) -> Perceiver:
        role = Role(setup["role"])
        own = rig.role(role)
        mission = decode_table(setup["mission"], MissionConfig, "/setup: mission")
        camera = camera_of(setup["camera"])
        views = RecordedViews(frames, perception_of(rig, role, camera, change).view_of)
        if role is Role.SENDER:
            return SenderPerceiver(views, own, camera, method, mission, begun_ns)
        return ReceiverPerceiver(views, own, camera, rig.layout, method, mission)

    return opened


def _rig_of(folder: Path, change: PerceptionChange) -> Rig:
    facts = load_facts(folder)
    name = change.rig or (facts.rig if facts is not None else None)
    if name is None:
        raise PartError(f"{folder}: nothing says which rig it was flown with", "name it with --rig")
    try:
        return rig_library.load_unchecked(name)
    except RigError as error:
        raise PartError(f"{name}: {error}", "name the rig with --rig") from error


def _frames(files: Sequence[Path]) -> Iterator[Frame]:
    try:
        for file in files:
            yield from recorded_frames(file)
    except (OSError, ValueError) as error:
        raise PartError(str(error), "the file is damaged") from error


def perception_of(
    rig: Rig,
    role: Role,
    camera: CameraModel,
    change: PerceptionChange,
) -> PixelPerception:
    """A role's perception, whose camera is never opened. Raises PartError."""
    own = rig.role(role)
    if own.perception.factory != PIXELS:
        raise PartError(
            f"rig {rig.name}: its perception has no pixels",
            "name another with --rig, such as sim-rendered",
        )
    table: Mapping[str, Any] = own.perception.options["detector"]
    if change.detector is not None and change.detector != table.get("factory"):
        table = {"factory": change.detector}
    options = {
        **own.perception.options,
        "camera": _RECORDED,
        "detector": {**table, **(change.settings or {})},
    }
    spec = PartSpec(own.perception.factory, options, own.perception.where, own.perception.base)
    context = PartContext(role, _ZeroClock(), camera, own.mount, rig.layout, rig.origin)
    try:
        made: PixelPerception = create(spec, context)
    except RigError as error:
        raise PartError(
            str(error), "see docs/detectors.md for detectors and their settings"
        ) from error
    return made


class _ZeroClock:
    """Stands in for the clock of a camera that is never opened."""

    def now_ns(self) -> int:
        return 0

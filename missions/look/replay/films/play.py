"""Two films played on one clock: each frame to its drone, each message to the other one some time
later.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

from drivers.interfaces import CameraError, Frame, PartError, View
from drivers.log.mcap_log import McapLog
from missions.ground import rig_library
from missions.look.replay.films.config import Films
from missions.look.replay.films.depth_unit import in_millimetres
from missions.look.replay.films.drones import FilmedReceiver, FilmedSender
from missions.look.replay.perceive import PerceptionChange, perception_of
from path.messages import Candidate, Role, Target


def play(
    films: Films,
    folder: Path,
    change: PerceptionChange,
) -> dict[Role, int]:
    """Write both drones' logs of two films into a folder, and return how many frames were looked at.

    Raises PartError for a damaged frame, or a target not there.
    """
    mission = rig_library.mission_of(films.rig)
    period_ns = round(1e9 / mission.image_hz) if mission.image_hz > 0.0 else 1 << 63
    logs = {
        role: McapLog(
            folder / f"{role.value}.mcap",
            role.value,
            utc_minus_stamp_ns=0,
            buffered=True,
        )
        for role in Role
    }
    try:
        sender = FilmedSender(films, mission, logs[Role.SENDER])
        receiver = FilmedReceiver(films, mission, logs[Role.RECEIVER])
        counted = dict.fromkeys(Role, 0)
        shown = dict.fromkeys(Role, films.begin_ns - period_ns)
        order = count()
        coming: list[tuple[int, int, Target | Candidate]] = []  # messages, by when they are there
        for stamp_ns, role, view in _views(films, change):
            while coming and coming[0][0] <= stamp_ns:
                at_ns, _, message = heapq.heappop(coming)
                if isinstance(message, Target):
                    receiver.hear(message, at_ns)
                else:
                    sender.hear(message, at_ns)
            said = sender.look(view) if role is Role.SENDER else receiver.look(view)
            if said is not None:
                heapq.heappush(coming, (stamp_ns + films.link_ns, next(order), said))
            counted[role] += 1
            image = view.image()
            if image is not None and stamp_ns - shown[role] >= period_ns:
                shown[role] = stamp_ns
                logs[role].image("/image", stamp_ns, image)
        if not sender.has_target:
            raise PartError(
                f"{films.sender.file.name}: it ends before the target was seen",
                "take an earlier target.at_s",
            )
    finally:
        for log in logs.values():
            log.close()
    return counted


def _views(films: Films, change: PerceptionChange) -> Iterator[tuple[int, Role, View]]:
    """The views of both cameras, in the order of their stamps."""
    each = (_views_of(films, role, change) for role in Role)
    return heapq.merge(*each, key=lambda seen: (seen[0], seen[1].value))


def _views_of(
    films: Films,
    role: Role,
    change: PerceptionChange,
) -> Iterator[tuple[int, Role, View]]:
    see: Callable[[Frame], View] = perception_of(
        films.rig,
        role,
        films.rig.role(role).camera,
        change,
    ).view_of
    film = films.of(role)
    for number, (stamp_ns, recorded) in enumerate(film.frames(films.begin_ns, films.end_ns)):
        loaded = recorded.load()
        try:
            depth_mm = in_millimetres(loaded.depth_mm, film.depth_unit_mm)
            view = see(Frame(stamp_ns, number, loaded.color, depth_mm))
        except CameraError as error:
            raise CameraError(f"{film.file}, {recorded.name}: {error}", error.remedy) from error
        yield stamp_ns, role, view

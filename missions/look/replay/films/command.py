"""``path-handoff replay FILMS.toml``: what the method makes of two films, as logs, a table and a
picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.interfaces import PartError
from missions.ground.options.runs import ReplayOptions
from missions.ground.run_folder import RunKind, claimed, unless_refused, write_json
from missions.ground.shown import tell_line
from missions.look.replay.command import (
    Replayed,
    asked_of,
    figures_rows,
    logs_of,
    replay_changed,
    replay_logs,
    show_columns,
)
from missions.look.replay.films.config import NS, read_films
from missions.look.replay.films.play import play
from missions.look.report.page import PageOf, write_page
from missions.look.report.records import PAGE, REPLAY, by_topic
from path.messages import Role

FILMS = "films.json"
KIND = RunKind(FILMS, (REPLAY, PAGE), tuple(role.value for role in Role))


def replay_films(options: ReplayOptions, file: Path) -> int:
    """Look at two films; decide also with other settings, if any are asked for. Raises
    PartError.
    """
    if options.frames or options.rig is not None:
        raise PartError(
            f"{file} names its films and its rig itself", "leave --frames and --rig out"
        )
    change, seen_with = asked_of(options)
    films = read_films(file)
    with unless_refused(options.out) as folder, claimed(folder, KIND):
        tell_line(f"{(films.end_ns - films.begin_ns) / NS:.2f} s of {films.sender.file.name} and "
                  f"{films.receiver.file.name}: {folder}")  # fmt: skip
        frames = play(films, folder, seen_with)
        for role in Role:
            if damage := films.of(role).recording.damage:
                tell_line(f"{films.of(role).file.name}: {damage}")
        logs = logs_of(folder)
        columns = {"as filmed": replay_logs(logs)}
        if change is not None:
            columns[" ".join((*options.set, options.gate or "")).strip()] = replay_changed(
                logs, change
            )
        show_columns(columns, options.picture, folder)
        complete = [each.stamp_ns for drone in columns["as filmed"] for each in drone.complete]
        record = {
            "outcome": "agreed" if complete else "no_agreement",
            "films": str(file),
            "rig": films.rig.name,
            "begin_ns": films.begin_ns,
            "end_ns": films.end_ns,
            "gate_complete_ns": complete[0] if complete else None,
            "frames": {role.value: count for role, count in frames.items()},
        }
        write_json(folder / FILMS, record)
        logs = {role.value: by_topic(folder / f"{role.value}.mcap") for role in Role}
        write_page(folder / PAGE, _page_of(columns, bool(complete), file, folder), logs)
        tell_line(str(folder / PAGE))
    return 0


def _page_of(
    columns: Mapping[str, Sequence[Replayed]],
    agreed: bool,
    file: Path,
    folder: Path,
) -> PageOf:
    return PageOf(
        outcome="agreed" if agreed else "no_agreement",
        good=agreed,
        why=f"the two films of {file.name}, of which nobody became responsible",
        command=f"path-handoff replay {file}",
        figures=[(name, ", ".join(values)) for name, *values in figures_rows(columns)],
        notes=[],
        pictures=[folder / REPLAY],
        advice="Look at the boxes below; --set, --gate and --detector decide with others beside them.",
    )

"""``path-handoff replay``: every decision of a run again, and what other settings would have made
of it.
"""

from __future__ import annotations

import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord
from drivers.rig.tables import RigError, decode_table
from missions.ground.options.runs import ReplayOptions
from missions.look.replay.perceive import PerceptionChange, detector_settings, perceiver_of
from missions.look.replay.redecide import (
    Change,
    Complete,
    DecisionPair,
    Open,
    other_answers,
    redecide,
)
from missions.look.report.command import show
from missions.look.report.records import REPLAY, drone_logs, load_facts
from missions.look.report.tables import plain_table
from path.config import MethodConfig
from path.messages import Role
from path.values import frozen

EXIT_DIFFERENT = 1
_VERDICT = "/agreement"


@frozen
class Replayed:
    """A drone's decisions. ``complete``: when its gate was, the first time in each attempt."""

    drone: str
    decided: Sequence[DecisionPair]
    complete: Sequence[Complete]

    @property
    def different(self) -> list[DecisionPair]:
        return [each for each in self.decided if not each.same]

    @property
    def verdicts(self) -> list[Mapping[str, Any]]:
        """Return the verdicts on D2's answers, in order."""
        return [
            each.again for each in self.decided if each.topic == _VERDICT and each.again is not None
        ]


def run(options: ReplayOptions) -> int:
    """``path-handoff replay``. Raises PartError for a folder or a setting that is none."""
    if len(options.folders) != 1:
        return run_many(options)
    (folder,) = options.folders
    if folder.suffix == ".toml":
        from missions.look.replay.films.command import replay_films  # noqa: PLC0415 (cameras, which a run needs not)

        return replay_films(options, folder)
    if options.out is not None:
        raise PartError(
            "--out is for films, whose logs have no folder yet",
            "a run's replay.png goes into its own",
        )
    logs = logs_of(folder)
    before = replay_logs(logs)
    show(_same_table(before), sys.stdout)
    differ = [each for drone in before for each in drone.different]
    if not any(drone.decided for drone in before):
        raise PartError(
            f"{folder}: nothing was decided in it",
            "name the folder of a run that reached a handoff",
        )
    unsaid = dict.fromkeys(
        name for drone in before for each in drone.decided for name in each.unsaid
    )
    if unsaid:
        sys.stdout.write(
            f"not compared, as an earlier version of PATH wrote this log: {', '.join(unsaid)}\n"
        )
    for each in differ[:1]:
        sys.stdout.write(f"first difference, {each.topic} at {each.stamp_ns}:\n{_difference(each)}")
    change, seen_with = asked_of(options)
    looks = options.frames or seen_with != PerceptionChange(options.rig)
    if change is not None or looks:
        perceivers = {name: perceiver_of(folder, name, seen_with) for name in logs} if looks else {}
        after = replay_changed(logs, change or (lambda method: method), perceivers)
        show_columns({"as flown": before, _title(options): after}, options.picture, folder)
    return EXIT_DIFFERENT if differ else 0


def asked_of(options: ReplayOptions) -> tuple[Change | None, PerceptionChange]:
    """Return the settings to decide with, None: the run's own; and the perception to look with.
    Raises PartError.
    """
    method = [text for text in options.set if not text.startswith("detector.")]
    detector = [text for text in options.set if text.startswith("detector.")]
    seen_with = PerceptionChange(options.rig, options.detector, detector_settings(detector) or None)
    return change_of(method, options.gate), seen_with


def show_columns(columns: Mapping[str, Sequence[Replayed]], picture: bool, folder: Path) -> None:
    """Show results by title, side by side: a table, and replay.png in a folder."""
    show(_figures_table(columns), sys.stdout)
    if picture:
        from missions.look.replay.picture import draw_replay  # noqa: PLC0415 (matplotlib takes a second to import)

        draw_replay(columns, folder / REPLAY)
        sys.stdout.write(f"\n{folder / REPLAY}\n")


def replay_logs(logs: Mapping[str, Sequence[LogRecord]]) -> list[Replayed]:
    """Every drone's decisions again, as they were."""
    return [_replay(name, records) for name, records in logs.items()]


def logs_of(folder: Path) -> dict[str, Sequence[LogRecord]]:
    """Every drone's log of a run. Raises PartError for what is none, or cannot be replayed."""
    return {name: _of_a_leg(name, records) for name, records in drone_logs(folder).items()}


def run_many(options: ReplayOptions) -> int:
    """Decide many runs again; 1 when anything differs. Raises PartError for settings, or no
    folder.
    """
    if not options.folders or options != ReplayOptions(options.folders, picture=options.picture):
        raise PartError(
            "other settings are for one run", "name one folder, or leave the settings out"
        )
    table = plain_table("run", "kind", "decisions", "differ", left=("run", "kind"))
    decisions = differ = replayed = 0
    for folder in options.folders:
        try:
            of = [
                each
                for name, records in logs_of(folder).items()
                for each in _replay(name, records).decided
            ]
        except PartError as error:
            table.add_row(str(folder), str(error).removeprefix(f"{folder}: "), "-", "-")
            continue
        different = sum(not each.same for each in of)
        table.add_row(str(folder), kind_of(folder), str(len(of)), str(different))
        decisions = decisions + len(of)
        differ = differ + different
        replayed = replayed + bool(of)
    show(Group(Text(), table), sys.stdout)
    sys.stdout.write(f"\n{replayed} runs, {decisions} decisions, {differ} differ\n")
    return EXIT_DIFFERENT if differ else 0


def kind_of(folder: Path) -> str:
    """Return the kind of a run, in a few words."""
    facts = load_facts(folder)
    return "cut off" if facts is None else " ".join((facts.rig, *facts.faults, facts.outcome))


def _title(options: ReplayOptions) -> str:
    looked = options.frames or options.detector
    return " ".join(
        ("seen again" if looked else "", options.detector or "", *options.set, options.gate or "")
    ).strip()


def change_of(settings: Sequence[str], gate: str | None) -> Change | None:
    """Return the change that ``--set`` and ``--gate`` ask for; None: nothing. Raises PartError."""
    named = [_setting(text) for text in settings] + ([(["gate"], gate)] if gate else [])
    if not named:
        return None

    def change(method: MethodConfig) -> MethodConfig:
        table = asdict(method)
        for (*above, name), value in named:
            inner = table
            for each in above:
                inner = inner[each] = dict(inner.get(each) or {})
            inner[name] = value
        try:
            return decode_table(table, MethodConfig, "--set method")
        except RigError as error:
            raise PartError(
                str(error), "see path/config.py for the settings and what is allowed"
            ) from error

    change(MethodConfig())
    return change


def replay_changed(
    logs: Mapping[str, Sequence[LogRecord]],
    change: Change,
    perceivers: Mapping[str, Open] | None = None,
) -> list[Replayed]:
    """Replays with other settings on both drones: D1 judges what D2 would have answered to what D1
    sent.

    ``perceivers``: of the drones that look at their recorded frames again.
    """
    perceivers = perceivers or {}
    receivers = {
        name: _replay(name, records, change, open_perceiver=perceivers.get(name))
        for name, records in logs.items()
        if _is(Role.RECEIVER, records)
    }
    answers = {
        key: answer
        for each in receivers.values()
        for key, answer in other_answers(each.decided).items()
    }
    return [
        receivers[name]
        if name in receivers
        else _replay(name, records, change, answers, perceivers.get(name))
        for name, records in logs.items()
    ]


def _replay(
    drone: str,
    records: Sequence[LogRecord],
    change: Change = lambda method: method,
    answers: Mapping[tuple[int, int], Mapping[str, Any]] | None = None,
    open_perceiver: Open | None = None,
) -> Replayed:
    decided: list[DecisionPair] = []
    complete: list[Complete] = []
    for each in redecide(records, change, answers, open_perceiver):
        if isinstance(each, DecisionPair):
            decided.append(each)
        else:
            complete.append(each)
    return Replayed(drone, _of_the_logs_version(decided), complete)


def _of_the_logs_version(decided: Sequence[DecisionPair]) -> list[DecisionPair]:
    """The same without what is null all through the log though it is decided again: an earlier
    version wrote it.
    """
    said: set[tuple[str, str]] = set()
    again: set[tuple[str, str]] = set()
    for each in decided:
        said |= {
            (each.topic, name) for name, value in (each.logged or {}).items() if value is not None
        }
        again |= {
            (each.topic, name) for name, value in (each.again or {}).items() if value is not None
        }
    unsaid = again - said
    return [
        replace(
            each, logged={k: v for k, v in each.logged.items() if (each.topic, k) not in unsaid}
        )
        if each.logged is not None
        else each
        for each in decided
    ]


def _of_a_leg(name: str, records: Sequence[LogRecord]) -> Sequence[LogRecord]:
    if not any(record.topic == "/setup" for record in records):
        raise PartError(
            f"{name}: its log does not say what the program was given",
            "replay a run of this version of PATH",
        )
    return records


def _is(role: Role, records: Sequence[LogRecord]) -> bool:
    """Return whether a drone was nothing else than this role."""
    return {record.record["role"] for record in records if record.topic == "/setup"} == {role.value}


def _setting(text: str) -> tuple[list[str], Any]:
    name, _, value = text.partition("=")
    table, *path = name.strip().split(".")
    try:
        if table != "method" or not path:
            raise ValueError
        return path, tomllib.loads(f"value = {value}")["value"]
    except ValueError as error:
        raise PartError(
            f"--set {text}: no setting of the method", "such as --set method.tau_min=0.4"
        ) from error


# --- what a person sees


def _same_table(replayed: Sequence[Replayed]) -> RenderableType:
    table = plain_table("drone", "decisions", "decided again", "differ", left=("drone",))
    for drone in replayed:
        for topic in dict.fromkeys(each.topic for each in drone.decided):
            of = [each for each in drone.decided if each.topic == topic]
            different = sum(not each.same for each in of)
            table.add_row(
                f"{drone.drone} {topic}", str(len(of)), str(len(of) - different), str(different)
            )
    return Group(Text(), table)


def _figures_table(columns: Mapping[str, Sequence[Replayed]]) -> RenderableType:
    first, *others = columns
    table = plain_table("", first, *("otherwise" for _ in others))
    for row in figures_rows(columns):
        table.add_row(*row)
    return Group(Text(), table)


def figures_rows(columns: Mapping[str, Sequence[Replayed]]) -> Iterator[tuple[str, ...]]:
    """Yield a name and its values, one of each column."""
    for drones in zip(*columns.values(), strict=True):
        rows = [_figures(drone) for drone in drones]
        for name in dict.fromkeys(name for row in rows for name in row):
            yield f"{drones[0].drone}: {name}", *(row.get(name, "-") for row in rows)


def _figures(drone: Replayed) -> dict[str, str]:
    rows: dict[str, str] = {}
    verdicts = drone.verdicts
    if verdicts:
        begin_ns = next(each.stamp_ns for each in drone.decided if each.topic == _VERDICT)
        ends = [f"{(each.stamp_ns - begin_ns) * 1e-9:.2f} s" for each in drone.complete]
        rows["gate complete, after the first answer"] = ", ".join(ends) or "not within the log"
        agreed = sum(bool(verdict["agreed"]) for verdict in verdicts)
        rows["answers that agree"] = f"{agreed}/{len(verdicts)}"
    for topic, what in (
        ("/target", "frames with the target"),
        ("/candidate", "frames with a candidate"),
    ):
        of = [
            each.again for each in drone.decided if each.topic == topic and each.again is not None
        ]
        if of:
            rows[what] = f"{sum(record['box'] is not None for record in of)}/{len(of)}"
    misses = Counter(
        f"{each.topic}: {each.again['reason']}"
        for each in drone.decided
        if each.again and each.again["reason"]
    )
    return rows | {name: str(count) for name, count in sorted(misses.items())}


def _difference(each: DecisionPair) -> str:
    if each.logged is None or each.again is None:
        return f"  {'only decided again' if each.logged is None else 'only in the log'}\n"
    names = [name for name in each.logged if each.logged[name] != each.again.get(name)]
    return "".join(
        f"  {name}: {each.logged[name]} in the log, {each.again.get(name)} again\n"
        for name in names
    )

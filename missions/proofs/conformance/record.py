"""The figures of one vehicle's flights as a file: ``px4.json`` beside those of the others."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

from drivers.interfaces import PartError
from missions.ground.run_folder import write_json
from missions.proofs.conformance.stage import Values
from path.values import frozen

EMBEDDED = "embedded"
VEHICLES = (EMBEDDED, "px4", "ardupilot")


@frozen
class Record:
    """``values`` by the names of ``rows``; ``failed`` by flight; ``load_*``: of this computer, over
    a minute.
    """

    vehicle: str
    rig: str
    made: str
    cores: int
    load_before: float
    load_after: float
    restarts: int
    values: Values
    failed: dict[str, str]
    flown: tuple[str, ...] = ()


def write(folder: Path, record: Record) -> None:
    write_json(folder / f"{record.vehicle}.json", asdict(record))


def joined(before: Record | None, now: Record) -> Record:
    """Return a record with some flights flown again: what they gave replaces what there was, the
    rest is kept.
    """
    if before is None:
        return now
    failed = {name: why for name, why in before.failed.items() if name not in now.flown}
    flown = tuple(dict.fromkeys((*before.flown, *now.flown)))
    return replace(
        now, flown=flown, restarts=before.restarts + now.restarts, values={**before.values, **now.values},
        failed={**failed, **now.failed},
    )  # fmt: skip


def read_all(folder: Path) -> dict[str, Record]:
    """The records of a folder, in the order of the table. Raises PartError for a file that is
    none.
    """
    records: dict[str, Record] = {}
    for vehicle in VEHICLES:
        file = folder / f"{vehicle}.json"
        if file.is_file():
            try:
                records[vehicle] = Record(**json.loads(file.read_bytes()))
            except (ValueError, TypeError) as error:
                raise PartError(
                    f"{file} is no record of this suite: {error}", "delete it, or fly it again"
                ) from error
    return records

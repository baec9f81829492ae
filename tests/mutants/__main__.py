"""Do the tests notice? Changes code in small wrong ways, and runs the tests that are there for it
on each.

    python -m tests.mutants --room flight/guard --sample 40 --seed 1
    python -m tests.mutants --diff main~5

A room is one of ``rooms.toml``; ``--diff`` takes the lines that differ from a revision, in whatever
room they are. A table by room and the survivors come last. A survivor is a test to write, or a
change that changes nothing: that is named in ``rooms.toml`` with the reason.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

from tests.mutants.rooms import Chosen, TableError, load_table, of_change, of_room, sample
from tests.mutants.trials import Tried, score

GOAL = 0.95


def main(arguments: Sequence[str], root: Path, stream: TextIO) -> int:
    """Returns 0 when enough was noticed, 1 when not, and 2 when nothing could be tried."""
    asked = _asked(arguments)
    began_s = time.monotonic()
    table = load_table()
    every: Chosen = []
    untested: list[str] = []
    try:
        if asked.diff is not None:
            every, untested = of_change(table, asked.diff, root)
            every = sample(every, asked.sample, asked.seed)
        for name in asked.room:
            every += sample(of_room(table, table.room(name), root), asked.sample, asked.seed)
        rooms = {tested.file: tested.room for tested, _ in every}
        tried = score(table, every, asked.jobs, root, stream, asked.quick)
    except TableError as error:
        stream.write(f"{error}\n")
        return 2
    told = summarize(tried, rooms, untested, time.monotonic() - began_s)
    show(told, stream)
    if asked.out is not None:
        asked.out.write_text(json.dumps({"seed": asked.seed, **told}, indent=2) + "\n", "utf-8")
    return 0 if told["holds"] else 1


def _asked(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "python -m tests.mutants", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--diff", metavar="REVISION", help="change the lines that differ from it")
    parser.add_argument(
        "--room", action="append", default=[], metavar="NAME", help="change a room; may be repeated"
    )
    parser.add_argument(
        "--sample",
        type=int,
        default=40,
        help="changes of each room, and of the difference: %(default)s",
    )
    parser.add_argument("--seed", type=int, default=0, help="which ones: %(default)s")
    parser.add_argument("--jobs", type=int, default=1, help="side by side: %(default)s")
    parser.add_argument(
        "--quick", action="store_true", help="ask neither slow tests nor a second time: minutes"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="what came of it, as JSON")
    asked = parser.parse_args(arguments)
    if asked.diff is None and not asked.room:
        parser.error(
            f"name --diff or --room: {', '.join(room.name for room in load_table().rooms)}"
        )
    return asked


def summarize(
    tried: Sequence[Tried], rooms: dict[str, str], untested: Sequence[str], wall_s: float
) -> dict[str, Any]:
    """``mutants`` are those that are not equivalent. ``rooms``: by file."""
    real = [one for one in tried if not one.why]
    by_room: dict[str, dict[str, int]] = {}
    for one in real:
        count = by_room.setdefault(rooms[one.mutation.file], {"mutants": 0, "caught": 0})
        count["mutants"] += 1
        count["caught"] += one.caught
    caught = sum(one.caught for one in real)
    return {
        "holds": bool(real) and caught >= GOAL * len(real),
        "mutants": len(real),
        "caught": caught,
        "by_room": dict(sorted(by_room.items())),
        "survivors": [
            {"name": one.mutation.name, "line": one.mutation.line} for one in real if not one.caught
        ],
        "equivalent": [{"name": one.mutation.name, "why": one.why} for one in tried if one.why],
        "untested": list(untested),
        "wall_s": round(wall_s, 1),
    }


def show(told: dict[str, Any], stream: TextIO) -> None:
    stream.write(f"\n{'room':<28}{'mutants':>8}{'caught':>8}{'share':>9}\n")
    for room, count in (*told["by_room"].items(), ("all", told)):
        share = f"{count['caught'] / count['mutants']:.1%}" if count["mutants"] else "-"
        stream.write(f"{room:<28}{count['mutants']:>8}{count['caught']:>8}{share:>9}\n")
    for one in told["survivors"]:
        stream.write(f"SURVIVED line {one['line']:>4}  {one['name']}\n")
    for one in told["equivalent"]:
        stream.write(f"the same: {one['name']}\n")
    for file in told["untested"]:
        stream.write(f"no tests mirror {file}\n")
    stream.write(f"{told['wall_s']:.0f} s\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], Path(), sys.stdout))

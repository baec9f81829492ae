"""Systems of other people: rigs that say what was measured, flown, and what became of them
(docs/systems.md).

``python -m tests.docs.systems fly --seeds 5 [NAME ...]`` flies those in docs/systems at level
``sim``, on so many seeds more, and keeps what came of it beside them; ``write`` makes the page of
what is kept.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Self

from flight.plan.checks import problems
from flight.plan.facts import facts_of
from flight.plan.flown import Flown, flown
from flight.plan.predictions import predictions
from missions.ground import rig_library
from missions.ground.rig_library import mission_of

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "systems"
KEPT = FOLDER / "flown.json"
PAGE = ROOT / "docs" / "systems.md"
# Nobody has looked at what comes of these. Each system has seeds of its own: errors that last are
# drawn by the seed, and one unlucky draw would be in the figures of all of them.
SEED = 90000
SEEDS = 10_000
BEGIN, END = "<!-- systems -->\n", "<!-- end of systems -->"


@dataclass(frozen=True, slots=True)
class Kept:
    """What became of a series of one system's flights, in numbers of flights and medians."""

    commit: str
    seed: int
    runs: int
    outcomes: Mapping[str, int]
    wrong: int
    violations: Mapping[str, int]
    agreement_s: float | None = None
    receiver_m: float | None = None
    target_m: float | None = None
    lost: int = 0  # within ten seconds of taking over

    @classmethod
    def of(cls, said: Mapping[str, Any], commit: str, seed: int) -> Self:
        """Take what is kept from the summary of a series, or of a single flight."""

        def median(key: str) -> float | None:
            found = said.get(key)
            if isinstance(found, Mapping):
                return float(found["median"])
            return None if found is None else float(found)

        alone = "runs" not in said
        return cls(
            commit,
            seed,
            1 if alone else int(said["runs"]),
            {said["outcome"]: 1} if alone else said["outcomes"],
            int(said["wrong_handover"] if alone else said["wrong_handovers"]),
            said["monitors"],
            median("agreement_s"),
            median("d2_error_m"),
            median("target_error_m"),
            int(said["lost_after_taking_over"] or 0),
        )


def names() -> list[str]:
    """Return the names of all systems."""
    return sorted(file.stem for file in FOLDER.glob("*.toml"))


@cache
def _planned(name: str) -> Flown:
    """Return the plan of a system: the page and its tests ask for each of them several times."""
    rig = rig_library.load_unchecked(str(FOLDER / f"{name}.toml"))
    mission = mission_of(rig)
    return flown(facts_of(rig, mission), mission)


@cache
def refusals(name: str) -> tuple[str, ...]:
    """Return why a system is refused, each with the smallest change; empty for one that is
    flown.
    """
    return tuple(f"{problem.where}: {problem}" for problem in problems(_planned(name)))


@cache
def predicted(name: str) -> Mapping[str, float]:
    """Return what the plan expects of a system's flights."""
    return {each.key: each.value for each in predictions(_planned(name))}


def seed_of(name: str, flown_before: int) -> int:
    """Return the seed of a system's next flight."""
    return SEED + zlib.crc32(name.encode()) % SEEDS + flown_before


def faults_of(name: str) -> list[str]:
    """Return what a system's link does to packets, as its rig states it."""
    link = rig_library.load_unchecked(str(FOLDER / f"{name}.toml")).link
    if link is None:
        return []
    return ["--fault", f"link_loss={link.loss:g}", "--fault", f"link_delay={link.latency_s:g}"]


def fly(name: str, seeds: int, commit: str) -> Kept:
    """Fly one system on its next seeds. Raises CalledProcessError when the command itself
    failed.
    """
    series = kept().get(name, [])
    seed = seed_of(name, sum(each.runs for each in series))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "runs"
        words = ["--rig", str(FOLDER / f"{name}.toml"), "--jobs", "1", "--out", str(out)]
        words += ["--seed", str(seed), "--seeds", str(seeds), *faults_of(name)]
        command = [sys.executable, "-m", "missions.cli", "handoff", *words]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        summary = out / "summary.json"
        if not summary.exists():
            raise subprocess.CalledProcessError(done.returncode, command, done.stdout, done.stderr)
        return Kept.of(json.loads(summary.read_text("utf-8")), commit, seed)


def kept() -> dict[str, list[Kept]]:
    """Return every series that is kept, by system."""
    if not KEPT.exists():
        return {}
    record = json.loads(KEPT.read_text("utf-8"))
    return {name: [Kept(**each) for each in series] for name, series in record.items()}


def keep(name: str, found: Kept) -> None:
    """Keep another series of one system."""
    every = kept()
    every.setdefault(name, []).append(found)
    record = {name: [asdict(each) for each in every[name]] for name in sorted(every)}
    KEPT.write_text(json.dumps(record, indent=2) + "\n", "utf-8")


def together(series: Sequence[Kept]) -> Kept:
    """Return several series as one: counts added up, medians by how many flights they are of.

    Errors are of series on seeds of their own, where there is one: one seed's draw was in the first
    series of nearly all systems.
    """

    def added(key: str) -> dict[str, int]:
        total: Counter[str] = Counter()
        for each in series:
            total.update(getattr(each, key))
        return dict(total)

    def middle(key: str) -> float | None:
        told = [each for each in series if getattr(each, key) is not None]
        if not told:
            return None
        own = [each for each in told if each.seed >= SEED] or told
        return statistics.median(getattr(each, key) for each in own for _ in range(each.runs))

    return Kept(
        series[-1].commit,
        series[0].seed,
        sum(each.runs for each in series),
        added("outcomes"),
        sum(each.wrong for each in series),
        added("violations"),
        middle("agreement_s"),
        middle("receiver_m"),
        middle("target_m"),
        sum(each.lost for each in series),
    )


def table() -> str:
    """Return the table of the systems that were flown, and lists of those that were not."""
    every = {name: together(series) for name, series in kept().items()}
    refused = {name: found for name in names() if (found := refusals(name))}
    flown_ones = {name: each for name, each in every.items() if name not in refused}
    head = "| system | what it is | handed over | agreement, s: plan, flown |\n|---|---|---|---|\n"
    rows = "".join(_row(name, found) for name, found in sorted(flown_ones.items()))
    wrong = sum(found.wrong for found in every.values())
    runs = sum(found.runs for found in every.values())
    fixes = "".join(
        f"- {_described(name)}: {found[0].split('; ')[-1]}\n" for name, found in refused.items()
    )
    waiting = [_described(name) for name in names() if name not in refused and name not in every]
    still = f"\nNot flown yet: {'; '.join(waiting)}.\n" if waiting else ""
    return (
        f"{head}{rows}\nWrong objects: {wrong} of {runs} flights. {_held(every)}\n\n"
        f"Refused by `plan`, and what would do:\n\n{fixes}{still}"
    )


def _described(name: str) -> str:
    """Return a system's link with what it is."""
    rig = rig_library.load_unchecked(str(FOLDER / f"{name}.toml"))
    return f"[{name}](systems/{name}.toml), {rig.description}"


def _held(every: Mapping[str, Kept]) -> str:
    """Return in how many of the systems that were flown the plan's predictions hold."""
    flown_ones = {
        name: found
        for name, found in every.items()
        if found.agreement_s is not None and not refusals(name)
    }
    said: list[str] = []
    for key, name, most in (
        ("agreement_s", "agreement", 2.0),
        ("receiver_m", "D2", 1.5),
        ("target_m", "target", 1.5),
    ):
        expected_key = {"receiver_m": "receiver_error_m", "target_m": "target_error_m"}.get(
            key, key
        )
        ratios = [
            getattr(found, key) / predicted(each)[expected_key]
            for each, found in flown_ones.items()
        ]
        within = sum(1.0 / most <= ratio <= most for ratio in ratios)
        said.append(f"{name} within a factor of {most:g} in {within}")
    return f"What the plan expects holds, of {len(flown_ones)} systems that handed over: {', '.join(said)}."


def _row(name: str, found: Kept) -> str:
    expected = predicted(name)
    others = {what: count for what, count in found.outcomes.items() if what != "committed"}
    others |= found.violations
    if found.lost > others.get("lost_after_taking_over", 0):
        others["lost after taking over"] = found.lost
    agreement = _pair(expected.get("agreement_s"), found.agreement_s)
    committed = f"{found.outcomes.get('committed', 0)} of {found.runs}"
    ends = "; ".join([committed, *(f"{count} `{what}`" for what, count in others.items())])
    cells = (_described(name), ends, agreement)
    return f"| {' | '.join(cells)} |\n"


def _pair(expected: float | None, measured: float | None) -> str:
    return ", ".join("–" if each is None else f"{each:.1f}" for each in (expected, measured))


def written(page: str) -> str:
    """Return the page with its table as it is now."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}{table()}{END}{after}"


def main(words: Sequence[str]) -> int:
    """Fly, or write the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.docs.systems", description=__doc__)
    parser.add_argument("does", choices=("fly", "write"))
    parser.add_argument("names", nargs="*", help="all when left out")
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_intermixed_args(words)
    if asked.does == "fly":
        commit = subprocess.run(
            ("git", "rev-parse", "--short=8", "HEAD"),
            cwd=ROOT,
            check=True,
            capture_output=True,
            text=True,
        ).stdout.strip()
        for name in asked.names or names():
            if refusals(name):
                continue
            found = fly(name, asked.seeds, commit)
            keep(name, found)
            sys.stdout.write(
                f"{name}: {dict(found.outcomes)}, wrong {found.wrong}, {dict(found.violations)}\n"
            )
            sys.stdout.flush()
    PAGE.write_text(written(PAGE.read_text("utf-8")), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

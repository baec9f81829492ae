"""``path-handoff verify --mutants``: the score of the tests against small wrong changes of what they are there for."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TextIO

from drivers.interfaces import PartError
from missions.assurance.verify.mutations import Mutation, mutated, mutations

TABLE = Path(__file__).with_name("mutation.toml")
LEAST = 6  # of a file
GOAL = 0.95
_SLOWER, _MORE_S = 5.0, 30.0  # than the right code: then a wrong version has hung
_COLDER = 3.0  # how much longer a trial may take that imports everything anew
_LONGEST_S = 900.0


@dataclass(frozen=True, slots=True)
class FileTests:
    """A file and the tests that are there for it, the quickest first."""

    file: str
    tests: tuple[str, ...]

    @property
    def module(self) -> str:
        return self.file.removesuffix(".py").replace("/", ".")


@dataclass(frozen=True, slots=True)
class TriedMutant:
    """The result of a wrong version. ``by``: the test that noticed; ``why``: it is the same in all that counts."""

    mutation: Mutation
    caught: bool
    by: str = ""
    why: str = ""
    took_s: float = 0.0


@dataclass(slots=True)
class MutationTable:
    """``mutation.toml``."""

    suites: tuple[FileTests, ...]
    equivalent: dict[str, str] = field(default_factory=dict[str, str])


def load_table(path: Path = TABLE) -> MutationTable:
    told: Any = tomllib.loads(path.read_text("utf-8"))
    suites = tuple(FileTests(one["file"], tuple(one["tests"])) for one in told["target"])
    return MutationTable(suites, {one["name"]: one["why"] for one in told.get("equivalent", ())})


def choose(table: MutationTable, seed: int, number: int, root: Path) -> list[tuple[FileTests, Mutation]]:
    """Returns so many of all mutations, by seed: each file its share, the first ``LEAST`` of each in any case."""
    rng = random.Random(f"mutants {seed}")
    every: list[list[tuple[FileTests, Mutation]]] = []
    for suite in table.suites:
        own = [(suite, one) for one in mutations(suite.file, (root / suite.file).read_text("utf-8"))]
        rng.shuffle(own)
        every.append(own)
    least = min(LEAST, -(-number // len(every)))
    chosen = [one for own in every for one in own[:least]]
    rest = [one for own in every for one in own[least:]]
    rng.shuffle(rest)
    return [*chosen, *rest][:number]


class Server:
    """A ``mutation_warm``, which has collected these tests, or with none a ``mutation_server``; what is said to it."""

    def __init__(self, root: Path, tests: Sequence[str] = ()) -> None:
        name = "mutation_warm" if tests else "mutation_server"
        command = [sys.executable, "-m", f"missions.assurance.verify.{name}", *tests]
        self._told = " ".join(["python", *command[1:]])
        self._process = subprocess.Popen(command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def trial(self, suite: FileTests, source: str | None, bound_s: float) -> dict[str, Any]:
        order = {"module": suite.module, "source": source, "tests": suite.tests, "bound_s": bound_s}
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise PartError(
                "the program that runs the tests has ended", f"run `{self._told} < /dev/null` and see what it says"
            )
        return json.loads(answer)

    def close(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


class Trials:
    """Servers, one a job, and the trials they run.

    A wrong version is put into what is imported already, which takes a moment. Only one that is not noticed there, or
    cannot be put there, is tried again from the first import on, by a server that is started then.
    """

    def __init__(self, root: Path, jobs: int, tests: Sequence[str]) -> None:
        self._root, self._jobs, self._tests = root, jobs, tests
        self._warm: SimpleQueue[Server] = SimpleQueue()
        self._cold: SimpleQueue[Server | None] = SimpleQueue()
        self._servers: list[Server] = []

    def __enter__(self) -> Trials:
        for _ in range(self._jobs):
            self._servers.append(Server(self._root, self._tests))
            self._warm.put(self._servers[-1])
            self._cold.put(None)
        return self

    def __exit__(self, *_: object) -> None:
        for server in self._servers:
            server.close()

    def trial(self, suite: FileTests, source: str | None, bound_s: float) -> dict[str, Any]:
        """Runs a trial on the next server that is free."""
        server = self._warm.get()
        try:
            came = server.trial(suite, source, bound_s)
        finally:
            self._warm.put(server)
        return (
            came
            if source is None or not (came["passed"] or came["broken"])
            else self._from_the_first(suite, source, _COLDER * bound_s)
        )

    def _from_the_first(self, suite: FileTests, source: str, bound_s: float) -> dict[str, Any]:
        server = self._cold.get()
        try:
            if server is None:
                server = Server(self._root)
                self._servers.append(server)
            return server.trial(suite, source, bound_s)
        finally:
            self._cold.put(server)

    def bounds_s(self, suites: Sequence[FileTests]) -> dict[str, float]:
        """Returns how long each suite may take, from how long it takes on the right code. Raises PartError."""

        def right(suite: FileTests) -> float:
            came = self.trial(suite, None, _LONGEST_S)
            if not came["passed"]:
                raise PartError(f"the tests of {suite.file} fail as it is: {came['what']}", "mend that first")
            return _SLOWER * came["took_s"] + _MORE_S

        with ThreadPoolExecutor(self._jobs) as threads:
            return {suite.file: bound_s for suite, bound_s in zip(suites, threads.map(right, suites), strict=True)}

    def wrong(self, chosen: Sequence[tuple[FileTests, Mutation]], bounds_s: dict[str, float]) -> Iterator[TriedMutant]:
        def tried(one: tuple[FileTests, Mutation]) -> TriedMutant:
            suite, mutation = one
            source = mutated((self._root / suite.file).read_text("utf-8"), mutation)
            came = self.trial(suite, source, bounds_s[suite.file])
            if came["broken"]:
                raise PartError(f"the tests of {suite.file} were not run: {came['what']}", "mend that first")
            return TriedMutant(mutation, not came["passed"], by=came["what"], took_s=came["took_s"])

        with ThreadPoolExecutor(self._jobs) as threads:
            yield from threads.map(tried, chosen)


def score(table: MutationTable, seed: int, number: int, jobs: int, root: Path, stream: TextIO) -> list[TriedMutant]:
    """Runs the tests on a sample of wrong versions; those known to be equivalent are not run. Raises PartError."""
    for suite in table.suites:
        for place in (suite.file, *suite.tests):
            if not (root / place).exists():
                raise PartError(
                    f"there is no {place} here", "run `path-handoff verify --mutants` in a checkout of PATH"
                )
    chosen = choose(table, seed, number, root)
    known = [
        TriedMutant(one, False, why=table.equivalent[one.name]) for _, one in chosen if one.name in table.equivalent
    ]
    rest = [(suite, one) for suite, one in chosen if one.name not in table.equivalent]
    suites = [suite for suite in table.suites if any(suite == of for of, _ in rest)]
    tests = sorted({place for suite in suites for place in suite.tests})
    with Trials(root, jobs, tests) as trials:
        bounds_s = trials.bounds_s(suites)
        for came in trials.wrong(rest, bounds_s):
            known.append(came)
            stream.write(f"{'caught  ' if came.caught else 'SURVIVED'} {came.took_s:6.1f} s  {came.mutation.name}\n")
            stream.flush()
    return known


def summarize(tried: Sequence[TriedMutant], seed: int, wall_s: float) -> dict[str, Any]:
    """``mutants`` are those that are not equivalent."""
    real = [one for one in tried if not one.why]
    survivors = [one for one in real if not one.caught]
    by_file: dict[str, Counter[str]] = {}
    for one in real:
        by_file.setdefault(one.mutation.file, Counter()).update([("caught" if one.caught else "survived")])
    share = (len(real) - len(survivors)) / len(real) if real else 0.0
    return {
        "holds": share >= GOAL,
        "seed": seed,
        "generated": len(tried),
        "mutants": len(real),
        "mutants_caught": len(real) - len(survivors),
        "score": round(share, 4),
        "survivors": [{"name": one.mutation.name, "line": one.mutation.line} for one in survivors],
        "equivalent": [{"name": one.mutation.name, "why": one.why} for one in tried if one.why],
        "by_file": {name: dict(counts) for name, counts in sorted(by_file.items())},
        "by_operator": dict(Counter(one.mutation.operator for one in real)),
        "wall_s": round(wall_s, 1),
    }

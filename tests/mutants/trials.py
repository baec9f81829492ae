"""The tests of a file run on wrong versions of it, by programs that wait for orders."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TextIO

from tests.mutants.operators import Mutation, constants, mutated, rewritten
from tests.mutants.rooms import FileTests, Table, TableError

HERE = Path(__file__).parents[2]
WITH_THIS = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])]),
}
_SLOWER, _MORE_S = 3.0, 10.0  # than the right code: then a wrong version has hung
_ALONE_S = 20.0  # for one test that has failed or hung
_COLDER = 3.0  # how much longer a trial may take that imports everything anew
_SLOW_S = 600.0  # that those may take which are run on what the others do not notice
_LONGEST_S = 900.0


@dataclass(frozen=True, slots=True)
class Tried:
    """The result of a wrong version.

    Attributes:
        caught: a test failed or hung on it, did so again alone, and passes on the right code.
        by: that test, or the one that could not be believed.
        why: it is the same in all that counts.
    """

    mutation: Mutation
    caught: bool
    by: str = ""
    why: str = ""
    took_s: float = 0.0


class Server:
    """A ``warm`` one, which has collected these tests, or with none a ``cold`` one; what is said to
    it.
    """

    def __init__(self, root: Path, tests: Sequence[str] = ()) -> None:
        command = [sys.executable, "-m", f"tests.mutants.{'warm' if tests else 'cold'}", *tests]
        self._told = " ".join(["python", *command[1:]])
        self._process = subprocess.Popen(
            command,
            cwd=root,
            env=WITH_THIS,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def trial(
        self, sources: Mapping[str, str], tests: Sequence[str], bound_s: float
    ) -> dict[str, Any]:
        order = {"sources": sources, "tests": tests, "bound_s": bound_s}
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise TableError(
                f"the program that runs the tests has ended: see what `{self._told} < /dev/null` says"
            )
        return json.loads(answer)

    def close(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


class Trials:
    """Servers, one a job, and the trials they run.

    A wrong version is put into what is imported already, which takes a moment. Only one that is not
    noticed there, or cannot be put there, is tried again from the first import on, by a server that
    is started then. With ``quick`` only those are that are made at import, and no slow tests are
    asked: the others are survivors at once.
    """

    def __init__(self, root: Path, jobs: int, tests: Sequence[str], quick: bool = False) -> None:
        self._root = root
        self._jobs = jobs
        self._tests = tests
        self._quick = quick
        self._warm: SimpleQueue[Server] = SimpleQueue()
        self._cold: SimpleQueue[Server | None] = SimpleQueue()
        self._servers: list[Server] = []
        self._costs_s: dict[str, float] = {}

    def __enter__(self) -> Trials:
        for _ in range(self._jobs):
            self._servers.append(Server(self._root, self._tests))
            self._warm.put(self._servers[-1])
            self._cold.put(None)
        return self

    def __exit__(self, *_: object) -> None:
        for server in self._servers:
            server.close()

    def trial(
        self, suite: FileTests, source: str, bound_s: float, *, at_import: bool = False
    ) -> dict[str, Any]:
        """Run a trial on the next server that is free.

        Args:
            at_import: what is wrong shows in what the module makes when it is imported.
        """
        wrong = {suite.module: source}
        tests = self._cheapest_first(suite)
        server = self._warm.get()
        try:
            came = _asked(server, wrong, tests, bound_s)
        finally:
            self._warm.put(server)
        if not (came["passed"] or came["broken"]):
            return came
        if self._quick and not (came["broken"] or at_import):
            return came
        slow = () if self._quick else suite.slow
        longer_s = _COLDER * bound_s + (_SLOW_S if slow else 0.0)
        return self._from_the_first(wrong, (*tests, *slow), longer_s)

    def _cheapest_first(self, suite: FileTests) -> list[str]:
        """Order the tests: those of the file's own name, then those that take least."""
        own = Path(suite.file).stem

        def rank(test: str) -> tuple[bool, float]:
            return own not in Path(test).stem, self._costs_s.get(test.partition("::")[0], 0.0)

        return sorted(suite.tests, key=rank)

    def _from_the_first(
        self, wrong: Mapping[str, str], tests: Sequence[str], bound_s: float
    ) -> dict[str, Any]:
        server = self._cold.get()
        try:
            if server is None:
                server = Server(self._root)
                self._servers.append(server)
            return _asked(server, wrong, tests, bound_s)
        finally:
            self._cold.put(server)

    def bounds_s(self, suites: Sequence[FileTests]) -> dict[str, float]:
        """Return how long each suite may take, from how long it takes on the right code.

        The right code is put there as the wrong versions are: written anew from its syntax tree,
        without comments and with other line numbers, which a test must not notice. Raises
        TableError.
        """
        kinds: dict[frozenset[str], list[FileTests]] = {}
        for suite in suites:
            kinds.setdefault(frozenset(suite.tests), []).append(suite)

        def right(alike: list[FileTests]) -> float:
            sources = {one.module: (self._root / one.file).read_text() for one in alike}
            # what numba compiles cannot be put where it is already
            anew = {
                module: rewritten(source)
                for module, source in sources.items()
                if "path.compiled" not in source
            }
            server = self._warm.get()
            try:
                came = server.trial(anew, alike[0].tests, _LONGEST_S)
            finally:
                self._warm.put(server)
            if not came["passed"]:
                files = ", ".join(one.file for one in alike)
                raise TableError(f"the tests of {files} fail as it is: {came['what']}")
            self._costs_s.update(came["costs_s"])
            return _SLOWER * came["took_s"] + _MORE_S

        with ThreadPoolExecutor(self._jobs) as threads:
            found = dict(zip(kinds, threads.map(right, kinds.values()), strict=True))
        return {suite.file: found[frozenset(suite.tests)] for suite in suites}

    def wrong(
        self, chosen: Sequence[tuple[FileTests, Mutation]], bounds_s: dict[str, float]
    ) -> Iterator[Tried]:
        def tried(one: tuple[FileTests, Mutation]) -> Tried:
            suite, mutation = one
            right = (self._root / suite.file).read_text("utf-8")
            source = mutated(right, mutation)
            at_import = mutation.where in constants(right)
            came = self.trial(suite, source, bounds_s[suite.file], at_import=at_import)
            if came["broken"]:
                raise TableError(f"the tests of {suite.file} were not run: {came['what']}")
            return Tried(mutation, not came["passed"], by=came["what"], took_s=came["took_s"])

        with ThreadPoolExecutor(self._jobs) as threads:
            yield from threads.map(tried, chosen)


def _asked(
    server: Server, wrong: Mapping[str, str], tests: Sequence[str], bound_s: float
) -> dict[str, Any]:
    """Run a trial, and once more with more time where a test failed for another reason: the others
    may notice.
    """
    came = believed(server.trial(wrong, tests, bound_s), server, wrong, bound_s)
    if came["passed"] and came["what"]:
        bound_s *= _COLDER
        return believed(server.trial(wrong, tests, bound_s), server, wrong, bound_s)
    return came


def believed(
    came: dict[str, Any], server: Server, wrong: Mapping[str, str], bound_s: float
) -> dict[str, Any]:
    """Return a trial as it came, or as passed when its test fails for another reason: it passes
    alone, or fails on the right code too.
    """
    test = came["what"]
    if came["hung"] and "::" not in test:  # its time was over as its last test had passed
        return {**came, "passed": True, "what": "not because of it: it ran out of time"}
    if came["passed"] or came["broken"] or "::" not in test:
        return came  # no test failed, or none could be imported
    again = server.trial(wrong, [test], min(bound_s, _ALONE_S))
    right = server.trial({}, [test], min(bound_s, _ALONE_S))
    came["took_s"] += again["took_s"] + right["took_s"]
    if right["passed"] and not again["passed"]:
        return came
    return {**came, "passed": True, "what": f"not because of it: {test}"}


def score(
    table: Table,
    chosen: Sequence[tuple[FileTests, Mutation]],
    jobs: int,
    root: Path,
    stream: TextIO,
    quick: bool = False,
) -> list[Tried]:
    """Run the tests on wrong versions; those known to be equivalent are not run. Raises
    TableError.
    """
    for place in sorted(
        {place for tested, _ in chosen for place in (tested.file, *tested.tests, *tested.slow)}
    ):
        if not (root / place.partition("::")[0]).exists():
            raise TableError(f"there is no {place} here: run it in a checkout, and see rooms.toml")
    known = [Tried(one, False, why=why) for _, one in chosen if (why := table.why_the_same(one))]
    rest = [(tested, one) for tested, one in chosen if not table.why_the_same(one)]
    files = list(dict.fromkeys(tested for tested, _ in rest))
    tests = sorted({place for tested in files for place in tested.tests})
    if not rest:
        return known
    with Trials(root, jobs, tests, quick) as trials:
        bounds_s = trials.bounds_s(files)
        for came in trials.wrong(rest, bounds_s):
            known.append(came)
            stream.write(
                f"{'caught  ' if came.caught else 'SURVIVED'} {came.took_s:6.1f} s "
                f" {came.mutation.name}  [{came.by.rpartition('::')[2]}]\n"
            )
            stream.flush()
    return known

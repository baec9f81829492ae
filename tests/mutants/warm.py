"""Runs tests on wrong versions of modules that are imported already: ``python -m``, this module,
and test files.

All tests are collected once, on the right code. Each trial is a fork of that: in the child the
functions of one module get the code of another source, in place, and the tests of that module run
in it, until the first one fails. What was made of them before, at import or when tests were
collected, stays as it was, so that a wrong version which gets through here is worth a trial by
``cold``, from the first import on.

A line of JSON comes in for each trial: {"sources" (by module), "tests" (files, folders, or single
ones), "bound_s"}; one goes out: {"passed", "what" (the test that failed first, or hung), "hung",
"took_s", "broken", "costs_s"}: broken when the tests could not be run like this, and what each file
of tests took when all passed.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import FunctionType, ModuleType
from typing import IO, Any

from tests.mutants.cold import wait_for

_MARK = "<wrong version>"
_BROKEN = 77  # exit code of a child that could not run the tests


class NotHereError(Exception):
    """This wrong version cannot be put into a module that is imported already."""


def put_into(module: ModuleType, source: str) -> None:
    """A module gets another source's numbers, and its functions the code and defaults. Raises
    NotHereError.
    """
    made = ModuleType(module.__name__)
    made.__dict__.update(
        __package__=module.__package__, __file__=module.__file__, __spec__=module.__spec__
    )
    try:
        exec(compile(source, _MARK, "exec"), made.__dict__)
    except Exception as error:
        raise NotHereError(f"it cannot be imported: {error}") from error
    wrong = dict(_functions(made, made.__name__, set()))
    module.__dict__.update(_numbers(made))
    right = dict(_functions(module, module.__name__, set()))
    for name, function in wrong.items():
        if function.__code__.co_filename != _MARK:
            continue  # made by a decorator
        if name not in right:
            raise NotHereError(f"there is no {name}")
        try:
            right[name].__code__ = function.__code__
        except ValueError as error:
            raise NotHereError(f"{name}: {error}") from error
        if not any(isinstance(value, type) for value in function.__defaults__ or ()):
            right[name].__defaults__ = function.__defaults__
            right[name].__kwdefaults__ = function.__kwdefaults__


def _numbers(module: ModuleType) -> dict[str, int | float]:
    return {name: value for name, value in vars(module).items() if type(value) in (int, float)}


def _functions(holder: object, module: str, seen: set[int]) -> Iterator[tuple[str, FunctionType]]:
    """Those of a module or class that were written there, with their qualified names."""
    for key, value in list(vars(holder).items()):
        if isinstance(value, type):
            if value.__module__ == module and id(value) not in seen:
                seen.add(id(value))
                yield from _functions(value, module, seen)
            continue
        for part, one in enumerate(_parts(value)):
            if isinstance(one, FunctionType) and one.__module__ == module:
                owner = f"{holder.__qualname__}." if isinstance(holder, type) else ""
                yield f"{owner}{key} {part}", one


def _parts(value: object) -> list[object]:
    """The functions that something in a namespace is made of."""
    if isinstance(value, property):
        return [value.fget, value.fset, value.fdel]
    if isinstance(value, staticmethod | classmethod):
        return [inspect.unwrap(value.__func__)]
    if isinstance(value, functools.cached_property):
        return [value.func]
    if isinstance(value, dict):  # a table of functions
        return list(value.values())
    return [inspect.unwrap(value)] if callable(value) else []


class Serving:
    """A plugin of pytest: instead of running the tests, it runs some of them in a fork, whenever it
    is told to.
    """

    def __init__(self, orders: IO[str], answers: IO[str]) -> None:
        self._orders, self._answers = orders, answers
        self._said: int | None = None  # a child's, for what it has to say
        self._costs_s: dict[str, float] = {}

    def pytest_runtestloop(self, session: Any) -> bool | None:
        """None, in a child, has pytest run what is left in its list."""
        if session.testsfailed:
            return None
        for line in self._orders:
            order = json.loads(line)
            begun_s = time.monotonic()
            with tempfile.TemporaryFile() as said:
                child = os.fork()
                if child == 0:
                    self._become(session, order, os.dup(said.fileno()))
                    return None
                code = wait_for(child, begun_s + float(order["bound_s"]))
                with suppress(ProcessLookupError):
                    os.killpg(child, signal.SIGKILL)  # whatever a test that failed had started
                said.seek(0)
                what = said.read().decode(errors="replace")
            answer = {
                "passed": code == 0,
                "what": "" if code == 0 else what,
                "hung": code is None,
                "took_s": time.monotonic() - begun_s,
                "broken": code == _BROKEN,
                "costs_s": json.loads(what) if code == 0 else {},
            }
            self._answers.write(json.dumps(answer) + "\n")
            self._answers.flush()
        return True

    def _become(self, session: Any, order: dict[str, Any], said: int) -> None:
        """A child: silent, a process group of its own, the module wrong and the tests in their
        order.
        """
        os.setsid()
        self._said = said
        try:
            for module, source in order["sources"].items():
                put_into(importlib.import_module(module), source)
        except NotHereError as error:
            self._end(_BROKEN, str(error))
        session.items = [
            item for place in order["tests"] for item in session.items if _is_of(item.nodeid, place)
        ]
        if not session.items:
            self._end(_BROKEN, f"no tests in {order['tests']}")

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Leave word of the test that runs: it may be the one that never ends."""
        if self._said is not None:
            self._say(nodeid)

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and self._said is not None:
            self._end(1, report.nodeid)
        file = report.nodeid.partition("::")[0]
        self._costs_s[file] = self._costs_s.get(file, 0.0) + report.duration

    def pytest_internalerror(self, excrepr: Any) -> None:
        if self._said is not None:
            self._end(_BROKEN, str(excrepr)[-500:])

    def pytest_sessionfinish(self, session: Any, exitstatus: int) -> None:
        if self._said is not None:
            passed = session.testscollected and exitstatus == 0
            if passed:
                self._end(0, json.dumps(self._costs_s))
            self._end(_BROKEN, f"pytest ended with {exitstatus}")

    def _say(self, what: str) -> None:
        assert self._said is not None
        os.ftruncate(self._said, 0)
        os.pwrite(self._said, what.encode(), 0)

    def _end(self, code: int, what: str) -> None:
        """At once: what tests left open goes with the process group."""
        self._say(what)
        os._exit(code)


def _is_of(nodeid: str, place: str) -> bool:
    return nodeid == place or nodeid.startswith((f"{place}::", f"{place.rstrip('/')}/"))


def main(tests: Sequence[str]) -> int:
    orders, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    silent = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1):
        os.dup2(silent, number)
    sys.path.insert(0, str(Path.cwd()))
    import pytest  # noqa: PLC0415

    quiet = ["-q", "-n", "0", "-p", "no:cacheprovider", "--capture=sys", "--no-header", "--tb=no"]
    quiet += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        os.environ["PYTEST_DEBUG_TEMPROOT"] = folder
        return int(pytest.main([*quiet, *tests], plugins=[Serving(orders, answers)]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

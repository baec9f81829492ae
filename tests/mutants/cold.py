"""Runs a module's tests on its code and on wrong versions of it: ``python -m``, this module.

Everything that takes long to import and is not PATH's is imported once; each trial is a fork of
that. A line of JSON comes in for each: {"sources" (by module), "tests", "bound_s"}; one goes out:
{"passed", "what", "hung", "took_s", "broken"}, the last when the tests were not run at all.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.util
import json
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import IO, Any

_HEAVY = ("cv2", "msgspec", "numba", "numpy", "pytest", "pymavlink.mavutil", "rich.console", "tyro")
_POLL_S = 0.02
_MISUSED = (3, 4, 5)  # pytest's exit codes, when it ran no test
_NOT_IMPORTED = 2  # also pytest's, of tests that cannot import it
_SHOWN = 2000


class Wrong(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Has one module made from another source than the one in its file.

    ``file``: where that source stands, too: numba keeps what it compiles beside it, and compiles
    nothing without one.
    """

    def __init__(self, module: str, source: str, file: Path) -> None:
        self._module, self._source, self._file = module, source, file
        file.write_text(source, "utf-8")

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        del path, target
        return importlib.util.spec_from_loader(fullname, self) if fullname == self._module else None

    def exec_module(self, module: ModuleType) -> None:
        exec(compile(self._source, str(self._file), "exec"), module.__dict__)


def run_tests(order: dict[str, Any]) -> int:
    """pytest's exit code. In a process of its own: what it imports is not to be imported by another
    trial.
    """
    import pytest  # noqa: PLC0415

    for module, source in order["sources"].items():
        sys.meta_path.insert(0, Wrong(module, source, Path(order["folder"]) / "wrong.py"))
        # now: pytest loads the modules of its plugins' packages by itself, and would take this one
        # from its file
        try:
            importlib.import_module(module)
        except Exception:
            traceback.print_exc()
            return _NOT_IMPORTED
    quiet = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--no-header", "--tb=line"]
    # this module's own package is imported already
    quiet += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    return int(pytest.main([*quiet, *order["tests"]]))


def trial(order: dict[str, Any]) -> dict[str, Any]:
    begun_s = time.monotonic()
    with tempfile.TemporaryFile() as said, tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        order["folder"] = folder
        child = os.fork()
        if child == 0:
            _become(said)
            code = 3
            try:
                code = run_tests(order)
            except BaseException:
                traceback.print_exc()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        code = wait_for(child, begun_s + float(order["bound_s"]))
        said.seek(0)
        text = said.read().decode(errors="replace")[-_SHOWN:]
    took_s = time.monotonic() - begun_s
    if code in _MISUSED:
        return {"passed": False, "what": text, "hung": False, "took_s": took_s, "broken": True}
    what = _first(text)
    hung = code is None
    return {"passed": code == 0, "what": what, "hung": hung, "took_s": took_s, "broken": False}


def _become(said: IO[bytes]) -> None:
    """A process group of its own, silent."""
    os.setsid()
    os.dup2(said.fileno(), 1)
    os.dup2(said.fileno(), 2)


def wait_for(child: int, end_s: float) -> int | None:
    """Its exit code; None when it took too long, and is gone with all that it started."""
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > end_s:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(_POLL_S)


def _first(text: str) -> str:
    """The test that failed first."""
    return next(
        (
            line.partition(" - ")[0].partition(" ")[2]
            for line in text.splitlines()
            if line.startswith(("FAILED", "ERROR"))
        ),
        "",
    )


def main() -> None:
    sys.path.insert(0, str(Path.cwd()))
    whole = (Path.cwd() / "path").is_dir()  # another project imports what it needs itself
    for name in _HEAVY if whole else ("pytest",):
        importlib.import_module(name)
    for line in sys.stdin:
        sys.stdout.write(json.dumps(trial(json.loads(line))) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()

"""The settings of all tests: what they share, which may run side by side, and property tests that
repeat.

Property tests have the same examples each time everywhere, and no limit of wall time.

Machines are noisy. ``pytest --hypothesis-profile=explore`` looks for new examples.
"""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tests.kernels import LIMIT_S, compile_kernels, compile_tests
from tests.left_behind import end_left_behind
from tests.overloaded import REPEATED, Repeating, repetitions
from tests.scheduling import Groups, be_nice, told_by_group

# as in missions, and before any test loads numpy
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Workers and hundreds of short programs load the same modules: each is compiled once, and kept beside
# the kernels, which are kept in any case.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


FLYING = pytest.StashKey[Path]()
"""In the process that hands tests out: a file that is there while something flies."""
COMPILING = pytest.StashKey[list[subprocess.Popen[bytes]]]()
"""There too: what compiles kernels."""


# Signals that whoever began the tests ignores (nohup, a shell's `&`) would be ignored by the
# programs under test too: a handler keeps the tests running as before, and does not pass on to
# programs that they start.
def _go_on(_number: int, _frame: object) -> None:
    """Does nothing, as a signal that is ignored."""


for _ignored in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(_ignored) is signal.SIG_IGN:
        signal.signal(_ignored, _go_on)

settings.register_profile("steady", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=1000, deadline=None)
settings.load_profile("steady")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """All modules and tests stay to the end: they are not walked for garbage while they come, nor
    ever after.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """All tests on two cores: two workers compute in the background, beside the flights in a third
    one, and then beside what waits, in five.

    Some of the tests are run without workers, which take seconds to start and cannot show output.
    """
    if config.args_source is not config.ArgsSource.TESTPATHS or config.option.collectonly:
        return 0
    config.stash[COMPILING] = compile_kernels()
    compile_tests()
    return 7


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Groups:
    """Hand out tests once kernels are compiled, which began before workers did, unless their
    number was told.
    """
    if config.args_source is config.ArgsSource.TESTPATHS:
        for process in config.stash.get(COMPILING, None) or compile_kernels():
            process.wait(LIMIT_S)
    return Groups(config, log, config.stash[FLYING])


def pytest_configure_node(node: Any) -> None:
    """Tell each worker by which file it sees that something flies."""
    stash = node.config.stash
    if FLYING not in stash:
        handle, name = tempfile.mkstemp(prefix="path-tests-flying-")
        os.close(handle)
        stash[FLYING] = Path(name)
    node.workerinput["flying"] = str(stash[FLYING])


def pytest_testnodedown(node: Any, error: object) -> None:
    """End what a worker that died had started: its own ends were never run."""
    if error:
        end_left_behind(node.workerinput["workerid"], node.workerinput["testrunuid"])


def pytest_unconfigure(config: pytest.Config) -> None:
    if FLYING in config.stash:
        config.stash[FLYING].unlink(missing_ok=True)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker lets the others go first while it only computes: their limits are in seconds."""
    given: dict[str, str] | None = getattr(item.config, "workerinput", None)
    if given is not None:
        be_nice(item.nodeid, Path(given["flying"]).exists())


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Flights that a computer was too slow for are not hidden by those that were flown in their
    place.
    """
    again = repetitions(report for reports in terminalreporter.stats.values() for report in reports)
    if again:
        terminalreporter.section(
            f"{len(again)} flights were flown again: the computer was too slow"
        )
        for each in again:
            terminalreporter.write_line(each)
    if terminalreporter.config.args_source is pytest.Config.ArgsSource.TESTPATHS:
        every = (each for reports in terminalreporter.stats.values() for each in reports)
        told = told_by_group(each for each in every if isinstance(each, pytest.TestReport))
        terminalreporter.write_line("; ".join(told))


@pytest.fixture
def flown_again(request: pytest.FixtureRequest, tmp_path: Path) -> Repeating:
    """Flies a flight in real time, and again while the computer is too slow for it."""

    def tell(why: str) -> None:
        request.node.user_properties.append((REPEATED, why))

    return Repeating(tmp_path, tell)


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    """A key of a link, as it must be kept."""
    path = tmp_path / "pair.key"
    path.write_bytes(bytes(range(32)))
    path.chmod(0o600)
    return path

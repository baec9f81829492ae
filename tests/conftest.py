"""The settings of all tests: what they share, which may run side by side, and property tests that repeat.

Property tests have the same examples each time everywhere, and no limit of wall time.

Machines are noisy. ``pytest --hypothesis-profile=explore`` looks for new examples.
"""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in missions, and before any test loads numpy


# Signals that whoever began the tests ignores (nohup, a shell's `&`) would be ignored by the programs under test too:
# a handler keeps the tests running as before, and does not pass on to programs that they start.
def _go_on(_number: int, _frame: object) -> None:
    """Does nothing, as a signal that is ignored."""


for _ignored in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(_ignored) is signal.SIG_IGN:
        signal.signal(_ignored, _go_on)

# What has sockets, threads, processes and limits of its own: one at a time, and beside it what computes, and BESIDE.
REAL_TIME = (
    "contracts/",
    "drivers/",
    "flight/test_ceiling",
    "hil/",
    "missions/assurance/conformance/",
    "missions/test_bad_inputs.py::test_a_signal",
    "missions/test_cli",
    "missions/doctor/",
    "missions/guard/test_command",
    "missions/leg/records/test_failing_disk",
    "missions/leg/records/test_restart",
    "missions/leg/test_session",
    "missions/leg/records/test_slow_disk",
    "missions/test_ground_station",
    "missions/test_work",
    "missions/trials/beacon/test_trial.py::test_a_listener_on",
    "missions/trials/link/test_trial",
    "missions/assurance/verify/test_attack",
    "missions/assurance/verify/test_run",
    "scenarios/test_guard_sitl",
    "scenarios/test_own_sitl",
    "scenarios/test_relay_sitl",
    "scenarios/test_sitl",
    "scenarios/test_unplugged",
)
# What of these only computes.
COMPUTES = (
    "contracts/test_log_for_strangers",
    "drivers/detectors/",
    "hil/autopilot/",
    "hil/camera/test_pictures",
    "hil/camera/test_pipeline",
    "hil/geometric/",
    "hil/monitors/",
    "hil/montecarlo/",
    "hil/render/",
    "hil/vehicle/test_busy_world",
    "hil/world/",
)
# What of it waits most of its time, and has no port that is not its own: beside the rest, in a worker of its own.
BESIDE = (
    "contracts/",
    "drivers/mavlink/",
    "flight/test_ceiling",
    "hil/vehicle/",
    "missions/guard/test_command",
)
IN_REAL_TIME, BESIDE_REAL_TIME = "real time", "real time, beside the rest"
BEGUN = pytest.StashKey[bool]()
APART = ("scenarios/test_sim",)  # long tests that share nothing
# What takes longest of what computes. A worker is given up to three groups ahead: the last ones must be short.
LONG = (
    *APART,
    "contracts/test_log_for_strangers",
    "missions/assurance/campaign/",
    "missions/assurance/verify/",
    "missions/trials/",
    "scenarios/",
)

settings.register_profile("steady", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=1000, deadline=None)
settings.load_profile("steady")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """All modules and tests stay to the end: they are not walked for garbage while they come, nor ever after."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """All tests on two cores: what is in real time waits in two workers, and two others compute meanwhile.

    Some of the tests are run without workers, which take seconds to start and cannot show output.
    """
    return 4 if config.args_source is config.ArgsSource.TESTPATHS else 0


class Groups(LoadScopeScheduling):
    """Tests of one group stay in one worker: those in real time first, then long ones, then the largest group.

    A group is one of the two in real time, or the tests of a module, which share fixtures.
    """

    _ordered = False

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)

    def _assign_work_unit(self, node: Any) -> None:
        if not self._ordered:
            self._ordered = True
            for group in sorted(self.workqueue, key=urgency):
                self.workqueue.move_to_end(group)
        super()._assign_work_unit(node)


def urgency(group: str) -> int:
    """Returns which groups go first: the lower the sooner."""
    if group in (IN_REAL_TIME, BESIDE_REAL_TIME):
        return 0
    return 1 if group.removeprefix("tests/").startswith(LONG) else 2


def group_of(nodeid: str) -> str:
    test = nodeid.removeprefix("tests/")
    if test.startswith(APART):
        return nodeid
    if test.startswith(REAL_TIME) and not test.startswith(COMPUTES):
        return BESIDE_REAL_TIME if test.startswith(BESIDE) else IN_REAL_TIME
    return test.split("::", maxsplit=1)[0]


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Groups:
    return Groups(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that begins with what only computes lets the other go first whose limits are in seconds."""
    if "PYTEST_XDIST_WORKER" in os.environ and not item.config.stash.get(BEGUN, False):
        item.config.stash[BEGUN] = True
        if urgency(group_of(item.nodeid)) > 0:
            os.nice(15)  # two of them together take less than one at 10 would


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    """A key of a link, as it must be kept."""
    path = tmp_path / "pair.key"
    path.write_bytes(bytes(range(32)))
    path.chmod(0o600)
    return path

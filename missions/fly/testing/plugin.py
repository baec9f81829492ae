"""The plugin that pytest loads wherever PATH is installed. Nothing of PATH is imported before a
test asks for it.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from drivers.rig.parts import Rig
    from missions.fly.testing.flights import PytestFlights

pytest.register_assert_rewrite("missions.fly.testing.vehicle")  # its tests say what they found

FLOWN = pytest.StashKey[list[Path]]()
FAILED = pytest.StashKey[bool]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("path-handoff", "flights of two drones (PATH)")
    group.addoption(
        "--path-rig", default="sim", metavar="NAME|FILE", help="rig that is flown; sim by default"
    )
    group.addoption(
        "--path-runs",
        default="runs/pytest",
        metavar="DIR",
        help="where the folders of failed tests' runs are kept",
    )


@pytest.fixture
def path_rig(request: pytest.FixtureRequest) -> Rig:
    """The rig that ``--path-rig`` names, checked."""
    from drivers.interfaces import PartError  # noqa: PLC0415 (numpy behind it)
    from missions.ground import rig_library  # noqa: PLC0415

    try:
        return rig_library.load(str(request.config.getoption("--path-rig")))
    except PartError as error:
        pytest.fail(f"{error}\n  fix: {error.remedy}", pytrace=False)


@pytest.fixture
def path_flights(request: pytest.FixtureRequest, path_rig: Rig) -> PytestFlights:
    """Fly missions and handoffs on the rig of ``--path-rig``; a violated monitor fails the test."""
    from missions.fly.testing.flights import PytestFlights  # noqa: PLC0415 (numpy and numba behind it)

    runs = request.config.rootpath / str(request.config.getoption("--path-runs"))
    own = runs / re.sub(r"[^\w.=-]+", "_", request.node.nodeid)
    flown = request.node.stash.setdefault(FLOWN, [])
    return PytestFlights(path_rig, own, request.path.parent, flown.append)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failed test's report names its runs; those of one that passed are taken away."""
    report = yield
    flown = item.stash.get(FLOWN, [])
    if flown and report.failed:
        item.stash[FAILED] = True
        report.sections.append(("run folders", "\n".join(map(_with_page, flown))))
    if call.when == "teardown" and not item.stash.get(FAILED, False):
        for folder in flown:
            shutil.rmtree(folder, ignore_errors=True)
    return report


def _with_page(folder: Path) -> str:
    """Return a failed test's run as it is named, with a page where there is anything to show."""
    from drivers.interfaces import PartError  # noqa: PLC0415 (as above)
    from missions.look.report.command import write_report  # noqa: PLC0415
    from missions.look.report.records import PAGE  # noqa: PLC0415

    page = folder / PAGE
    with suppress(OSError, PartError):
        if not page.exists():
            write_report(folder, picture=False)
    return str(page if page.exists() else folder)

"""Which tests may run side by side, and in which order: the plan of the one command that runs them
all.

Used by ``tests/conftest.py``. A run has two phases. First flights in real time, one after another
in one worker: what is measured then is the flight's, not that of whatever shared its two cores.
Beside them two workers compute in the background (``tests/background.py``), which takes what the
flights leave, and the others wait. Then everything else side by side. It is decided where tests are
handed out, so that a worker that dies holds nobody up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from xdist.scheduler import LoadScopeScheduling

from tests import background

# Programs, vehicles and links in real time, judged by what happens within fractions of a second.
FLYING = (
    "missions/proofs/conformance/test_suite",
    "scenarios/test_guard_sitl",
    "scenarios/test_own_sitl",
    "scenarios/test_relay_sitl",
    "scenarios/test_sitl",
)
# What has sockets, threads, processes and limits of its own: one at a time, and beside it what
# computes, and BESIDE.
REAL_TIME = (
    "contracts/",
    "drivers/",
    "flight/test_ceiling",
    "hil/",
    "missions/proofs/conformance/",
    "missions/test_cli",
    "missions/field/doctor/",
    "missions/fly/guard/test_command",
    "missions/fly/test_stand_in",
    "missions/fly/leg/records/test_failing_disk",
    "missions/fly/leg/records/test_restart",
    "missions/fly/leg/test_session",
    "missions/fly/leg/records/test_slow_disk",
    "missions/ground/test_ground_station",
    "missions/ground/test_work",
    "missions/trials/flights/beacon/test_trial.py::test_a_listener_on",
    "missions/proofs/verify/test_attack",
    "missions/proofs/verify/test_run",
    "scenarios/test_unplugged",
)
# What of these only computes.
COMPUTES = (
    "contracts/test_log_for_strangers",
    "drivers/beacons/test_dashboard_log",
    "drivers/beacons/test_frames",
    "drivers/beacons/test_log",
    "drivers/detectors/",
    "drivers/link/test_end",
    "drivers/link/test_framing",
    "drivers/link/test_units",
    "drivers/link/test_wire",
    "drivers/perception/test_depth",
    "drivers/perception/test_history",
    "drivers/realsense/test_registration",
    "drivers/recordings/test_h264",
    "drivers/recordings/test_recording",
    "drivers/rig/",
    "hil/autopilot/",
    "hil/camera/test_pictures",
    "hil/camera/test_pipeline",
    "hil/geometric/",
    "hil/monitors/",
    "hil/montecarlo/",
    "hil/render/",
    "hil/vehicle/test_busy_world",
    "hil/world/",
    "missions/proofs/verify/test_run",
)
FLIGHTS, IN_REAL_TIME = "flights", "real time"
# What of it waits most of its time, and has no port that is not its own: in workers of their own,
# beside the rest. Each takes about as long as what is left.
BESIDE = {
    "real time, flown": (
        "drivers/mavlink/test_vehicle.py",
        "flight/test_ceiling",
        "missions/fly/guard/test_command",
    ),
    "real time, vehicles": ("drivers/mavlink/",),
    "real time, contracts": ("contracts/", "hil/vehicle/"),
    "real time, cameras": (
        "drivers/perception/",
        "drivers/realsense/",
        "drivers/recordings/",
        "drivers/tello/",
        "hil/camera/",
        "missions/field/doctor/",
        "scenarios/test_unplugged",
    ),
}
# long tests that share nothing
APART = (
    "missions/fly/relay/test_command",
    "missions/fly/team/test_command",
    "mutants/test_mutants",
    "scenarios/test_sim",
)
# What takes longest of what computes. A worker is given up to three groups ahead: the last ones
# must be short.
LONG = (
    *APART,
    "contracts/test_log_for_strangers",
    "docs/test_systems",
    "hil/montecarlo/",
    "missions/field/calibrate/",
    "missions/fly/own/",
    "missions/proofs/campaign/",
    "missions/proofs/verify/",
    "missions/trials/",
    "outside/",
    "scenarios/",
)
# What begins programs in sessions of their own, which are not in the background.
SESSIONS = ("missions/ground/test_held", "missions/look/live/", "missions/look/view/", "mutants/")
COMPUTING = 2
"""Workers that compute in the background from the first flight on."""


def group_of(nodeid: str) -> str:
    """The group of a test, which stays in one worker: flights, one of those in real time, or its
    module.
    """
    test = nodeid.removeprefix("tests/")
    if test.startswith(FLYING):
        return FLIGHTS
    if test.startswith(APART):
        return nodeid
    if test.startswith(REAL_TIME) and not test.startswith(COMPUTES):
        return next(
            (group for group, tests in BESIDE.items() if test.startswith(tests)), IN_REAL_TIME
        )
    return test.split("::", maxsplit=1)[0]


def urgency(group: str) -> int:
    """Return which groups go first: the lower the sooner."""
    if group == FLIGHTS:
        return 0
    if group == IN_REAL_TIME or group in BESIDE:
        return 1
    return 2 if group.removeprefix("tests/").startswith(LONG) else 3


def computes(nodeid: str) -> bool:
    """Whether a test only computes, so that it may wait for those whose limits are in seconds."""
    return urgency(group_of(nodeid)) > 1


def fits_beside_flights(group: str) -> bool:
    """Whether flights are not disturbed by it."""
    return (
        background.POSSIBLE
        and urgency(group) > 1
        and not group.removeprefix("tests/").startswith(SESSIONS)
    )


def be_nice(nodeid: str, flying: bool) -> None:
    """Make this worker as urgent as the test that comes next, and as whether something flies asks
    for.

    Whoever may not become more urgent again (anybody but root) stays as nice as a computing test
    was: real-time groups are handed out first.
    """
    if computes(nodeid):
        background.go(background.NICER if flying else background.A_LITTLE_NICER)
    else:
        background.come_back()


def told_by_group(reports: Iterable[Any]) -> list[str]:
    """Return when flights, each group in real time, and all that computes began and were over, s
    after the first test: what is last makes a run as long as it is.
    """
    spans: dict[str, tuple[float, float]] = {}
    for report in reports:
        if not report.start:  # its worker died
            continue
        group = group_of(report.nodeid)
        group = group if urgency(group) < 2 else "computes"
        begun, over = spans.get(group, (math.inf, 0.0))
        spans[group] = min(begun, report.start), max(over, report.stop)
    first = min((begun for begun, _ in spans.values()), default=0.0)
    return [
        f"{group}: {begun - first:.0f} to {over - first:.0f} s"
        for group, (begun, over) in sorted(spans.items(), key=lambda each: each[1])
    ]


class Groups(LoadScopeScheduling):
    """Hands out flights first, to one worker, and beside them to two workers what computes; then the
    other groups, by their urgency.
    """

    _computing: tuple[Any, ...] | None = None

    def __init__(self, config: Any, log: Any, flying: Path) -> None:
        """``flying``: a file that is there until the last flight is down, for the workers."""
        super().__init__(config, log)
        self._file = flying

    def schedule(self) -> None:
        super().schedule()
        if not self._flying():
            self._file.unlink(missing_ok=True)

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)

    def mark_test_complete(self, node: Any, item_index: int, duration: float = 0) -> None:
        flew = self._flying()
        super().mark_test_complete(node, item_index, duration)
        if flew and not self._flying():
            self._everybody_goes_on()

    def remove_node(self, node: Any) -> str | None:
        """Give others what a worker that ended has not done; return the test that it died in.

        That test has failed and is not given to anybody: xdist would have one worker after the
        other die of it.
        """
        groups = self.assigned_work.pop(node)
        left = [
            (tests, test) for tests in groups.values() for test, done in tests.items() if not done
        ]
        if not left:
            return None
        tests, died_in = left[0]
        tests[died_in] = True
        self.workqueue.update(
            (group, tests) for group, tests in groups.items() if not all(tests.values())
        )
        self._everybody_goes_on()
        return died_in

    def _everybody_goes_on(self) -> None:
        """Give everybody work, and tell the workers once the last flight is down."""
        if not self._flying():
            self._file.unlink(missing_ok=True)
        for each in self.nodes:
            self._reschedule(each)

    def _reschedule(self, node: Any) -> None:
        """Give a worker as much as it needs to go on; nothing while it does not know its tests.

        It runs a test only when it has the next one, or the word that none comes: one that came in
        the place of another and was given a group of one test would wait for ever.
        """
        if node not in self.registered_collections:
            return
        held = -1
        while held < (pending := self._pending_of(self.assigned_work[node])):
            held = pending
            super()._reschedule(node)

    def _assign_work_unit(self, node: Any) -> None:
        self._order()
        group = self._next_for(node)
        if group is not None:
            self.workqueue.move_to_end(group, last=False)
            super()._assign_work_unit(node)

    def _order(self) -> None:
        """Each time: a worker that died has put what it had not done at the end."""
        if self._computing is None:
            self._computing = tuple(self.nodes[1:][-COMPUTING:])
        for group in sorted(self.workqueue, key=urgency):
            self.workqueue.move_to_end(group)

    def _next_for(self, node: Any) -> str | None:
        """Return the group that a worker is given next; None while it has to wait."""
        assert self._computing is not None
        first = next(iter(self.workqueue))
        flying = self._flying()
        if node in self._computing:
            # What has limits in seconds is for workers that were never in the background.
            fitting = (
                group
                for group in self.workqueue
                if urgency(group) > 1 and (not flying or fits_beside_flights(group))
            )
            return next(fitting, None if flying else first)

        if not flying or FLIGHTS in self.assigned_work[node]:
            return first

        # A worker that died has given its flights back: whoever has nothing else to do takes them.
        others = (work for each, work in self.assigned_work.items() if each not in self._computing)
        busy = any(self._pending_of(work) for work in others)
        return FLIGHTS if FLIGHTS in self.workqueue and not busy else None

    def _flying(self) -> bool:
        """Whether a flight is still to come, or in the air."""
        if FLIGHTS in self.workqueue:
            return True
        given = (work.get(FLIGHTS, {}) for work in self.assigned_work.values())
        return any(not all(flights.values()) for flights in given)

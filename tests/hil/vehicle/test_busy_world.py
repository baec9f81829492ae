"""A world that gets to its packets late: what came in counts from when it came, and what came late
counts as late.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode
from hil.monitors.monitors import Monitors
from path.config import MethodConfig
from path.messages import Role
from tests.exact_world import QUICK
from tests.hil.vehicle.mavlink_bench import Bench

STILL = (0.0, 0.0, 0.0)
TOLERANCE_S = 1e-6


class BusyBench(Bench):
    """The kernel's stamps are what a test says they are: ``stamps``, in the order of what is sent;
    after them now.
    """

    def __init__(self) -> None:
        self.stamps: list[float] = []
        super().__init__(arrived=lambda _: self.stamps.pop(0) if self.stamps else self.now_s)

    def offboard(self) -> None:
        """Flies by setpoints, one every 0.05 s, the newest just now."""
        self.fly_at(0.8)
        self.setpoint(STILL)
        assert (
            self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
        )
        for _ in range(4):
            self.setpoint(STILL)
            self.run(0.05)
        self.setpoint(STILL)
        self.run(0.005)
        assert self.drone.autopilot.mode is FlightMode.OFFBOARD

    def stand_still(self, duration_s: float, *sent_s: float) -> None:
        """The world does nothing for a while, and then all at once; setpoints come so long after it
        stopped.
        """
        self.stamps += [self.now_s + at_s for at_s in sent_s]
        for _ in sent_s:
            self.setpoint(STILL)
        self.now_s += duration_s
        self.world.advance(self.now_s)
        self.vehicle.pump(self.now_s)

    @property
    def violations(self) -> dict[str, int]:
        monitors = Monitors.of_pair(MethodConfig())
        monitors.on_offboard(Role.SENDER, self.drone.autopilot.offboard_sessions)
        return dict(monitors.violations)


@pytest.fixture
def bench() -> Iterator[BusyBench]:
    made = BusyBench()
    yield made
    made.close()


def test_setpoints_that_came_while_the_world_stood_still_came_in_time(bench: BusyBench) -> None:
    bench.offboard()
    bench.stand_still(0.45, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30, 0.35, 0.40)
    bench.setpoint(STILL)
    bench.run(0.02)
    assert bench.drone.autopilot.setpoint_gap_s < 0.075
    assert bench.violations == {}


@pytest.mark.parametrize("sent_s", [(0.05, 0.30, 0.35, 0.40), (0.05, 0.10), (0.38, 0.42)])
def test_a_program_that_sent_late_meanwhile_is_told_on(
    bench: BusyBench, sent_s: tuple[float, ...]
) -> None:
    bench.offboard()
    bench.stand_still(0.45, *sent_s)
    gaps = [b - a for a, b in zip((-0.005, *sent_s), (*sent_s, 0.45), strict=True)]
    # a tick, while it is open
    assert bench.drone.autopilot.setpoint_gap_s == pytest.approx(max(gaps), abs=0.021)
    assert bench.violations == {"S8": 1}


def test_a_program_that_sends_late_is_told_on_by_a_world_that_keeps_up(bench: BusyBench) -> None:
    bench.offboard()
    bench.run(0.25)
    bench.setpoint(STILL)
    bench.run(0.02)
    assert bench.drone.autopilot.setpoint_gap_s == pytest.approx(0.25, abs=0.011)
    assert bench.violations == {"S8": 1}


def test_the_autopilot_gives_up_nobody_whose_setpoints_wait(bench: BusyBench) -> None:
    """Its own failsafe goes by the same times: it comes after a stop, as long after it as ever."""
    bench.offboard()
    autopilot = bench.drone.autopilot
    bench.stand_still(0.9, *(0.05 * k for k in range(1, 18)))
    assert autopilot.mode is FlightMode.OFFBOARD
    stopped_s = bench.now_s
    bench.stand_still(0.9, 0.1, 0.2)
    assert autopilot.mode is FlightMode.HOLD
    (session,) = autopilot.offboard_sessions
    assert session.end_s is not None
    assert session.end_s - stopped_s == pytest.approx(0.2 + QUICK.offboard_loss_s, abs=0.021)


def test_what_came_after_the_newest_step_waits_for_the_next(bench: BusyBench) -> None:
    """The world's time is the time it was stepped to; a packet that came since is not heard before
    it was sent.
    """
    bench.offboard()
    heard: list[tuple[float, Any]] = []
    bench.vehicle.tap = lambda at_s, message: heard.append((at_s, message))
    came_s = bench.now_s + 0.012
    bench.stand_still(0.005, 0.012)
    assert heard == []
    bench.run(0.015)
    assert [at_s for at_s, _ in heard] == [pytest.approx(came_s, abs=TOLERANCE_S)]


def test_channels_are_heard_in_the_order_of_their_packets(bench: BusyBench) -> None:
    """A command that came last is obeyed last, whichever was read first."""
    bench.offboard()
    seen: list[str] = []
    bench.vehicle.tap = lambda _, message: seen.append(message.get_type())
    bench.stamps += [bench.now_s + 0.04, bench.now_s + 0.01]
    bench.send(mavlink.MAVLink_command_long_message(7, 1, mavlink.MAV_CMD_NAV_LAND, 0, *[0.0] * 7))
    bench.setpoint(STILL)
    bench.run(0.06)
    assert seen == ["SET_POSITION_TARGET_LOCAL_NED", "COMMAND_LONG"]


def test_a_vehicle_off_the_wire_hears_nothing(bench: BusyBench) -> None:
    bench.fly_at(0.8)
    bench.vehicle.close()
    bench.world.advance(bench.now_s + 0.1)

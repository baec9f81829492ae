"""Each command and the wait for what it was for, in virtual time, on a session and telemetry that
stand in.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.interfaces import FlightMode, TakenOver, VehicleError
from drivers.mavlink.manoeuvres import Manoeuvres
from drivers.mavlink.modes import ARDUPILOT, PX4
from drivers.mavlink.session import ACCEPTED
from hil.harness.virtual_time import run_virtual

DENIED = 2
CONFIG = SimpleNamespace(mode_timeout_s=3.0, take_off_tolerance_m=0.3)
Sent = tuple[int, tuple[float | None, ...], int]


class Clock:
    def now_ns(self) -> int:
        return round((100.0 + asyncio.get_running_loop().time()) * 1e9)


@dataclass
class Telemetry:
    """The newest of a vehicle, as it was set."""

    clock: Clock = field(default_factory=Clock)
    mode: FlightMode = FlightMode.HOLD
    mode_told: int = 2
    reported_mode: Any = None
    position: Any = None
    velocity_n_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    armed: bool = True
    heartbeat: Any = None
    texts: list[str] = field(default_factory=list[str])

    def state(self) -> Any:
        return SimpleNamespace(armed=self.armed)

    def texts_since(self, _stamp_ns: int) -> list[str]:
        return self.texts

    def missing(self) -> list[str]:
        return ["global position"]

    def show(self, mode: FlightMode, told: int = 2) -> None:
        self.mode, self.mode_told = mode, told
        self.reported_mode = SimpleNamespace(arrival_ns=self.clock.now_ns())

    def at(self, above_home_m: float, climbs_mps: float = 0.0) -> None:
        self.position = SimpleNamespace(above_home_m=above_home_m, altitude_m=488.0 + above_home_m)
        self.velocity_n_mps = (0.0, 0.0, -climbs_mps)


@dataclass
class Session:
    """What was sent, and what is answered."""

    result: int | None = ACCEPTED
    sent: list[Sent] = field(default_factory=list[Sent])
    parameters: list[tuple[str, float]] = field(default_factory=list[tuple[str, float]])

    async def command(
        self, command: int, params: tuple[float | None, ...], tries: int
    ) -> int | None:
        self.sent.append((command, params, tries))
        await asyncio.sleep(0.01)
        return self.result

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end_s = asyncio.get_running_loop().time() + timeout_s
        while not condition():
            if asyncio.get_running_loop().time() >= end_s:
                return False
            await asyncio.sleep(0.02)
        return True

    async def set_float_parameter(self, name: str, value: float) -> None:
        self.parameters.append((name, value))


class Bench:
    def __init__(self) -> None:
        self.session, self.telemetry = Session(), Telemetry()
        parts = cast(Any, (self.session, self.telemetry, CONFIG))
        self.manoeuvres = Manoeuvres(*parts)

    def later(self, after_s: float, do: Callable[..., None], *args: Any) -> None:
        asyncio.get_running_loop().call_later(after_s, do, *args)


def fly(main: Callable[[Bench], Coroutine[Any, Any, None]]) -> None:
    async def run() -> None:
        await main(Bench())

    run_virtual(run())


async def refused(step: Coroutine[Any, Any, None], kind: type[VehicleError] = VehicleError) -> str:
    with pytest.raises(VehicleError) as caught:
        await step
    assert type(caught.value) is kind
    return str(caught.value)


# --- one command


def test_a_command_that_is_accepted_is_sent_once_as_it_is() -> None:
    async def main(bench: Bench) -> None:
        await bench.manoeuvres.do("go", 7, (1.0, 2.0))
        await bench.manoeuvres.do("go", 8, (None,), 3)
        assert bench.session.sent == [(7, (1.0, 2.0), 1), (8, (None,), 3)]

    fly(main)


def test_a_command_without_an_answer_says_that_nobody_knows() -> None:
    async def main(bench: Bench) -> None:
        bench.session.result = None
        said = await refused(bench.manoeuvres.do("go", 7, ()))
        assert "no answer to the command to go" in said and "unknown" in said
        assert asyncio.get_running_loop().time() < 0.1

    fly(main)


@pytest.mark.parametrize(
    ("text", "said"), [("crash detected", "crash detected"), (None, "global position missing")]
)
def test_a_refusal_says_the_vehicle_s_own_reason_which_may_come_after_it(
    text: str | None, said: str
) -> None:
    async def main(bench: Bench) -> None:
        bench.session.result = DENIED
        if text is not None:
            bench.later(0.4, bench.telemetry.texts.append, text)
        told = await refused(bench.manoeuvres.do("arm", 400, ()))
        assert "refused to arm" in told and said in told
        assert asyncio.get_running_loop().time() == pytest.approx(
            0.51 if text is None else 0.41, abs=0.05
        )

    fly(main)


def test_an_answer_that_mavlink_has_no_word_for_is_told_by_its_number() -> None:
    async def main(bench: Bench) -> None:
        bench.session.result = 99
        assert "(result 99)" in await refused(bench.manoeuvres.do("arm", 400, ()))

    fly(main)


# --- modes


@pytest.mark.parametrize(("kind", "params"), [(PX4, (1, 4.0, 3.0)), (ARDUPILOT, (1, 17.0, 0.0))])
def test_a_mode_is_changed_once_a_younger_report_shows_it(
    kind: Any, params: tuple[float, ...]
) -> None:
    async def main(bench: Bench) -> None:
        telemetry = bench.telemetry
        telemetry.show(FlightMode.HOLD)  # already, as an older report says
        bench.manoeuvres.kind = kind
        await asyncio.sleep(0.0)
        changing = asyncio.create_task(bench.manoeuvres.change_mode(FlightMode.HOLD, "hold", 3))
        await asyncio.sleep(1.0)
        assert not changing.done() and bench.session.sent == [(176, params, 3)]
        telemetry.show(FlightMode.HOLD)
        await changing

    fly(main)


def test_a_mode_that_never_comes_is_an_error_with_the_vehicle_s_reason() -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.texts = ["no local position"]
        said = await refused(bench.manoeuvres.change_mode(FlightMode.OFFBOARD, "fly setpoints"))
        assert "agreed to fly setpoints but is in mode hold: no local position" in said
        assert asyncio.get_running_loop().time() == pytest.approx(3.0, abs=0.1)

    fly(main)


@pytest.mark.parametrize(("told", "kind"), [(1, VehicleError), (2, TakenOver)])
def test_a_mode_of_somebody_else_s_is_theirs_once_more_than_one_message_says_so(
    told: int, kind: type[VehicleError]
) -> None:
    async def main(bench: Bench) -> None:
        bench.later(0.5, bench.telemetry.show, FlightMode.OTHER, told)
        await refused(bench.manoeuvres.change_mode(FlightMode.OFFBOARD, "fly"), kind)

    fly(main)


# --- take-off


def test_a_px4_is_told_an_altitude_above_the_sea_and_an_ardupilot_a_height() -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.at(0.0)
        bench.later(1.0, bench.telemetry.at, 1.5)
        await bench.manoeuvres.take_off(1.5, 10.0)
        assert bench.session.sent == [(22, (None,) * 6 + (489.5,), 1)]
        assert bench.session.parameters == [("MIS_TAKEOFF_ALT", 1.5)]
        bench.manoeuvres.kind = ARDUPILOT
        bench.telemetry.show(FlightMode.OFFBOARD)
        await bench.manoeuvres.take_off(1.5, 10.0)
        assert bench.session.sent[1:] == [(22, (0.0,) * 6 + (1.5,), 1)]
        assert len(bench.session.parameters) == 1

    fly(main)


@pytest.mark.parametrize("position", [None, SimpleNamespace(above_home_m=0.0, altitude_m=math.nan)])
def test_a_px4_without_an_altitude_does_not_take_off(position: Any) -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.position = position
        assert "tells no altitude" in await refused(bench.manoeuvres.take_off(1.5, 10.0))
        assert bench.session.sent == []

    fly(main)


@pytest.mark.parametrize(
    ("above_m", "climbs_mps", "mode", "there"),
    [
        (1.5, 0.0, FlightMode.HOLD, True),
        (1.75, 0.0, FlightMode.HOLD, True),
        (1.25, 0.0, FlightMode.HOLD, True),
        (1.85, 0.0, FlightMode.HOLD, False),
        (1.15, 0.0, FlightMode.HOLD, False),
        (1.5, 0.3, FlightMode.HOLD, True),
        (1.5, 0.31, FlightMode.HOLD, False),
        (1.5, -0.31, FlightMode.HOLD, False),
        (1.5, 0.0, FlightMode.TAKEOFF, False),
    ],
)
def test_a_climb_is_over_at_its_height_and_at_rest_and_in_the_mode_that_ends_it(
    above_m: float, climbs_mps: float, mode: FlightMode, there: bool
) -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.at(0.0)
        bench.telemetry.show(mode)
        bench.later(1.0, bench.telemetry.at, above_m, climbs_mps)
        climbing = asyncio.create_task(bench.manoeuvres.take_off(1.5, 9.0))
        await asyncio.sleep(2.0)
        assert climbing.done() is there
        if not there:
            assert "not at 1.5 m 9 s after" in await refused(cast(Any, climbing))

    fly(main)


@pytest.mark.parametrize(
    ("above_m", "mode", "told", "kind"),
    [
        (0.5, FlightMode.OTHER, 2, TakenOver),
        (0.5, FlightMode.OTHER, 1, None),
        (0.5, FlightMode.LAND, 2, TakenOver),
        (0.5, FlightMode.HOLD, 2, TakenOver),  # 2.5 m short of where it was told to go
        (1.0, FlightMode.HOLD, 2, None),  # as short as a PX4 may end it
    ],
)
def test_a_climb_that_somebody_ends_is_theirs_after_the_time_that_a_mode_may_take(
    above_m: float, mode: FlightMode, told: int, kind: type[VehicleError] | None
) -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.at(above_m)
        bench.telemetry.show(mode, told)
        climbing = asyncio.create_task(bench.manoeuvres.take_off(3.0, 9.0))
        await asyncio.sleep(2.9)
        assert not climbing.done()
        await asyncio.sleep(0.3)
        assert climbing.done() is (kind is not None)
        await refused(cast(Any, climbing), kind or VehicleError)

    fly(main)


@pytest.mark.parametrize(
    ("heartbeat", "kind", "said"),
    [
        (None, VehicleError, "disarmed"),
        (SimpleNamespace(disarmed=True), VehicleError, "disarmed"),
        (SimpleNamespace(disarmed=False), TakenOver, "the motors were stopped"),
    ],
)
def test_motors_that_stop_on_the_way_up_end_it_at_once_and_say_whose_doing_it_was(
    heartbeat: Any, kind: type[VehicleError], said: str
) -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.at(0.5)
        bench.telemetry.show(FlightMode.TAKEOFF)
        bench.telemetry.heartbeat = heartbeat
        bench.later(1.0, setattr, bench.telemetry, "armed", False)
        assert said in await refused(bench.manoeuvres.take_off(3.0, 9.0), kind)
        assert asyncio.get_running_loop().time() < 1.2

    fly(main)


# --- landing


@pytest.mark.parametrize(("kind", "unset"), [(PX4, None), (ARDUPILOT, 0.0)])
def test_a_landing_is_over_when_the_vehicle_is_disarmed(kind: Any, unset: float | None) -> None:
    async def main(bench: Bench) -> None:
        bench.manoeuvres.kind = kind
        bench.later(0.2, bench.telemetry.show, FlightMode.LAND)
        bench.later(5.0, setattr, bench.telemetry, "armed", False)
        await bench.manoeuvres.land(20.0)
        assert asyncio.get_running_loop().time() == pytest.approx(5.0, abs=0.1)
        assert bench.session.sent == [(21, (0.0, 0.0, 0.0, unset, unset, unset, 0.0), 3)]

    fly(main)


def test_a_vehicle_that_is_down_already_has_landed() -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.armed = False
        await bench.manoeuvres.land(20.0)
        assert asyncio.get_running_loop().time() < 0.1

    fly(main)


@pytest.mark.parametrize(("told", "landings"), [(2, 2), (1, 1)])
def test_a_landing_that_the_end_of_a_take_off_overrode_is_begun_again(
    told: int, landings: int
) -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.show(FlightMode.TAKEOFF)
        bench.later(0.2, bench.telemetry.show, FlightMode.HOLD, told)
        bench.later(1.0, bench.telemetry.show, FlightMode.LAND)
        bench.later(5.0, setattr, bench.telemetry, "armed", False)
        await bench.manoeuvres.land(20.0)
        assert len(bench.session.sent) == landings

    fly(main)


def test_a_landing_that_takes_too_long_is_told() -> None:
    async def main(bench: Bench) -> None:
        bench.later(0.2, bench.telemetry.show, FlightMode.LAND)
        assert "not on the ground 20 s after" in await refused(bench.manoeuvres.land(20.0))
        assert asyncio.get_running_loop().time() == pytest.approx(20.2, abs=0.1)

    fly(main)


@pytest.mark.parametrize(
    ("mode", "told", "disarms_s", "kind", "ends_s"),
    [
        (FlightMode.OTHER, 2, None, TakenOver, 5.0),
        # a landed PX4 goes back to it before it says it is disarmed
        (FlightMode.OFFBOARD, 2, None, TakenOver, 6.5),
        (FlightMode.OFFBOARD, 2, 1.0, None, 6.0),
        (FlightMode.OTHER, 1, 1.0, None, 6.0),
    ],
)
def test_another_mode_in_a_landing_is_somebody_s_when_the_vehicle_stays_armed(
    mode: FlightMode,
    told: int,
    disarms_s: float | None,
    kind: type[VehicleError] | None,
    ends_s: float,
) -> None:
    async def main(bench: Bench) -> None:
        bench.later(0.2, bench.telemetry.show, FlightMode.LAND)
        bench.later(5.0, bench.telemetry.show, mode, told)
        if disarms_s is not None:
            bench.later(5.0 + disarms_s, setattr, bench.telemetry, "armed", False)
        if kind is None:
            await bench.manoeuvres.land(20.0)
        else:
            await refused(bench.manoeuvres.land(20.0), kind)
        assert asyncio.get_running_loop().time() == pytest.approx(ends_s, abs=0.1)

    fly(main)

"""The opening and the end of a session, and what it sends, on a MAVSDK that stands in."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
from mavsdk.exceptions import MavsdkError

from drivers.interfaces import VehicleError
from drivers.mavlink import session as session_file
from drivers.mavlink.modes import PX4
from tests.drivers.mavlink.mavsdk_bench import SYSID
from tests.drivers.mavlink.test_answers import Session
from tests.drivers.mavlink.test_session_alone import beat

LogLevel = session_file.mavsdk_logging.LogLevel


class Opening:
    """What a session opens, and in which order what of it ends."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **options: Any) -> None:
        self.done: list[str] = []
        self.hears = True
        self.fails = False
        self.with_line = False
        self.bed = Session(connect_timeout_s=0.3, **options)
        self.session = self.bed.session
        opened: Any = self.session
        opened._direct = None
        system = SimpleNamespace(get_system_id=lambda: SYSID, has_autopilot=lambda: True)
        self.system = system

        opening = self

        class Part:
            def __init__(self, name: str, given: object) -> None:
                self.name, self.given = name, given
                opening.done.append(f"makes {name}")
                opening.made[name] = self

            def destroy(self) -> None:
                opening.done.append(f"destroys {self.name}")

        class Mavsdk(Part):
            def add_any_connection_with_handle(self, url: str) -> None:
                opening.done.append(f"connects {url}")
                if opening.fails:
                    raise MavsdkError("no such device")

            def get_systems(self) -> list[Any]:
                return [system]

        class Direct(Part):
            def subscribe_message(self, name: str, handler: Any) -> None:
                if name == "HEARTBEAT" and opening.hears:
                    beat(opening.bed)

        class Line:
            ignored = {"a second vehicle": 3}  # noqa: RUF012

            def __init__(self, *args: Any) -> None:
                opening.line_args = args

            def start(self, mavsdk: object) -> None:
                assert mavsdk is opening.made["mavsdk"]
                opening.done.append("line starts")

            def stop(self) -> None:
                opening.done.append("line stops")

            def close(self) -> None:
                opening.done.append("line closes")

        class Lock:
            def __init__(self, url: str) -> None:
                opening.done.append(f"locks {url}")

            def release(self) -> None:
                opening.done.append("releases")

        self.made: dict[str, Any] = {}
        self.line_args: tuple[Any, ...] = ()

        def make(kind: type[Part], name: str) -> Any:
            return lambda given: kind(name, given)  # pyright: ignore[reportUnknownLambdaType]

        def needs_line(url: str, key: object) -> bool:
            return self.with_line

        def create(*args: object) -> object:
            return args

        monkeypatch.setattr(session_file, "Mavsdk", make(Mavsdk, "mavsdk"))
        monkeypatch.setattr(session_file, "MavlinkDirect", make(Direct, "direct"))
        monkeypatch.setattr(session_file, "TelemetryPlugin", make(Part, "plugin"))
        monkeypatch.setattr(session_file, "ParameterAccess", make(Part, "parameters"))
        monkeypatch.setattr(session_file, "MavsdkLine", Line)
        monkeypatch.setattr(session_file, "PortLock", Lock)
        monkeypatch.setattr(session_file, "needs_line", needs_line)
        monkeypatch.setattr(session_file, "Configuration", SimpleNamespace(create_manual=create))

        def log_subscribe(to: object) -> None:
            assert to is session_file._to_python_log
            self.done.append("logs")

        monkeypatch.setattr(
            session_file,
            "mavsdk_logging",
            SimpleNamespace(
                log_subscribe=log_subscribe,
                log_unsubscribe=lambda: self.done.append("logs no more"),
                LogLevel=LogLevel,
            ),
        )

        def subscribe(plugin: Any, direct: Any) -> None:
            assert (plugin.name, direct.name) == ("plugin", "direct")
            self.done.append("subscribes")

        telemetry: Any = self.bed.telemetry
        telemetry.subscribe = subscribe


URL = "udpin://127.0.0.1:14540"


@pytest.mark.parametrize("with_line", [False, True])
def test_a_session_takes_the_port_finds_its_vehicle_and_gives_all_of_it_back(
    with_line: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    opening = Opening(monkeypatch)
    opening.with_line = with_line

    async def main() -> None:
        session = opening.session
        assert await session.open() is PX4
        telemetry: Any = opening.bed.telemetry
        assert telemetry.kind is PX4
        parameters: Any = session.parameters
        assert parameters is opening.made["parameters"]
        for name in ("direct", "plugin", "parameters"):
            assert opening.made[name].given is opening.system
        assert opening.made["mavsdk"].given == (245, 190, True)
        connects = ["line starts"] if with_line else [f"connects {URL}"]
        assert opening.done == [
            f"locks {URL}",
            "logs",
            "makes mavsdk",
            *connects,
            "makes direct",
            "makes parameters",
            "makes plugin",
            "subscribes",
        ]
        assert session.ignored == ({"a second vehicle": 3} if with_line else {})
        if with_line:
            assert opening.line_args == (URL, SYSID, (245, 190), None)
        opening.done.clear()
        await session.close()
        parts = [f"destroys {name}" for name in ("parameters", "plugin", "direct", "mavsdk")]
        assert opening.done == [
            *["line stops"] * with_line,
            *parts,
            "logs no more",
            *["line closes"] * with_line,
            "releases",
        ]
        assert session.parameters is None
        await session.close()  # again: nothing is destroyed twice
        assert sum(each.startswith("destroys") for each in opening.done) == 4

    asyncio.run(main())


def test_a_port_that_cannot_be_opened_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    opening = Opening(monkeypatch)
    opening.fails = True

    async def main() -> None:
        with pytest.raises(VehicleError, match=r"cannot open udpin://127.0.0.1:14540"):
            await opening.session.open()
        await opening.session.close()
        assert opening.done[-2:] == ["logs no more", "releases"]

    asyncio.run(main())


def test_a_vehicle_whose_heartbeat_does_not_come_in_time_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opening = Opening(monkeypatch)
    opening.hears = False

    async def main() -> None:
        begun_s = time.monotonic()
        with pytest.raises(VehicleError, match="stopped on"):
            await opening.session.open()
        assert time.monotonic() - begun_s >= 0.3
        await opening.session.close()

    asyncio.run(main())


def test_the_log_of_mavsdk_is_taken_until_the_last_session_has_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opening = Opening(monkeypatch)
    other = Session().session
    monkeypatch.setattr(session_file, "_logging", {other})

    async def main() -> None:
        await opening.session.open()
        await opening.session.close()
        assert "logs no more" not in opening.done
        session_file._logging.discard(other)
        await opening.session.close()
        assert opening.done.count("logs no more") == 1

    asyncio.run(main())


def test_a_telemetry_that_cannot_be_understood_ends_every_wait() -> None:
    bed = Session()

    async def main() -> None:
        bed.telemetry.check()
        beat(bed)
        telemetry: Any = bed.telemetry
        telemetry._failure = ValueError("x")
        with pytest.raises(VehicleError, match="cannot be understood"):
            await bed.session.until(lambda: False, 60.0)

    asyncio.run(main())


def test_a_mavsdk_that_does_not_end_is_told_of_and_not_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(session_file, "CLOSE_S", 0.05)
    go_on = threading.Event()
    part = SimpleNamespace(destroy=lambda: go_on.wait(5.0))
    with pytest.raises(VehicleError, match=r"did not close within 0.05 s"):
        asyncio.run(session_file._destroy([part]))
    go_on.set()


@pytest.mark.parametrize(
    ("level", "told"),
    [
        (LogLevel.DEBUG, logging.DEBUG),
        (LogLevel.WARN, logging.DEBUG),
        (LogLevel.ERROR, logging.WARNING),
    ],
)
def test_what_mavsdk_says_is_in_the_program_s_own_log(
    level: Any, told: int, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG, "drivers.mavsdk"):
        assert session_file._to_python_log(level, "100 %", None, 0)
    assert [(each.levelno, each.getMessage()) for each in caplog.records] == [(told, "100 %")]


# --- what it sends


def test_a_message_goes_to_the_autopilot_from_this_program() -> None:
    bed = Session(own_sysid=240, own_compid=191)
    sent: list[Any] = []
    direct: Any = bed.direct
    direct.send_message = sent.append
    bed.session.send("PARAM_SET", {"param_id": "X", "target_component": 9})
    (message,) = sent
    assert message.message_name == "PARAM_SET"
    assert (message.system_id, message.component_id) == (240, 191)
    assert (message.target_system_id, message.target_component_id) == (SYSID, 1)
    fields = json.loads(message.fields_json)
    assert fields == {"target_system": SYSID, "target_component": 9, "param_id": "X"}


@pytest.mark.parametrize("error", [MavsdkError("x"), RuntimeError("x")])
def test_a_message_that_cannot_be_sent_is_told(error: Exception) -> None:
    bed = Session()

    def fail(_message: object) -> None:
        raise error

    direct: Any = bed.direct
    direct.send_message = fail
    with pytest.raises(VehicleError, match="cannot send PARAM_SET on udpin"):
        bed.session.send("PARAM_SET", {})


def test_a_command_has_seven_parameters_and_the_autopilot_s_own_unset() -> None:
    bed = Session((22, 0))
    bed.telemetry.kind = PX4
    asyncio.run(bed.command(22))
    (sent,) = bed.direct.sent
    assert [sent[f"param{k}"] for k in range(1, 8)] == [1.0] + [None] * 6
    assert (sent["command"], sent["confirmation"]) == (22, 0)


@pytest.mark.parametrize(
    ("name", "value", "taken"),
    [("MIS_TAKEOFF_ALT", 2.5, True), ("MIS_TAKEOFF_ALT", 2.6, False), ("OTHER", 2.5, False)],
)
def test_a_parameter_is_set_once_the_vehicle_says_that_it_has_it(
    name: str, value: float, taken: bool
) -> None:
    bed = Session()

    def answer(_sent: dict[str, Any]) -> None:
        fields = json.dumps({"param_id": name, "param_value": value})
        bed.telemetry._on_parameter(SimpleNamespace(system_id=SYSID, fields_json=fields))

    direct: Any = bed.direct
    direct._on_sent = answer
    session: Any = bed.session
    session._config = SimpleNamespace(
        **{
            each: getattr(session._config, each)
            for each in ("sysid", "own_sysid", "own_compid", "url", "heartbeat_timeout_s")
        },
        command_timeout_s=0.03,
    )

    async def main() -> None:
        bed.telemetry.check()
        beat(bed)
        await bed.session.set_float_parameter("MIS_TAKEOFF_ALT", 2.5)

    if taken:
        asyncio.run(main())
    else:
        with pytest.raises(VehicleError, match=r"did not take parameter MIS_TAKEOFF_ALT = 2\.5"):
            asyncio.run(main())
    assert len(bed.direct.sent) == (1 if taken else 3)
    first = bed.direct.sent[0]
    assert (first["param_id"], first["param_value"], first["param_type"]) == (
        "MIS_TAKEOFF_ALT",
        2.5,
        9,
    )


def test_its_time_since_it_began_is_in_milliseconds(monkeypatch: pytest.MonkeyPatch) -> None:
    bed = Session()
    session: Any = bed.session
    session._start_s = time.monotonic() - 12.5
    assert bed.session.boot_ms() == pytest.approx(12_500, abs=50)
    session._start_s = time.monotonic() - 2**32 / 1e3 - 1.0
    assert bed.session.boot_ms() == pytest.approx(1000, abs=50)


def test_a_wait_ends_with_its_condition_or_its_time() -> None:
    bed = Session()

    async def main() -> None:
        bed.telemetry.check()
        beat(bed)
        assert await bed.session.until(lambda: True, 0.0)
        begun_s = time.monotonic()
        assert not await bed.session.until(lambda: False, 0.05)
        assert 0.05 <= time.monotonic() - begun_s < 2.0

    asyncio.run(main())

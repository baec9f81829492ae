"""The guard's program over real sockets, beside a role that hangs while its MAVSDK goes on sending
setpoints.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.interfaces import FlightMode, PartError
from drivers.link.udp import address_of
from drivers.log.mcap_log import read_log
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, Hand, Script
from drivers.mavlink.guard.line import UdpGuardLine, encode_beat
from hil.autopilot.values import OffboardSession
from missions.cli import main
from missions.fly.guard import start as guard_start
from missions.fly.guard.command import guard_of
from missions.fly.guard.start import with_guard
from missions.ground import rig_library
from path.messages import Role
from tests.doubles import WallClock
from tests.free_ports import free_port
from tests.guard_bench import LIMIT_S, Bench, bench, until

HOLD_OR_LAND = (176, 21)


class FakeRole:
    """Beats like a role; ``stopped`` is what SIGSTOP does to it."""

    def __init__(self, bind: str) -> None:
        self.guard = bind
        self._line = UdpGuardLine(bind, WallClock())
        self.script = Script.IDLE
        self.stopped = False
        self.answers: list[GuardAnswer] = []
        self._setpoints = 0

    def run(self, stop: threading.Event) -> None:
        asyncio.run(self._run(stop))

    async def _run(self, stop: threading.Event) -> None:
        async with self._line:
            while not stop.wait(0.02):
                if not self.stopped:
                    self._setpoints += 1
                    self._line.beat(Beat(self.script, self._setpoints))
                    newest = self._line.answer()
                    self.answers += [newest[1]] if newest else []

    @property
    def hand(self) -> Hand | None:
        return self.answers[-1].hand if self.answers and self.answers[-1].sees else None


# A guard's program whose rules are patient enough for a busy machine.
PATIENT = """
import sys
from dataclasses import replace
from flight.guard.rules import GuardRules
from missions import cli
from missions.ground import rig_library

usual = rig_library.mission_of
rules = GuardRules(
    hold_s=float(sys.argv.pop(1)), beat_age_s=2.5, setpoint_gap_s=2.5,
    ack_s=10.0, confirm_s=10.0, blind_s=10.0,
)
rig_library.mission_of = lambda rig: replace(usual(rig), guard_process=rules)
cli.main()
"""


def rig_file(folder: Path, own: Bench, beat_port: int) -> Path:
    """The rig ``sitl`` with the sender's guard on free ports."""
    text = rig_library.whole("sitl")
    text = text.replace("127.0.0.1:14551", f"127.0.0.1:{own.port}").replace(
        "127.0.0.1:14561", f"127.0.0.1:{beat_port}"
    )
    file = folder / "rig.toml"
    file.write_text(text)
    return file


@contextmanager
def guarded(
    folder: Path, *more: str, hold_s: float = 2.0
) -> Generator[tuple[Bench, FakeRole, subprocess.Popen[str]]]:
    """A vehicle in offboard control, its guard's program, and a role that beats."""
    port, stop = free_port(), threading.Event()
    role = FakeRole(f"127.0.0.1:{port}")
    thread = threading.Thread(target=role.run, args=(stop,))
    with bench(speed=3.0) as own:
        command = [
            sys.executable,
            "-c",
            PATIENT,
            str(hold_s),
            "guard",
            "--rig",
            str(rig_file(folder, own, port)),
        ]
        command += ["--role", "sender", "--out", str(folder), *more]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as process:
            thread.start()
            try:
                until(lambda: role.hand is Hand.FREE)
                role.script = Script.CLIMB
                own.in_air()
                role.script = Script.CONTROL
                until(lambda: role.hand is Hand.SCRIPT)
                yield own, role, process
            finally:
                stop.set()
                thread.join()
                process.kill()


def modes(own: Bench) -> list[OffboardSession]:
    return list(own.autopilot.offboard_sessions)


def test_a_hung_role_s_vehicle_is_held_and_landed_though_its_setpoints_go_on(
    tmp_path: Path,
) -> None:
    with guarded(tmp_path, "--while-flown") as (own, role, process):
        role.stopped = True
        until(lambda: own.autopilot.mode is FlightMode.HOLD)
        # what a role that wakes up in the middle of something may send
        own.select(FlightMode.OFFBOARD)
        until(lambda: own.autopilot.mode is FlightMode.LAND)
        role.stopped = False
        until(lambda: role.hand is Hand.GUARD)
        assert "no sign of life" in role.answers[-1].reason
        until(lambda: not own.autopilot.armed)
        assert [session.ended_by for session in modes(own)] == [FlightMode.HOLD, FlightMode.LAND]
        assert own.commands(*HOLD_OR_LAND) == [176, 21]  # each once
        until(lambda: role.hand is Hand.FREE)
        role.stopped = True  # its program has ended
        assert process.wait(LIMIT_S) == 0
        assert process.stdout is not None
        said = process.stdout.read()
    assert "watching vehicle 1" in said
    assert "holding, told it to hold: no sign of life" in said
    decisions = [
        r.record["stage"] for r in read_log(tmp_path / "sender.guard.mcap") if r.topic == "/guard"
    ]
    assert decisions == ["holding", "landing", "watching"]


def test_another_program_s_beats_do_not_keep_a_guard_quiet(tmp_path: Path) -> None:
    with (
        guarded(tmp_path) as (own, role, process),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign,
    ):
        stop = threading.Event()

        def beat_on() -> None:
            setpoints = 1000
            while not stop.wait(0.02):
                setpoints += 1
                foreign.sendto(
                    encode_beat(Beat(Script.CONTROL, setpoints)), address_of(role.guard, "bind")
                )

        thread = threading.Thread(target=beat_on)
        thread.start()
        try:
            # the crew is told
            until(lambda: bool(role.answers) and "not sealed" in role.answers[-1].alarm)
            assert role.hand is Hand.SCRIPT  # and goes on
            role.stopped = True
            until(lambda: own.autopilot.mode is FlightMode.HOLD)
            until(lambda: not own.autopilot.armed)
        finally:
            stop.set()
            thread.join()
        process.send_signal(signal.SIGTERM)
        assert process.wait(LIMIT_S) == 0
        assert process.stdout is not None
        assert "ALARM: ignored beats that are not sealed" in process.stdout.read()


def test_a_guard_that_is_told_to_end_stays_until_the_vehicle_is_down_and_leaves_it_to_a_pilot(
    tmp_path: Path,
) -> None:
    with guarded(tmp_path, hold_s=30.0) as (own, role, process):
        process.send_signal(signal.SIGTERM)
        process.send_signal(signal.SIGINT)
        role.stopped = True
        until(lambda: own.autopilot.mode is FlightMode.HOLD)
        own.select(FlightMode.OTHER, by_pilot=True)
        assert process.wait(LIMIT_S) == 0  # nothing is left to do, and it had been told
        assert own.autopilot.mode is FlightMode.OTHER
        assert own.commands(*HOLD_OR_LAND) == [176]


def test_a_role_s_guard_begins_beside_it_and_ends_by_itself(tmp_path: Path) -> None:
    with bench() as own:
        port, stop = free_port(), threading.Event()
        rig = rig_library.load_unchecked(str(rig_file(tmp_path, own, port)))
        assert with_guard(rig, Role.SENDER, "start", tmp_path) is rig
        (process,) = guard_start._begun
        role = FakeRole(f"127.0.0.1:{port}")
        thread = threading.Thread(target=role.run, args=(stop,))
        thread.start()
        try:
            until(lambda: role.hand is Hand.FREE)
            assert os.getsid(process.pid) != os.getsid(0)  # Ctrl-C and Ctrl-Z are not for it
        finally:
            stop.set()
            thread.join()
        assert process.wait(LIMIT_S) == 0
        guard_start._begun.clear()
    assert "watching vehicle 1" in (tmp_path / "sender.guard.txt").read_text()


def test_a_rig_whose_guard_cannot_be_a_program_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["guard", "--rig", "sim", "--out", str(tmp_path)])
    assert ended.value.code == 3
    assert "needs the simulated world in the same process" in capsys.readouterr().err
    bare = with_guard(rig_library.load_unchecked("sitl"), Role.SENDER, "none", tmp_path)
    with pytest.raises(PartError, match=r"has no \[sender\.guard\]"):
        guard_of(bare, Role.SENDER)


def test_a_second_guard_of_the_same_vehicle_is_refused(tmp_path: Path) -> None:
    with bench() as own:
        port = free_port()
        file = rig_file(tmp_path, own, port)
        rig = rig_library.load_unchecked(str(file))

        async def occupy() -> None:
            from drivers.mavlink.guard.line import UdpBeatLine  # noqa: PLC0415

            async with UdpBeatLine(f"127.0.0.1:{port}", WallClock()):
                # one is there: none is begun
                assert with_guard(rig, Role.SENDER, "start", tmp_path) is rig
                with pytest.raises(PartError, match="cannot listen"):
                    async with UdpBeatLine(f"127.0.0.1:{port}", WallClock()):
                        pass

        asyncio.run(occupy())
        assert not (tmp_path / "sender.guard.txt").exists()
        assert with_guard(rig, Role.RECEIVER, "none", tmp_path).receiver.guard is None
        assert with_guard(rig, Role.RECEIVER, "expect", tmp_path) is rig


def test_a_guard_of_another_vehicle_is_refused(tmp_path: Path) -> None:
    text = rig_library.whole("sitl")
    file = tmp_path / "rig.toml"
    file.write_text(text.replace("vehicle_sysid = 1", "vehicle_sysid = 7"))
    with pytest.raises(
        PartError, match=r"sender\.guard\.vehicle_sysid: 7 is not the vehicle that is flown, 1"
    ):
        rig_library.load(str(file))
    file.write_text(text.replace("127.0.0.1:14551", "127.0.0.1:14541"))
    with pytest.raises(PartError, match="already used"):
        rig_library.load(str(file))

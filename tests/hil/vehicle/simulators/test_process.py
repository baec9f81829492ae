"""The launcher of real autopilots, with scripted programs in their place."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from hil.autopilot.simulator import SimulatorConfig
from hil.vehicle.simulators.process import AutopilotProcess, Home, SimulatorBroken, binary_of

HOME = Home(47.4, 8.5, 480.0, 90.0)
LIMIT_S = 60.0


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s, "did not happen"
        time.sleep(0.01)


def program(folder: Path, text: str, name: str = "arducopter") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / name
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)
    return file


def ardupilot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> AutopilotProcess:
    monkeypatch.setenv("PATH_ARDUPILOT", str(program(tmp_path / "bin", text)))
    return AutopilotProcess(
        "ardupilot", 5, HOME, {"RTL_ALT": 300, "MAV_GCS_SYSID": 245}, tmp_path / "run"
    )


def alive(pid: int) -> bool:
    """Neither gone nor a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_without_a_binary_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PATH_PX4", raising=False)
    with pytest.raises(PartError, match="needs px4, and none was named") as caught:
        binary_of("px4")
    assert "--px4 PATH" in caught.value.remedy
    assert "PATH_PX4" in caught.value.remedy


def test_a_binary_that_is_not_there_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH_ARDUPILOT", str(tmp_path / "nowhere"))
    with pytest.raises(PartError, match="nowhere: there is no such program"):
        binary_of("ardupilot")


def test_px4_without_its_scripts_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH_PX4", str(program(tmp_path, "true", "px4")))
    with pytest.raises(PartError, match="rcS"):
        binary_of("px4")


def test_ardupilot_gets_its_own_numbers_home_and_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = ardupilot(tmp_path, monkeypatch, 'echo "$@"; pwd; exec sleep 600')
    process.start()
    try:
        until(lambda: str(tmp_path / "run") in process.last_words())
        said = process.output.read_text()
    finally:
        process.stop()
    for part in ("-I 4", "--sysid 5", "47.400000000,8.500000000,480.000,90.000", "14544", "19414"):
        assert part in said
    defaults = (tmp_path / "run" / "defaults.parm").read_text().splitlines()
    assert {"RTL_ALT 300", "MAV_GCS_SYSID 245", "SYSID_MYGCS 245"} < set(defaults)


def test_px4_finds_its_parameters_on_its_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "build" / "etc" / "init.d-posix" / "rcS"
    script.parent.mkdir(parents=True)
    script.touch()
    script.with_name("px4-rc.simulator").write_text("echo starts the simulation\n")
    said = f'R={tmp_path}/build/; param() {{ echo "$@"; }}; '
    said += '. px4-rc.simulator; echo "$@" "$PX4_SIM_MODEL"; exec sleep 600'
    monkeypatch.setenv("PATH_PX4", str(program(tmp_path / "build" / "bin", said, "px4")))
    process = AutopilotProcess("px4", 6, HOME, {"COM_RC_IN_MODE": 4}, tmp_path / "run")
    process.start()
    try:
        until(lambda: "sihsim_quadx" in process.last_words())
        said = process.output.read_text()
    finally:
        process.stop()
    assert "set COM_RC_IN_MODE 4\nstarts the simulation\n" in said
    assert "set SIH_LOC_H0 480\n" in said
    assert f"-i 5 -d {tmp_path}/build/etc" in said


def test_a_simulator_that_dies_is_broken_and_quoted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = ardupilot(tmp_path, monkeypatch, "echo bind failed on port 5760; exit 3")
    process.start()

    def dead() -> bool:
        try:
            process.check()
        except SimulatorBroken as error:
            assert "ardupilot of vehicle 5 ended (exit code 3): bind failed on port 5760" in str(
                error
            )
            return True
        return False

    until(dead)
    process.stop()


def test_stop_ends_its_children_too_and_those_who_do_not_listen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.vehicle.simulators.process.STOP_S", 0.3)
    process = ardupilot(
        tmp_path, monkeypatch, "trap '' TERM; sleep 600 & echo $! > child; wait; sleep 600"
    )
    process.start()
    child = tmp_path / "run" / "child"
    until(lambda: child.exists() and child.read_text().strip() != "")
    process.stop()
    until(lambda: not alive(int(child.read_text())))
    process.stop()


def test_it_dies_with_a_harness_that_is_killed(tmp_path: Path) -> None:
    binary = program(tmp_path / "bin", "echo $$ > pid; exec sleep 600")
    source = (
        "import pathlib, sys, time\n"
        "from hil.vehicle.simulators.process import AutopilotProcess, Home\n"
        "process = AutopilotProcess('ardupilot', 5, Home(0.0, 0.0, 0.0), {}, pathlib.Path(sys.argv[1]))\n"
        "process.start()\n"
        "time.sleep(600)\n"
    )
    environment = {**os.environ, "PATH_ARDUPILOT": str(binary)}
    harness = subprocess.Popen(
        [sys.executable, "-c", source, str(tmp_path / "run")], env=environment
    )
    try:
        pid = tmp_path / "run" / "pid"
        until(lambda: pid.exists() and pid.read_text().strip() != "")
    finally:
        os.kill(harness.pid, signal.SIGKILL)
        harness.wait(LIMIT_S)
    until(lambda: not alive(int(pid.read_text())))


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"kind": "px4", "url": "udp://127.0.0.1:14540"}, "both url and truth_url"),
        ({"kind": "px4", "speedup": 5.0}, "leave speedup out"),
        ({"kind": "ardupilot", "speedup": 100.0}, "within 1..20"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        SimulatorConfig(**options)  # type: ignore[arg-type]


def test_a_sysid_that_has_no_ports_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PartError, match="sysid 11"):
        AutopilotProcess("px4", 11, HOME, {}, tmp_path)

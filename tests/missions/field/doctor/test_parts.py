"""A role's parts by its rig: what is tested, what a harness stands in for, how a test is ended, and
how it is shown.
"""

from __future__ import annotations

import asyncio
import io
import os
import signal
import threading
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.interfaces import CameraError
from drivers.rig.part_check import Finding, State
from missions.field.doctor import command as doctor
from missions.field.doctor import parts as doctor_parts
from missions.field.doctor.parts import PartTest, part_tests, run_test
from missions.field.doctor.table import open_findings, table
from missions.ground import rig_library
from missions.ground.options.field import DoctorOptions
from path.messages import Role
from tests.drivers.detectors.onnx_graphs import bright_cells_network, identity_network
from tests.missions.field.doctor.test_link import ports

SITL = rig_library.load("sitl")


def test_behind_a_harness_only_what_needs_no_far_side_is_tested() -> None:
    tests = list(part_tests(SITL, Role.SENDER))
    assert [test.name for test in tests] == [
        "sender detector", "sender vehicle", "sender guard", "sender perception", "sender link",
    ]  # fmt: skip
    for test in tests[1:]:
        (finding,) = run_test(test)
        assert finding.state == "note"
        assert finding.untested and finding.name == test.name
        assert finding.detail.startswith(
            "not tested: the harness hil.harness.sitl:SitlHarness stands in"
        )
    assert run_test(tests[0])[0].state == "ok"


def with_model(file: Path) -> PartTest:
    """The test of a detector that is a network, as the rig names it."""
    detector = {"factory": "drivers.detectors.yolox:YoloxDetector", "model": str(file)}
    perception = replace(
        SITL.sender.perception, options={**SITL.sender.perception.options, "detector": detector}
    )
    return next(
        part_tests(replace(SITL, sender=replace(SITL.sender, perception=perception)), Role.SENDER)
    )


def test_a_model_is_loaded_and_timed_through_onnxruntime_and_one_that_cannot_be_used_is_named(
    tmp_path: Path,
) -> None:
    loads, timed = run_test(with_model(bright_cells_network(tmp_path / "bright.onnx", 64, 3)))
    assert (loads.state, loads.detail) == ("ok", "YoloxDetector")
    assert timed.name == "sender detector time" and "ms for a grey image of 640x480" in timed.detail
    (missing,) = run_test(with_model(tmp_path / "none.onnx"))
    assert missing.state == "fault" and "none.onnx" in missing.detail and missing.fix
    (tmp_path / "other.onnx").write_bytes(identity_network((1, 3, 64, 64)))
    (other,) = run_test(with_model(tmp_path / "other.onnx"))
    assert other.state == "fault" and "expected an output of rows of boxes" in other.detail
    (tmp_path / "broken.onnx").write_bytes(b"no protobuf")
    (broken,) = run_test(with_model(tmp_path / "broken.onnx"))
    assert broken.state == "fault" and "broken.onnx" in broken.detail and broken.fix


def test_in_the_field_every_part_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_parts, "WAIT_S", 0.1)
    own, peer = ports()
    link = {"bind": f"127.0.0.1:{own}", "peer": f"127.0.0.1:{peer}"}
    options = {
        **SITL.sender.vehicle.options,
        "url": f"udpin://127.0.0.1:{own}",
        "connect_timeout_s": 0.1,
    }
    camera = {
        "factory": "drivers.realsense.camera:RealSense",
        "serial": "none-such",
        "reopen_s": 0.0,
        "open_timeout_s": 2.0,
    }
    sender = replace(
        SITL.sender,
        vehicle=replace(SITL.sender.vehicle, options=options),
        perception=replace(
            SITL.sender.perception, options={**SITL.sender.perception.options, "camera": camera}
        ),
        link=replace(SITL.sender.link, options=link),
        guard=None,
    )
    rig = replace(SITL, level="field", harness=None, sender=sender)
    every = {
        finding.name: finding for test in part_tests(rig, Role.SENDER) for finding in run_test(test)
    }
    assert every["sender vehicle"].state == "fault"
    assert "no heartbeat" in every["sender vehicle"].detail
    assert every["sender perception"].state == "fault"
    assert "RealSense" in every["sender perception"].detail
    assert every["sender link opens"].state == "ok"
    assert every["sender link other end"].state == "note"
    assert [finding.name for finding in every.values() if finding.untested] == [
        "sender link other end"
    ]


class Part:
    """Says when it was closed."""

    def __init__(self, then: BaseException | None) -> None:
        self.then, self.closed = then, False
        self.waits = threading.Event()

    async def findings(self) -> AsyncIterator[Finding]:
        try:
            yield Finding("ok", "opens", "at once")
            if self.then is not None:
                raise self.then
            self.waits.set()
            await asyncio.sleep(600.0)
        finally:
            self.closed = True


def test_what_was_found_before_an_error_or_the_limit_stays_and_the_part_is_closed() -> None:
    broken, endless = Part(CameraError("it fell silent", "look at its cable")), Part(None)
    found = run_test(PartTest("perception", "", broken.findings))
    assert [(each.state, each.name, each.fix) for each in found] == [
        ("ok", "perception opens", ""), ("fault", "perception", "look at its cable"),
    ]  # fmt: skip
    found = run_test(PartTest("perception", "", endless.findings), limit_s=0.05)
    assert (found[-1].state, found[-1].detail) == ("fault", "its test did not end within 0.05 s")
    assert broken.closed
    assert endless.closed


def test_ctrl_c_closes_the_part_and_shows_what_was_found() -> None:
    part, out = Part(None), io.StringIO()

    def press() -> None:
        assert part.waits.wait(60.0)
        # one that comes just before the loop begins to wait is seen when that has ended: 40 s
        time.sleep(0.2)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press)
    with pytest.raises(KeyboardInterrupt), open_findings(out) as shown:
        thread.start()
        shown.add(Finding("ok", "Python", "is here"))
        shown.doing("perception: frames")
        run_test(PartTest("perception", "", part.findings))
    thread.join()
    assert part.closed
    assert out.getvalue().startswith("perception: frames ...\n")
    assert "Python" in out.getvalue()


def test_doctor_tests_the_parts_of_the_role_and_a_fault_among_them_is_its_exit_code(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)

    def tests(rig: object, role: Role) -> Iterator[PartTest]:
        yield PartTest(
            f"{role.value} perception", "frames", Part(CameraError("it fell silent")).findings
        )

    monkeypatch.setattr(doctor, "part_tests", tests)
    monkeypatch.setattr(
        doctor,
        "computer_findings",
        lambda *_: [Finding("ok", "computer", "is quick")],  # type: ignore[misc]
    )
    monkeypatch.setattr(doctor, "findings", lambda _: [Finding("ok", "rig", "is read")])  # type: ignore[misc]
    out = io.StringIO()
    assert doctor.run(DoctorOptions("sitl", role="receiver"), out) == doctor.EXIT_UNFIT
    assert "receiver perception: frames ..." in out.getvalue()
    assert "it fell silent" in out.getvalue()
    assert out.getvalue().endswith("1 fault (receiver perception): not ready to fly\n")
    out = io.StringIO()
    assert doctor.run(DoctorOptions("sitl"), out) == 0
    assert "--role sender" in out.getvalue()


@pytest.mark.parametrize(("name", "role"), [("sitl", "sender"), ("sim", "receiver")])
def test_nothing_is_called_ready_to_fly_of_which_nothing_was_tested(
    name: str, role: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        doctor,
        "computer_findings",
        lambda *_: [Finding("ok", "computer", "is quick")],  # type: ignore[misc]
    )
    monkeypatch.setattr(doctor, "findings", lambda _: [Finding("ok", "rig", "is read")])  # type: ignore[misc]
    out = io.StringIO()
    assert doctor.run(DoctorOptions(name, role=role), out) == 0  # type: ignore[arg-type]
    last = out.getvalue().splitlines()[-1]
    parts = ", ".join(f"{role} {part}" for part in ("vehicle", "guard", "perception", "link"))
    assert last == f"no fault, but not known to be ready to fly; not tested: {parts}"


def test_the_last_line_tells_what_was_not_tested_beside_faults_and_notes_and_else_that_it_is_ready() -> (
    None
):
    alone = Finding("note", "sender link other end", "nobody answered", untested=True)
    fault = Finding("fault", "sender vehicle", "no heartbeat")
    note = Finding("note", "Python", "one core")
    not_known = "no fault, but not known to be ready to fly; not tested: sender link other end"
    assert doctor.verdict([note, alone], tested=True) == not_known
    told = "1 fault (sender vehicle): not ready to fly; not tested: sender link other end"
    assert doctor.verdict([fault, alone], tested=True) == told
    assert doctor.verdict([note], tested=True) == "ready to fly, 1 note"


def test_what_is_wrong_comes_before_all_that_is_right() -> None:
    states: tuple[State, ...] = ("ok", "note", "ok", "fault", "note")
    found = [Finding(state, f"row {at}", "") for at, state in enumerate(states)]
    names = list(table(found).columns[1].cells)
    assert names == ["row 3", "row 1", "row 4", "row 0", "row 2"]


def test_a_terminal_sees_the_same_table_grow() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    out = Terminal()
    with open_findings(out) as shown:
        shown.doing("perception: frames")
        shown.add(Finding("fault", "perception", "is silent", "look at its cable"))
    assert "fix: look at its cable" in out.getvalue()

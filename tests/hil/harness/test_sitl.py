"""The parent of a run in real time, with small programs in the places of the world and the roles."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import textwrap
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from drivers.cpu_share import CpuShare
from drivers.interfaces import PartError
from drivers.link.udp import address_of
from drivers.log.mcap_log import McapLog, new_part
from drivers.log.state_file import StateFile
from drivers.rig.parts import with_slow
from flight.harness.flights import FlightReport, FlightRequest, Progress, RoleResult, encode_event
from flight.outcome import Outcome
from hil.harness import sitl
from hil.harness.realtime import children
from hil.harness.realtime.parts import proxy_side
from hil.harness.realtime.run import Ending, RealTimeRun
from hil.harness.sim import LEG
from hil.world.faults import AT_COUNT, parse_fault
from missions import rig_library
from path.messages import Role
from path.protocol.values import Handoff, ReceiverRecord


@pytest.fixture(scope="module")
def rig() -> Any:
    return rig_library.load("sitl")


def result(role: Role, outcome: Outcome = Outcome.COMMITTED) -> RoleResult:
    return RoleResult(role, outcome, "", responsible=False, landed=True)


def progress(role: Role, count: int = 0) -> Progress:
    return Progress(role, 0, "verify", count, 350, None, None, None, 0.0, False, "")


def saying(*lines: object, then: str = "") -> str:
    """A program that prints lines, events as JSON, and does something."""
    texts = [line if isinstance(line, str) else encode_event(line) for line in lines]  # type: ignore[arg-type]
    return "\n".join([*(f"print({text!r}, flush=True)" for text in texts), textwrap.dedent(then)])


READY = 'print(\'{"event": "ready", "air": 1}\', flush=True)\n'
WRITES_DOWN = """
import sys
with open({file!r}, "a") as file:
    for line in sys.stdin:
        file.write(line)
        file.flush()
        if "finish" in line:
            print('{{"event": "finished"}}', flush=True)
"""
Programs = Mapping[Role, str | Sequence[str]]
UNTIL_STDIN_ENDS = "import sys; sys.stdin.read()"


@dataclass
class Stage:
    """A run folder, the programs in it, and what the console was shown."""

    rig: Any
    out: Path
    shown: list[Progress] = field(default_factory=list[Progress])
    processes: list[asyncio.subprocess.Process] = field(default_factory=list[asyncio.subprocess.Process])
    on_progress: Any = None
    ending: Any = None
    shares: Mapping[str, CpuShare] = field(default_factory=dict[str, CpuShare])

    @property
    def request(self) -> FlightRequest:
        no_role: Any = None  # roles are processes here
        return FlightRequest(self.rig, self.out, 1, (), no_role, lambda role: [], self.show)

    def show(self, shown: Progress) -> None:
        self.shown.append(shown)
        if self.on_progress is not None:
            self.on_progress(shown)

    async def start(self, name: str, program: str) -> asyncio.subprocess.Process:
        command: Sequence[str] = [sys.executable, "-I", "-S", "-c", program]
        process = await children.spawn(command, self.out / f"{name}.stderr.txt")
        self.processes.append(process)
        return process

    def run_of(self, programs: Programs, faults: Sequence[str] = (), world: str = "") -> RealTimeRun:
        """``world`` writes down what it is told. A role's programs start one after another."""
        left = {role: iter([own] if isinstance(own, str) else own) for role, own in programs.items()}

        def python(program: str) -> Sequence[str]:
            return [sys.executable, "-I", "-S", "-c", program]

        def command(name: str) -> Sequence[str]:
            return python(next(left[Role(name)]))

        orders = replace(
            sitl.orders_of(self.request, self.shares),
            world=python(READY + (world or WRITES_DOWN.format(file=str(self.out / "told")))),
            program=command,
            awaited=frozenset(),
        )
        return RealTimeRun(orders, sitl.ENDS, {LEG: [parse_fault(text) for text in faults]})

    def fly(
        self, programs: Programs, faults: Sequence[str] = (), world: str = "", limit_s: float = 600.0
    ) -> RealTimeRun:
        """One run to its end."""
        run = self.run_of(programs, faults, world)
        self.ending = asyncio.run(run.run(lambda: sitl.one_leg(run), limit_s, 0.5))
        self.processes = run.children
        return run

    def told(self) -> list[Any]:
        """Returns the faults that the world was told of: their names, of which drone, their values."""
        told = [json.loads(line) for line in (self.out / "told").read_text().splitlines()]
        return [(command["fault"], command["drone"], command["value"]) for command in told if "fault" in command]


@pytest.fixture
def stage(rig: Any, tmp_path: Path) -> Stage:
    return Stage(rig, tmp_path)


def results(run: RealTimeRun) -> dict[Role, RoleResult]:
    return {Role(name): drone.result for name, drone in run.drones.items() if drone.result is not None}


def gone(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state == "Z"


# --- supervising -------------------------------------------------------------------------------------------------


def test_results_are_collected_and_progress_shown_whatever_else_is_printed(stage: Stage) -> None:
    programs = {role: saying("[Info] a library says hello", progress(role), "{}", result(role), "bye") for role in Role}
    run = stage.fly(programs)
    assert results(run) == {role: result(role) for role in Role}
    assert sorted(shown.role.value for shown in stage.shown) == ["receiver", "sender"]
    assert not run.interrupted


def test_a_program_that_dies_has_no_result(stage: Stage) -> None:
    programs = {Role.SENDER: saying(result(Role.SENDER)), Role.RECEIVER: "raise SystemExit(3)"}
    assert results(stage.fly(programs)) == {Role.SENDER: result(Role.SENDER)}


def test_a_fault_that_is_due_is_told_to_the_world(stage: Stage) -> None:
    programs = {
        Role.SENDER: saying(progress(Role.SENDER, AT_COUNT - 1), progress(Role.SENDER, AT_COUNT)),
        Role.RECEIVER: saying(result(Role.RECEIVER)),
    }
    stage.fly(programs, ["marker_hidden"])
    assert stage.told() == [("marker_hidden", "sender", None)]


def test_a_fault_that_kills_kills_the_program_and_no_other(stage: Stage) -> None:
    programs = {
        Role.SENDER: saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER)),
        Role.RECEIVER: saying(then="import time; time.sleep(600)"),
    }
    run = stage.fly(programs, ["kill_receiver"])
    assert results(run) == {Role.SENDER: result(Role.SENDER)}
    assert stage.processes[2].returncode == -signal.SIGKILL
    assert stage.told() == [("kill_receiver", "receiver", None)]


def test_a_program_is_started_again_after_its_death(stage: Stage) -> None:
    programs = {
        Role.SENDER: [
            saying(progress(Role.SENDER, AT_COUNT), then="import time; time.sleep(600)"),
            saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER, Outcome.RESTARTED)),
        ],
        Role.RECEIVER: saying(result(Role.RECEIVER)),
    }
    run = stage.fly(programs, ["kill_sender=0.05"])
    assert results(run)[Role.SENDER].outcome is Outcome.RESTARTED
    assert [process.returncode for process in stage.processes].count(-signal.SIGKILL) == 1
    assert stage.told() == [("kill_sender", "sender", 0.05)]


@pytest.mark.parametrize("again", [False, True])
def test_a_fault_that_is_due_while_its_program_is_being_started_strikes_once_it_has_begun(
    stage: Stage, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other drone's count makes it due, and of this one's program nothing is known here yet."""
    begun: list[asyncio.subprocess.Process] = []

    async def spawn(command: Sequence[str], errors: Path, run: str = "") -> asyncio.subprocess.Process:
        process = await children.spawn(command, errors, run)
        if errors.name == "receiver.stderr.txt":
            begun.append(process)
            if len(begun) == 1 + again:
                (stage.out / "begins").touch()
                async with asyncio.timeout(60.0):
                    while Role.SENDER not in [shown.role for shown in stage.shown]:  # noqa: ASYNC110 (another process's)
                        await asyncio.sleep(0.001)
        return process

    monkeypatch.setattr("hil.harness.realtime.programs.spawn", spawn)
    waits = f"import os, time\nwhile not os.path.exists({str(stage.out / 'begins')!r}): time.sleep(0.001)\n"
    receiver = saying(replace(progress(Role.RECEIVER), phase="waiting"), then="import time; time.sleep(600)")
    programs = {
        Role.SENDER: waits + saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER)),
        Role.RECEIVER: [receiver] * (1 + again),
    }
    faults = ["kill_receiver=0@waiting"] * again + ["kill_receiver"]
    run = stage.fly(programs, faults, limit_s=60.0)
    assert set(results(run)) == {Role.SENDER}
    assert [process.returncode for process in begun] == [-signal.SIGKILL] * len(faults)
    assert stage.told()[-1] == ("kill_receiver", "receiver", None) and len(stage.told()) == len(faults)
    assert run.missed == []


def test_a_fault_of_a_program_that_has_ended_is_told_as_missed_in_the_report(stage: Stage) -> None:
    pid = stage.out / "pid"
    waits = f"""
        import os, time
        while not os.path.exists({str(pid)!r}) or os.path.exists("/proc/" + open({str(pid)!r}).read()):
            time.sleep(0.001)
    """
    writes = f"import os; open('{pid}.new', 'w').write(str(os.getpid())); os.rename('{pid}.new', {str(pid)!r})"
    programs = {
        Role.SENDER: textwrap.dedent(waits) + saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER)),
        Role.RECEIVER: saying(result(Role.RECEIVER), then=writes),
    }
    run = stage.fly(programs, ["kill_receiver", "guard_death", "marker_hidden"])
    assert stage.told() == [("marker_hidden", "sender", None)]
    assert sitl.report_of(stage.request, run, stage.ending).notes[-2:] == [
        "fault kill_receiver had nothing to strike: the receiver's program had ended",
        "fault guard_death had nothing to strike: the sender has no guard",
    ]


@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_a_record_that_is_written_down_is_a_moment_too(
    stage: Stage, late_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is noticed on the disk: nobody but the file says so, and a quick program writes it before it is known here."""

    async def spawn(command: Sequence[str], errors: Path, run: str = "") -> asyncio.subprocess.Process:
        process = await children.spawn(command, errors, run)
        until_s = time.monotonic() + 30.0
        if late_s and errors.name == "receiver.stderr.txt":
            while not has_written.exists() and time.monotonic() < until_s:  # noqa: ASYNC110 (another process's)
                await asyncio.sleep(0.01)
            await asyncio.sleep(late_s)
        return process

    monkeypatch.setattr("hil.harness.realtime.programs.spawn", spawn)
    provisional = StateFile(stage.out / "x", Role.RECEIVER)
    provisional.save(ReceiverRecord(1, "provisional", Handoff(1, 1, 1)))
    text, has_written = (stage.out / "x").read_text(), stage.out / "receiver.state.json"
    writes = f"import time; open({str(has_written)!r}, 'w').write({text!r}); time.sleep(600)"
    programs = {Role.SENDER: saying(result(Role.SENDER)), Role.RECEIVER: writes}
    run = stage.fly(programs, ["kill_receiver@provisional"], limit_s=60.0)
    assert stage.ending.failure == ""
    assert list(results(run)) == [Role.SENDER]


RUNS = """
import time
begun_s = last_s = time.monotonic()
"""
STANDS_STILL = """
while last_s - begun_s < 60.0:
    time.sleep(0.01)
    now_s = time.monotonic()
    if now_s - last_s > 0.4:  # it slept longer than it meant to
        break
    last_s = now_s
print(LAST, flush=True)
"""


def test_a_program_that_stalls_goes_on_afterwards(stage: Stage) -> None:
    programs = {
        Role.SENDER: f"LAST = {encode_event(result(Role.SENDER))!r}\n{RUNS}"
        + saying(progress(Role.SENDER, AT_COUNT), then=STANDS_STILL),
        Role.RECEIVER: saying(result(Role.RECEIVER)),
    }
    run = stage.fly(programs, ["stall_sender=0.5"])
    assert set(results(run)) == set(Role)
    assert stage.told() == [("stall_sender", "sender", 0.5)]


def test_a_program_that_is_stopped_for_good_is_ended_at_last(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(children, "STOPPED_S", 0.2)
    programs = {
        Role.SENDER: saying(progress(Role.SENDER, AT_COUNT), then="import time; time.sleep(600)"),
        Role.RECEIVER: saying(result(Role.RECEIVER)),
    }
    run = stage.fly(programs, ["stop_sender"])
    assert set(results(run)) == {Role.RECEIVER}
    assert [process.returncode for process in stage.processes].count(-signal.SIGKILL) == 1


def test_a_world_that_dies_in_flight_is_the_harness_s_failure(stage: Stage) -> None:
    programs = dict.fromkeys(Role, UNTIL_STDIN_ENDS)
    stage.fly(programs, world="raise SystemExit(1)")
    assert "world.stderr.txt" in stage.ending.failure
    assert all(process.returncode is not None for process in stage.processes)


def test_a_program_that_begins_while_the_world_dies_has_ended_when_the_run_has(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[asyncio.subprocess.Process] = []
    spawn, both_begin = children.spawn, stage.out / "both begin"
    dies = f"import os, time\nwhile not os.path.exists({str(both_begin)!r}): time.sleep(0.001)\nraise SystemExit(1)"

    async def slowly(command: Sequence[str], errors: Path, run: str = "") -> asyncio.subprocess.Process:
        made.append(child := await spawn(command, errors, run))
        if child is made[0]:
            return child
        if len(made) == 3:
            both_begin.touch()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            for _ in range(1000 * (len(made) - 2) if child is made[-1] else 0):  # turns: it ends after the other one
                await asyncio.sleep(0.0)
            child.kill()
            await child.wait()
            raise
        raise AssertionError

    monkeypatch.setattr("hil.harness.realtime.programs.spawn", slowly)
    stage.fly(dict.fromkeys(Role, UNTIL_STDIN_ENDS), world=dies)
    assert "world.stderr.txt" in stage.ending.failure
    assert len(made) == 3 and all(process.returncode is not None for process in made)


def test_a_signal_stops_the_roles_gently(stage: Stage) -> None:
    """They may land: what they say after it is still heard."""
    lands = """
        import signal
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # it may come while the first line is written
        print(FIRST, flush=True)
        signal.sigwait({signal.SIGTERM})
        print(LAST, flush=True)
    """
    programs = {
        role: f"FIRST, LAST = {encode_event(progress(role))!r}, {encode_event(result(role, Outcome.INTERRUPTED))!r}\n"
        + textwrap.dedent(lands)
        for role in Role
    }

    def when_both_are_flying(_: Progress) -> None:
        if len(stage.shown) == 2:
            os.kill(os.getpid(), signal.SIGTERM)

    stage.on_progress = when_both_are_flying
    run = stage.fly(programs)
    assert run.interrupted
    assert {end.outcome for end in results(run).values()} == {Outcome.INTERRUPTED}


def test_nothing_is_left_behind_not_even_a_child_of_a_child(stage: Stage) -> None:
    mother = """
        import os, sys, time
        pid = os.fork()
        if pid == 0:
            os.closerange(0, 3)
            time.sleep(600)
        print(pid, flush=True)
        sys.stdin.read()
    """

    async def main() -> int:
        process = await stage.start("mother", textwrap.dedent(mother))
        assert process.stdout is not None
        child = int(await process.stdout.readline())
        assert not gone(child)
        await children.end(stage.processes)
        return child

    child = asyncio.run(main())
    assert all(process.returncode is not None for process in stage.processes)
    given_up_s = time.monotonic() + 60.0
    while not gone(child) and time.monotonic() < given_up_s:  # whoever reaps it may be a busy process
        os.sched_yield()
    assert gone(child)


def test_the_children_of_a_run_share_its_name(stage: Stage) -> None:
    async def main() -> bytes:
        process = await stage.start("child", f"import os; print(os.environ[{children.RUN_VARIABLE!r}])")
        output, _ = await process.communicate()
        await children.end(stage.processes)
        return output

    assert asyncio.run(main()).decode().strip() == children.run_name()


def test_what_a_program_writes_to_stderr_is_kept(stage: Stage) -> None:
    stage.fly(dict.fromkeys(Role, "import sys; sys.stderr.write('why')"))
    assert (stage.out / "sender.stderr.txt").read_text() == "why"


# --- the report --------------------------------------------------------------------------------------------------


FOUND = {"landed": {"sender": True, "receiver": True}, "violations": {}, "details": []}


def report(
    stage: Stage, finished: Mapping[str, Any] = FOUND, failure: str = "", dead: Sequence[Role] = ()
) -> FlightReport:
    run = RealTimeRun(sitl.orders_of(stage.request, {}), sitl.ENDS, {})
    for role in Role:
        run.drones[role.value].result = None if role in dead else result(role)
    return sitl.report_of(stage.request, run, Ending(finished, failure, "", 50.0, 0.0))


def log_responsibility(stage: Stage, role: Role, *changes: tuple[int, bool], ended: bool = True) -> None:
    with McapLog(new_part(stage.out, role.value)) as log:
        for stamp_ns, responsible in changes:
            log.write("/responsibility", stamp_ns, {"responsible": responsible, "until_ns": None})
        if ended:
            log.write("/outcome", changes[-1][0] + 1, {"outcome": "committed"})


def test_a_good_run_reports_no_violation(stage: Stage) -> None:
    log_responsibility(stage, Role.SENDER, (10, True), (20, False))
    log_responsibility(stage, Role.RECEIVER, (30, True))
    good = report(stage)
    assert (good.violations, good.failure, list(good.notes)) == ({}, "", [])
    assert good.landed == dict.fromkeys(Role, True)
    assert good.results == {role: result(role) for role in Role}


def test_the_logs_of_both_roles_are_judged_in_the_order_of_time(stage: Stage) -> None:
    """The receiver's log is read after the sender's; what counts is when it was written."""
    log_responsibility(stage, Role.SENDER, (10, True), (30, False))
    log_responsibility(stage, Role.RECEIVER, (20, True))
    assert report(stage).violations == {"S1": 1}


def test_the_logs_of_a_role_s_programs_are_judged_one_after_another(stage: Stage) -> None:
    """A dead program is responsible for nothing; one that was started again is what it says."""
    log_responsibility(stage, Role.SENDER, (10, True), ended=False)
    log_responsibility(stage, Role.RECEIVER, (20, True))
    assert report(stage).violations == {}
    log_responsibility(stage, Role.SENDER, (30, True))
    assert report(stage).violations == {"S1": 1}


def test_what_the_world_saw_is_added(stage: Stage) -> None:
    log_responsibility(stage, Role.SENDER, (10, True))
    log_responsibility(stage, Role.RECEIVER, (20, True))
    finished = {
        "landed": {"sender": True, "receiver": False},
        "violations": {"S1": 1, "S9": 2},
        "details": ["S9 at 3.00 s: near"],
    }
    bad = report(stage, finished=finished)
    assert bad.violations == {"S1": 2, "S9": 2}
    assert bad.landed == {Role.SENDER: True, Role.RECEIVER: False}
    assert "S9 at 3.00 s: near" in bad.notes


def test_a_dead_program_is_named_with_its_last_words(stage: Stage) -> None:
    (stage.out / "receiver.stderr.txt").write_text("Traceback\n  ...\nValueError: no such camera\n")
    dead = report(stage, dead=[Role.RECEIVER])
    assert dead.results[Role.RECEIVER] is None
    (note,) = dead.notes
    assert note.startswith("the receiver's program died") and note.endswith("ValueError: no such camera")


def test_a_world_without_findings_is_a_failure(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(children, "FINDINGS_S", 0.2)
    stage.fly({role: saying(result(role)) for role in Role}, world="import sys; sys.stdin.read()")
    assert stage.ending.failure == "the world did not end"
    silent = report(stage, finished={}, failure=stage.ending.failure)
    assert silent.landed == dict.fromkeys(Role, False)


# --- wiring ------------------------------------------------------------------------------------------------------


def test_the_proxy_is_where_each_link_believes_the_other_drone_to_be(rig: Any) -> None:
    for role in (Role.SENDER, Role.RECEIVER):
        side, link = proxy_side(rig.role(role)), rig.role(role).link.options
        assert side.listen == address_of(link["peer"], "peer")
        assert side.end == address_of(link["bind"], "bind")


def test_no_two_ends_of_a_run_share_a_port(rig: Any) -> None:
    sides = [proxy_side(rig.role(role)) for role in Role]
    ends = [end for side in sides for end in (side.listen, side.end)]
    assert len(set(ends)) == 4


UNTIL_CONFINED = """
import time
end = time.monotonic() + 60.0
while "path-handoff-share" not in open("/proc/self/cgroup").read() and time.monotonic() < end:
    time.sleep(0.01)
assert "-{}\\n" in open("/proc/self/cgroup").read()
"""


def test_each_roles_program_gets_a_group_of_its_own_also_when_it_is_started_again(stage: Stage) -> None:
    """It goes on only when it finds itself in it."""
    try:
        with CpuShare("test", 0.5):
            pass
    except PartError as error:
        pytest.skip(str(error))
    of_sender, of_receiver = (UNTIL_CONFINED.format(name) for name in sitl.ENDS)
    programs = {
        Role.SENDER: [
            of_sender + saying(progress(Role.SENDER, AT_COUNT), then="import time; time.sleep(600)"),
            of_sender + saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER, Outcome.RESTARTED)),
        ],
        Role.RECEIVER: of_receiver + saying(result(Role.RECEIVER)),
    }
    with CpuShare("sender", 0.5) as one, CpuShare("receiver", 0.5) as other:
        stage.shares = {"sender": one, "receiver": other}
        run = stage.fly(programs, ["kill_sender=0.05"])
    assert {role: each.outcome for role, each in results(run).items()} == {
        Role.SENDER: Outcome.RESTARTED, Role.RECEIVER: Outcome.COMMITTED
    }  # fmt: skip


def test_a_share_that_cannot_be_had_ends_before_anything_starts(
    rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.cpu_share.hierarchies", lambda: iter(()))
    request = FlightRequest(with_slow(rig, 0.2), tmp_path, 1, (), None, lambda role: [], lambda _: None)  # type: ignore[arg-type]
    with pytest.raises(PartError, match="control group"):
        sitl.SitlHarness().fly(request)
    assert not list(tmp_path.iterdir())

"""The parent of a run in real time, with small programs in the places of the world and the
roles.
"""

from __future__ import annotations

import asyncio
import os
import signal
import textwrap
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.cpu_share import CpuShare
from drivers.interfaces import PartError
from drivers.link.udp import address_of
from drivers.rig.parts import with_slow
from flight.harness.flights import ABSENT, FlightRequest, Progress, encode_event
from flight.outcome import Outcome
from hil.harness import sitl
from hil.harness.realtime import children
from hil.harness.realtime.parts import proxy_side
from hil.world.faults import AT_COUNT
from path.messages import Role
from tests.hil.harness.programs_on_stage import (
    UNTIL_STDIN_ENDS,
    Stage,
    gone,
    progress,
    result,
    results,
    saying,
)


def test_results_are_collected_and_progress_shown_whatever_else_is_printed(stage: Stage) -> None:
    programs = {
        role: saying("[Info] a library says hello", progress(role), "{}", result(role), "bye")
        for role in Role
    }
    run = stage.fly(programs)
    assert results(run) == {role: result(role) for role in Role}
    assert sorted(shown.role.value for shown in stage.shown) == ["receiver", "sender"]
    assert not run.interrupted


def test_a_program_that_dies_has_no_result(stage: Stage) -> None:
    programs = {Role.SENDER: saying(result(Role.SENDER)), Role.RECEIVER: "raise SystemExit(3)"}
    assert results(stage.fly(programs)) == {Role.SENDER: result(Role.SENDER)}


def test_a_program_that_is_stopped_for_good_is_ended_at_last(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
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

    async def slowly(
        command: Sequence[str], errors: Path, run: str = ""
    ) -> asyncio.subprocess.Process:
        made.append(child := await spawn(command, errors, run))
        if child is made[0]:
            return child
        if len(made) == 3:
            both_begin.touch()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            # turns: it ends after the other one
            for _ in range(1000 * (len(made) - 2) if child is made[-1] else 0):
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


@pytest.mark.parametrize(("comes", "begins"), [(True, 1), (False, 0)])
def test_the_worlds_time_begins_with_the_last_program_and_not_while_one_is_absent(
    stage: Stage, comes: bool, begins: int
) -> None:
    stage.awaited = frozenset(sitl.ENDS)
    absent = replace(progress(Role.RECEIVER), phase=ABSENT)
    end = result(Role.RECEIVER, Outcome.COMMITTED if comes else Outcome.NOT_STARTED)
    come = [progress(Role.RECEIVER)] if comes else []
    programs = {
        Role.SENDER: saying(progress(Role.SENDER), result(Role.SENDER)),
        Role.RECEIVER: saying(absent, *come, end),
    }
    run = stage.fly(programs)
    assert (stage.out / "told").read_text().count('"begin"') == begins
    assert ABSENT in [shown.phase for shown in stage.shown]
    assert results(run)[Role.RECEIVER].outcome is end.outcome


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
    # whoever reaps it may be a busy process
    while not gone(child) and time.monotonic() < given_up_s:
        os.sched_yield()
    assert gone(child)


def test_the_children_of_a_run_share_its_name(stage: Stage) -> None:
    async def main() -> bytes:
        process = await stage.start(
            "child", f"import os; print(os.environ[{children.RUN_VARIABLE!r}])"
        )
        output, _ = await process.communicate()
        await children.end(stage.processes)
        return output

    assert asyncio.run(main()).decode().strip() == children.run_name()


def test_what_a_program_writes_to_stderr_is_kept(stage: Stage) -> None:
    stage.fly(dict.fromkeys(Role, "import sys; sys.stderr.write('why')"))
    assert (stage.out / "sender.stderr.txt").read_text() == "why"


# --- wiring


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


def test_each_roles_program_gets_a_group_of_its_own_also_when_it_is_started_again(
    stage: Stage,
) -> None:
    """It goes on only when it finds itself in it."""
    try:
        with CpuShare("test", 0.5):
            pass
    except PartError as error:
        pytest.skip(str(error))
    of_sender, of_receiver = (UNTIL_CONFINED.format(name) for name in sitl.ENDS)
    programs = {
        Role.SENDER: [
            of_sender
            + saying(progress(Role.SENDER, AT_COUNT), then="import time; time.sleep(600)"),
            of_sender
            + saying(progress(Role.SENDER, AT_COUNT), result(Role.SENDER, Outcome.RESTARTED)),
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
    request = FlightRequest(
        with_slow(rig, 0.2),
        tmp_path,
        1,
        (),
        None,  # type: ignore[arg-type]
        lambda role: [],
        lambda _: None,
    )
    with pytest.raises(PartError, match="control group"):
        sitl.SitlHarness().fly(request)
    assert not list(tmp_path.iterdir())

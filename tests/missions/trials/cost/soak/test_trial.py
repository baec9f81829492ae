"""The figures that a soak reads from the programs and their logs; it notices what grows."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord
from missions.ground import rig_library
from missions.ground.rig_library import mission_of
from missions.trials.cost.soak import trial as soak
from missions.trials.cost.soak.watch import ProgramSample, Watch, programs
from path.messages import Role

GROWS = """
import sys
held = []
print("up", flush=True)
for _ in sys.stdin:
    held.append(b"x" * 30 * 2**20)
    print("done", flush=True)
"""
MS = 1_000_000


def test_programs_have_names_that_a_reader_knows() -> None:
    with (
        subprocess.Popen(
            [sys.executable, "-c", "input()", "guard", "--role", "receiver"], stdin=subprocess.PIPE
        ) as one,
        subprocess.Popen(
            [sys.executable, "-c", "input()", "missions.cli", "sender"], stdin=subprocess.PIPE
        ) as other,
    ):
        found = dict(programs(os.getpid()))
        assert found[one.pid] == "guard of the receiver"
        assert found[other.pid] == "sender"
        one.kill()
        other.kill()


def test_memory_that_grows_is_noticed_in_the_program_that_holds_it() -> None:
    line = [sys.executable, "-c", GROWS, "receiver"]
    watch = Watch(60.0, lambda: 0.0, lambda: True, lambda: None)
    with subprocess.Popen(
        line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdout.readline()
        for _ in range(4):
            watch.take()
        process.stdin.write("more\n")
        process.stdin.flush()
        process.stdout.readline()
        for _ in range(4):
            watch.take()
        process.stdin.close()
    assert soak.growth_mib(watch.samples["receiver"]) == pytest.approx(30.0, abs=3.0)
    assert soak.growth_mib(watch.samples["receiver"][:4]) == pytest.approx(0.0, abs=1.0)
    assert sum(soak.cpu_share(watch.samples["receiver"]).values()) >= 0.0


def test_the_processor_s_share_is_of_the_time_between_the_samples() -> None:
    taken = [
        ProgramSample(10.0, 1.0, {"main": 2.0}),
        ProgramSample(14.0, 1.0, {"main": 3.0, "camera": 1.0}),
    ]
    assert soak.cpu_share(taken) == {"main": 0.25, "camera": 0.25}


def records(topic: str, bodies: Sequence[tuple[int, Mapping[str, object]]]) -> list[LogRecord]:
    return [LogRecord(topic, stamp_ns, dict(body)) for stamp_ns, body in bodies]


def logged(ages_ms: Sequence[float]) -> dict[str, list[LogRecord]]:
    """A role that verifies from 100 ms to its end, one frame a 20 ms."""
    frames = [
        (100 * MS + 20 * MS * k, {"frame_id": k, "age_ns": age * MS})
        for k, age in enumerate(ages_ms)
    ]
    phases = [
        (0, {"phase": "approach"}),
        (100 * MS, {"phase": "verify"}),
        (10**12, {"phase": "land"}),
    ]
    return {
        "/phase": records("/phase", phases),
        "/frame": records("/frame", [(50 * MS, {"frame_id": 0, "age_ns": 900 * MS}), *frames]),
    }


def test_a_queue_that_grows_makes_frames_older() -> None:
    ages = soak.ages_ms(logged([3.0] * 10 + [20.0] * 10))
    assert (ages["p50"], ages["first_quarter_p95"], ages["last_quarter_p95"]) == (11.5, 3.0, 20.0)
    (finding,) = soak._age_findings(Role.SENDER, ages)
    assert finding.verdict == "short"
    (finding,) = soak._age_findings(Role.SENDER, soak.ages_ms(logged([3.0] * 20)))
    assert finding.verdict == "met"


def test_it_verifies_until_its_deadline_only(tmp_path: Path) -> None:
    rig = soak._endless(rig_library.load("sitl-light"), 90.0, tmp_path)
    assert mission_of(rig).deadlines.verify_s == 90.0
    assert rig.method.tau_min == rig.method.tau_max == soak.NEVER  # no pair agrees
    assert rig.harness == rig_library.load("sitl-light").harness


def test_a_rig_in_virtual_time_is_refused() -> None:
    with pytest.raises(PartError, match="level sitl"):
        soak.check(rig_library.load("sim"))

"""What a worker that died leaves running is ended, and nothing else."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.left_behind import end_left_behind

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/environ").exists(), reason="only Linux shows the environment of processes"
)


def sleeper(worker: str, run: str) -> subprocess.Popen[bytes]:
    environment = os.environ | {"PYTEST_XDIST_WORKER": worker, "PYTEST_XDIST_TESTRUNUID": run}
    program = "print(flush=True); import time; time.sleep(600)"
    started = subprocess.Popen(
        [sys.executable, "-c", program], env=environment, stdout=subprocess.PIPE
    )
    assert started.stdout is not None
    started.stdout.readline()
    return started


def test_only_the_dead_worker_s_processes_are_ended(tmp_path: Path) -> None:
    run = tmp_path.as_posix()
    with sleeper("gw3", run) as left, sleeper("gw4", run) as other, sleeper("gw3", "x") as foreign:
        try:
            assert end_left_behind("gw3", run) == [left.pid]
            assert left.wait(60.0) == -signal.SIGKILL
            assert other.poll() is None
            assert foreign.poll() is None
        finally:
            for each in (left, other, foreign):
                each.kill()


def test_a_computer_without_such_a_folder_is_left_alone(tmp_path: Path) -> None:
    assert end_left_behind("gw3", "run", tmp_path / "proc") == []

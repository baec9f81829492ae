"""A share of a core: held to by the kernel, gone at the end, and refused with the reason where it
may not be had.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers import cpu_share
from drivers.cpu_share import PREFIX, CpuShare, Hierarchy, hierarchies
from drivers.interfaces import PartError

BURN_S = 1.0
TRIES = 5
BURN = f"""
import time
end, begin = time.monotonic() + {BURN_S}, time.process_time()
while time.monotonic() < end:
    pass
print(time.process_time() - begin)
"""
HOLDS = """
import sys
from drivers.cpu_share import CpuShare
with CpuShare("kept", 0.5) as share:
    print(share.folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module")
def groups() -> None:
    """Skips, with the reason, where control groups cannot be written to."""
    try:
        with CpuShare("test", 0.5):
            pass
    except PartError as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("groups")
def test_a_process_and_what_it_starts_get_their_share_together() -> None:
    for _ in range(TRIES):
        with CpuShare("test", 0.2) as share:
            program = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {BURN!r}])"
            waits = f"import sys; sys.stdin.readline(); {program}"
            pipe = subprocess.PIPE
            process = subprocess.Popen(
                [sys.executable, "-c", waits], stdin=pipe, stdout=pipe, text=True
            )
            share.add(process.pid)
            told, _ = process.communicate("go\n")
            assert float(told) < 0.35 * BURN_S
            if float(told) > 0.05 * BURN_S and share.stopped_s() > 0.1 * BURN_S:
                return
    # others may have had the core, but not each time
    pytest.fail("it was never given its share, nor held to it")


@pytest.mark.usefixtures("groups")
def test_the_group_is_gone_at_the_end_whatever_happens() -> None:
    folders: list[Path] = []
    with pytest.raises(KeyboardInterrupt), CpuShare("test", 0.5) as share:
        assert share.folder is not None
        folders.append(share.folder)
        assert folders[0].is_dir()
        raise KeyboardInterrupt
    assert not folders[0].exists()


@pytest.mark.usefixtures("groups")
def test_what_a_killed_program_left_is_removed_by_the_next_run_and_nothing_else() -> None:
    killed, living = (
        subprocess.Popen(
            [sys.executable, "-c", HOLDS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    )
    assert killed.stdout is not None
    assert living.stdout is not None
    left, used = Path(killed.stdout.readline().strip()), Path(living.stdout.readline().strip())
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert left.is_dir()
    with CpuShare("test", 0.5):
        assert not left.exists()
        assert used.is_dir()
    living.communicate()
    assert not used.exists()


@pytest.mark.usefixtures("groups")
def test_a_process_that_still_runs_is_let_out() -> None:
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    with CpuShare("test", 0.5) as share:
        assert share.folder is not None
        share.add(process.pid)
        folder = share.folder
        assert folder.name in Path(f"/proc/{process.pid}/cgroup").read_text("utf-8")
    assert not folder.exists()
    assert process.poll() is None
    process.communicate(b"\n")


@pytest.mark.usefixtures("groups")
def test_a_process_that_has_ended_is_no_error() -> None:
    process = subprocess.Popen(["true"])
    process.wait()
    with CpuShare("test", 0.5) as share:
        share.add(process.pid)


@pytest.fixture
def version_2(tmp_path: Path) -> Iterator[Path]:
    """What the kernel shows of version 2, as plain files: groups cannot be limited in it."""
    top, own = tmp_path / "top", tmp_path / "top" / "scope"
    own.mkdir(parents=True)
    for folder, given in ((top, ""), (own, "")):
        (folder / "cgroup.controllers").write_text("cpu memory")
        (folder / "cgroup.subtree_control").write_text(given)
    yield top


def test_version_2_is_given_a_quota_in_its_own_words(version_2: Path) -> None:
    with CpuShare("test", 0.2, [Hierarchy(2, (version_2,))]) as share:
        assert share.folder is not None
        assert (share.folder / "cpu.max").read_text() == "2000 10000"
        assert (version_2 / "cgroup.subtree_control").read_text() == "+cpu"
        (share.folder / "cpu.stat").write_text(
            "usage_usec 900\nnr_throttled 3\nthrottled_usec 1500000\n"
        )
        assert share.stopped_s() == pytest.approx(1.5)


def test_in_version_2_a_group_that_cannot_limit_is_left_for_the_one_above(version_2: Path) -> None:
    own = version_2 / "scope"
    (own / "cgroup.controllers").write_text("memory")
    with CpuShare("test", 0.2, [Hierarchy(2, (own, version_2))]) as share:
        assert share.folder is not None
        assert share.folder.parent == version_2


def test_a_short_share_gets_a_quota_that_the_kernel_takes(version_2: Path) -> None:
    with CpuShare("test", 0.02, [Hierarchy(2, (version_2,))]) as share:
        assert share.folder is not None
        assert (share.folder / "cpu.max").read_text() == "1000 50000"


def test_where_no_group_may_be_made_it_is_refused_with_the_reasons_and_a_way_out(
    tmp_path: Path,
) -> None:
    gone = Hierarchy(1, (tmp_path / "none",))
    without = Hierarchy(2, (tmp_path,))
    (tmp_path / "cgroup.controllers").write_text("memory")
    with (
        pytest.raises(PartError, match=r"none.*has no cpu controller") as refused,
        CpuShare("test", 0.2, [gone, without]),
    ):
        pass
    assert "as root" in refused.value.remedy
    with pytest.raises(PartError, match="none is mounted"), CpuShare("test", 0.2, []):
        pass


@pytest.mark.parametrize("share", [0.0, 0.01, 1.5, float("nan")])
def test_a_share_that_is_none_is_refused(share: float) -> None:
    with pytest.raises(PartError, match="of a core"):
        CpuShare("test", share)


def test_the_groups_of_a_process_are_found_as_they_are_mounted(tmp_path: Path) -> None:
    (tmp_path / "cgroup").write_text("2:cpuacct:/a\n1:cpu:/docker/7f/job\n0::/user.slice/x.scope\n")
    (tmp_path / "mountinfo").write_text(
        "30 2 0:25 /docker/7f /sys/fs/cgroup/cpu rw,nosuid - cgroup cgroup rw,cpu\n"
        "31 2 0:26 / /sys/fs/cgroup/cpuacct rw - cgroup cgroup rw,cpuacct\n"
        "32 2 0:27 / /sys/fs/cgroup/unified rw shared:9 - cgroup2 cgroup2 rw\n"
    )
    unified = Path("/sys/fs/cgroup/unified")
    assert list(hierarchies(tmp_path)) == [
        Hierarchy(1, (Path("/sys/fs/cgroup/cpu/job"),)),
        Hierarchy(2, (unified / "user.slice/x.scope", unified / "user.slice", unified)),
    ]


def test_a_leftover_is_told_by_when_its_maker_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, others = tmp_path / f"{PREFIX}-1-77-sender", tmp_path / f"{PREFIX}-1-99-sender"
    for folder in (ours, others):
        folder.mkdir()
    monkeypatch.setattr(cpu_share, "_began", lambda pid: "99")  # type: ignore[misc]
    cpu_share.remove_leftovers(tmp_path)
    assert not ours.exists()
    assert others.exists()

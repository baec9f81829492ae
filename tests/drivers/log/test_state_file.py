from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import Kept, RecordStore, StateError
from drivers.log import state_file
from drivers.log.state_file import MemoryStore, StateFile, boot_id
from path.messages import AbortReason, Role
from path.protocol.values import Handoff, ReceiverRecord, SenderRecord

LIVE = Handoff(7, 3, 1)
RELEASED = SenderRecord(3, "released", LIVE, 0xFFFF_FFFF, 1 << 60, (1 << 60) + 5, AbortReason.PILOT)
HOLDING = ReceiverRecord(3, "holding", LIVE, 99)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "sender.state.json"


def test_what_was_saved_is_loaded_by_another_program(path: Path) -> None:
    assert StateFile(path, Role.SENDER).load() is None
    StateFile(path, Role.SENDER).save(SenderRecord(2))
    StateFile(path, Role.SENDER).save(RELEASED)
    assert StateFile(path, Role.SENDER).load() == Kept(RELEASED, same_clock=True)
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert "released" in path.read_text() and "pilot" in path.read_text()
    other = path.with_name("receiver.state.json")
    StateFile(other, Role.RECEIVER).save(HOLDING)
    assert StateFile(other, Role.RECEIVER).load() == Kept(HOLDING, same_clock=True)


def test_a_drone_that_changes_its_role_has_one_record_of_the_role_it_is_in(path: Path) -> None:
    StateFile(path, None).save(HOLDING)
    assert (
        StateFile(path, None).load()
        == StateFile(path, Role.RECEIVER).load()
        == Kept(HOLDING, same_clock=True)
    )
    StateFile(path, None).save(RELEASED)
    assert (
        StateFile(path, None).load()
        == StateFile(path, Role.SENDER).load()
        == Kept(RELEASED, same_clock=True)
    )
    with pytest.raises(StateError, match="is of the sender"):
        StateFile(path, Role.RECEIVER).load()


def test_after_a_reboot_its_instants_are_of_another_clock(path: Path) -> None:
    StateFile(path, Role.SENDER, boot="one").save(RELEASED)
    assert StateFile(path, Role.SENDER, boot="two").load() == Kept(RELEASED, same_clock=False)
    StateFile(path, Role.SENDER, boot="").save(RELEASED)
    assert StateFile(path, Role.SENDER, boot="").load() == Kept(RELEASED, same_clock=False)


def test_the_computer_says_which_boot_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert boot_id() == boot_id()
    monkeypatch.setattr(state_file, "BOOT_ID", tmp_path / "none")
    assert boot_id() == ""


def becomes(text: str) -> Callable[[str], str]:
    def change(before: str) -> str:
        del before
        return text

    return change


def cut_short(text: str) -> str:
    return text[:-30]


def one_digit_changed(text: str) -> str:
    return text.replace('"epoch": 3', '"epoch": 2', 1)


def changed(**changes: Any) -> Callable[[str], str]:
    """With its check sum made right again: not damaged, but another file."""

    def change(text: str) -> str:
        content = {**json.loads(text), **changes}
        content.pop("check")
        return json.dumps({**content, "check": state_file._check(content)})

    return change


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (becomes(""), "damaged: not JSON"),
        (cut_short, "damaged: not JSON"),
        (becomes("[" * 100_000), "damaged: not JSON"),
        (becomes("[]"), "damaged: no check sum"),
        (becomes('{"epoch": 3}'), "damaged: no check sum"),
        (one_digit_changed, "damaged: the check sum"),
        (changed(format="something else"), "no state file of this version"),
        (changed(role="receiver"), "is of the receiver, and this is the sender"),
        (changed(record={"epoch": "three"}), "damaged: Expected `int`"),
        (changed(record={"epoch": 3, "duty": "king"}), "damaged: Invalid enum value 'king'"),
        (changed(record=None), "damaged: Expected `object`"),
    ],
)
def test_a_damaged_or_foreign_file_is_named_with_what_to_do(
    path: Path, spoil: Callable[[str], str], says: str
) -> None:
    StateFile(path, Role.SENDER).save(RELEASED)
    path.write_text(spoil(path.read_text()))
    with pytest.raises(StateError) as caught:
        StateFile(path, Role.SENDER).load()
    assert says in str(caught.value) and str(path) in str(caught.value)
    assert caught.value.remedy


def test_what_cannot_be_read_is_named(path: Path) -> None:
    path.mkdir()
    with pytest.raises(StateError, match="cannot read"):
        StateFile(path, Role.SENDER).load()


def full(*_: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(("module", "call"), [(os, "fsync"), (Path, "replace")])
def test_a_full_disk_is_named_and_leaves_the_old_record(
    path: Path, monkeypatch: pytest.MonkeyPatch, module: Any, call: str
) -> None:
    store = StateFile(path, Role.SENDER)
    store.save(SenderRecord(2))
    with monkeypatch.context() as patch:
        patch.setattr(module, call, full)
        with pytest.raises(StateError, match=r"cannot write .*No space left"):
            store.save(RELEASED)
    assert store.load() == Kept(SenderRecord(2), same_clock=True)
    store.save(RELEASED)
    assert store.load() == Kept(RELEASED, same_clock=True)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(StateError, match="cannot write"):
        StateFile(tmp_path / "none" / "file", Role.SENDER).save(RELEASED)


def test_file_and_folder_are_on_the_disk_before_it_returns(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file before it is renamed, the folder after."""
    calls: list[str] = []
    real_sync, real_replace = os.fsync, Path.replace

    def sync(number: int) -> None:
        calls.append(
            "sync folder" if Path(f"/proc/self/fd/{number}").resolve().is_dir() else "sync file"
        )
        real_sync(number)

    def replace(self: Path, other: Path) -> Path:
        calls.append("rename")
        return real_replace(self, other)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(Path, "replace", replace)
    StateFile(path, Role.SENDER).save(RELEASED)
    assert calls == ["sync file", "rename", "sync folder"]


SAVES_FOR_EVER = """
import sys
from itertools import count
from pathlib import Path
from drivers.log.state_file import StateFile
from path.messages import Role
from path.protocol.values import SenderRecord
store = StateFile(Path(sys.argv[1]), Role.SENDER)
for epoch in count(1):
    store.save(SenderRecord(epoch))
    print(epoch, flush=True)
"""


def test_killed_at_any_moment_it_leaves_what_was_saved_or_what_was_being_saved(path: Path) -> None:
    wait = np.random.default_rng(1)
    root = Path(__file__).parents[3]
    for _ in range(4):
        command = [sys.executable, "-c", SAVES_FOR_EVER, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(wait.uniform(0.0, 0.05))
            process.kill()
            said = process.stdout.read().split() or ["1"]
        kept = StateFile(path, Role.SENDER).load()
        assert kept is not None and kept.record.epoch in (int(said[-1]), int(said[-1]) + 1)


def test_memory_keeps_it_as_long_as_it_is_there() -> None:
    store: RecordStore = MemoryStore()
    assert store.load() is None
    store.save(HOLDING)
    assert store.load() == Kept(HOLDING, same_clock=True)


def test_what_is_saved_aside_is_on_the_disk_when_it_says_so(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = StateFile(path, Role.SENDER)
    going, real = threading.Event(), os.fsync

    def slow(number: int) -> None:
        assert going.wait(60.0)
        real(number)

    monkeypatch.setattr(os, "fsync", slow)
    saved = store.begin_save(RELEASED)
    assert not saved.done() and not path.exists()
    going.set()
    saved.result(60.0)
    assert store.load() == Kept(RELEASED, same_clock=True)


def test_a_disk_that_is_full_is_told_to_whoever_waits(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StateError, match="No space left"):
        StateFile(path, Role.SENDER).begin_save(RELEASED).result(60.0)


def test_what_the_disk_is_asked_to_keep_has_left_the_program_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sync of a file whose content still waits in a buffer keeps nothing."""
    sizes: list[int] = []

    def note(number: int) -> None:
        sizes.append(os.fstat(number).st_size)

    monkeypatch.setattr(os, "fsync", note)
    file = tmp_path / "state.json"
    StateFile(file, Role.SENDER).save(SenderRecord(7))
    assert sizes[0] == file.stat().st_size > 0


def test_a_person_can_read_it_a_line_for_each_thing(path: Path) -> None:
    StateFile(path, Role.SENDER).save(RELEASED)
    assert any(line.strip().startswith('"duty"') for line in path.read_text().splitlines())


KEPT_BY_A_FORMER_PROGRAM = """{
  "format": "path-handoff state 1",
  "role": "receiver",
  "boot": "a boot",
  "record": {
    "epoch": 3,
    "duty": "holding",
    "live": {"handoff_id": 7, "epoch": 3, "target_id": 1, "instance": 0},
    "nonce": 99,
    "lease_end_ns": 0,
    "sure_ns": 0
  },
  "check": "4b44ed8e5dc4e1b2"
}
"""


def test_what_a_former_program_wrote_down_is_still_read(path: Path) -> None:
    """The check sum is of the content, however it is laid out: a newer program must not take it for
    damaged.
    """
    path.write_text(KEPT_BY_A_FORMER_PROGRAM)
    assert StateFile(path, Role.RECEIVER, boot="a boot").load() == Kept(HOLDING, same_clock=True)
    content = json.loads(KEPT_BY_A_FORMER_PROGRAM)
    path.write_text(json.dumps(dict(reversed(content.items()))))
    assert StateFile(path, Role.RECEIVER, boot="another").load() == Kept(HOLDING, same_clock=False)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="counts open files in /proc")
def test_many_records_leave_no_file_open(path: Path) -> None:
    """A drone that hands over for hours must not run out of them."""
    kept = StateFile(path, Role.SENDER)
    kept.save(RELEASED)
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        kept.save(RELEASED)
    assert len(list(Path("/proc/self/fd").iterdir())) <= before

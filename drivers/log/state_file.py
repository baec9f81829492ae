"""The record that a role needs after a restart, in a file that is always whole: the old record or
the new one.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import msgspec

from drivers.interfaces import Kept, StateError
from drivers.text_file import read_file
from path.messages import Role
from path.protocol.values import ReceiverRecord, SenderRecord

FORMAT = "path-handoff state 1"
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")

_KINDS: dict[Role, type[SenderRecord] | type[ReceiverRecord]] = {
    Role.SENDER: SenderRecord,
    Role.RECEIVER: ReceiverRecord,
}


class MemoryStore:
    """A ``RecordStore`` for simulations: what was saved is there as long as this object is."""

    def __init__(self, kept: Kept | None = None) -> None:
        self.kept = kept

    def load(self) -> Kept | None:
        return self.kept

    def save(self, record: SenderRecord | ReceiverRecord) -> None:
        self.kept = Kept(record, same_clock=True)

    def begin_save(self, record: SenderRecord | ReceiverRecord) -> Future[None]:
        saved = Future[None]()
        _settle(saved, lambda: self.save(record))
        return saved


class StateFile:
    """A ``RecordStore`` on disk, as JSON that a person can read.

    Saving writes a file beside it, waits until the disk has it, renames it over the old one and
    waits for the folder too. A check sum tells a damaged file from a whole one.

    Args:
        path: the file; its folder must exist.
        role: whose record it is; a file of the other role is refused. None: of a drone that changes
            its role in the air; there is one record of it at any time, of the role that it is in.
        boot: of this run of the computer's clock; "" where the computer does not say.
    """

    def __init__(
        self,
        path: Path,
        role: Role | None,
        boot: str | None = None,
    ) -> None:
        self._path = path
        self._role = role
        self._boot = boot_id() if boot is None else boot

    def load(self) -> Kept | None:
        try:
            text = read_file(self._path)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StateError(
                f"cannot read {self._path}: {error.strerror}", "make it readable for this user"
            ) from error
        content = self._whole(text)
        if content.get("format") != FORMAT:
            raise StateError(
                f"{self._path} is no state file of this version of PATH", f"move {self._path} away"
            )
        if self._role is not None and content.get("role") != self._role.value:
            raise StateError(
                f"{self._path} is of the {content.get('role')}, and this is the {self._role.value}",
                "give each role a state file of its own with --state",
            )
        try:
            record = msgspec.convert(content["record"], _KINDS[Role(content["role"])])
        except (KeyError, ValueError) as error:  # a msgspec.ValidationError is one
            raise self._damaged(str(error)) from error
        same_clock = bool(self._boot) and content.get("boot") == self._boot
        return Kept(record, same_clock)

    def save(self, record: SenderRecord | ReceiverRecord) -> None:
        content = {
            "format": FORMAT,
            "role": (Role.SENDER if isinstance(record, SenderRecord) else Role.RECEIVER).value,
            "boot": self._boot,
            "record": msgspec.to_builtins(record),
        }
        text = json.dumps({**content, "check": _check(content)}, indent=2) + "\n"
        beside = self._path.with_name(self._path.name + ".new")
        try:
            with beside.open("wb") as file:
                file.write(text.encode())
                file.flush()
                os.fsync(file.fileno())
            beside.replace(self._path)
            _sync_folder(self._path.parent)
        except OSError as error:
            raise StateError(
                f"cannot write {self._path}: {error.strerror}",
                "make room on the disk, and see that this user may write there",
            ) from error

    def begin_save(self, record: SenderRecord | ReceiverRecord) -> Future[None]:
        """Save in a thread of its own, which ends with it: there are half a dozen in a mission."""
        saved = Future[None]()
        saved.set_running_or_notify_cancel()  # from here on nobody can take it back
        threading.Thread(
            target=_settle,
            args=(saved, lambda: self.save(record)),
            name="state-file",
        ).start()
        return saved

    def _whole(self, text: bytes) -> dict[str, Any]:
        try:
            content: Any = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise self._damaged("not JSON") from error
        if not isinstance(content, dict) or not isinstance(content.get("check"), str):
            raise self._damaged("no check sum")
        check = content.pop("check")
        if check != _check(content):
            raise self._damaged("the check sum is of another content")
        return content

    def _damaged(self, why: str) -> StateError:
        return StateError(
            f"{self._path} is damaged: {why}",
            f"land both drones; then delete {self._path} and the other drone's state file, so that both begin anew",
        )


def boot_id() -> str:
    """Return an id that differs from one start of this computer to the next; "" where it does not
    say.
    """
    try:
        return BOOT_ID.read_text().strip()
    except OSError:
        return ""


def _check(content: dict[str, Any]) -> str:
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:16]


def _settle(saved: Future[None], save: Callable[[], None]) -> None:
    try:
        save()
    except Exception as error:
        saved.set_exception(error)
    else:
        saved.set_result(None)


def _sync_folder(folder: Path) -> None:
    """Make a rename in it safe."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)

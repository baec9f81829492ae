"""The record on a drone's disk when it changes its role.

One record is on it at any time, of the role it is in; epochs only grow, whichever role wrote them.
So a program that dies between two roles finds either the one or the other, and both say the same:
who is responsible.

A drone goes from one target of a team to another, and takes its epoch with it. So the epochs of a
leg begin above all that any drone can have seen before: by the leg's number, not by what its sender
held.
"""

from __future__ import annotations

import asyncio

from drivers.interfaces import Kept, RecordStore
from path.protocol.values import LAST_EPOCH, ReceiverRecord, SenderRecord

Record = SenderRecord | ReceiverRecord
# of a leg: as often can its target be taken back and offered once more before it meets the next
# leg's
EPOCHS = 8


def as_holder(kept: Kept | None) -> SenderRecord:
    """Return the record of a drone that is responsible from now on, and will hand over.

    What it held, or was first to find, is its own.

    Raises ValueError for a record of another drone's target.
    """
    record = None if kept is None else kept.record
    if isinstance(record, ReceiverRecord) and record.duty != "holding":
        raise ValueError(f"a drone that is {record.duty} has nothing to hand over")
    return SenderRecord(0 if record is None else record.epoch, "mine")


def for_leg(kept: Kept | None, number: int) -> SenderRecord:
    """Return the record of a responsible drone whose relief has been called, before anything is
    said to it.

    Raises ValueError for a record of a drone that has nothing to hand over.
    """
    own = as_holder(kept)
    return SenderRecord(max(own.epoch, min(EPOCHS * (number - 1), LAST_EPOCH - EPOCHS)), own.duty)


def as_relief(kept: Kept | None) -> ReceiverRecord:
    """Return the record of a drone on the ground that is called.

    Nothing is its own, and of what it handed over nothing is taken back. What it held when its
    program died has long been given to another drone.
    """
    record = None if kept is None else kept.record
    if record is None or (isinstance(record, ReceiverRecord) and record.live is None):
        return record or ReceiverRecord()
    return ReceiverRecord(record.epoch + 1)


def as_first(kept: Kept | None) -> SenderRecord:
    """Return the record of a drone that is to find the target, which nobody has: nothing is its
    own yet.
    """
    return SenderRecord() if kept is None else SenderRecord(kept.record.epoch)


async def write(store: RecordStore, record: Record) -> None:
    """Write a record, and return when the disk has it. Raises StateError."""
    await asyncio.wrap_future(store.begin_save(record))

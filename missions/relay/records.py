"""The record on a drone's disk when it changes its role.

One record is on it at any time, of the role it is in; epochs only grow, whichever role wrote them. So a program that
dies between two roles finds either the one or the other, and both say the same: who is responsible.
"""

from __future__ import annotations

import asyncio

from drivers.interfaces import Kept, RecordStore
from path.protocol.values import ReceiverRecord, SenderRecord

Record = SenderRecord | ReceiverRecord


def as_holder(kept: Kept | None) -> SenderRecord:
    """Returns the record of a drone that is responsible from now on, and will hand over.

    What it held, or was first to find, is its own.

    Raises ValueError for a record of another drone's target.
    """
    record = None if kept is None else kept.record
    if isinstance(record, ReceiverRecord) and record.duty != "holding":
        raise ValueError(f"a drone that is {record.duty} has nothing to hand over")
    return SenderRecord(0 if record is None else record.epoch, "mine")


def as_relief(kept: Kept | None) -> ReceiverRecord:
    """Returns the record of a drone on the ground that is called.

    Nothing is its own, and of what it handed over nothing is taken back.
    """
    record = None if kept is None else kept.record
    if isinstance(record, ReceiverRecord):
        return record
    return ReceiverRecord() if record is None else ReceiverRecord(record.epoch + 1)


def as_first(kept: Kept | None) -> SenderRecord:
    """Returns the record of a drone on the ground that is to find the target."""
    record = None if kept is None else kept.record
    if isinstance(record, SenderRecord):
        return record
    return SenderRecord() if record is None else SenderRecord(record.epoch)


async def write(store: RecordStore, record: Record) -> None:
    """Writes a record, and returns when the disk has it. Raises StateError."""
    await asyncio.wrap_future(store.begin_save(record))

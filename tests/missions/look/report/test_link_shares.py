from __future__ import annotations

from typing import Any

import pytest

from drivers.log.mcap_log import LogRecord
from missions.look.report.link_shares import link_shares
from path.messages import Role

OFFSET_NS = 40_000_000_000  # of the receiver's clock to the sender's


def counted(
    at_ns: int, sent: int, received: int, offset_ns: int | None, **dropped: int
) -> LogRecord:
    record: dict[str, Any] = {
        "packets_sent": sent,
        "packets_received": received,
        "dropped": dropped,
    }
    return LogRecord("/link", at_ns, {**record, "clock_offset_ns": offset_ns})


def end(begin_s: float, offset_ns: int, flood_hz: int, lost: float) -> list[LogRecord]:
    """One end that says 60 packets a second, and is told as many less the lost ones, for ten
    seconds.
    """
    return [
        counted(
            round((begin_s + k) * 1e9), 60 * k, round(60 * k * (1.0 - lost)) + flood_hz * k, offset_ns,
            flooded=flood_hz * k, superseded=7 * k,
        )
        for k in range(10)
    ]  # fmt: skip


def test_what_arrived_is_counted_against_what_was_said_on_the_others_clock() -> None:
    sender, receiver = end(100.0, OFFSET_NS, 0, 0.0), end(140.4, -OFFSET_NS, 25_000, 0.1)
    told = link_shares({Role.SENDER: sender, Role.RECEIVER: receiver})
    assert told["link_taken"] == {
        "sender": pytest.approx(1.0),
        "receiver": pytest.approx(0.9, abs=0.002),
    }
    assert told["link_foreign_hz"] == {"sender": 0.0, "receiver": 25_000.0}


def test_what_the_logs_do_not_tell_is_null() -> None:
    whole, short = end(100.0, 0, 0, 0.0), end(100.0, 0, 0, 0.0)[:2]
    nobody: list[LogRecord] = []
    # too short; no log; a program that began anew
    for other in (short, nobody, [*whole, *end(120.0, 0, 0, 0.0)]):
        assert (
            link_shares({Role.SENDER: whole, Role.RECEIVER: other})["link_taken"]["sender"] is None
        )
    assert link_shares({Role.SENDER: nobody, Role.RECEIVER: nobody})["link_foreign_hz"] == {
        "sender": None, "receiver": None,
    }  # fmt: skip
    unaligned = [counted(one.stamp_ns, 60, 60, None) for one in whole]
    assert (
        link_shares({Role.SENDER: unaligned, Role.RECEIVER: whole})["link_taken"]["sender"] is None
    )

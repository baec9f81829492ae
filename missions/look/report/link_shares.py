"""The share of one drone's messages that the other took, and what else came in, by both logs'
counters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from drivers.link.flood import foreign_packets
from drivers.log.mcap_log import LogRecord
from path.messages import Role

LEAST_S = 2.0


def link_shares(records: Mapping[Role, Sequence[LogRecord]]) -> dict[str, Any]:
    """``link_taken``: of the packets that its peer sent while both were there; ``link_foreign_hz``:
    of others, the most in a second. By role; null where the records do not tell.
    """
    peer = {Role.SENDER: Role.RECEIVER, Role.RECEIVER: Role.SENDER}
    return {
        "link_taken": {role.value: _taken(records[role], records[peer[role]]) for role in Role},
        "link_foreign_hz": {role.value: _foreign_hz(records[role]) for role in Role},
    }


def _taken(own: Sequence[LogRecord], peer: Sequence[LogRecord]) -> float | None:
    """Return the share; the peer's counter is read between its records, at the instants of this
    end's.
    """
    if len(peer) < 2 or _began_anew(own) or _began_anew(peer):
        return None
    stamps_ns = np.array([one.stamp_ns for one in peer], float)
    within: list[tuple[float, LogRecord]] = []
    for one in own:
        if one.record["clock_offset_ns"] is not None:
            at_ns = float(one.stamp_ns + one.record["clock_offset_ns"])
            if stamps_ns[0] <= at_ns <= stamps_ns[-1]:
                within.append((at_ns, one))
    if len(within) < 2 or within[-1][0] - within[0][0] < LEAST_S * 1e9:
        return None
    counts = np.array([one.record["packets_sent"] for one in peer], float)
    begin, end = (
        float(np.interp(at_ns, stamps_ns, counts)) for at_ns, _ in (within[0], within[-1])
    )
    taken = _taken_by(within[-1][1]) - _taken_by(within[0][1])
    return round(taken / (end - begin), 4) if end > begin else None


def _taken_by(record: LogRecord) -> int:
    return int(record.record["packets_received"]) - foreign_packets(record.record["dropped"])


def _foreign_hz(own: Sequence[LogRecord]) -> float | None:
    rates = [
        (foreign_packets(b.record["dropped"]) - foreign_packets(a.record["dropped"]))
        / ((b.stamp_ns - a.stamp_ns) * 1e-9)
        for a, b in pairwise(own)
        if b.stamp_ns > a.stamp_ns and not _began_anew((a, b))
    ]
    return round(max(rates), 1) if rates else None


def _began_anew(records: Sequence[LogRecord]) -> bool:
    return any(b.record["packets_sent"] < a.record["packets_sent"] for a, b in pairwise(records))

"""The paper's gate's word on a run, whichever gate decided: the longest row of agreeing pairs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from missions.look.report.records import RunRecords, judged_pairs, last


def longest_row(run: RunRecords) -> dict[str, Any] | None:
    """Return the longest row of agreeing pairs without a miss of either drone, up to the commit;
    None when the sender judged nothing. The rules are those of ``path.gate.window``.

    Returns:
        ``pairs`` and ``seconds`` of it, on the stamps of D2's frames, and ``complete``: whether the
        paper's gate would have let the target be handed over by then.
    """
    setup = last(run.sender, "/setup")
    pairs = judged_pairs(run)
    if setup is None or not pairs:
        return None
    method: Mapping[str, Any] = setup.record["method"]
    max_gap_ns = round(method["max_gap_s"] * 1e9)
    hold_ns = round(method["hold_s"] * 1e9)
    missed = [r.record["capture_ns"] for r in run.sender.get("/target", ()) if r.record["reason"]]
    judged = [r.record for r in pairs if r.record["counted"]]
    events = [(record["capture_ns"], bool(record["agreed"])) for record in judged]
    events += [
        (capture_ns, False) for capture_ns in missed if capture_ns <= pairs[-1].record["capture_ns"]
    ]
    count = 0
    begin_ns = 0
    newest_ns = 0
    most = 0
    longest_ns = 0
    complete = False
    for capture_ns, agreed in sorted(events):
        if not agreed:
            count = 0
            continue
        if count == 0 or capture_ns - newest_ns > max_gap_ns:
            count = 0
            begin_ns = capture_ns
        count = count + 1
        newest_ns = capture_ns
        span_ns = capture_ns - begin_ns
        if count > most:
            most = count
            longest_ns = span_ns
        complete = complete or (count >= method["hold_frames"] and span_ns >= hold_ns)
    return {"pairs": most, "seconds": longest_ns * 1e-9, "complete": complete}

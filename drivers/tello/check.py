"""A Tello's answers about itself."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.rig.part_check import Finding, counted
from drivers.tello.commands import TelloLink

ANSWER_S = 1.0
STATE_HZ = 10.0  # of state packets, as the SDK says


async def drone_findings(link: TelloLink) -> Sequence[Finding]:
    """Its SDK, serial number and Wi-Fi. Questions only: what it does not know or answer is a
    note.
    """
    sdk, serial, wifi = [await link.ask(f"{word}?", ANSWER_S) for word in ("sdk", "sn", "wifi")]
    findings = [
        _told("SDK", sdk),
        _told("serial", serial),
        _told("Wi-Fi", wifi, "signal to noise "),
    ]
    if link.report is not None:
        findings.append(
            Finding("ok", "temperature", f"{link.report.hottest_c:.0f} degrees C at most")
        )
    packets = {"state packets": lambda: link.report and link.report.arrival_ns}
    findings += await counted(packets, STATE_HZ, "nearer to it, or another Wi-Fi channel")
    if link.bad_reports:
        fix = "see docs/tello.md for the firmwares that are known"
        findings.append(Finding("note", "unreadable", f"{link.bad_reports} state packets", fix))
    return findings


def _told(
    name: str,
    answer: str | None,
    before: str = "",
) -> Finding:
    if answer is None or answer.lower().startswith(("unknown", "error")):
        what = "it does not answer" if answer is None else f"it says {answer!r}"
        return Finding(
            "note",
            name,
            what,
            "" if answer else "nearer to it, or fewer networks on this channel",
        )
    return Finding("ok", name, f"{before}{answer}")

"""Runs as a JUnit file, which continuous integration shows as tests: one test case a run."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from path.values import frozen

_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@frozen
class JUnitCase:
    """One run.

    Attributes:
        name: of the run in its suite, such as ``seed 7``.
        outcome: how it ended.
        replay: the command that shows it again.
        failures: why it counts as failed, the first one first; empty for a good run.
        seconds: how long it took.
    """

    name: str
    outcome: str
    replay: str
    failures: Sequence[str] = ()
    seconds: float = 0.0


def write_junit(
    file: Path,
    suite: str,
    cases: Sequence[JUnitCase],
) -> None:
    """Write the runs of one suite. Raises OSError."""
    counts = {
        "name": suite, "tests": str(len(cases)), "failures": str(sum(bool(case.failures) for case in cases)),
        "errors": "0", "skipped": "0", "time": f"{sum(case.seconds for case in cases):.3f}",
    }  # fmt: skip
    root = ET.Element("testsuites")
    element = ET.SubElement(root, "testsuite", counts)
    for case in cases:
        _add(element, suite, case)
    ET.indent(root)
    file.write_bytes(ET.tostring(root, "utf-8", xml_declaration=True) + b"\n")


def _add(
    suite: ET.Element,
    classname: str,
    case: JUnitCase,
) -> None:
    named = {"classname": classname, "name": case.name, "time": f"{case.seconds:.3f}"}
    element = ET.SubElement(suite, "testcase", named)
    told = f"outcome: {case.outcome}\nreplay: {case.replay}\n"
    if case.failures:
        failure = ET.SubElement(
            element,
            "failure",
            {"message": _clean(case.failures[0]), "type": case.outcome},
        )
        failure.text = _clean("\n".join((*case.failures, told)))
    else:
        ET.SubElement(element, "system-out").text = _clean(told)


def _clean(text: str) -> str:
    """Return a text without the characters that XML cannot hold."""
    return _NOT_XML.sub("?", text)

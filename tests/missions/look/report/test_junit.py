"""The JUnit files of many runs, held against the structure that readers of such files expect
(Jenkins' schema).
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from missions.fly.handoff.many import junit_case as handoff_case
from missions.ground.options.flights import HandoffOptions
from missions.ground.options.proofs import CampaignOptions
from missions.look.report.junit import JUnitCase, write_junit
from missions.proofs.campaign.results import RunLine
from missions.proofs.campaign.run import junit_case, run

# element: (attributes it must have, attributes it may have, children it may have)
SCHEMA: dict[str, tuple[set[str], set[str], set[str]]] = {
    "testsuites": (set(), {"name", "time", "tests", "failures", "errors"}, {"testsuite"}),
    "testsuite": (
        {"name", "tests", "failures"},
        {"errors", "skipped", "time", "timestamp", "hostname", "id", "package"},
        {"properties", "testcase", "system-out", "system-err"},
    ),
    "testcase": (
        {"name", "classname"}, {"time", "status", "assertions"},
        {"skipped", "error", "failure", "system-out", "system-err"},
    ),
    "failure": (set(), {"message", "type"}, set()),
    "system-out": (set(), set(), set()),
}  # fmt: skip


def validated(file: Path) -> ET.Element:
    """The only suite of a file that keeps to the schema, and whose counts are those of its
    cases.
    """
    root = ET.parse(file).getroot()
    assert root.tag == "testsuites"
    for element in root.iter():
        must, may, children = SCHEMA[element.tag]
        assert must <= set(element.attrib) <= must | may, element.tag
        assert {child.tag for child in element} <= children, element.tag
        for name in {"time", "tests", "failures", "errors", "skipped"} & set(element.attrib):
            assert float(element.attrib[name]) >= 0.0
    (suite,) = root
    assert int(suite.attrib["tests"]) == len(suite)
    assert int(suite.attrib["failures"]) == len(suite.findall("testcase/failure"))
    return suite


def test_a_failed_run_has_its_outcome_its_failures_and_the_line_that_replays_it(
    tmp_path: Path,
) -> None:
    bad = JUnitCase(
        "seed 2", "crashed", "path-handoff handoff --seed 2", ("it < died & \x00", "twice"), 1.5
    )
    write_junit(
        tmp_path / "runs.xml", "handoff sim", [JUnitCase("seed 1", "committed", "again"), bad]
    )
    suite = validated(tmp_path / "runs.xml")
    good, failed = suite
    assert (good.attrib["name"], good.findtext("system-out")) == (
        "seed 1",
        "outcome: committed\nreplay: again\n",
    )
    failure = failed.find("failure")
    assert failure is not None
    assert failure.attrib == {"message": "it < died & ?", "type": "crashed"}
    assert (
        failure.text
        == "it < died & ?\ntwice\noutcome: crashed\nreplay: path-handoff handoff --seed 2\n"
    )
    assert suite.attrib["time"] == "1.500"


def test_a_campaign_writes_one_case_a_run(tmp_path: Path) -> None:
    asked = CampaignOptions(
        runs=6, faults=("none", "lossy"), jobs=1, out=tmp_path, junit=tmp_path / "runs.xml"
    )
    assert run(asked) == 0
    suite = validated(tmp_path / "runs.xml")
    assert [case.attrib["name"] for case in suite] == [
        f"{('none', 'lossy')[n % 2]} {n}" for n in range(6)
    ]
    assert "--faults lossy --seed 0 --only 3" in (suite[3].findtext("system-out") or "")


def test_a_run_of_a_campaign_fails_by_what_it_violated_and_by_nothing_else() -> None:
    asked = CampaignOptions(seed=5)
    violated = junit_case(asked, RunLine(3, "harsh", "commit", ("S1 at 2 s: two",)))
    assert (violated.failures, violated.outcome) == (("S1 at 2 s: two",), "commit")
    assert (
        violated.replay
        == "path-handoff campaign --program machines --faults harsh --seed 5 --only 3"
    )
    assert (
        junit_case(asked, RunLine(4, "harsh", "timeout", beyond=("S1 at 2 s: two",))).failures == ()
    )


def test_a_handoff_fails_when_its_own_exit_code_says_so() -> None:
    asked = HandoffOptions(rig="sim", fault=("link_loss=0.3",), errors="exact")
    summary = {
        "seed": 7,
        "outcome": "no_agreement",
        "exit_code": 10,
        "detail": "sender: late",
        "notes": [],
        "wall_s": 2.0,
    }
    late = handoff_case(asked, summary)
    assert (late.name, late.outcome, late.failures, late.seconds) == (
        "seed 7",
        "no_agreement",
        ("sender: late",),
        2.0,
    )
    assert (
        late.replay
        == "path-handoff handoff --rig sim --seed 7 --errors exact --fault link_loss=0.3"
    )
    good = handoff_case(asked, {**summary, "outcome": "committed", "exit_code": 0, "detail": ""})
    assert good.failures == ()

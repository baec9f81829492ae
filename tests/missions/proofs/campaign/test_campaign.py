"""The command: resumable JSON lines, gone on with, refused for another campaign, replayed by the
line it prints.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from flight.command_end import CommandEnd
from missions.cli import main
from missions.fly.team.base import TeamBase
from missions.ground.options.proofs import CampaignOptions
from missions.proofs.campaign.results import FILE, RunLine, resumable_results
from missions.proofs.campaign.run import replay_command, run
from missions.proofs.campaign.summary import summarize, table

ASKED = {"program": "machines", "rig": "sim", "seed": 0, "levels": ["none"]}


def options(out: Path, **changes: object) -> CampaignOptions:
    return CampaignOptions(
        **{"runs": 8, "faults": ("none", "lossy"), "jobs": 1, "out": out, **changes}  # type: ignore[arg-type]
    )


def test_a_campaign_makes_its_table_and_goes_on_where_it_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(options(tmp_path)) == 0
    whole = (tmp_path / FILE).read_text()
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["runs"], summary["violations"]) == (8, 0)
    assert {name: level["runs"] for name, level in summary["levels"].items()} == {
        "none": 4,
        "lossy": 4,
    }
    assert (tmp_path / "outcomes.png").stat().st_size > 1000
    assert "8 runs" in capsys.readouterr().out

    lines = whole.splitlines(keepends=True)
    (tmp_path / FILE).write_text("".join(lines[:4]) + lines[4][:20])  # killed within a line
    assert run(options(tmp_path)) == 0
    assert "3 runs are done, 5 are left" in capsys.readouterr().out
    assert sorted((tmp_path / FILE).read_text().splitlines()[1:]) == sorted(whole.splitlines()[1:])


def test_ctrl_c_during_a_flight_stops_the_campaign_and_that_run_is_not_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With one job the flight is in this process, and takes the signal first."""
    name_targets = TeamBase._name_targets

    def pressed(base: TeamBase) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        name_targets(base)

    monkeypatch.setattr(TeamBase, "_name_targets", pressed)
    asked = options(tmp_path, program="team", runs=2, faults=("none",), hours=0.02)
    assert run(asked) == CommandEnd.STOPPED.exit_code
    assert "0 of 2 runs are done" in capsys.readouterr().out
    assert len((tmp_path / FILE).read_text().splitlines()) == 1


def test_another_campaign_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    assert run(options(tmp_path, runs=2)) == 0
    with pytest.raises(PartError, match=r"begun with seed 0, not 1"):
        run(options(tmp_path, runs=2, seed=1))
    with pytest.raises(PartError, match="levels"):
        run(options(tmp_path, runs=2, faults=("none",)))


def test_what_is_no_campaign_is_refused(tmp_path: Path) -> None:
    (tmp_path / FILE).write_text("something else\n")
    with (
        pytest.raises(PartError, match="no file of this version"),
        resumable_results(tmp_path, ASKED),
    ):
        pass


def test_lines_come_back_as_they_were(tmp_path: Path) -> None:
    line = RunLine(3, "none", "commit", ("S1 at 2 s: two",), (), {"gap_s": 0.25})
    with resumable_results(tmp_path, ASKED) as results:
        results.add([line])
    with resumable_results(tmp_path, ASKED) as results:
        assert results.lines == [line]


def test_a_violation_is_shown_with_the_line_that_replays_it() -> None:
    lines = [
        RunLine(3, "harsh", "commit", ("S1 at 2.000 s: two responsible drones",)),
        RunLine(4, "harsh", "timeout"),
    ]
    told = CampaignOptions(seed=5)
    summary = summarize("machines", 5, lines, lambda line: replay_command(told, line))
    replay = "path-handoff campaign --program machines --faults harsh --seed 5 --only 3"
    assert summary["failures"] == [
        {
            "number": 3,
            "level": "harsh",
            "violations": ["S1 at 2.000 s: two responsible drones"],
            "replay": replay,
        }
    ]
    assert summary["violations_of"] == {"S1": 1}
    assert replay in table(summary)


def test_a_run_is_replayed_from_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["campaign", "--faults", "none", "--seed", "0", "--only", "1"])
    told = capsys.readouterr().out
    assert end.value.code == 0
    assert "sends COMMIT epoch 1" in told and "outcome: commit" in told


def test_a_replay_wants_to_know_the_level(tmp_path: Path) -> None:
    with pytest.raises(PartError, match="of which level"):
        run(options(tmp_path, only=1))


def test_a_cluster_needs_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as where the extra is not installed
    with pytest.raises(PartError, match="needs Dask"):
        run(options(tmp_path, cluster="tcp://127.0.0.1:1"))

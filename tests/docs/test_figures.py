"""Figures on pages are those that were kept of a run."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from missions import cli
from tests.docs import figures
from tests.docs.figures import (
    BLOCK,
    OF_ALL,
    ROOT,
    FigureError,
    FigureFolder,
    as_text,
    code_digest,
    code_of,
    rests_on,
    value_at,
)

HERE = FigureFolder(ROOT / "docs")
FLOWN = "path-handoff handoff --rig sim --seed 5 --seeds 50"
ENDS = {"committed": 48, "no_agreement": 2}
SERIES = {"command": FLOWN, "runs": 50, "outcomes": ENDS, "commit_rate_interval": [0.8654, 0.989]}
ROW = (
    "| {sim: outcomes.committed} of {sim: runs} | {sim: commit_rate_interval, 100 * .1f} "
    "| {sim: outcomes, counts} |\n"
)


@pytest.fixture
def folder(tmp_path: Path) -> FigureFolder:
    for file, text in (
        ("figures/kept/sim.json", '{"command": "path-handoff handoff --rig sim --seed 1"}'),
        ("figures/tables/flights.md", ROW),
        ("page.md", "<!-- figures: flights -->\n<!-- end of figures -->\n"),
    ):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    return FigureFolder(tmp_path)


def test_the_tables_of_the_pages_are_what_was_kept() -> None:
    stale = [
        page.name for page in HERE.pages() if HERE.written(text := page.read_text("utf-8")) != text
    ]
    assert stale == []  # python -m tests.docs.figures write


def test_every_table_is_on_a_page_and_everything_kept_in_a_table() -> None:
    text = "".join(page.read_text("utf-8") for page in HERE.pages())
    shown = [block[2] for block in BLOCK.finditer(text)]
    assert sorted({*shown}) == HERE.names("tables")
    assert len(re.findall("<!-- (?:figures: |end of figures)", text)) == 2 * len(shown)
    quoted = set(HERE.quotes())
    assert sorted({name for name, _ in quoted}) == HERE.names()


@pytest.mark.parametrize("name", HERE.names())
def test_what_is_kept_is_what_is_quoted_of_a_command_that_there_is(name: str) -> None:
    kept = HERE.kept(name)
    assert kept.command.startswith("path-handoff ")
    cli._understood(cli._spelled_out(shlex.split(kept.command)[1:]))
    quoted = {path for quoted, path in HERE.quotes() if quoted == name} - {*OF_ALL}
    assert set(kept.values) == (quoted if kept.commit else set())


def test_a_run_is_kept_and_shown(folder: FigureFolder) -> None:
    assert "| – of – | – | – |" in folder.written((folder.docs / "page.md").read_text())
    folder.keep("sim", SERIES, "1234abcd")
    folder.write()
    page = (folder.docs / "page.md").read_text()
    assert page.splitlines()[1] == "| 48 of 50 | 86.5 to 98.9 | 2 `no_agreement` |"
    # a number that somebody changed by hand
    assert folder.written(page.replace("48 of 50", "50 of 50")) == page


def test_another_run_is_not_kept(folder: FigureFolder) -> None:
    others = {
        "sim-drone": {"command": "path-handoff handoff --rig sim-drone --seed 5"},
        "short": {"quick": True},
    }
    for said, changed in (*others.items(), ("committed", {"outcomes": {}})):
        with pytest.raises(FigureError, match=said):
            folder.keep("sim", {**SERIES, **changed}, "1234abcd")
    assert not folder.kept("sim").values


def test_a_summary_that_names_no_command_says_how_it_was_run(folder: FigureFolder) -> None:
    kept = folder.docs / "figures" / "kept" / "sim.json"
    kept.write_text('{"command": "path-handoff relay --hours 8 --seed 0"}')
    summary = {**SERIES, "command": None, "seed": 3, "hours": 8.0}
    folder.keep("sim", summary, "1234abcd")
    assert folder.kept("sim").command == "path-handoff relay --hours 8 --seed 3"
    with pytest.raises(FigureError, match="hours 2 "):
        folder.keep("sim", {**summary, "hours": 2.0}, "1234abcd")


def test_a_page_names_what_there_is(folder: FigureFolder) -> None:
    with pytest.raises(FigureError, match="tables/none"):
        folder.written("<!-- figures: none -->\n<!-- end of figures -->\n")
    (folder.docs / "figures" / "tables" / "flights.md").write_text("{gone: runs}")
    with pytest.raises(FigureError, match="kept/gone"):
        folder.render("flights")


def test_a_figure_whose_code_has_changed_is_marked(folder: FigureFolder) -> None:
    (folder.docs / "figures" / "tables" / "flights.md").write_text("{sim: commit}\n")
    page = (folder.docs / "page.md").read_text()
    folder.keep("sim", SERIES, "1234abcd", code_digest(rests_on(FLOWN)))
    assert "1234abcd\n" in folder.written(page)
    folder.keep("sim", SERIES, "1234abcd", "of yesterday")
    assert "1234abcd, older code\n" in folder.written(page)


def test_comments_docstrings_and_layout_are_no_code() -> None:
    one = 'def half(x: float) -> float:\n    """Return it."""\n    # of all\n    return x / 2\n'
    other = "def half(\n    x: float\n) -> float:\n    return x / 2\n"
    assert code_of(one) == code_of(other)
    assert code_of(one) != code_of(other.replace("2", "3"))


def test_of_single_frames_no_flight_is_asked() -> None:
    assert "flight" in rests_on(FLOWN)
    assert "flight" not in rests_on("path-handoff trial pose --only static --seed 0")
    for command in (FLOWN, "path-handoff trial static"):
        assert all((ROOT / room).is_dir() for room in rests_on(command))


def test_figures_are_run_again_the_quick_ones_first_and_within_the_time_that_there_is(
    folder: FigureFolder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, command, took_s in (("slow", "relay", 7200.0), ("broken", "team", 2.0)):
        kept = {"command": f"path-handoff {command}", "commit": "1234abcd", "took_s": took_s}
        (folder.docs / "figures" / "kept" / f"{name}.json").write_text(json.dumps(kept))

    def run(words: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        if "team" in words:
            return subprocess.CompletedProcess(words, 3, "", "error: no such rig\n  fix: another\n")
        out = Path(words[words.index("--out") + 1])
        (out / "summary.json").write_text(json.dumps(SERIES))
        return subprocess.CompletedProcess(words, 0, "", "")

    monkeypatch.setattr(figures.subprocess, "run", run)
    left_out = folder.refresh(folder.names(), 60.0, "5678abcd")
    assert capsys.readouterr().out == "sim: 0 s\n"
    assert folder.kept("sim").commit == "5678abcd" and not folder.kept("sim").is_old
    assert left_out[0] == "broken: error: no such rig"
    assert left_out[1].startswith("slow: took 7200 s, and 3")


def test_a_row_of_flights_is_written_once(folder: FigureFolder) -> None:
    figures_of = {f"{key}_m": {"median": 0.02} for key in ("d2_error", "target_error")}
    summary = {
        **SERIES,
        **figures_of,
        "commit_rate": 0.96,
        "agreement_s": {"median": 1.6, "p95": 5.0},
        "monitors": {},
        "wrong_handovers": 0,
    }
    (folder.docs / "figures" / "tables" / "flights.md").write_text("flights:\nflights: sim\n")
    folder.keep("sim", summary, "1234abcd")
    shown = folder.render("flights").splitlines()
    assert shown[0].startswith("| command |") and shown[1].startswith("|---|")
    row = "96 % of 50 (86.5 to 98.9) | 1.6 and 5.0 s | 20.0 | 20 | 0; none | 2 `no_agreement`"
    assert f"| `{FLOWN}` | {row} | " in shown[2]


def test_values_are_found_by_their_path_and_told_by_their_form() -> None:
    cells = {"cells": [{"recall": 0.9, "gate": gate, "t": 1.5} for gate in ("count", "evidence")]}
    assert value_at(cells, "cells[recall=0.9 gate=evidence].t") == 1.5
    with pytest.raises(FigureError):
        value_at(cells, "cells[recall=0.9].t")
    finding = {
        "quantity": "D2",
        "ours": "4",
        "interval": "3 to 5",
        "paper": "47",
        "goal": "≤ 8",
        "verdict": "met",
    }
    assert as_text([finding], "findings") == "| D2 | 4 | 3 to 5 | 47 | ≤ 8, met |"
    assert as_text([finding], "findings D1; D2") == as_text([finding], "findings")
    assert as_text([finding], "findings target") == ""
    assert (as_text(15120, ""), as_text({"S9": 1}, "counts"), as_text({}, "counts")) == (
        "15,120",
        "1 `S9`",
        "none",
    )

"""Figures on pages are those that were kept of a run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from missions import cli
from tests.docs.figures import BLOCK, OF_ALL, ROOT, FigureError, FigureFolder, as_text, value_at

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
    assert as_text([finding], "findings") == "| D2 | 4 | 3 to 5 | 47 | ≤ 8 | met |"
    assert (as_text(15120, ""), as_text({"S9": 1}, "counts"), as_text({}, "counts")) == (
        "15,120",
        "1 `S9`",
        "none",
    )

"""run.html holds what a person needs, and nothing from elsewhere."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from flight.outcome import Outcome
from missions.look.report.advice import advice
from missions.look.report.command import make_report
from missions.look.report.records import FACTS, PAGE


def page_of(folder: Path, *, picture: bool = False) -> str:
    make_report(folder, picture, io.StringIO())
    return (folder / PAGE).read_text("utf-8")


def test_a_page_says_how_it_ended_what_to_do_and_how_to_run_it_again(
    make_run: Callable[..., Path],
) -> None:
    page = page_of(make_run(images=True), picture=True)
    for words in (
        "committed",
        "What to do next",
        "path-handoff handoff --rig sim --seed 7",
        "smallest separation",
    ):
        assert words in page
    assert page.count("<figure>") >= 4
    assert "data:image/png;base64," in page
    assert "data:image/jpeg;base64," in page


def test_a_page_needs_nothing_else(make_run: Callable[..., Path]) -> None:
    page = page_of(make_run(images=True), picture=True)
    assert "<script" not in page
    assert all(source.startswith("data:") for source in re.findall(r"src='([^']{0,20})", page))
    assert "http" not in page


def test_one_drones_flight_in_the_field_has_a_page_that_says_its_own_end(
    make_run: Callable[..., Path],
) -> None:
    folder = make_run(world=False)
    (folder / FACTS).unlink()
    (folder / "receiver.mcap").unlink()
    page = page_of(folder)
    assert "on the drone" in page
    assert "<h2>sender</h2>" in page
    assert "<h2>receiver</h2>" not in page


@pytest.mark.parametrize("outcome", Outcome)
def test_there_is_something_to_do_after_every_end(outcome: Outcome) -> None:
    assert advice(outcome.label).endswith((".", "?"))
    assert advice(outcome.label) != advice("unfinished")

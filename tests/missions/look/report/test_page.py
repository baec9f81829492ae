"""run.html holds what a person needs, and nothing from elsewhere."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from flight.outcome import Outcome
from missions.look.report.above import played
from missions.look.report.advice import advice
from missions.look.report.command import make_report
from missions.look.report.records import FACTS, PAGE, by_topic
from tests.missions.look.colours import SEEN_BY, TEN_TIMES_SEEN, contrast, difference, linear
from tests.missions.look.live import little_flight as flown
from tests.missions.look.live.browser import CHROMIUM, WHY_NOT, browser
from tests.missions.look.live.little_flight import little_flight

PHONE = (390, 844)


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


@pytest.fixture
def little_page(tmp_path: Path) -> str:
    """Of the moment that the live page is tested with."""
    with little_flight(tmp_path) as flight:
        flight.begin()
        for _ in range(3):
            flight.moment()
    return page_of(tmp_path)


def drawn(page: str, kind: str) -> list[ElementTree.Element]:
    """The drawings of a class."""
    found = re.findall(rf"<svg class='{kind}'.*?</svg>", page, re.DOTALL)
    return [ElementTree.fromstring(each) for each in found]


def test_the_map_shows_what_the_live_page_shows_when_each_phase_began(little_page: str) -> None:
    [sheet] = drawn(little_page, "map")
    moments = sheet.findall("g")
    # two programs' stamps of one instant are in either order
    *began, last = re.findall(r"<label for='m\d+'>(.*?)</label>", little_page)
    assert {*began} == {
        f"{who} {what} 0 s" for who in ("D1", "D2") for what in ("take-off", "verify")
    }
    assert last == "the end"
    assert len(moments) == 5
    end = moments[-1]
    fence, *about = [float(each.attrib["r"]) for each in sheet.iter("circle")]
    px_per_m = fence / 25.0
    assert about[-2:] == pytest.approx([0.7 * px_per_m] * 2, abs=0.1)
    assert len(sheet.findall("polygon")) == 2  # the walls, and the strip along them
    strip = float(sheet.findall("polygon")[0].attrib["stroke-width"])
    assert strip == pytest.approx(2.0 * flown.CLEAR_M * px_per_m, abs=0.1)
    places = [
        re.findall(r"translate\(([-\d.]+) ([-\d.]+)\) rotate", each.attrib.get("transform", ""))
        for each in end.findall("path")
    ]
    (d1,), (d2,) = ([(float(x), float(y)) for x, y in each] for each in places if each)
    east_m = flown.D1_M[1] - flown.D2_M[1]
    north_m = flown.D1_M[0] - flown.D2_M[0]
    assert d1[0] - d2[0] == pytest.approx(px_per_m * east_m, abs=0.3)
    assert d2[1] - d1[1] == pytest.approx(px_per_m * north_m, abs=0.3)
    assert len(end.findall("rect")) == 1  # what D1 saw beside it
    assert end.find("g/ellipse") is not None
    assert "Evidence 2.5 of 3.3 needed" in little_page


def test_what_is_written_on_the_map_has_seven_to_one_and_its_drones_are_told_apart(
    little_page: str,
) -> None:
    [sheet] = drawn(little_page, "map")
    written = {text.attrib["fill"]: text.text or "" for text in sheet.iter() if text.tag == "text"}
    inks = {code: linear(bytes.fromhex(code.removeprefix("#"))) for code in written}
    assert {"D1", "D2", "target"} <= {*written.values()}
    assert min(contrast(ink, linear(b"\xff\xff\xff")) for ink in inks.values()) >= 7.0
    first, second = (inks[code] for code, said in written.items() if said in ("D1", "D2"))
    for who in SEEN_BY:
        assert difference(first, second, who) > TEN_TIMES_SEEN


def test_an_image_of_a_phase_has_what_was_found_in_its_frame(little_page: str) -> None:
    boxes: list[tuple[float, ...]] = []
    corners: list[str] = []
    for image in drawn(little_page, "seen"):
        for each in image.iter("rect"):
            boxes.append(tuple(float(each.attrib[key]) for key in ("x", "y", "width", "height")))
        corners += [each.attrib["points"] for each in image.iter("polygon")]
    assert {*boxes} == {flown.OWN_BOX, flown.MAPPED_BOX, flown.D2_BOX}
    assert {*corners} == {" ".join(map(str, flown.MARKER_PX))}
    words = re.findall(r"<text[^>]*>(target|marker|D2.{0,8}s box)</text>", little_page)
    assert {"target", "marker"} < {*words}


def test_a_flight_of_hours_is_thinned_and_has_all_its_phases(tmp_path: Path) -> None:
    with little_flight(tmp_path) as flight:
        flight.begin()
        flight.moment()
    records = by_topic(tmp_path / "sender.mcap")
    [state] = records["/state"]
    records["/state"] = [
        replace(state, utc_ns=state.utc_ns + 100_000_000 * k) for k in range(36_000)
    ]
    run = played({"sender": records})
    assert [each.title for each in run.moments] == [
        "D1 take-off 0 s",
        "D1 verify 0 s",
        "the end",
    ]
    assert 3000 < len(run.ways["sender"]) <= 6000


@pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)
def test_it_is_read_on_a_phone_and_a_tap_on_a_phase_shows_its_moment(
    tmp_path: Path, little_page: str
) -> None:
    assert "<script" not in little_page
    shown = (
        "[...document.querySelectorAll('svg g.m')]"
        ".filter(e => getComputedStyle(e).display !== 'none').map(e => e.classList[1]).join()"
    )
    with browser() as tab:
        tab.size(*PHONE)
        tab.open((tmp_path / PAGE).as_uri())
        tab.until("!!document.querySelector('.map')", drawn=False)
        assert tab.value("document.documentElement.scrollWidth") <= PHONE[0]
        assert tab.value("document.querySelector('.map').getBoundingClientRect().width") > 350
        assert tab.value(shown) == "m4"  # the last at which views were compared
        tab.tap_on("label[for=m0]")
        assert tab.value(shown) == "m0"


@pytest.mark.parametrize("outcome", Outcome)
def test_there_is_something_to_do_after_every_end(outcome: Outcome) -> None:
    assert advice(outcome.label).endswith((".", "?"))
    assert advice(outcome.label) != advice("unfinished")

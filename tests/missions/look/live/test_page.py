"""The live page in a browser: what is drawn is what is logged, and taps do what they say."""

from __future__ import annotations

import json
import re
import signal
import socket
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from drivers.log.mcap_log import read_log
from flight.config import SeparationConfig
from missions.look.live.gate import LOOPBACK, TOKEN
from missions.look.live.start import Operated, live
from tests.free_ports import free_port
from tests.missions.look.colours import RGB, SEEN_BY, TEN_TIMES_SEEN, contrast, difference, linear
from tests.missions.look.live import little_flight as flown
from tests.missions.look.live.browser import CHROMIUM, WHY_NOT, Tab, browser
from tests.missions.look.live.little_flight import LittleFlight, little_flight
from tests.written_logs import until_written

SECRET = "0123456789abcdef"
STOPS = "both drones end the hand-over and land"
PHONE = (360, 780)
LAPTOP = (1280, 800)

in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)


@dataclass
class Watched:
    """A little flight under way, its page in a browser, and D1's end of the operator's line."""

    flight: LittleFlight
    tab: Tab
    drone: socket.socket
    folder: Path

    def moment(self) -> None:
        """Have one more frame, and wait until it is drawn."""
        before = self.tab.value("window.drawn && drawn.utc_ns || 0")
        self.flight.moment()
        for log in self.flight.logs.values():
            until_written(log)
        self.tab.until(f"drawn.utc_ns > {before} && drawn.images.sender && drawn.images.receiver")

    def drawn(self) -> dict[str, Any]:
        return json.loads(self.tab.value("JSON.stringify(drawn)"))

    def heard(self, seconds: float) -> dict[str, Any] | None:
        """What D1's program is told, but for who is there."""
        self.drone.settimeout(seconds)
        try:
            while True:
                words = json.loads(self.drone.recv(65536))
                if "hello" not in words:
                    return words
        except TimeoutError:
            return None


@contextmanager
def watching(
    folder: Path, monkeypatch: pytest.MonkeyPatch, size: tuple[int, int], query: str = SECRET
) -> Generator[Watched, None, None]:
    monkeypatch.setenv(TOKEN, SECRET)
    port = free_port(socket.SOCK_STREAM)
    with ExitStack() as stack:
        drone = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        drone.bind((LOOPBACK, 0))
        operated = Operated(drone.getsockname(), STOPS)
        stack.enter_context(live(f"{LOOPBACK}:{port}", folder, operated))
        flight = stack.enter_context(little_flight(folder))
        tab = stack.enter_context(browser())
        tab.size(*size)
        tab.open(f"http://{LOOPBACK}:{port}/?token={query}")
        watched = Watched(flight, tab, drone, folder)
        flight.begin()
        watched.moment()
        yield watched


@in_a_browser
def test_what_is_drawn_is_what_is_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with watching(tmp_path, monkeypatch, PHONE) as watched:
        stamp_ns = watched.flight.moment()
        for log in watched.flight.logs.values():
            until_written(log)
        watched.tab.until(
            "drawn.matters.value === '2.5' && drawn.timeline && drawn.timeline.length >= 4"
        )
        # until the image of that very moment has come
        images = {
            path.stem: [each.stamp_ns for each in read_log(path, {"/image"})]
            for path in tmp_path.glob("*.mcap")
        }
        assert images["sender"][-1] == stamp_ns
        utc_ns = time.time_ns() - time.monotonic_ns() + stamp_ns
        watched.tab.until(f"Math.abs(drawn.images.sender.ns - {utc_ns}) < 5e7")
        watched.tab.until("drawn.images.sender.overlays.length === 2")
        drawn = watched.drawn()

    assert drawn["matters"]["of"] == "of 3.3 needed"
    assert drawn["cards"]["sender"]["name"] == "D1 ● has target"
    assert drawn["cards"]["receiver"]["words"] == "Compares both views"
    assert drawn["cards"]["receiver"]["state"] == "2.1 m up · 0.5 m/s · offboard"
    boxes = {each["kind"]: tuple(each["px"]) for each in drawn["images"]["sender"]["overlays"]}
    assert boxes == {"target": flown.OWN_BOX, "mapped": flown.MAPPED_BOX}
    d1 = drawn["map"]["drones"]["sender"]
    d2 = drawn["map"]["drones"]["receiver"]
    assert d1["place_m"] == [flown.D1_M[0] - flown.OFF_M[0], flown.D1_M[1] - flown.OFF_M[1]]
    # north is up and east to the right, to scale
    px_per_m = drawn["map"]["scale"]
    assert d1["px"][0] - d2["px"][0] == pytest.approx(px_per_m * (flown.D1_M[1] - flown.D2_M[1]))
    assert d2["px"][1] - d1["px"][1] == pytest.approx(px_per_m * (flown.D1_M[0] - flown.D2_M[0]))
    assert drawn["site"]["corners"] == len(flown.CORNERS)
    assert drawn["site"]["kept"]["strip_px"] == pytest.approx(px_per_m * flown.CLEAR_M)
    about = {each["of"]: each["radius_px"] for each in drawn["site"]["kept"]["drones"]}
    least_px = pytest.approx(px_per_m * SeparationConfig().minimum_m)
    assert about == {"sender": least_px, "receiver": least_px}
    numbers = {name: told for name, *told in drawn["numbers"]}
    assert numbers["GPS"] == ["RTK, 17 satellites"] * 2
    assert numbers["pilot's radio"] == ["heard"] * 2
    assert numbers["late"] == ["42 ms", "–"]
    assert len(drawn["map"]["others"]) == 1
    phases = {(each["of"], each["phase"]) for each in drawn["timeline"]}
    assert phases == {
        (of, phase) for of in ("sender", "receiver") for phase in ("take-off", "verify")
    }


@in_a_browser
@pytest.mark.parametrize("size", [PHONE, LAPTOP], ids=["phone", "laptop"])
def test_it_fits_its_screen_and_the_buttons_are_always_there(
    size: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with watching(tmp_path, monkeypatch, size) as watched:
        page = "document.documentElement"
        assert watched.tab.value(f"{page}.scrollWidth") <= size[0]
        if size == LAPTOP:
            assert watched.tab.value(f"{page}.scrollHeight") <= size[1]
        for name in ("point", "stop", "sound", "matters"):
            low, high, tall = watched.tab.value(
                f"(r => [r.top, r.bottom, r.height])(document.querySelector('#{name}').getBoundingClientRect())"
            )
            assert 0 <= low < high <= size[1]
            assert tall >= 44  # a thumb's


@in_a_browser
def test_a_tap_on_the_map_or_in_an_image_designates_at_the_second_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with watching(tmp_path, monkeypatch, PHONE) as watched:
        tab = watched.tab
        tab.tap_on("#map canvas", 100.0, 100.0)
        assert watched.heard(0.5) is None  # the map is not pointed at yet
        tab.tap_on("#point")
        place = tab.value("(view => ofMap(100, 100))()")
        tab.tap_on("#map canvas", 100.0, 100.0)
        tab.until("drawn.acts.pending")
        assert watched.heard(0.5) is None
        tab.tap_on("#yes")
        words = watched.heard(10.0)
        assert words is not None
        assert words["place"] == pytest.approx(place, abs=0.02)

        tab.until("!drawn.acts.pending")
        tab.tap_on("#point")
        tab.tap_on("#images canvas", 80.0, 100.0)
        tab.until("drawn.acts.pending")
        tab.tap_on("#no")
        assert watched.heard(0.5) is None
        tab.tap_on("#point")
        tab.tap_on("#images canvas", 80.0, 100.0)
        tab.until("drawn.acts.pending")
        time.sleep(0.3)
        tab.tap_on("#yes")
        seen = watched.heard(10.0)
        assert seen is not None and "place" in seen
        tab.until("drawn.events.some((each) => each.text.includes('sight, done'))")
    records = [each.record for each in read_log(tmp_path / "operator.mcap", {"/operator"})]
    assert [(each["act"], each["done"]) for each in records][:2] == [
        ("place", True),
        ("sight", True),
    ]


@in_a_browser
def test_two_taps_call_the_flight_off_as_ctrl_c_does_and_one_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupts: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number))
    try:
        with watching(tmp_path, monkeypatch, PHONE) as watched:
            watched.tab.tap_on("#stop")
            watched.tab.until(
                "drawn.acts.pending && drawn.acts.words.includes('end the hand-over')"
            )
            time.sleep(0.5)
            assert interrupts == []
            watched.tab.tap_on("#yes")
            watched.tab.until("drawn.events.some((each) => each.text.includes('stop, done'))")
            end_s = time.monotonic() + 10.0
            while not interrupts and time.monotonic() < end_s:
                time.sleep(0.02)
        assert interrupts == [signal.SIGINT]
    finally:
        signal.signal(signal.SIGINT, before)


@in_a_browser
def test_a_link_without_the_token_only_watches_and_a_wrong_one_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with watching(tmp_path, monkeypatch, LAPTOP, query="") as watched:
        watched.tab.until("drawn.acts && drawn.acts.words.startsWith('Watching only')")
        for name in ("point", "stop"):
            assert watched.tab.value(f"document.querySelector('#{name}').disabled")
        watched.tab.value(
            "fetch('/act', {method: 'POST', body: JSON.stringify({act: 'stop'})}) && 1"
        )
        watched.tab.until("drawn.events.some((each) => each.text.includes('without the token'))")


@in_a_browser
def test_alarms_stand_in_large_letters_and_sound_until_a_key_turns_that_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with watching(tmp_path, monkeypatch, PHONE) as watched:
        sender = watched.flight.sender
        violation = {"monitor": "S1", "detail": "nearer than 0.7 m"}
        sender.write("/violation", time.monotonic_ns(), violation)
        watched.moment()
        watched.tab.until("drawn.alarms.includes('✖ D1: nearer than 0.7 m')")
        size = watched.tab.value("getComputedStyle(document.querySelector('#alarms div')).fontSize")
        assert float(size.removesuffix("px")) >= 22.0
        sounded = watched.tab.value("drawn.sounded")
        assert sounded == 1
        watched.tab.tap_on("#sound")
        watched.tab.until("document.querySelector('#sound').textContent === 'Sound is on (S)'")
        for key in ("keyDown", "keyUp"):
            watched.tab.do("Input.dispatchKeyEvent", type=key, key="s", text="s")
        watched.tab.until("document.querySelector('#sound').textContent === 'Sound is off (S)'")
        sender.write("/violation", time.monotonic_ns(), {"monitor": "S2", "detail": "another"})
        watched.moment()
        watched.tab.until("drawn.alarms.includes('✖ D1: another')")
        assert watched.tab.value("drawn.sounded") == sounded


# --- colours ---


def colours() -> dict[str, RGB]:
    """The page's named colours, as linear RGB."""
    page = files("missions.look.live").joinpath("page.html").read_text()
    named = re.findall(r"--([a-z0-9]+): #([0-9a-f]{6})", page)
    return {name: linear(bytes.fromhex(code)) for name, code in named}


@pytest.mark.parametrize("name", ["ink", "dim", "d1", "d2", "alarm", "warning", "good"])
def test_all_that_is_written_has_seven_to_one_on_its_ground(name: str) -> None:
    found = colours()
    assert contrast(found[name], found["paper"]) >= 7.0


@pytest.mark.parametrize("who", SEEN_BY)
def test_the_two_drones_are_told_apart_by_the_colour_blind(who: str) -> None:
    found = colours()
    assert difference(found["d1"], found["d2"], who) > TEN_TIMES_SEEN

"""What an operator asks for on the live page goes the two ways that there are, with the token and a
second tap, and no other way.
"""

from __future__ import annotations

import asyncio
import json
import math
import socket
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from drivers.log.mcap_log import read_log
from missions.look.live import acts
from missions.look.live.acts import DroneLine, Operator
from missions.look.live.flight_state import FlightState
from missions.look.live.follow import FolderFollower
from tests.missions.look.live import little_flight as flown
from tests.missions.look.live.little_flight import little_flight
from tests.written_logs import until_written

TOKEN = "0123456789abcdef"
HOST = "10.0.0.7"
PLACE: dict[str, Any] = {"act": "place", "place": [4.2, 1.5], "error_m": 0.3}


class Desk:
    """An operator's page without a page, and D1's end of the line."""

    def __init__(self, folder: Path, line: bool = True, stops: str = "both land") -> None:
        self.folder = folder
        self.state = FlightState()
        self.drone = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.drone.bind(("127.0.0.1", 0))
        self.drone.settimeout(0.3)
        self.stopped = 0
        to_drone = DroneLine(self.drone.getsockname()) if line else None
        stop = self._stop if stops else None
        self.operator = Operator(self.state, folder, TOKEN, to_drone, stop, stops)

    def _stop(self) -> None:
        self.stopped += 1

    def tap(self, who: str = HOST, **wanted: Any) -> dict[str, Any]:
        return asyncio.run(self.operator.act({"token": TOKEN, **wanted}, who))

    def tap_twice(self, **wanted: Any) -> dict[str, Any]:
        first = self.tap(**wanted)
        time.sleep(acts.LEAST_S * 1.5)
        return self.tap(again=first["again"])

    def heard(self) -> tuple[dict[str, Any], tuple[str, int]] | None:
        """What D1's program hears next; None when it hears nothing."""
        try:
            line, address = self.drone.recvfrom(65536)
        except TimeoutError:
            return None
        return json.loads(line), address

    def log(self) -> list[tuple[str, bool]]:
        """What was asked for and whether it was done, as logged."""
        self.operator.close()
        path = self.folder / "operator.mcap"
        records = read_log(path, {"/operator"}) if path.is_file() else ()
        return [(each.record["act"], each.record["done"]) for each in records]


@pytest.fixture
def desk(tmp_path: Path) -> Generator[Desk, None, None]:
    desk = Desk(tmp_path)
    yield desk
    desk.operator.close()
    desk.drone.close()


def test_a_place_is_said_at_the_second_tap_and_not_before(desk: Desk) -> None:
    first = desk.tap(**PLACE)
    assert first["text"] == "the target is at 4.2 m north, 1.5 m east"
    assert desk.heard() is None
    time.sleep(acts.LEAST_S)
    assert desk.tap(again=first["again"]) == {"done": first["text"]}
    heard = desk.heard()
    assert heard is not None
    words, _ = heard
    assert (words["place"], words["error_m"]) == ([4.2, 1.5], 0.3)
    assert 0.2 < words["age_s"] < 10.0  # of the first tap, which is when the operator saw it
    assert desk.log() == [("place", True)]


@pytest.mark.parametrize("token", ["", "0123456789abcdeF", None, 5])
def test_nothing_is_done_without_the_token_and_that_is_logged(desk: Desk, token: Any) -> None:
    for wanted in (PLACE, {"act": "stop"}, {"act": "choose", "question": 1, "number": 1}):
        answer = asyncio.run(desk.operator.act({**wanted, "token": token}, HOST))
        assert "without the token" in answer["refused"]
        time.sleep(0.11)
    assert (desk.heard(), desk.stopped) == (None, 0)
    assert [done for _, done in desk.log()] == [False] * 3


def test_a_second_tap_counts_once_in_time_from_the_same_place_and_not_with_the_first(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = desk.tap(act="stop")
    assert "both taps at once" in desk.tap(again=first["again"])["refused"]
    first = desk.tap(act="stop")
    time.sleep(acts.LEAST_S)
    assert "no first tap" in desk.tap("10.0.0.8", again=first["again"])["refused"]
    assert "no first tap" in desk.tap(again="0123abcd")["refused"]
    monkeypatch.setattr(acts, "AGAIN_S", 0.1)
    assert "too long ago" in desk.tap_twice(act="stop")["refused"]
    monkeypatch.setattr(acts, "AGAIN_S", 5.0)
    assert desk.stopped == 0
    first = desk.tap(act="stop")
    time.sleep(acts.LEAST_S)
    assert desk.tap(again=first["again"]) == {"done": "called off"}
    assert "no first tap" in desk.tap(again=first["again"])["refused"]
    assert desk.stopped == 1


@pytest.mark.parametrize(
    "wanted",
    [
        {"act": "fly", "place": [0, 0]},
        {"act": ["stop"]},
        {},
        {"act": "place", "place": [1e9, 0.0], "error_m": 0.3},
        {"act": "place", "place": "here", "error_m": 0.3},
        {"act": "place", "place": [0.0, 0.0], "error_m": None},
        {"act": "place", "place": [0.0, 0.0], "error_m": -1.0},
        {"act": "choose", "question": -1, "number": 1},
        {"act": "choose", "question": 1, "number": True},
        {"act": "choose"},
        {"act": "sight", "of": "sender", "pixel": [1.0, 2.0], "image_ns": 5, "error_px": 5.0},
        {"act": "sight", "of": "nobody", "pixel": [1.0], "image_ns": None, "error_px": "x"},
    ],
)
def test_what_cannot_be_said_is_refused_at_the_first_tap(desk: Desk, wanted: Any) -> None:
    assert "refused" in desk.tap(**wanted)
    assert (desk.heard(), desk.stopped) == (None, 0)


def test_a_page_that_only_watches_does_nothing(tmp_path: Path) -> None:
    desk = Desk(tmp_path, line=False, stops="")
    assert "only watches" in desk.tap(act="stop")["refused"]
    assert "[sender.operator]" in desk.tap(**PLACE)["refused"]
    assert desk.operator.can() == {"designate": False, "stop": "", "question": None}
    desk.drone.close()
    desk.operator.close()


def test_a_tap_in_an_image_is_the_place_on_the_ground_that_is_seen_there(
    desk: Desk, tmp_path: Path
) -> None:
    with little_flight(tmp_path) as flight:
        follower = FolderFollower(tmp_path)
        flight.begin()
        flight.moment()
        for log in flight.logs.values():
            until_written(log)
        for said in follower.new():
            desk.state.take(said, time.monotonic())
        follower.close()
    drone = desk.state.drones["sender"]
    assert drone.camera is not None and drone.setup is not None and drone.image is not None
    # level, heading north, its camera half way down: a point of the ground in front of it
    rows = drone.setup["T_b_c"]
    ahead_m, down_m = 3.0, -flown.D1_M[2] - 0.1
    body = (ahead_m - rows[3], 0.0 - rows[7], down_m - rows[11])
    in_camera = [sum(body[j] * rows[4 * j + k] for j in range(3)) for k in range(3)]
    pixel = list(drone.camera.project_point((in_camera[0], in_camera[1], in_camera[2])))
    wanted: dict[str, Any] = {"act": "sight", "of": "sender", "pixel": pixel, "error_px": 10.0}
    desk.tap_twice(**wanted, image_ns=drone.image[0])
    heard = desk.heard()
    assert heard is not None
    words, _ = heard
    north = flown.D1_M[0] + ahead_m - flown.OFF_M[0]
    east = flown.D1_M[1] - flown.OFF_M[1]
    assert words["place"] == pytest.approx([north, east], abs=0.01)
    tilt_rad = math.radians(drone.setup["mission"]["attitude_sigma_deg"])
    at_least_m = down_m * math.hypot(10.0 / drone.camera.fx, tilt_rad)
    assert at_least_m < words["error_m"] < 10.0 * at_least_m
    wanted |= {"pixel": [320.0, -1.0], "image_ns": drone.image[0]}
    assert "outside of the image" in desk.tap(**wanted)["refused"]


def test_what_d1_asks_is_shown_and_answered(desk: Desk) -> None:
    desk.operator.turn(0.0, watched=False)
    assert desk.heard() is None  # nobody looks: nobody need be asked
    desk.operator.turn(100.0, watched=True)
    heard = desk.heard()
    assert heard is not None and heard[0] == {"hello": True}
    objects = [{"number": 2, "north_m": 4.0, "east_m": 1.0, "share": 0.6}]
    asked = {"asks": 7, "age_s": 0.1, "objects": objects, "jpeg": "/9g="}
    for line in (b"no json", b"[]", b"{}", json.dumps(asked).encode()):
        desk.drone.sendto(line, heard[1])
    desk.operator.turn(100.1, watched=True)
    shown = desk.operator.can()["question"]
    assert shown == {"asks": 7, "objects": objects, "image": "question-7"}
    assert desk.operator.image_of("question-7") == (0, b"\xff\xd8")
    desk.tap_twice(act="choose", question=7, number=2)
    heard = desk.heard()
    assert heard is not None and heard[0] == {"question": 7, "number": 2}
    desk.operator.turn(100.2 + acts.ASKED_S, watched=True)
    assert desk.operator.can()["question"] is None


def test_what_d1_does_not_take_up_is_told(desk: Desk) -> None:
    desk.tap_twice(**PLACE)
    now_s = time.monotonic()
    desk.operator.turn(now_s, watched=True)
    desk.operator.turn(now_s + acts.TAKEN_UP_S + 1.0, watched=True)
    desk.tap_twice(**PLACE)
    desk.state.told += 1  # D1 logs that it was told
    desk.operator.turn(now_s + 3 * acts.TAKEN_UP_S, watched=True)
    assert desk.log() == [("place", True), ("designate", False), ("place", True)]


def test_refusals_without_end_fill_no_disk(desk: Desk) -> None:
    for _ in range(200):
        desk.tap(act="fly")
    assert len(desk.log()) < 40

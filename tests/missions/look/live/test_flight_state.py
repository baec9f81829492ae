"""What the live page is told of a flight is what its logs say."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.log.mcap_log import McapLog
from missions.ground.journal import peer_record
from missions.look.live.flight_state import FlightState
from missions.look.live.follow import FolderFollower
from path.messages import Role, Status
from tests.missions.look.live import little_flight as flown
from tests.missions.look.live.little_flight import LittleFlight, little_flight
from tests.written_logs import until_written


class Followed:
    """A little flight, and what the page is told of it."""

    def __init__(self, flight: LittleFlight, folder: Path) -> None:
        self.flight = flight
        self.state = FlightState()
        self.follower = FolderFollower(folder)

    def now(self) -> dict[str, Any]:
        for log in self.flight.logs.values():
            until_written(log)
        for said in self.follower.new():
            self.state.take(said, time.monotonic())
        return self.state.now(time.monotonic(), time.time_ns())


@pytest.fixture
def followed(tmp_path: Path) -> Any:
    with little_flight(tmp_path) as flight:
        followed = Followed(flight, tmp_path)
        yield followed
        followed.follower.close()


def test_both_drones_are_told_in_words_and_in_the_crews_frame(followed: Followed) -> None:
    followed.flight.begin()
    followed.flight.moment()
    first, second = followed.now()["drones"]
    assert (first["short"], first["words"]) == ("D1", "Compares both views")
    north, east = (flown.D1_M[k] - flown.OFF_M[k] for k in (0, 1))
    assert first["place_m"] == [north, east]
    assert (first["height_m"], first["speed_mps"], first["battery"]) == (1.5, 0.5, 0.8)
    assert first["responsible"] and not second["responsible"]


def test_what_matters_is_evidence_while_views_are_compared_and_separation_when_it_is_small(
    followed: Followed,
) -> None:
    followed.flight.begin()
    followed.flight.moment()
    now = followed.now()
    assert now["matters"] == {
        "what": "Evidence",
        "value": "2.5",
        "of": "of 3.3 needed",
        "level": "good",
    }
    assert now["separation"] == {"m": 1.0, "limit_m": 0.7, "by": "marker"}
    now_ns = time.monotonic_ns()
    near = {"capture_ns": now_ns, "position_v_m": (0.0, 0.0, 0.65)}
    followed.flight.receiver.write("/marker", now_ns, near)
    followed.flight.sender.write("/phase", now_ns, {"phase": "depart", "note": ""})
    now = followed.now()
    assert now["matters"]["value"] == "0.65 m"
    assert now["holds"][0] == {
        "level": "alarm",
        "of": "both",
        "text": "too close: 0.65 m of 0.70 m",
    }


def test_boxes_are_those_of_the_image_that_is_shown_and_of_no_other_frame(
    followed: Followed,
) -> None:
    followed.flight.begin()
    followed.flight.moment()
    later_ns = time.monotonic_ns() + 500_000_000
    followed.flight.sender.write(
        "/target", later_ns, {"capture_ns": later_ns, "box": (1.0, 2.0, 3.0, 4.0)}
    )
    first, second = followed.now()["drones"]
    assert {each["kind"]: tuple(each["px"]) for each in first["overlays"]} == {
        "target": flown.OWN_BOX,
        "mapped": flown.MAPPED_BOX,
    }
    assert {each["kind"]: tuple(each["px"]) for each in second["overlays"]} == {
        "target": flown.D2_BOX,
        "marker": flown.MARKER_PX,
    }


def test_a_gps_and_a_radio_that_are_lost_are_told_and_a_radio_that_never_was_is_not_missed(
    followed: Followed,
) -> None:
    followed.flight.begin()
    followed.flight.told = {"gps_fix": 3, "satellites": 9, "radio": False}
    followed.flight.moment()
    now = followed.now()
    assert now["holds"] == []
    assert [drone["radio"] for drone in now["drones"]] == [None, None]
    followed.flight.told |= {"radio": True}
    followed.flight.moment()
    assert [drone["radio"] for drone in followed.now()["drones"]] == [True, True]
    followed.flight.told = {"gps_fix": 1, "satellites": 0, "radio": False}
    followed.flight.moment()
    texts = [each["text"] for each in followed.now()["holds"]]
    assert texts == ["its GPS has no place", "has lost the pilot's radio"] * 2


def test_the_target_has_its_place_and_three_standard_deviations_along_the_sight_and_across(
    followed: Followed,
) -> None:
    followed.flight.begin()
    followed.flight.moment()
    now = followed.now()
    drone = followed.state.drones["sender"]
    assert drone.setup is not None
    # the marker looks back and up by 45 degrees: three metres behind it are ahead of D1 and below
    back = drone.setup["T_b_v"]
    ahead_m = back[2] * -3.0 + back[3]
    north, east = now["target"]["place_m"]
    assert north == pytest.approx(flown.D1_M[0] + ahead_m - flown.OFF_M[0], abs=1e-3)
    assert east == pytest.approx(flown.D1_M[1] - flown.OFF_M[1], abs=1e-3)
    assert now["target"]["ellipse_m"] == [0.18, 0.12]
    assert now["target"]["turned_rad"] == pytest.approx(0.0, abs=1e-6)
    [other] = now["others"]
    assert math.dist(other, now["target"]["place_m"]) > 0.5


def test_a_link_that_brings_nothing_is_an_alarm_until_a_drone_has_ended(
    followed: Followed,
) -> None:
    followed.flight.begin()
    followed.flight.moment()
    followed.flight.link(-2, 0)
    followed.flight.link(-1, 0)
    assert followed.now()["holds"] == []  # nobody is there yet
    followed.flight.link(0, 100)
    followed.flight.link(1, 130)
    now = followed.now()
    assert now["drones"][0]["link"]["heard_per_s"] == pytest.approx(65.0, abs=1.0)
    assert now["holds"] == []
    for second in (2, 3, 4):
        followed.flight.link(second, 130)
    texts = [each["text"] for each in followed.now()["holds"]]
    assert texts == ["hears nothing of the other drone"] * 2
    end = {"outcome": "peer_lost", "detail": "nothing heard", "responsible": False, "landed": True}
    followed.flight.sender.write("/outcome", time.monotonic_ns(), end)
    now = followed.now()
    assert now["holds"] == []
    assert now["events"][-1]["level"] == "alarm"
    assert "peer_lost" in now["events"][-1]["text"]


def test_a_program_that_logs_nothing_any_more_is_an_alarm(followed: Followed) -> None:
    followed.flight.begin()
    followed.flight.moment()
    followed.now()
    later = followed.state.now(time.monotonic() + 5.0, time.time_ns())
    assert [each["text"] for each in later["holds"]] == ["nothing logged for 5 s"] * 2
    of_another_day = followed.state.now(time.monotonic() + 5.0, time.time_ns() + 10**14)
    assert of_another_day["holds"] == []  # virtual time: its log comes in pieces


@pytest.mark.parametrize(
    ("topic", "record", "level", "text"),
    [
        ("/violation", {"monitor": "S1", "detail": "too close"}, "alarm", "too close"),
        ("/guard", {"stage": "holding", "act": "hold", "reason": "beat"}, "alarm", "guard holding"),
        ("/guard_stalled", {"stalled_s": 0.5}, "alarm", "stood still for 0.50 s"),
        ("/estimator_step", {"shift_n_m": (3.0, 4.0, 0.0)}, "warning", "stepped by 5.00 m"),
        ("/shed", {"what": "images", "gone": True}, "warning", "without images"),
        ("/doubt", {"mode": "manual"}, "warning", "has the pilot taken it? mode manual"),
        ("/told", {"kind": "place", "used": True}, "told", "was told a place"),
        ("/alike", {"differing": "marker side"}, "alarm", "not alike: marker side"),
    ],
)
def test_what_is_said_once_is_an_event_of_its_level(
    followed: Followed, topic: str, record: dict[str, Any], level: str, text: str
) -> None:
    followed.flight.begin()
    followed.flight.sender.write(topic, time.monotonic_ns(), record)
    followed.flight.sender.write(topic, time.monotonic_ns(), record)
    [event] = followed.now()["events"]
    assert (event["level"], event["of"], event["times"]) == (level, "D1", 2)
    assert text in event["text"]


def test_a_drone_whose_log_is_on_another_computer_is_shown_as_it_is_heard(
    tmp_path: Path,
) -> None:
    with McapLog(tmp_path / "sender.mcap", "sender") as sender:
        followed = Followed(LittleFlight(sender, sender), tmp_path)
        followed.flight.begin()
        followed.flight.moment()
        status = Status(
            Role.RECEIVER, 5, (1.0, -1.5, -2.1), (0.3, 0.4, 0.0), 0.5, 7, True, True, 0.8
        )
        sender.write("/peer", time.monotonic_ns(), peer_record(status))
        first, second = followed.now()["drones"]
        assert (first["name"], second["name"]) == ("sender", "receiver")
        assert second["words"] == "Closes in on the marker"
        assert (second["place_m"], second["mode"]) == ([1.0, -1.5], "as D1 hears")
        assert (second["heading_rad"], second["battery"]) == (0.5, 0.8)
        assert second["responsible"]
        sender.write("/peer", time.monotonic_ns(), peer_record(replace(status, ended=16)))
        assert followed.now()["drones"][1]["outcome"] == "peer_lost"
        followed.follower.close()


def test_what_is_heard_of_a_drone_is_nothing_beside_its_own_log(followed: Followed) -> None:
    followed.flight.begin()
    followed.flight.moment()
    status = Status(Role.RECEIVER, 5, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5, 7, True, True, 0.1)
    followed.flight.sender.write("/peer", time.monotonic_ns(), peer_record(status))
    second = followed.now()["drones"][1]
    assert (second["words"], second["battery"]) == ("Compares both views", 0.8)


def test_a_relays_drones_are_known_by_their_own_names_alone(tmp_path: Path) -> None:
    with McapLog(tmp_path / "D1.mcap", "D1") as first:
        followed = Followed(LittleFlight(first, first), tmp_path)
        followed.flight.begin()
        status = Status(Role.RECEIVER, 5, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5, 7, True, True, 0.1)
        first.write("/peer", time.monotonic_ns(), peer_record(status))
        assert [drone["name"] for drone in followed.now()["drones"]] == ["D1"]
        followed.follower.close()


def test_a_leg_that_is_over_has_no_link_to_miss(followed: Followed) -> None:
    followed.flight.begin()
    followed.flight.moment()
    for second in (0, 1, 2):
        followed.flight.link(second, 100)
    assert followed.now()["holds"] != []
    later_ns = time.monotonic_ns() + 8_000_000_000
    for log in followed.flight.logs.values():
        log.write("/note", later_ns, {"note": "on the way home"})
    now = followed.now()
    assert [drone["link"] for drone in now["drones"]] == [None, None]
    assert now["holds"] == []


def test_records_that_are_none_are_not_shown_and_end_nothing(followed: Followed) -> None:
    followed.flight.begin()
    followed.flight.moment()
    before = followed.now()
    nonsense: list[dict[str, Any]] = [
        {},
        {"position_n_m": "here", "point_v_m": [1.0], "phase": 5, "box": [1.0], "q_n_b": None},
        {"position_n_m": [None, 0.0, 0.0], "corners_px": 7, "capture_ns": "x", "off_m": []},
        {"position_v_m": "far", "mapped_box": [1.0], "outcome": None, "shown": 5},
    ]
    for topic in ("/target", "/track", "/home", "/question", "/taken", "/estimator_step"):
        for record in nonsense:
            followed.flight.sender.write(topic, time.monotonic_ns(), record)
    after = followed.now()
    assert [drone["place_m"] for drone in after["drones"]] == [
        drone["place_m"] for drone in before["drones"]
    ]
    assert after["matters"] == before["matters"]


def test_the_timeline_and_the_ways_are_those_of_the_logs(followed: Followed) -> None:
    followed.flight.begin()
    followed.flight.moment()
    followed.now()
    slow = followed.state.slow()
    phases = [(each["of"], each["phase"]) for each in slow["timeline"]]
    assert sorted(phases) == [
        ("receiver", "take-off"),
        ("receiver", "verify"),
        ("sender", "take-off"),
        ("sender", "verify"),
    ]
    assert slow["site"]["corners_m"] == [list(corner) for corner in flown.CORNERS]
    assert slow["trails"]["sender"] == [[2.25, -1.5]]

"""Relays of minutes: who is responsible goes round without a break, and what happens when it
cannot.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import Kept, PartError, StateError
from drivers.log.mcap_log import read_log
from drivers.log.state_file import MemoryStore
from drivers.rig.parts import Rig
from flight.harness.fleet import RelayConfig
from flight.harness.relay import RelayReport
from flight.outcome import Outcome
from missions.fly.fleet.command import faults_of
from missions.fly.fleet.command import fly as fly_relay
from missions.fly.fleet.ending import judge
from missions.fly.relay.drone.battery import Gauge
from missions.fly.relay.drone.guidance import keep_clear
from missions.fly.relay.drone.records import EPOCHS, as_first, as_holder, as_relief, for_leg
from missions.fly.relay.ground import Event
from missions.fly.relay.legs import Base
from missions.ground import rig_library
from missions.ground.options.flights import RelayOptions
from missions.ground.team_config import relay_of
from path.protocol.values import LAST_EPOCH, Handoff, ReceiverRecord, SenderRecord

LIVE = Handoff(7, 7, 1)


@pytest.fixture(scope="module")
def rig() -> Rig:
    """A rig whose drones agree quickly."""
    loaded = rig_library.load("relay-sim")
    return replace(loaded, method=replace(loaded.method, hold_frames=50, hold_s=1.0))


def fly(
    rig: Rig,
    out: Path,
    *batteries: float,
    hours: float = 0.02,
    fault: tuple[str, ...] = (),
    **relay: Any,
) -> tuple[dict[str, Any], dict[str, Any], list[Event]]:
    """A relay of drones with these batteries at first; summary, record and what the crew was
    told.
    """
    config = relay_of(rig, len(batteries))
    drones = tuple(
        replace(each, battery=b) for each, b in zip(config.drones, batteries, strict=True)
    )
    config: RelayConfig = replace(config, drones=drones, **relay)
    told: list[Event] = []
    options = RelayOptions(drones=len(drones), hours=hours, fault=fault)
    return *fly_relay(rig, config, options, out, told.append), told


def held(record: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        (leg["sender"], leg["receiver"]) for leg in record["legs"] if leg["outcome"] == "committed"
    ]


def test_a_target_goes_round_without_a_break(rig: Rig, tmp_path: Path) -> None:
    summary, record, _ = fly(rig, tmp_path, 0.62, 0.62, 1.0, hours=0.03)
    assert (summary["outcome"], summary["monitors"]) == ("committed", {})
    assert held(record) == [("D1", "D2"), ("D2", "D3")]
    assert all(leg["gap_s"] < 0.1 for leg in record["legs"])
    assert all(flight["battery"] >= record["reserve"] for flight in record["flights"])

    log = list(read_log(tmp_path / "D2.mcap"))
    wrote = [each.record for each in log if each.topic == "/epoch"]
    duties = [duty for duty, _ in groupby(each["duty"] for each in wrote)]
    assert duties == ["observing", "provisional", "holding", "mine", "released", "handed_over"]
    assert [each["epoch"] for each in wrote] == sorted(each["epoch"] for each in wrote)
    says = [each.record["responsible"] for each in log if each.topic == "/responsibility"]
    spells = [responsible for responsible, _ in groupby(says)]
    assert spells in ([True, False], [False, True, False])  # one, across the change of role


def test_where_no_relief_is_ready_it_says_so_early_and_lands_above_the_reserve(
    rig: Rig, tmp_path: Path
) -> None:
    summary, record, told = fly(rig, tmp_path, 0.62, 0.36, hours=1.0, swap_s=5000.0)
    assert (summary["outcome"], summary["monitors"]) == ("no_relief", {})
    assert summary["exit_code"] == 33
    alarm, end = (next(event for event in told if event.what == what) for what in ("alarm", "end"))
    assert alarm.drone == "D2" and end.time_s - alarm.time_s > 30.0
    assert (
        min(flight["battery"] for flight in record["flights"] if flight["drone"] == "D2")
        >= record["reserve"]
    )


def test_a_relief_that_dies_on_its_way_is_replaced_by_the_next(rig: Rig, tmp_path: Path) -> None:
    summary, record, told = fly(rig, tmp_path, 0.62, 1.0, 1.0, fault=("1:kill_receiver@approach",))
    assert (summary["outcome"], summary["monitors"]) == ("committed", {})
    assert [leg["outcome"] for leg in record["legs"]] == ["peer_lost", "committed"]
    assert held(record) == [("D1", "D3")]
    assert "leg failed" in [event.what for event in told]


@pytest.mark.parametrize("fault", ["1:kill_receiver=0.3@holding+6.5", "2:kill_sender=0.3@mine"])
def test_a_program_that_dies_between_holding_and_offering_finds_itself_responsible(
    rig: Rig, tmp_path: Path, fault: str
) -> None:
    summary, record, _ = fly(rig, tmp_path, 0.62, 0.62, 1.0, hours=0.03, fault=(fault,))
    assert (summary["outcome"], summary["monitors"]) == ("restarted", {})
    assert held(record)[0] == ("D1", "D2")
    log = list(read_log(tmp_path / "D2.mcap"))
    ends = [each.record for each in log if each.topic == "/outcome"]
    assert ends[-1]["responsible"] and ends[-1]["landed"] and "mine" in ends[-1]["detail"]


def test_what_an_estimator_stepped_by_in_one_role_stays_taken_out_in_the_next(
    rig: Rig, tmp_path: Path
) -> None:
    fault = (
        "1:step_east_receiver=1@follow+4",
        "1:step_yaw_receiver=25@follow+4",
        "2:step_north_sender=-2@follow+3",
    )
    summary, record, _ = fly(rig, tmp_path, 0.62, 0.62, 1.0, hours=0.03, fault=fault)
    assert (summary["outcome"], summary["monitors"]) == ("committed", {})
    assert held(record) == [("D1", "D2"), ("D2", "D3")]
    steps = [
        each.record for each in read_log(tmp_path / "D2.mcap") if each.topic == "/estimator_step"
    ]
    assert [round(step["shift_n_m"][0]) for step in steps] == [0, -2]
    assert [round(step["shift_n_m"][1]) for step in steps] == [1, 0]


def test_a_disk_that_fails_at_the_change_of_role_ends_the_relay_by_name(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save = MemoryStore.save

    def full(store: MemoryStore, record: SenderRecord | ReceiverRecord) -> None:
        if (
            record.epoch
            and record.duty == "mine"
            and store.kept
            and store.kept.record.duty == "holding"
        ):
            raise StateError("cannot write: No space left on device", "make room")
        save(store, record)

    monkeypatch.setattr(MemoryStore, "save", full)
    summary, _, _ = fly(rig, tmp_path, 0.62, 1.0)
    assert (summary["outcome"], summary["monitors"]) == ("state_lost", {})


def test_the_same_seed_is_the_same_relay(rig: Rig, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        fly(rig, tmp_path / name, 0.62, 1.0, hours=0.012, fault=("link_loss=0.2",))
    for name in ("relay.json", "D1.mcap", "D2.mcap"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_record_changes_its_role_and_its_epoch_only_grows() -> None:
    def kept(record: SenderRecord | ReceiverRecord) -> Kept:
        return Kept(record, same_clock=True)

    holding = ReceiverRecord(7, "holding", LIVE, 5)
    assert as_holder(kept(holding)) == SenderRecord(7, "mine")
    assert as_relief(kept(SenderRecord(7, "handed_over", LIVE, 5))) == ReceiverRecord(8)
    # its program died with it: another drone has it by now
    assert as_relief(kept(holding)) == ReceiverRecord(8)
    assert as_relief(kept(ReceiverRecord(8, "let_go", LIVE, 5))) == ReceiverRecord(9)
    assert as_relief(kept(ReceiverRecord(7))) == ReceiverRecord(7)
    assert as_first(kept(ReceiverRecord(7))) == SenderRecord(7)
    assert as_first(kept(SenderRecord(7, "mine"))) == SenderRecord(7)
    assert (as_first(None), as_relief(None)) == (SenderRecord(), ReceiverRecord())
    for duty in ("observing", "provisional", "let_go"):
        with pytest.raises(ValueError, match=duty):
            as_holder(kept(ReceiverRecord(7, duty)))


def test_the_epochs_of_a_leg_are_above_those_of_the_leg_before_whoever_flew_in_it() -> None:
    held = Kept(ReceiverRecord(EPOCHS + 1, "holding", LIVE, 5), same_clock=True)
    # in the last attempt of leg 1
    gave_away = Kept(SenderRecord(EPOCHS, "handed_over", LIVE, 5), same_clock=True)
    found = Kept(SenderRecord(0, "mine"), same_clock=True)  # another target, just now
    assert for_leg(found, 1) == SenderRecord(0, "mine")
    assert for_leg(found, 2).epoch + 1 >= as_relief(gave_away).epoch
    assert for_leg(held, 2) == SenderRecord(EPOCHS + 1, "mine")  # never back
    assert for_leg(found, 60_000).epoch == LAST_EPOCH - EPOCHS
    with pytest.raises(ValueError, match="observing"):
        for_leg(Kept(ReceiverRecord(7), same_clock=True), 2)


def test_the_gauge_believes_what_it_sees_but_no_single_drop() -> None:
    gauge = Gauge(1000.0, 0.25)
    gauge.note(0.0, 1.0)
    assert gauge.left_s == pytest.approx(750.0)
    for second in range(1, 121):
        gauge.note(float(second), 1.0 - 0.002 * second)  # twice as fast as usual
    assert gauge.rate_per_s == pytest.approx(0.002)
    assert gauge.left_s == pytest.approx((0.76 - 0.25) / 0.002)
    gauge.note(130.0, 0.45)  # a cell gave out: less is left, and it runs down as before
    assert gauge.left_s == pytest.approx(0.20 / 0.002)


def test_a_place_is_kept_clear_of_and_the_rest_of_the_way_is_not_touched() -> None:
    assert keep_clear((0.0, -1.0, 0.2), (3.0, 0.0, -2.0), (0.0, 0.0, -1.0), 1.5) == (0.0, -1.0, 0.2)
    north, east, down = keep_clear((-1.0, 0.5, 0.2), (1.0, 0.0, -2.0), (0.0, 0.0, -1.0), 1.5)
    assert north == pytest.approx(0.4) and (east, down) == (0.5, 0.2)


def test_what_cannot_be_flown_is_refused_by_name(rig: Rig) -> None:
    with pytest.raises(PartError, match="names 5"):
        relay_of(rig, 9)
    with pytest.raises(PartError, match="no \\[relay\\]"):
        relay_of(rig_library.load("sim"), 3)
    with pytest.raises(PartError, match="'two' is no number"):
        faults_of(("two:link_loss=0.1",))
    assert faults_of(("3:kill_receiver@approach", "link_loss=0.2")) == {
        3: ["kill_receiver@approach"],
        0: ["link_loss=0.2"],
    }


def test_a_relay_on_a_computer_that_is_too_slow_is_blamed_on_nobody(
    rig: Rig, tmp_path: Path
) -> None:
    """In real time; but a monitor of what must hold on any computer is not excused."""
    config = relay_of(rig, 2)
    base = Base(config, lambda _: None, 0.1)
    base.outcome, base.detail = Outcome.TARGET_LOST, "nobody sees it"
    report = RelayReport(
        violations={},
        gaps_s={},
        flown=(),
        samples=(),
        closest_m=1.0,
        simulated_s=1.0,
        wall_s=1.0,
        overload="D1's program: 90 of 100 frames were late",
    )
    outcome, detail = judge(base, report)
    assert outcome is Outcome.OVERLOADED and outcome.exit_code == 43
    assert detail == "D1's program: 90 of 100 frames were late (and so target_lost: nobody sees it)"
    assert judge(base, replace(report, overload=""))[0] is Outcome.TARGET_LOST
    assert (
        judge(base, replace(report, failure="the world did not come up"))[0] is Outcome.OVERLOADED
    )
    assert judge(base, replace(report, violations={"S1": 1}))[0] is Outcome.MONITOR_VIOLATED

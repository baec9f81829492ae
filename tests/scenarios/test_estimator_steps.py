"""Whole handoffs in which an estimator steps while the drone does not (docs/faults.md)."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from missions.look.report.summary import summarize
from path.messages import Role
from tests.scenarios.estimator_step_flights import KINDS, LAST_S, drawn
from tests.scenarios.test_sim import fly as flown
from tests.scenarios.test_sim import shared


@pytest.mark.parametrize(
    ("seed", "faults"),
    [
        # handed over what stood where the target had been
        (7, ("step_east_sender=1@preflight+24",)),
        (31, ("step_north_sender=1@preflight+22",)),
        (3, ("step_north_sender=-0.7@verify+1", "step_yaw_sender=-30@verify+1")),
        (5, ("step_east_receiver=2@approach+1", "step_yaw_receiver=40@approach+1")),
        (6, ("step_height_receiver=-1@verify+1",)),
        (9, ("step_north_receiver=3@waiting+3",)),
        (10, ("step_yaw_receiver=-25@follow+2", "step_north_receiver=1@follow+2")),
    ],
    ids=lambda of: str(of) if isinstance(of, int) else "+".join(of),
)
def test_it_is_seen_and_the_target_is_handed_over(
    tmp_path_factory: pytest.TempPathFactory, seed: int, faults: tuple[str, ...]
) -> None:
    flight = shared(tmp_path_factory, seed, *faults)
    assert flight.facts.outcome == "committed", flight.facts.detail
    assert flight.facts.violations == {}
    assert flight.summary["wrong_handover"] is False
    who = Role.SENDER if "sender" in faults[0] else Role.RECEIVER
    other = Role.RECEIVER if who is Role.SENDER else Role.SENDER
    assert summarize(flight.run)["estimator_steps"] == {who.value: 1, other.value: 0}
    notes = [record.record["note"] for record in flight.run.role(who)["/note"]]
    assert sum(note.startswith("ALARM: the estimator stepped") for note in notes) == 1


def test_a_height_that_steps_in_the_climb_is_no_pilots_doing(tmp_path: Path) -> None:
    flight = flown("sim", tmp_path, 11, "step_height_sender=2.6@preflight+3.4")
    assert flight.facts.outcome == "vehicle_refused"
    assert "by the vehicle's own reckoning" in flight.facts.detail
    assert flight.facts.violations == {}


def test_evidence_is_gathered_anew_from_the_step_on(tmp_path: Path) -> None:
    flight = flown("sim", tmp_path, 6, "step_north_sender=0.5@verify+1.2")
    (step,) = flight.run.sender["/estimator_step"]
    (commit,) = flight.run.sender["/commit"]
    assert flight.facts.outcome == "committed"
    assert (commit.stamp_ns - step.stamp_ns) * 1e-9 > 1.5  # four blocks of 0.4 s
    reached = [
        record for record in flight.run.sender["/agreement"] if record.stamp_ns > step.stamp_ns
    ]
    assert reached[0].record["evidence"] == 0.0


def test_what_is_drawn_is_of_every_kind_drone_and_instant() -> None:
    flights = [drawn(1, number) for number in range(200)]
    assert {flight.kind for flight in flights} == set(KINDS)
    assert {flight.role for flight in flights} == set(Role)
    assert min(flight.at_s for flight in flights) < 1.0
    assert max(flight.at_s for flight in flights) > LAST_S - 1.0
    assert len({flight.seed for flight in flights}) == 200
    assert drawn(1, 5) == drawn(1, 5) != drawn(2, 5)
    for flight in flights:
        for fault in flight.faults:
            name, _, rest = fault.partition("=")
            size = abs(float(rest.partition("@")[0]))
            assert size <= (40.0 if "yaw" in name else 3.0)
    shifts = [
        math.hypot(
            *(
                float(fault.split("=")[1].split("@")[0])
                for fault in flight.faults
                if "yaw" not in fault
            )
        )
        for flight in flights
        if flight.kind != "heading"
    ]
    assert min(shifts) >= 0.249

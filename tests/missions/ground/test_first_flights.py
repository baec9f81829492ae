"""The record of first flights: filled as things are done, and in nobody's way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from flight.outcome import Outcome
from missions.ground import rig_library
from missions.ground.first_flights import STEPS, FirstFlights
from path.messages import Role

REAL = replace(rig_library.load_unchecked("sim"), name="mine", harness=None)


def test_what_was_seen_is_ticked_and_the_rest_is_said(tmp_path: Path) -> None:
    record = FirstFlights(REAL, tmp_path)
    assert f"not ticked: {', '.join(STEPS)} (" in record.left()
    record.doctor(Role.SENDER)
    record.flight(Role.SENDER, Outcome.PEER_LOST)
    record.flight(Role.RECEIVER, Outcome.PEER_LOST)
    record.flight(Role.RECEIVER, Outcome.TOO_CLOSE)
    record.tick("switches", "both pilots saw them")
    again = FirstFlights(REAL, tmp_path)
    done = {step: when for step, when in again.done().items() if when}
    assert list(done) == ["doctor-d1", "switches", "one-target"]
    assert done["switches"].endswith(", both pilots saw them")
    assert done["one-target"].endswith("sender: peer_lost")
    assert "doctor-d2" in again.left() and "switches" not in again.left()
    for step in STEPS:
        again.tick(step, "seen")
    assert again.left() == "first flights: all are ticked\n"


def test_a_line_that_is_damaged_says_nothing(tmp_path: Path) -> None:
    record = FirstFlights(REAL, tmp_path)
    record.file.write_bytes(b'\xff{"step"\n[1]\n{"step": 3}\n{"step": "blocks"}\n{"st')
    record.tick("guard", "seen")
    assert [step for step, when in record.done().items() if when] == ["blocks", "guard"]


def test_a_place_that_cannot_be_written_ends_nothing_and_is_told(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("a file")
    record = FirstFlights(REAL, tmp_path / "runs")
    record.flight(Role.SENDER, Outcome.COMMITTED)
    assert "first flights are not kept" in record.left()


def test_of_a_simulated_rig_nothing_is_kept(tmp_path: Path) -> None:
    record = FirstFlights(rig_library.load_unchecked("sim"), tmp_path)
    record.flight(Role.SENDER, Outcome.COMMITTED)
    assert (record.left(), list(tmp_path.iterdir())) == ("", [])

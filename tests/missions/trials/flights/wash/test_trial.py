"""The trial of drones in each other's air: what it asks of a flight, and what it makes of it."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from missions.ground import rig_library
from missions.ground.rig_library import mission_of
from missions.ground.work import open_work
from missions.trials.flights.wash import trial
from missions.trials.flights.wash.trial import SIZES, WashFlight, WashOrder, of_size
from missions.trials.shared.trial import TrialRequest


def test_every_size_flies_at_distances_of_its_own_in_air_of_its_own() -> None:
    rig = rig_library.load("sim")
    apart_m: list[float] = []
    for wide_m, mass_kg in SIZES:
        own = of_size(rig, wide_m, mass_kg)
        assert own.world["air"]["drone"]["mass_kg"] == mass_kg
        apart_m.append(mission_of(own).separation.viewpoint_m)
    assert apart_m == sorted(apart_m)
    assert (apart_m[0], apart_m[-1]) == pytest.approx((0.65, 1.25))


def test_commits_contacts_and_distances_are_told_by_size_and_air(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fly(order: WashOrder) -> WashFlight:
        near = order.times == 2.0 and order.mass_kg == 2.5
        outcome = "too_close" if near else "committed"
        return WashFlight(order.mass_kg, order.times, outcome, 0.7 if near else 1.1, near, False, 0)

    monkeypatch.setattr(trial, "fly_order", fly)
    monkeypatch.setattr(trial, "FLIGHTS", 2)
    with open_work(1, io.StringIO()) as work:
        request = TrialRequest(rig_library.load("sim"), tmp_path, 0, False, work)
        found = trial.run(request)
    cells = {(cell["mass_kg"], cell["wash"]): cell for cell in found.summary["cells"]}
    assert len(cells) == 12
    assert cells[2.5, 2.0]["contacts"] == 2
    assert cells[2.5, 2.0]["commit_rate"] == 0.0
    assert cells[2.5, 1.0]["commit_rate"] == found.summary["commit_rate"] == 1.0
    assert cells[0.08, 1.0]["keep_out_before_m"] == pytest.approx(0.577, abs=1e-3)
    assert cells[0.08, 1.0]["keep_out_after_m"] == pytest.approx(0.30, abs=0.01)
    assert [finding.verdict for finding in found.findings] == ["met", "short", "met"]

"""The rendezvous trial: one whole mission from bad positions, and what is read from the truth."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.log.mcap_log import LogRecord
from flight.config import SeparationConfig
from missions import cli
from missions.trials.flights.rendezvous import flights as rendezvous_flights
from missions.trials.flights.rendezvous import trial as rendezvous
from missions.trials.flights.rendezvous.pictures import draw
from missions.trials.run import plain


def truth(at_s: float, receiver_m: tuple[float, float, float], *, in_air: bool = True) -> LogRecord:
    east = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # turned to the north
    record: dict[str, Any] = {
        "sender": {"t": [1.0, 1.0, 1.5], "q": east, "in_air": True},
        "receiver": {"t": list(receiver_m), "q": east, "in_air": in_air},
    }
    return LogRecord("/truth", round(at_s * 1e9), record)


def test_nearness_is_the_truths_while_both_fly() -> None:
    world = {
        "/truth": [
            truth(0.0, (1.0, 0.9, 1.5), in_air=False),
            truth(0.1, (1.0, -0.2, 1.5)),
            truth(0.2, (1.3, 0.6, 3.0)),
            truth(0.3, (1.3, 0.6, 3.0)),
            truth(0.4, (3.0, 0.0, 1.5)),
        ]
    }
    places = list(rendezvous_flights._places(world))
    assert len(places) == 4
    assert min(math.hypot(*place.offset_w_m) for place in places) == pytest.approx(1.2)
    assert min(
        rendezvous_flights._in_ellipsoids(place, SeparationConfig()) for place in places
    ) == pytest.approx(2.0)
    # half a metre aside, one and a half below
    assert rendezvous_flights._in_cone_s(places, SeparationConfig()) == pytest.approx(0.2)
    assert rendezvous_flights._from_heading(places[0]) == pytest.approx((-1.2, 0.0, 0.0), abs=1e-9)


def test_a_mission_from_bad_positions_finds_the_sender(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(rendezvous, "QUICK_MISSIONS", 1)
    out = tmp_path / "trial"
    with pytest.raises(SystemExit) as end:
        cli.main(["trial", "rendezvous", "--quick", "--seed", "3", "--out", str(out)])
    assert end.value.code == 0
    assert "1 of 1" in capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["arrived"], summary["violations"]) == (1, 0)
    assert summary["smallest_separation_m"] > 0.7 and summary["smallest_ellipsoid"] > 1.0
    assert (out / "rendezvous.png").stat().st_size > 10_000


def test_a_mission_in_which_one_drone_never_flew_does_not_spoil_the_rest(tmp_path: Path) -> None:
    never = rendezvous_flights.RendezvousResult(
        seed=0, outcome="vehicle_refused", why="", arrived=False, began_s=None, arrived_s=None, go_arounds=0,
        separation_m=None, ellipsoid=None, downwash_s=0.0, violations={}, way_h_m=(),
    )  # fmt: skip
    for flown in ([never], [never, replace(never, separation_m=1.2, ellipsoid=2.0)]):
        draw(flown, SeparationConfig(), tmp_path / "ways.png")
        assert (tmp_path / "ways.png").stat().st_size > 5_000
        json.dumps(plain(rendezvous_flights.as_summary(flown)), allow_nan=False)
        rendezvous._findings(flown, 0.7)

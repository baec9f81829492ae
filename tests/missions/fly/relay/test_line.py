"""The line between the base and a drone's program in another process."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.log.mcap_log import McapLog, read_log
from flight.harness.fleet import NamedDrone, RelayConfig
from flight.outcome import MissionEnd, Outcome
from missions.fly.fleet.process import RelayedLog
from missions.fly.relay.ground import Leg, TakeOffOrder
from missions.fly.relay.legs import Base
from missions.fly.relay.line import FarBase, hear, news_of

CONFIG = RelayConfig("no:harness", tuple(NamedDrone(name, (0.0, 0.0)) for name in ("D1", "D2")))


class NoGround:
    def close_leg(self, number: int) -> None: ...


NO_GROUND: Any = NoGround()


@dataclass
class Line:
    """A base, and D2's program; what each says is on its way until the test carries it."""

    base: Base = field(default_factory=lambda: Base(CONFIG))
    words: list[str] = field(default_factory=list[str])

    def __post_init__(self) -> None:
        self.base._field = NO_GROUND
        self.far = FarBase("D2", lambda word: self.words.append(json.dumps(word)))

    def call(self, number: int, sender: str, receiver: str) -> None:
        self.base._leg = Leg(number, sender, receiver, 3.0, 0.6)
        self.base.legs.append(self.base._leg)

    def news(self) -> dict[str, Any]:
        return json.loads(json.dumps(news_of(self.base, "D2")))

    def carry_words(self) -> None:
        while self.words:
            hear(self.base, "D2", json.loads(self.words.pop(0)))


def twelve(base: Base) -> float:
    del base
    return 12.0


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Line:
    monkeypatch.setattr(Base, "_now_s", twelve)  # there is no loop here
    return Line()


def test_a_program_knows_what_the_base_knows(line: Line) -> None:
    assert not line.far.told
    line.far.on_news(line.news())
    assert line.far.told
    assert (line.far.order_of("D2"), line.far.leg_of("D2"), line.far.called_home("D2")) == (
        TakeOffOrder.RELIEVE,
        None,
        False,
    )
    line.call(1, "D1", "D2")
    line.base.over = True
    line.far.on_news(line.news())
    assert line.far.leg_of("D2") == line.base.leg_of("D2")
    assert line.far.called_home("D2")


def test_a_leg_that_is_over_for_the_drone_stays_over_whatever_was_on_its_way(line: Line) -> None:
    line.call(1, "D1", "D2")
    late = line.news()
    line.far.on_news(late)
    line.far.holds("D2")
    line.far.on_news(late)  # sent before the base had heard of it
    assert line.far.leg_of("D2") is None
    line.carry_words()
    assert (line.base.holder, line.base.leg_of("D2"), line.base.legs[0].outcome) == (
        "D2",
        None,
        "committed",
    )
    line.call(2, "D2", "D1")
    line.far.on_news(line.news())
    leg = line.far.leg_of("D2")
    assert leg is not None and leg.number == 2


def test_what_a_program_says_comes_to_the_base(line: Line) -> None:
    line.far.holds("D2")
    line.far.ask("D2", 0.4, 33.0)
    line.carry_words()
    assert line.base._asking == ("D2", 0.4, 33.0)
    line.call(1, "D2", "D1")
    line.far.on_news(line.news())
    line.far.leg_failed("D2", MissionEnd(Outcome.PEER_LOST, "nothing heard"))
    line.carry_words()
    assert (line.base.legs[0].outcome, line.base.legs[0].detail) == ("peer_lost", "nothing heard")
    for other in ({"event": "ask"}, {"event": "landed"}, {}):
        hear(line.base, "D2", other)  # no word of the line


def test_the_monitors_read_what_they_judge_by_and_the_disk_keeps_what_is_rare(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with McapLog(tmp_path / "D2.mcap") as file:
        log = RelayedLog(file, "D2", whole=False)
        for k in range(11):
            log.write("/frame", k * 50_000_000, {"frame_id": k})
            log.write("/agreement", k * 50_000_000, {"iou": np.float64(0.5)})
            log.write("/state", k * 50_000_000, {"armed": True})
        log.write("/phase", 7, {"phase": "follow"})
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith('{"event":"record"') for line in lines)
    shown = [json.loads(line)["record"] for line in lines]
    assert [record[3]["frame_id"] for record in shown if record[1] == "/frame"] == [0, 4, 8]
    assert sum(record[1] == "/agreement" for record in shown) == 11
    assert shown[-1] == ["D2", "/phase", 7, {"phase": "follow"}]
    assert [record.topic for record in read_log(tmp_path / "D2.mcap")] == ["/phase"]

"""What a computer holds, from the times of its stages; and that the stages can be measured at
all.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import pytest

from drivers.interfaces import PartError
from missions.field.doctor import command as doctor
from missions.ground import computer, rig_library
from missions.ground.computer import (
    FLOWN,
    MARGIN,
    REST,
    computer_findings,
    fits,
    holds_hz,
    pace_of,
    refuse_share,
    waits,
)
from missions.ground.options.field import DoctorOptions
from missions.ground.pace import SIZES, Pace, Stage
from path.messages import Role


def pace(
    frame_ms: float,
    link_ms: float = 0.0,
    size: tuple[int, int] = (640, 480),
    search_ms: float = 0.0,
) -> Pace:
    stages = {"pose": Stage(frame_ms, frame_ms), "link": Stage(link_ms, link_ms)}
    return Pace(size, stages, Stage(search_ms, search_ms))


@pytest.fixture(scope="module")
def rig() -> Any:
    return rig_library.load("sitl")


def test_what_is_held_leaves_the_margin_free() -> None:
    assert holds_hz(pace(10.0 / FLOWN)) == pytest.approx(100.0 * (1.0 - MARGIN))
    assert holds_hz(pace(10.0 / FLOWN), margin=0.0) == pytest.approx(100.0)
    assert holds_hz(pace(10.0 / FLOWN), share=0.2) == pytest.approx(20.0 * (1.0 - MARGIN))


def test_the_rest_of_a_program_takes_its_part_first() -> None:
    alone, link_ms = holds_hz(pace(10.0)), 0.1e3 / REST
    assert holds_hz(pace(10.0 - link_ms, link_ms)) == pytest.approx(
        alone * (1.0 - MARGIN - 0.1) / (1.0 - MARGIN)
    )
    assert holds_hz(pace(10.0, 1.0), share=0.1) == 0.0


@pytest.mark.parametrize(
    ("frame_ms", "share", "state"),
    [(4.0, 1.0, "ok"), (14.0, 1.0, "note"), (4.0, 0.2, "note"), (4.0, 0.05, "fault")],
)
def test_a_rate_that_is_not_held_is_told_and_one_that_nothing_flies_with_is_a_fault(
    frame_ms: float, share: float, state: str
) -> None:
    finding = fits(pace(frame_ms), 30.0, share)
    assert finding.state == state
    assert ("too slow" in finding.detail) == (state == "fault")
    assert bool(finding.fix) == (state != "ok")


@pytest.mark.parametrize(
    ("search_ms", "share", "state"), [(7.0, 0.2, "ok"), (7.0, 0.09, "fault"), (80.0, 1.0, "fault")]
)
def test_a_search_that_keeps_setpoints_waiting_too_long_is_a_fault(
    search_ms: float, share: float, state: str
) -> None:
    assert waits(pace(1.0, search_ms=search_ms), share).state == state


@pytest.mark.parametrize(
    ("measured", "share", "why"),
    [
        (pace(3.4, 0.024), 0.1, "0.1 of this core is too little for the sender: rate"),
        (
            pace(1.0, 0.001, search_ms=8.0),
            0.1,
            "0.1 of this core is too little for the sender: setpoints",
        ),
        (pace(3.4, 0.024, search_ms=8.0), 0.2, ""),
    ],
)
def test_a_share_that_flies_nothing_is_refused_with_what_was_measured(
    monkeypatch: pytest.MonkeyPatch, rig: Any, measured: Pace, share: float, why: str
) -> None:
    monkeypatch.setattr(computer, "pace_of", lambda *_, own_only: [measured])  # type: ignore[misc]
    if not why:
        refuse_share(rig, share)
        return
    with pytest.raises(PartError, match=why) as refused:
        refuse_share(rig, share)
    assert "too slow" in str(refused.value)
    assert f"doctor --rig sitl --role sender --slow {share}" in refused.value.remedy


def test_a_share_is_refused_only_when_it_was_too_little_each_time(
    monkeypatch: pytest.MonkeyPatch, rig: Any
) -> None:
    busy, quiet = pace(9.0, 0.04), pace(3.4, 0.024)
    measured = [busy, busy, quiet, quiet]
    monkeypatch.setattr(computer, "pace_of", lambda *_, own_only: [measured.pop(0)])  # type: ignore[misc]
    refuse_share(rig, 0.2)
    assert measured == []
    measured += [busy] * 4
    with pytest.raises(PartError, match="for the sender: rate"):
        refuse_share(rig, 0.2)
    assert len(measured) == 1


def test_every_stage_and_every_size_is_told(monkeypatch: pytest.MonkeyPatch, rig: Any) -> None:
    paces = [pace(4.0, 0.01), pace(20.0, 0.01, (1280, 720))]
    monkeypatch.setattr(computer, "pace_of", lambda *_: paces)  # type: ignore[misc]
    monkeypatch.setattr(os, "getloadavg", lambda: (99.0, 0.0, 0.0))
    found = {finding.name: finding for finding in computer_findings(rig, Role.RECEIVER)}
    assert found["receiver computer busy"].state == "note"
    assert "4.00 ms" in found["receiver computer pose"].detail
    assert found["receiver computer holds"].detail.startswith("640x480 at 60 Hz, 1280x720 at 15 Hz")
    assert found["receiver computer rate"].state == "ok"
    assert found["receiver computer setpoints"].state == "ok"


def test_a_computer_that_cannot_be_measured_is_a_fault(
    monkeypatch: pytest.MonkeyPatch, rig: Any
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(PartError, match="not measured"):
        pace_of(rig, Role.SENDER)
    assert [finding.state for finding in doctor.of_computer(rig, Role.SENDER, 1.0)] == ["fault"]


def test_a_share_is_somebodys() -> None:
    with pytest.raises(PartError, match="whose computer"):
        list(doctor.asked(DoctorOptions("sitl", slow=0.2), lambda _: None))


def test_the_stages_of_the_receiver_are_measured_in_a_process_of_its_own(rig: Any) -> None:
    paces = pace_of(rig, Role.RECEIVER)
    assert {each.size for each in paces} == set(SIZES)
    assert all(each.search.p99_ms > each.stages["log"].mean_ms for each in paces)
    assert all(set(each.stages) == {"frame", "detector", "pose", "log", "link"} for each in paces)
    assert all(0.0 < stage.mean_ms < 500.0 for each in paces for stage in each.stages.values())
    small, large = paces[0].stages, paces[-1].stages
    assert large["frame"].mean_ms > small["frame"].mean_ms

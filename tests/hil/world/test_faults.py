"""Faults as the user writes them, and when they begin."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.interfaces import PartError
from flight.harness.flights import Progress
from hil.harness.inject import inject_in_world, need_own_estimators
from hil.link.faulty import LinkFaults
from hil.world.config import WorldConfig
from hil.world.faults import AT_COUNT, FAULTS, FaultKind, FaultTrigger, parse_fault, parse_faults
from hil.world.world import World
from missions.ground import rig_library
from path.geometry.rotation import yaw_of
from path.messages import Role


def progress(role: Role, count: int) -> Progress:
    return Progress(role, 0, "verify", count, 350, None, None, None, 0.0, False, "")


@pytest.mark.parametrize("kind", FAULTS.values(), ids=lambda kind: kind.name)
def test_every_fault_can_be_asked_for_by_its_name(kind: FaultKind) -> None:
    value = max(0.25, kind.least)
    text = kind.name if kind.value == "no" else f"{kind.name}={value}"
    fault = parse_fault(text)
    assert (fault.kind, fault.value) == (kind, None if kind.value == "no" else value)
    assert (fault.moment, fault.after_s) == ("", 0.0)
    assert kind.meaning


@pytest.mark.parametrize(
    ("text", "value", "moment", "after_s"),
    [
        ("kill_sender", None, "", 0.0),
        ("kill_sender=2", 2.0, "", 0.0),
        ("kill_sender=0@take-off", 0.0, "take-off", 0.0),
        ("kill_sender@verify+1.5", None, "verify", 1.5),
        ("kill_receiver=0.3@provisional", 0.3, "provisional", 0.0),
        ("link_loss=0.5@follow+4", 0.5, "follow", 4.0),
        ("pilot_takeover@stand-off", None, "stand-off", 0.0),
    ],
)
def test_when_it_begins_is_written_behind_it(
    text: str, value: float | None, moment: str, after_s: float
) -> None:
    fault = parse_fault(text)
    assert (fault.value, fault.moment, fault.after_s) == (value, moment, after_s)


def test_an_estimator_steps_either_way_and_only_where_it_is_simulated() -> None:
    assert parse_fault("step_height_sender=-1.5@follow+2").value == -1.5
    assert parse_fault("step_yaw_receiver=-40").kind.role is Role.RECEIVER
    with pytest.raises(PartError, match="-181 is not from -180 to 180"):
        parse_fault("step_yaw_sender=-181")
    faults = parse_faults(["step_north_sender=1"], "sitl")
    need_own_estimators(rig_library.load("sitl"), faults)
    with pytest.raises(
        PartError, match=r"step_north_sender: the estimators of .* are the autopilots' own"
    ):
        need_own_estimators(rig_library.load("sitl-px4"), faults)


@pytest.mark.parametrize("role", Role)
@pytest.mark.parametrize(
    ("name", "shift_n_m", "turn_rad"),
    [
        ("step_north", (2.0, 0.0, 0.0), 0.0),
        ("step_east", (0.0, 2.0, 0.0), 0.0),
        ("step_height", (0.0, 0.0, -2.0), 0.0),
        ("step_yaw", (0.0, 0.0, 0.0), math.radians(2.0)),
    ],
)
def test_a_step_comes_where_it_was_ordered(
    name: str, shift_n_m: tuple[float, float, float], turn_rad: float, role: Role
) -> None:
    world, plain = World(WorldConfig(), 1), World(WorldConfig(), 1)
    inject_in_world(f"{name}_{role.value}", role, world, 2.0)
    for each in (world, plain):
        each.advance(0.1)
    for other in Role:
        stepped, before = world.drone(other).estimate, plain.drone(other).estimate
        moved = np.subtract(stepped.position_n_m, before.position_n_m)
        turned = yaw_of(stepped.q_n_b) - yaw_of(before.q_n_b)
        assert moved == pytest.approx(shift_n_m if other is role else (0.0, 0.0, 0.0))
        assert turned == pytest.approx(turn_rad if other is role else 0.0, abs=0.002)


def test_detectors_are_degraded_where_they_are_not_real() -> None:
    assert [fault.name for fault in parse_faults(["detector_recall=0.9", "lookalike"], "sim")] == [
        "detector_recall", "lookalike",
    ]  # fmt: skip
    assert parse_faults(["lookalike"], "sitl")
    for level in ("sim-rendered", "sitl"):
        with pytest.raises(PartError, match=f"detector_false: level {level} has real detectors"):
            parse_faults(["detector_false=0.1"], level)


@pytest.mark.parametrize(
    ("text", "complaint", "remedy"),
    [
        ("detector_miss_frames=0.5", "0.5 is not from 1 to 1000", "--fault detector_miss_frames=1"),
        ("lookalikes", "there is no fault 'lookalikes'", "lookalike, marker_hidden"),
        ("", "there is no fault ''", "lookalike"),
        ("link_loss", "needs a value", "--fault link_loss=0.3"),
        ("link_loss=", "needs a value", "--fault link_loss=0.3"),
        ("link_loss=much", "'much' is not a number", "--fault link_loss=0.3"),
        ("link_loss=30", "30 is not from 0 to 1", "--fault link_loss=0.3"),
        ("link_loss=-0.1", "-0.1 is not from 0 to 1", "--fault link_loss=0.3"),
        ("link_loss=nan", "nan is not from 0 to 1", "--fault link_loss=0.3"),
        ("link_delay=inf", "inf is not from 0 to 60", "--fault link_delay=0.3"),
        ("lookalike=1", "takes no value", "write --fault lookalike"),
        ("kill_sender=", "needs a value", "--fault kill_sender=0.3"),
        ("kill_sender=soon", "'soon' is not a number", "from 0 to 600"),
        ("kill_sender@", "'' is no moment of the sender's course", "preflight, take-off, acquire"),
        ("kill_sender@search", "'search' is no moment of the sender's course", "handed_over"),
        ("kill_receiver@acquire", "'acquire' is no moment of the receiver's course", "provisional"),
        ("link_loss=0.3@waiting", "'waiting' is no moment of the sender's course", "verify"),
        ("kill_sender@verify+", "'' is not a number", "--fault kill_sender@verify+2.5"),
        ("kill_sender@verify+-1", "-1 is not from 0", "--fault kill_sender@verify+2.5"),
        ("kill_sender@verify+nan", "nan is not from 0", "--fault kill_sender@verify+2.5"),
        ("lookalike=", "takes no value", "write --fault lookalike"),
    ],
)
def test_a_fault_written_wrongly_names_the_fix(text: str, complaint: str, remedy: str) -> None:
    with pytest.raises(PartError) as caught:
        parse_fault(text)
    assert complaint in str(caught.value)
    assert remedy in caught.value.remedy


@given(st.sampled_from(["link_loss", "link_delay"]), st.floats() | st.text(max_size=5))
def test_what_is_taken_the_link_can_do(name: str, value: float | str) -> None:
    """A value that gets through here must not fail in the middle of a run."""
    try:
        fault = parse_fault(f"{name}={value}")
    except PartError:
        return
    if name == "link_loss":
        assert LinkFaults(loss=fault.value or 0.0).loss == fault.value
    else:
        assert (
            LinkFaults(delay_s=fault.value or 0.0, jitter_s=fault.value or 0.0).delay_s
            == fault.value
        )


@pytest.mark.parametrize(
    ("name", "kills", "cuts_off"),
    [
        ("kill_receiver", Role.RECEIVER, Role.RECEIVER),
        ("kill_sender", Role.SENDER, Role.SENDER),
        ("fc_link_loss", None, Role.RECEIVER),
        ("camera_freeze", None, None),
        ("pilot_takeover", None, None),
        ("rc_kill_sender", None, None),
    ],
)
def test_who_is_killed_and_who_is_cut_off(
    name: str, kills: Role | None, cuts_off: Role | None
) -> None:
    fault = parse_fault(name)
    assert (fault.kills, fault.cuts_off) == (kills, cuts_off)


def test_what_is_there_from_the_start_and_what_begins_while_the_views_agree() -> None:
    loss, lookalike, freeze = (
        parse_fault("link_loss=0.3"),
        parse_fault("lookalike"),
        parse_fault("camera_freeze"),
    )
    trigger = FaultTrigger([lookalike, loss, freeze])
    assert trigger.from_the_start() == [loss]
    assert trigger.on_progress(progress(Role.SENDER, AT_COUNT - 1)) == []
    assert trigger.on_progress(progress(Role.RECEIVER, 2 * AT_COUNT)) == []  # the sender counts
    assert trigger.on_progress(progress(Role.SENDER, AT_COUNT)) == [lookalike, freeze]
    assert trigger.on_progress(progress(Role.SENDER, AT_COUNT + 1)) == []  # once
    assert trigger.from_the_start() == []


def test_without_faults_nothing_begins() -> None:
    trigger = FaultTrigger([])
    assert trigger.from_the_start() == []
    assert trigger.on_progress(progress(Role.SENDER, 350)) == []


def at(role: Role, phase: str) -> Progress:
    return replace(progress(role, 0), phase=phase)


def test_a_fault_with_a_moment_begins_at_no_other() -> None:
    loss, kill, pilot = (
        parse_fault(t)
        for t in ("link_loss=0.3@follow", "kill_sender=1@verify", "pilot_takeover@verify")
    )
    trigger = FaultTrigger([loss, kill, pilot])
    assert trigger.from_the_start() == []
    assert trigger.on_progress(at(Role.RECEIVER, "follow")) == []  # a link's is the sender's course
    assert trigger.on_progress(at(Role.SENDER, "follow")) == [loss]
    assert trigger.on_progress(at(Role.SENDER, "verify")) == [kill]
    assert trigger.on_progress(replace(at(Role.SENDER, "verify"), count=AT_COUNT)) == []
    assert trigger.on_progress(at(Role.RECEIVER, "verify")) == [pilot]


def test_what_is_written_down_is_a_moment() -> None:
    kill = parse_fault("kill_receiver@provisional")
    trigger = FaultTrigger([kill])
    assert trigger.waits_for_duty(Role.RECEIVER) and not trigger.waits_for_duty(Role.SENDER)
    assert trigger.on_duty(Role.RECEIVER, "observing") == []
    assert trigger.on_duty(Role.SENDER, "provisional") == []
    assert trigger.on_duty(Role.RECEIVER, "provisional") == [kill]
    assert not trigger.waits_for_duty(Role.RECEIVER)


def test_the_same_fault_twice_is_two() -> None:
    faults = [parse_fault("kill_sender=1"), parse_fault("kill_sender=1")]
    assert FaultTrigger(faults).on_progress(progress(Role.SENDER, AT_COUNT)) == faults

"""Faults as the user writes them, and when they begin."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flight.harness import Progress
from hil.faults import AT_COUNT, FAULTS, FaultError, FaultKind, FaultTrigger, parse_fault
from hil.faulty_link import LinkFaults
from path.messages import Role


def progress(role: Role, count: int) -> Progress:
    return Progress(role, 0, "verify", count, 350, None, None, None, 0.0, False, "")


@pytest.mark.parametrize("kind", FAULTS.values(), ids=lambda kind: kind.name)
def test_every_fault_can_be_asked_for_by_its_name(kind: FaultKind) -> None:
    text = f"{kind.name}=0.25" if kind.needs_value else kind.name
    fault = parse_fault(text)
    assert (fault.kind, fault.value) == (kind, 0.25 if kind.needs_value else 0.0)
    assert kind.meaning


@pytest.mark.parametrize(
    ("text", "complaint", "remedy"),
    [
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
        ("lookalike=", "takes no value", "write --fault lookalike"),
    ],
)
def test_a_fault_written_wrongly_names_the_fix(text: str, complaint: str, remedy: str) -> None:
    with pytest.raises(FaultError) as caught:
        parse_fault(text)
    assert complaint in str(caught.value)
    assert remedy in caught.value.remedy


@given(st.sampled_from(["link_loss", "link_delay"]), st.floats() | st.text(max_size=5))
def test_what_is_taken_the_link_can_do(name: str, value: float | str) -> None:
    """What gets through here must not fail in the middle of a run."""
    try:
        fault = parse_fault(f"{name}={value}")
    except FaultError:
        return
    if name == "link_loss":
        assert LinkFaults(loss=fault.value).loss == fault.value
    else:
        assert LinkFaults(delay_s=fault.value, jitter_s=fault.value).delay_s == fault.value


@pytest.mark.parametrize(
    ("name", "kills", "cuts_off"),
    [
        ("kill_receiver", Role.RECEIVER, Role.RECEIVER),
        ("kill_sender", Role.SENDER, Role.SENDER),
        ("fc_link_loss", None, Role.RECEIVER),
        ("camera_freeze", None, None),
        ("pilot_takeover", None, None),
    ],
)
def test_who_is_killed_and_who_is_cut_off(name: str, kills: Role | None, cuts_off: Role | None) -> None:
    fault = parse_fault(name)
    assert (fault.kills, fault.cuts_off) == (kills, cuts_off)


def test_what_is_there_from_the_start_and_what_begins_while_the_views_agree() -> None:
    loss, lookalike, freeze = parse_fault("link_loss=0.3"), parse_fault("lookalike"), parse_fault("camera_freeze")
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

"""Each machine's answer to each event in each of its states: both tables whole, one row a state and
event.

A row says the state that comes after and the actions in their order. Whatever has no row is
refused: the state stays, and the one action is Refused(WRONG_STATE). Words about another attempt,
and instants, are in the other tests.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from path.messages import Abort, AbortReason, Target
from path.protocol.receiver import Observing, ReceiverMachine
from path.protocol.sender import Idle, SenderMachine
from path.protocol.values import (
    AbortRequested,
    Action,
    Ended,
    Heard,
    NewMission,
    Offer,
    PeerStatus,
    Persist,
    Refusal,
    Refused,
    Send,
    Settled,
    TakeResponsibility,
    Tick,
    VerifyAgain,
)
from tests.path.protocol import test_receiver as at_receiver
from tests.path.protocol import test_sender as at_sender

S = 1_000_000_000
MS = 1_000_000
T0 = at_sender.T0
LATE = T0 + 9 * S  # after every lease and wait for word


def told(action: Action) -> str:  # noqa: PLR0911
    match action:
        case Send(message):
            return f"send {type(message).__name__}"
        case Persist(record):
            return f"write {record.duty} {record.epoch}"
        case TakeResponsibility():
            return "take for now" if action.provisional else "take"
        case Ended(outcome, reason):
            return f"ended {outcome.value}" + (f" ({reason.value})" if reason else "")
        case Settled(outcome):
            return f"settled {outcome.value}"
        case Refused(why):
            return f"refused {why.value}"
        case _:
            return type(action).__name__.lower()


def step(machine: Any, event: Any, now_ns: int) -> str:
    before = machine.state
    actions = [told(action) for action in machine.step(event, now_ns)]
    after = "same" if machine.state == before else type(machine.state).__name__
    return ", ".join([after, *actions])


def sender_after(
    make: Callable[[], SenderMachine], *events: tuple[Any, int]
) -> Callable[[], SenderMachine]:
    def made() -> SenderMachine:
        machine = make()
        for event, now_ns in events:
            machine.step(event, now_ns)
        return machine

    return made


def receiver_after(
    make: Callable[[], ReceiverMachine], *events: tuple[Any, int]
) -> Callable[[], ReceiverMachine]:
    def made() -> ReceiverMachine:
        machine = make()
        for event, now_ns in events:
            machine.step(event, now_ns)
        return machine

    return made


STOP = AbortRequested(AbortReason.PILOT)
SENDERS = {
    "idle": lambda: SenderMachine(at_sender.CONFIG, Idle(0)),
    "offering": at_sender.offering,
    "keeping": sender_after(at_sender.offering, (STOP, T0)),
    "verifying": at_sender.verifying,
    "awaiting": at_sender.awaiting,
    "withdrawn": sender_after(at_sender.awaiting, (STOP, T0)),
    "handed over": at_sender.handed_over,
    "held": sender_after(at_sender.handed_over, (PeerStatus(True, LATE - 1, at_sender.ME), T0 + S)),
    "orphaned": sender_after(
        at_sender.handed_over, (PeerStatus(False, LATE - 1, at_sender.ME), T0 + S)
    ),
    "unconfirmed": sender_after(at_sender.handed_over, (Tick(), LATE - 1)),
    "taken back": sender_after(at_sender.awaiting, (Tick(), at_sender.TAKE_BACK)),
}
TO_SENDER = {
    "offer": Offer(8, 4),
    "verify again": VerifyAgain(),
    "new mission": NewMission(),
    "agreed": at_sender.AGREED,
    "stop": STOP,
    "candidate": Heard(at_sender.CANDIDATE),
    "accept": Heard(at_sender.ACCEPT),
    "abort": Heard(Abort(7, 1, AbortReason.TARGET_LOST, T0, at_sender.ME)),
    "another's abort": Heard(Abort(7, 1, AbortReason.TARGET_LOST, T0, at_sender.OTHER)),
    "confirm": Heard(at_sender.CONFIRM),
    "holds": PeerStatus(True, LATE - 1, at_sender.ME),
    "holds not": PeerStatus(False, LATE - 1, at_sender.ME),
}
SENDER = """
offering + another's abort -> Keeping, ended aborted (target_lost)
verifying + another's abort -> Keeping, ended aborted (target_lost)
awaiting + another's abort -> AwaitingAccept, write released 1
withdrawn + another's abort -> same
handed over + another's abort -> same, refused wrong_instance
held + another's abort -> same, refused wrong_instance
orphaned + another's abort -> same, refused wrong_instance
unconfirmed + another's abort -> same, refused wrong_instance
idle + offer -> Offering, write mine 1, take
idle + new mission -> same, write idle 0
idle + holds -> same
idle + holds not -> same
offering + stop -> Keeping, send Abort, ended aborted (pilot)
offering + candidate -> Verifying
offering + accept -> same, refused wrong_instance
offering + abort -> Keeping, ended aborted (target_lost)
offering + holds -> same
offering + holds not -> same
keeping + offer -> Offering, write mine 2
keeping + new mission -> Idle, release, write idle 1
keeping + holds -> same
keeping + holds not -> same
verifying + agreed -> AwaitingAccept, write released 1, release, send Commit
verifying + stop -> Keeping, send Abort, ended aborted (pilot)
verifying + candidate -> same
verifying + accept -> same, refused wrong_instance
verifying + abort -> Keeping, ended aborted (target_lost)
verifying + holds -> same
verifying + holds not -> same
awaiting + stop -> AwaitingAccept, write released 1, send Abort
awaiting + candidate -> same
awaiting + accept -> HandedOver, write handed_over 1, send Confirm, ended handed_over
awaiting + abort -> AwaitingAccept, write released 1
awaiting + holds -> same
awaiting + holds not -> same
withdrawn + stop -> same, write released 1, send Abort
withdrawn + candidate -> same
withdrawn + accept -> same, send Abort
withdrawn + abort -> same
withdrawn + holds -> same
withdrawn + holds not -> same
handed over + new mission -> Idle, write idle 1
handed over + candidate -> same
handed over + accept -> same, send Confirm
handed over + abort -> HandedOver, settled orphaned
handed over + holds -> HandedOver, settled handed_over
handed over + holds not -> HandedOver, settled orphaned
held + new mission -> Idle, write idle 1
held + candidate -> same
held + accept -> same, send Confirm
held + abort -> HandedOver, settled orphaned
held + holds -> same
held + holds not -> same
orphaned + new mission -> Idle, write idle 1
orphaned + candidate -> same
orphaned + accept -> same, send Confirm
orphaned + abort -> same
orphaned + holds -> same
orphaned + holds not -> same
unconfirmed + new mission -> Idle, write idle 1
unconfirmed + candidate -> same
unconfirmed + accept -> same, send Confirm
unconfirmed + abort -> HandedOver, settled orphaned
unconfirmed + holds -> HandedOver, settled handed_over
unconfirmed + holds not -> HandedOver, settled orphaned
taken back + offer -> Offering, write mine 3
taken back + verify again -> Verifying
taken back + new mission -> Idle, release, write idle 2
taken back + holds -> same
taken back + holds not -> same
"""
RECEIVERS = {
    "observing": lambda: ReceiverMachine(at_receiver.CONFIG, Observing(0)),
    "joined": at_receiver.joined,
    "provisional": at_receiver.provisional,
    "holding": at_receiver.holding,
    "let go": at_receiver.let_go,
    "orphaned": receiver_after(at_receiver.let_go, (PeerStatus(False, LATE - 1), T0 + 2 * S)),
    "taken back": receiver_after(at_receiver.let_go, (PeerStatus(True, LATE - 1), T0 + 2 * S)),
    "unconfirmed": receiver_after(at_receiver.let_go, (Tick(), LATE - 1)),
}
TO_RECEIVER = {
    "target": Heard(at_receiver.TARGET),
    "next target": Heard(Target(7, 6, 3, 1, 1, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.01)),
    "commit": at_receiver.HEARD,
    "confirm": Heard(at_receiver.CONFIRM),
    "abort": Heard(Abort(7, 5, AbortReason.TARGET_LOST, T0, at_receiver.ME)),
    "accept": Heard(at_sender.ACCEPT),
    "stop": STOP,
    "new mission": NewMission(),
    "holds": PeerStatus(True, LATE - 1),
    "holds not": PeerStatus(False, LATE - 1),
}
RECEIVER = """
observing + target -> Observing, write observing 5
observing + next target -> Observing, write observing 6
observing + commit -> same, refused unknown_epoch
observing + abort -> same, refused wrong_handoff
observing + new mission -> same
observing + holds -> same
observing + holds not -> same
joined + target -> same
joined + next target -> Observing, write observing 6
joined + commit -> Provisional, write provisional 5, take for now, send Accept
joined + abort -> Observing, write observing 6, ended aborted (target_lost)
joined + stop -> Observing, write observing 6, send Abort, ended aborted (pilot)
joined + new mission -> Observing, write observing 6
joined + holds -> same
joined + holds not -> same
provisional + target -> same
provisional + next target -> Observing, release, ended superseded, write observing 6
provisional + commit -> same
provisional + confirm -> Holding, write holding 5, take, ended handed_over
provisional + abort -> Observing, release, write observing 6, ended aborted (target_lost)
provisional + stop -> LetGo, release, write let_go 6, send Abort, ended aborted (pilot)
provisional + holds -> same
provisional + holds not -> same
holding + target -> same
holding + next target -> Observing, release, ended superseded, write observing 6
holding + commit -> same
holding + confirm -> same
holding + stop -> LetGo, release, write let_go 6, send Abort, ended aborted (pilot), settled orphaned
holding + new mission -> Observing, release, write observing 6
holding + holds -> same
holding + holds not -> same
let go + target -> same, refused lower_epoch
let go + next target -> Observing, settled taken_back, write observing 6
let go + commit -> same, refused lease_over
let go + confirm -> LetGo, send Abort, settled orphaned
let go + abort -> same
let go + new mission -> Observing, write observing 6
let go + holds -> LetGo, settled taken_back
let go + holds not -> LetGo, settled orphaned
orphaned + target -> same, refused lower_epoch
orphaned + next target -> Observing, settled taken_back, write observing 6
orphaned + commit -> same, refused lease_over
orphaned + confirm -> same, send Abort
orphaned + abort -> same
orphaned + new mission -> Observing, write observing 6
orphaned + holds -> same
orphaned + holds not -> same
taken back + target -> same, refused lower_epoch
taken back + next target -> Observing, write observing 6
taken back + commit -> same, refused lease_over
taken back + confirm -> LetGo, send Abort, settled orphaned
taken back + abort -> same
taken back + new mission -> Observing, write observing 6
taken back + holds -> same
taken back + holds not -> same
unconfirmed + target -> same, refused lower_epoch
unconfirmed + next target -> Observing, settled taken_back, write observing 6
unconfirmed + commit -> same, refused lease_over
unconfirmed + confirm -> LetGo, send Abort, settled orphaned
unconfirmed + abort -> same
unconfirmed + new mission -> Observing, write observing 6
unconfirmed + holds -> LetGo, settled taken_back
unconfirmed + holds not -> LetGo, settled orphaned
"""
REFUSED = f"same, refused {Refusal.WRONG_STATE.value}"


def rows(table: str) -> dict[str, str]:
    lines = [line.partition(" -> ") for line in table.strip().splitlines()]
    return {left.strip(): right.strip() for left, _, right in lines}


def when(name: str) -> int:
    """An instant at which time alone brings nothing about in that state."""
    if name in (
        "offering",
        "verifying",
        "awaiting",
        "withdrawn",
        "handed over",
        "joined",
        "provisional",
    ):
        return T0 + 50 * MS
    return T0 + 1500 * MS if name == "let go" else LATE


@pytest.mark.parametrize("state", SENDERS)
def test_the_sender(state: str) -> None:
    expected, seen = rows(SENDER), dict[str, str]()
    for name, event in TO_SENDER.items():
        seen[f"{state} + {name}"] = step(SENDERS[state](), event, when(state))
    assert seen == {row: expected.get(row, REFUSED) for row in seen}


@pytest.mark.parametrize("state", RECEIVERS)
def test_the_receiver(state: str) -> None:
    expected, seen = rows(RECEIVER), dict[str, str]()
    for name, event in TO_RECEIVER.items():
        seen[f"{state} + {name}"] = step(RECEIVERS[state](), event, when(state))
    assert seen == {row: expected.get(row, REFUSED) for row in seen}


def test_every_row_is_of_a_state_and_an_event() -> None:
    for table, states, events in ((SENDER, SENDERS, TO_SENDER), (RECEIVER, RECEIVERS, TO_RECEIVER)):
        assert rows(table).keys() <= {f"{state} + {event}" for state in states for event in events}

"""docs/protocol.md says what the machines do."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import pytest

from missions.proofs.verify.explore import Covering, explore
from missions.proofs.verify.model import target
from missions.proofs.verify.moves import Moves
from missions.proofs.verify.mutants import SMALL
from missions.proofs.verify.rules import Dead
from path.messages import Accept, Candidate, Commit, Confirm, Message, Target
from path.observations import MissReason
from path.protocol import receiver, sender
from path.protocol.receiver import ReceiverMachine
from path.protocol.sender import SenderMachine
from path.protocol.values import (
    AgreementComplete,
    CommitHeard,
    Handoff,
    Heard,
    NewMission,
    Offer,
    ProtocolConfig,
    ReceiverRecord,
    Send,
    SenderRecord,
)

PAGE = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()
CONFIG = ProtocolConfig()
LIVE = Handoff(1, 1, 1)
S = 1_000_000_000

Edges = set[tuple[str, str]]


def section(heading: str) -> str:
    (found,) = re.findall(rf"^## {re.escape(heading)}$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)
    return found


def drawn(heading: str) -> Edges:
    return set(re.findall(r"^    (\w+) --> (\w+):", section(heading), re.M))


def rows(heading: str) -> list[list[str]]:
    lines = [line for line in section(heading).splitlines() if line.startswith("|")]
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines
        if not line.startswith("|---")
    ]


def named(value: object) -> str:
    return type(value).__name__


@cache
def edges() -> tuple[Edges, Edges]:
    """Between which states the machines go, whatever happens: of the sender, of the receiver."""
    gives: Edges = set()
    takes: Edges = set()
    for scope in (replace(SMALL, aborts=1), replace(SMALL, attempts=2)):
        moves = Moves(scope)
        explore(scope, seen=Covering(), moves=moves)
        effects, config = moves.effects, scope.config
        for (state, _), effect in effects._by_sender.items():
            gives.add(
                (named(effects.senders.values[state]), named(effects.senders.values[effect.state]))
            )
        for (state, _, _), effect in effects._by_receiver.items():
            takes.add(
                (
                    named(effects.receivers.values[state]),
                    named(effects.receivers.values[effect.state]),
                )
            )
        for state in list(effects.senders.values):
            assert not isinstance(state, Dead)
            # no longer at once
            if not isinstance(state, sender.Offering | sender.Verifying | sender.AwaitingAccept):
                gives.add((named(state), named(sender.step(config, state, NewMission(), 0)[0])))
        for held in list(effects.receivers.values):
            assert not isinstance(held, Dead)
            following = Handoff(1, receiver.floor(held) + 1, 1)
            for event in (NewMission(), Heard(target(following))):
                takes.add((named(held), named(receiver.step(config, held, event, -100)[0])))
    return {edge for edge in gives if edge[0] != edge[1]}, {
        edge for edge in takes if edge[0] != edge[1]
    }


def test_the_state_diagrams_have_every_transition_and_no_other() -> None:
    assert drawn("The sender, D1") == edges()[0]
    assert drawn("The receiver, D2") == edges()[1]


def test_the_table_says_in_which_states_a_drone_is_responsible() -> None:
    told = {row[0].strip("`"): row[1] == "yes" for row in rows("The receiver, D2")[1:]}
    states: list[sender.SenderState | receiver.ReceiverState] = [
        sender.Idle(),
        sender.Keeping(1),
        sender.Offering(LIVE, 0, 0),
        sender.Verifying(LIVE, 0),
        sender.AwaitingAccept(LIVE, Commit(1, 1, 1, 1, 0, 0, 9), 0, 0),
        sender.HandedOver(LIVE, 0, 0, 0),
        sender.TakenBack(LIVE),
        receiver.Observing(),
        receiver.Provisional(LIVE, 0, 0, 0, 0),
        receiver.Holding(LIVE, 0),
        receiver.LetGo(LIVE, 0, 0, 0),
    ]
    assert told == {
        named(state): receiver.is_responsible(state, -1)
        if isinstance(state, receiver.ReceiverState)
        else sender.is_responsible(state)
        for state in states
    }


def test_the_sequence_chart_is_what_the_machines_say_to_each_other() -> None:
    chart = re.findall(r"(D\d)->>D\d: ([A-Z]+)", section("One that goes well"))
    d1, d2 = SenderMachine(CONFIG), ReceiverMachine(CONFIG)
    said: list[tuple[str, str]] = []

    def say(who: str, message: Message) -> Message:
        said.append((who, named(message).upper()))
        return message

    def only(who: str, actions: tuple[object, ...]) -> Message:
        (message,) = [action.message for action in actions if isinstance(action, Send)]
        return say(who, message)

    d1.step(Offer(1, 1), 0)
    d2.step(Heard(say("D1", Target(1, 1, 1, 0, 0, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.0))), 0)
    reason = MissReason.NO_CANDIDATE
    candidate = Candidate(
        1, 1, 1, 0, 0, 0, None, reason, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0), 0.0
    )
    d1.step(Heard(say("D2", candidate)), 0)
    commit = only("D1", d1.step(AgreementComplete(1, 1, 7, 0, 9), 0))
    assert isinstance(commit, Commit)
    accept = only("D2", d2.step(CommitHeard(commit, commit.lease_end_ns, 0, 9), 1))
    confirm = only("D1", d1.step(Heard(accept), 2))
    d2.step(Heard(confirm), 3)
    assert isinstance(accept, Accept) and isinstance(confirm, Confirm)
    assert isinstance(d1.state, sender.HandedOver) and isinstance(d2.state, receiver.Holding)
    assert chart == said


def test_the_deadlines_are_those_of_the_code() -> None:
    told = {row[0].strip("`"): float(row[1]) for row in rows("One that goes well")[1:]}
    assert told == {field.name: getattr(CONFIG, field.name) for field in fields(CONFIG)}


@pytest.mark.parametrize("same_clock", [True, False])
def test_a_restart_resumes_what_the_table_says(same_clock: bool) -> None:
    now, column = 100 * S, 1 if same_clock else 2
    told = {row[0].replace("`", ""): row[column].strip("`") for row in rows("After a restart")[1:]}
    senders = {
        "idle": SenderRecord(1),
        "mine": SenderRecord(1, "mine"),
        "released": SenderRecord(1, "released", LIVE, 7, now + S, now + S),
        "handed_over": SenderRecord(1, "handed_over", LIVE, 7, 0, now + S),
    }
    receivers = {
        "observing": ReceiverRecord(1),
        "provisional, lease not over": ReceiverRecord(1, "provisional", LIVE, 7, now + S, now + S),
        "provisional, lease over": ReceiverRecord(1, "provisional", LIVE, 7, now - S, now + S),
        "holding": ReceiverRecord(1, "holding", LIVE, 7),
        "let_go": ReceiverRecord(2, "let_go", LIVE, 7, 0, now + S),
    }
    resumed = {
        f"sender {name}": named(sender.restored(CONFIG, kept, now, same_clock=same_clock))
        for name, kept in senders.items()
    }
    for name, kept in receivers.items():
        resumed[f"receiver {name}"] = named(
            receiver.restored(CONFIG, kept, now, same_clock=same_clock)
        )
    assert told == resumed

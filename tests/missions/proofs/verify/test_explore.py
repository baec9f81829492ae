"""Every interleaving of small worlds: the machines keep every invariant in all of them, and no
mutant does.
"""

from __future__ import annotations

import gc
from dataclasses import replace
from functools import cache

import pytest

from missions.proofs.verify.effects import bits
from missions.proofs.verify.explore import Covering, Exact, Exploration, explore
from missions.proofs.verify.model import UNREAD, ModelWorld, Scope
from missions.proofs.verify.moves import Moves
from missions.proofs.verify.mutants import MUTANTS, SHORT, SMALL, Mutant, caught, wrong
from path.protocol import sender

INVARIANTS = {"S1", "S2", "S3", "S4", "S5", "S6", "L1", "L2"}


ABORTING = replace(SMALL, aborts=1)


@cache
def every_world(scope: Scope) -> tuple[Moves, Exact, Exploration]:
    """Every world of a scope: several tests ask for something of it."""
    moves, exact = Moves(scope), Exact()
    return moves, exact, explore(scope, seen=exact, moves=moves)


def of_small() -> Exploration:
    return every_world(SMALL)[2]


def said_of(found: Exploration) -> str:
    return f"{dict(found.broken)} in {found.states} worlds:\n" + "\n".join(found.example)


@pytest.mark.parametrize(
    ("scope", "states"),
    [
        (SMALL, 9000),
        (ABORTING, 30_000),
        (replace(SMALL, guard=0, uncertainty=2, lease=5), 15_000),
    ],
)
def test_the_machines_keep_every_invariant_in_every_reachable_world(
    scope: Scope, states: int
) -> None:
    found = every_world(scope)[2]
    assert found.complete and not found.broken, said_of(found)
    assert found.states > states
    assert found.in_flight >= 4


def test_killed_at_any_moment_and_started_again_at_any_later_one_they_still_do() -> None:
    found = explore(replace(SMALL, crashes=1), seen=Covering())
    assert found.complete and not found.broken, said_of(found)
    assert found.states > 20_000


def test_whatever_sleeps_through_whatever_they_still_do() -> None:
    """All but what is to end in time (L1, L2): nothing does while everybody sleeps."""
    found = explore(replace(SMALL, stalls=True), seen=Covering())
    assert found.complete and not found.broken, said_of(found)
    # it has not been told, and is not responsible
    assert ("TakenBack", "Provisional") in found.pairs


def test_of_two_receivers_on_one_channel_they_still_do() -> None:
    found = explore(replace(SHORT, lease=2, guard=0, receivers=2), seen=Covering())
    assert found.complete and not found.broken, said_of(found)
    assert found.states > 2000


@pytest.mark.parametrize(
    ("scope", "breaks"),
    [
        # clocks that differ by more than both sides were told
        (replace(SHORT, beyond=2), {"S1", "S3"}),
        # a disk that has an earlier record, or none
        (replace(SHORT, crashes=1, forgetful=True), {"S1", "S2"}),
    ],
)
def test_what_the_page_calls_an_assumption_is_needed(scope: Scope, breaks: set[str]) -> None:
    assert breaks <= set(explore(scope, until_broken=frozenset(breaks), seen=Covering()).broken)


def test_all_that_can_come_of_a_handover_is_reached() -> None:
    """And nobody is responsible for good only when the sender handed over and the receiver let go:
    the orphan.
    """
    pairs = of_small().pairs
    assert ("HandedOver", "Holding") in pairs
    assert ("HandedOver", "LetGo") in pairs
    assert ("TakenBack", "LetGo") in pairs and ("TakenBack", "Observing") in pairs
    assert {receiver for gives, receiver in pairs if gives == "HandedOver"} == {
        "Provisional",
        "Holding",
        "LetGo",
    }


def test_every_world_is_covered_by_one_that_a_covering_exploration_enters() -> None:
    for scope in (SMALL, ABORTING):
        moves, exact, everything = every_world(scope)
        covering = Covering()
        fewer = explore(scope, seen=covering, moves=moves)
        assert all(covering.covered(world) for world in exact.worlds)
        assert fewer.states < everything.states / 2
        assert set(fewer.pairs) == set(everything.pairs)


def added(first: ModelWorld, then: ModelWorld) -> bool:
    """Whether a world is something new beside another one."""
    seen = Covering()
    assert seen.add(first)
    return seen.add(then)


def test_a_world_covers_those_with_less_to_come() -> None:
    world = Moves(replace(SMALL, crashes=1, aborts=1)).start(0)
    for less in (
        world._replace(packets=world.packets & (world.packets - 1)),
        world._replace(crashes=0),
        world._replace(aborts=0),
        world._replace(attempts=0),
        world._replace(crashes=0, sender_kept=UNREAD, receiver_kept=UNREAD),
    ):
        assert not added(world, less) and added(less, world)
    other = world._replace(sender_kept=world.sender_kept + 1)
    assert added(world, other) and added(other, world)


def test_the_limit_ends_it_and_says_so() -> None:
    told: list[tuple[int, int]] = []
    found = explore(SMALL, limit=500, advance=lambda depth, worlds: told.append((depth, worlds)))
    assert not found.complete and 500 <= found.states < 5000
    assert [worlds for _, worlds in told] == sorted(worlds for _, worlds in told)


@pytest.mark.parametrize("collected", [True, False])
def test_the_collector_is_as_it_was_however_it_ends(collected: bool) -> None:
    def stop(_depth: int, _worlds: int) -> None:
        assert not gc.isenabled()
        raise KeyboardInterrupt

    was_on = gc.isenabled()
    (gc.enable if collected else gc.disable)()
    try:
        explore(SMALL, limit=1)
        assert gc.isenabled() is collected
        with pytest.raises(KeyboardInterrupt):
            explore(SMALL, advance=stop)
        assert gc.isenabled() is collected
    finally:
        (gc.enable if was_on else gc.disable)()


def test_bits() -> None:
    assert bits(0) == [] and bits(0b1011) == [0, 1, 3] and bits(1 << 200) == [200]


# --- mutants


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.rule)
def test_a_machine_that_skips_a_rule_is_caught(mutant: Mutant) -> None:
    found = caught(mutant)
    assert found is not None
    assert found.example[-1].endswith(f"breaks {next(iter(found.broken))}")


def test_there_is_a_mutant_for_every_invariant() -> None:
    broken: set[str] = set()
    for mutant in MUTANTS:
        if len(mutant.breaks) == 1:
            broken.update(mutant.breaks)
    found = caught(next(mutant for mutant in MUTANTS if mutant.breaks == ("S3", "S1")))
    assert found is not None
    assert broken | set(found.broken) == INVARIANTS


def test_after_a_mutant_the_machines_are_right_again() -> None:
    right = sender._commit
    mutant = next(mutant for mutant in MUTANTS if mutant.patches[0][1] == "_commit")
    with wrong(mutant):
        assert sender._commit is not right
    assert sender._commit is right


def test_a_right_machine_is_not_caught() -> None:
    assert caught(Mutant("nothing is skipped", tuple(INVARIANTS), [])) is None

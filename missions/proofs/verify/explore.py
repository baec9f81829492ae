"""Through every reachable world, tick by tick, with the way to whatever breaks an invariant.

Two ways of not walking in circles:

- exactly: a world that was seen is not entered again, any other is;
- covering: nor is a world that is *covered* by one that was seen, which is the same but for more
  packets on the link, more crashes, aborts and attempts to come, and a longer gap behind it.
  Nothing forces a packet to be delivered or a program to crash, so whatever can happen in the
  covered world can happen in the other, and is held against invariants that are no weaker there.
  Far fewer worlds tell as much, and larger scopes become possible.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from drivers.collector import collector_off
from missions.proofs.verify.model import UNREAD, ModelWorld, Scope
from missions.proofs.verify.moves import TICK, ModelStep, Moves
from path.values import frozen

ANY: frozenset[str] = frozenset()
_ONES = 24  # bits for a number of crashes, aborts, attempts or ticks
_RECORD = 16
_COMPLEMENT = (1 << _RECORD) - 1


@frozen
class Exploration:
    """The result of an exploration.

    Attributes:
        states, steps: worlds that were entered, and steps that were taken from them.
        depth: ticks to the farthest world.
        complete: everything reachable was seen; False when the limit came first.
        broken: how often each invariant was broken.
        example: the way to the first break: what happened, step by step.
        in_flight: packets on the link at most, of which any may be delivered, or not, at any
            moment.
        pairs: in how many worlds each pair of machine states was.
    """

    scope: Scope
    states: int
    steps: int
    depth: int
    complete: bool
    broken: Counter[str]
    example: tuple[str, ...]
    in_flight: int
    pairs: Counter[tuple[str, str]]


class Exact:
    """The worlds that were seen, each by itself."""

    def __init__(self) -> None:
        self.worlds: set[ModelWorld] = set()

    def add(self, world: ModelWorld) -> bool:
        """Return whether the world is to be entered: it is new."""
        before = len(self.worlds)
        self.worlds.add(world)
        return len(self.worlds) > before

    def still(self, world: ModelWorld) -> bool:
        """Return whether the world is worth going on from: nothing better was seen since."""
        del world
        return True


def weight(world: ModelWorld) -> int:
    """Return as bits all that may still happen in a world.

    A world covers another when it has all of the other's bits.

    Numbers are as many ones; records, which have to be equal unless nobody reads them, are their
    bits and the complement of their bits, of which none contains another.
    """
    bits = world.packets
    for number in (world.crashes, world.aborts, world.attempts, world.alone):
        bits = bits << _ONES | (1 << number) - 1
    for kept in (world.sender_kept, world.receiver_kept):
        bits = bits << 2 * _RECORD | (
            0 if kept == UNREAD else kept << _RECORD | (kept ^ _COMPLEMENT)
        )
    return bits


def _place(world: ModelWorld) -> tuple[int, ...]:
    """Return the key that worlds share which may cover one another."""
    return world.sender, world.receiver, world.second, world.skew, world.agreed


class Covering:
    """The set of only those worlds that no other covers."""

    def __init__(self) -> None:
        self._weights: dict[tuple[int, ...], list[int]] = {}
        self._bits: dict[ModelWorld, int] = {}

    def add(self, world: ModelWorld) -> bool:
        if world in self._bits:  # it is known, or what covers it is
            return False
        key = _place(world)
        bits = self._bits[world] = weight(world)
        known = self._weights.get(key)
        if known is None:
            self._weights[key] = [bits]
            return True
        for place, other in enumerate(known):
            if bits | other == other:
                known[0], known[place] = other, known[0]  # it is likely to cover the next one too
                return False
        known[:] = [bits, *[other for other in known if bits | other != bits]]
        return True

    def still(self, world: ModelWorld) -> bool:
        return self._bits[world] in self._weights[_place(world)]

    def covered(self, world: ModelWorld) -> bool:
        if world in self._bits:
            return True
        known = self._weights.get(_place(world), ())
        bits = weight(world)
        return any(bits | other == other for other in known)


class _Trail:
    """The worlds found so far, and how they were reached."""

    def __init__(self, moves: Moves, until_broken: frozenset[str] | None) -> None:
        self.moves = moves
        self.until_broken = until_broken
        self.ended = False
        self.came_from: dict[ModelWorld, tuple[ModelWorld, str] | None] = {}
        self.broken: Counter[str] = Counter()
        self.example: tuple[str, ...] = ()
        self.entered = self.steps = self.in_flight = 0
        self.pairs: Counter[tuple[int, int]] = Counter()

    def enter(self, world: ModelWorld) -> None:
        self.entered += 1
        self.in_flight = max(self.in_flight, world.packets.bit_count())
        self.pairs[world.sender, world.receiver] += 1

    def take(self, world: ModelWorld, move: ModelStep) -> None:
        self.steps += 1
        if move.broken:
            if not self.broken:
                self.example = (*self._way(world), f"{move.what}: breaks {move.broken}")
            self.broken[move.broken] += 1
            self.ended = self.until_broken is not None and self.until_broken <= self.broken.keys()

    def _way(self, world: ModelWorld) -> tuple[str, ...]:
        steps: list[str] = []
        while (before := self.came_from[world]) is not None:
            world, what = before
            steps.append(what)
        return tuple(reversed(steps))


# worlds refer to no one another: looking for cycles among so many would take an eighth of the time
@collector_off()
def explore(
    scope: Scope,
    limit: int = 1 << 62,
    advance: Callable[[int, int], None] | None = None,
    *,
    until_broken: frozenset[str] | None = None,
    seen: Exact | Covering | None = None,
    moves: Moves | None = None,
) -> Exploration:
    """Everything that can happen in a scope.

    Args:
        limit: worlds to enter at most, or a few more.
        advance: told now and then how many ticks and worlds it is in.
        until_broken: stop once all of these invariants are broken, with ``ANY`` at the first break
            of whichever: for what is known to be wrong. None goes through everything.
        seen: ``Exact()`` unless told.
        moves: of the same scope, to number its worlds as another exploration did.
    """
    seen = Exact() if seen is None else seen
    moves = moves or Moves(scope)
    trail = _Trail(moves, until_broken)
    waiting = [moves.start(skew) for skew in range(-scope.uncertainty, scope.uncertainty + 1)]
    for world in waiting:
        seen.add(world)
        trail.came_from[world] = None
    depth = 0
    while waiting:
        waiting = _one_instant(trail, seen, waiting)
        if advance is not None:
            advance(depth, trail.entered)
        if trail.entered >= limit or trail.ended:
            break
        depth += bool(waiting)
    named: Counter[tuple[str, str]] = Counter()
    for (gives, takes), count in trail.pairs.items():
        named[moves.names(gives, takes)] += count
    return Exploration(
        scope,
        trail.entered,
        trail.steps,
        depth,
        not waiting,
        trail.broken,
        trail.example,
        trail.in_flight,
        named,
    )


def _one_instant(
    trail: _Trail,
    seen: Exact | Covering,
    waiting: list[ModelWorld],
) -> list[ModelWorld]:
    """Everything that can happen before the next tick, and the worlds of that tick."""
    ticks: list[tuple[ModelWorld, ModelWorld]] = []
    for world in waiting:  # grows while it is walked through
        if not seen.still(world):
            continue
        trail.enter(world)
        for move in trail.moves(world):
            trail.take(world, move)
            if move.what is TICK:
                ticks.append((world, move.world))
            elif seen.add(move.world):
                trail.came_from[move.world] = (world, move.what)
                waiting.append(move.world)
            if trail.ended:
                return []
    following: list[ModelWorld] = []
    for world, after in ticks:
        if seen.still(world) and seen.add(after):
            trail.came_from[after] = (world, TICK)
            following.append(after)
    return following

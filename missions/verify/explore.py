"""Breadth first through every reachable world, with the way to whatever breaks an invariant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from missions.verify.model import Scope, World
from missions.verify.moves import Moves


@dataclass(frozen=True, slots=True)
class Exploration:
    """What was found.

    Attributes:
        states, steps: reachable worlds, and steps between them.
        depth: steps to the farthest world.
        complete: everything reachable was seen; False when the limit came first.
        broken: how often each invariant was broken.
        example: the shortest way to the first break: what happened, step by step.
        ends: how often each pair of machine states was reached.
    """

    scope: Scope
    states: int
    steps: int
    depth: int
    complete: bool
    broken: Counter[str]
    example: tuple[str, ...]
    ends: Counter[tuple[str, str]]


def explore(
    scope: Scope,
    limit: int = 1 << 62,
    advance: Callable[[int, int], None] | None = None,
    *,
    until_broken: bool = False,
) -> Exploration:
    """Everything that can happen in a scope.

    Args:
        limit: worlds to see at most.
        advance: told now and then how many worlds were seen and how many wait.
        until_broken: stop at the first break of an invariant, for machines that are known to be wrong.
    """
    moves = Moves(scope)
    firsts = [moves.start(skew) for skew in range(-scope.uncertainty, scope.uncertainty + 1)]
    came_from: dict[World, tuple[World, str] | None] = dict.fromkeys(firsts)
    frontier, depth, steps = firsts, 0, 0
    broken: Counter[str] = Counter()
    example: tuple[str, ...] = ()
    while frontier and len(came_from) < limit and not (until_broken and broken):
        following: list[World] = []
        for number, world in enumerate(frontier):
            for move in moves(world):
                steps += 1
                if move.broken:
                    if not broken:
                        example = (*_way(came_from, world), f"{move.what}: breaks {move.broken}")
                    broken[move.broken] += 1
                    if until_broken:
                        break
                if move.world not in came_from:
                    came_from[move.world] = (world, move.what)
                    following.append(move.world)
            if until_broken and broken:
                break
            if advance is not None and number % 4096 == 0:
                advance(len(came_from), len(frontier) - number + len(following))
        frontier = following
        depth += bool(following)
    ends = Counter(
        (type(moves.sender_of(world)).__name__, type(moves.receiver_of(world)).__name__) for world in came_from
    )
    return Exploration(scope, len(came_from), steps, depth, not frontier, broken, example, ends)


def _way(came_from: dict[World, tuple[World, str] | None], world: World) -> tuple[str, ...]:
    steps: list[str] = []
    while (before := came_from[world]) is not None:
        world, what = before
        steps.append(what)
    return tuple(reversed(steps))


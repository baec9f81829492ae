"""The orders of a run in real time: its processes' commands, and who hears of what they say."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from flight.harness.flights import Emit
from hil.harness.realtime.children import run_name
from path.values import frozen

Command = Sequence[str]


def no_news(name: str) -> Mapping[str, Any]:
    """The news of a program that was told everything when it was started."""
    del name
    return {}


@frozen
class Orders:
    """The commands of a run, and who hears of it.

    Attributes:
        world, program, guard: commands; the guard's is None for a drone without one.
        out: the run's folder.
        emit: shown the progress of every program.
        shares: the name of what a drone's program shares with the world.
        news: what a drone's program has to know at present; it is told on its stdin whenever that
            changes.
        heard: takes any other line of JSON that a program prints.
        attack: the command of a program that floods the link with so many packets a second, once
            the world said where.
        begun: takes the process number of a drone's program that has just been started.
        awaited: the world's traffic stands until the programs of all these drones have reported.
    """

    world: Command
    program: Callable[[str], Command]
    guard: Callable[[str], Command | None]
    out: Path
    emit: Emit
    shares: Callable[[str], str] = lambda _: run_name()
    news: Callable[[str], Mapping[str, Any]] = no_news
    heard: Callable[[str, Mapping[str, Any]], None] = lambda _name, _word: None
    attack: Callable[[float, Mapping[str, Any]], Command] = lambda _rate, _ready: ()
    begun: Callable[[str, int], None] = lambda _name, _pid: None
    awaited: frozenset[str] = frozenset()

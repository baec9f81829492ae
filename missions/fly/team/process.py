"""One drone's program of a team, and its guard, as processes of their own: children of
``path-handoff team``.

    python -m missions.fly.team.process program RIG DRONES/TARGETS NAME FOLDER whole|rare
    python -m missions.fly.team.process guard   RIG DRONES/TARGETS NAME FOLDER

As those of a relay (``missions.fly.relay.process``), with what a team's ground says besides.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from drivers.rig.parts import Rig
from flight.harness.fleet import TeamConfig
from flight.harness.relay import DroneProcesses
from missions.fly.relay.line import team_hear, team_news_of
from missions.fly.relay.process import FarFlight, commands, main
from missions.fly.team.base import OwnGround, TeamBase
from missions.fly.team.flight import TeamFlight
from missions.ground.team_config import team_of


def processes_of(
    rig: Rig, config: TeamConfig, out: Path, base: TeamBase, whole_log: bool
) -> DroneProcesses:
    """Return how the harness starts the processes of this team's drones."""
    size = f"{len(config.drones)}/{len(config.targets)}"
    return DroneProcesses(
        *commands("missions.fly.team.process", rig, size, out, whole_log),
        news=lambda name: team_news_of(OwnGround(base, name), name),
        heard=lambda name, word: team_hear(OwnGround(base, name), name, word),
    )


def _of_a_team(rig: Rig, size: str) -> tuple[TeamConfig, FarFlight]:
    drones, _, targets = size.partition("/")
    config = team_of(rig, int(drones), int(targets))
    return config, partial(TeamFlight, rig, config)


if __name__ == "__main__":
    main(_of_a_team)

"""The course of a mission, in the order both drones go through it."""

from __future__ import annotations

from enum import IntEnum

from path.messages import Role


class Phase(IntEnum):
    """Sent in every Status: the other drone waits for some of these."""

    PREFLIGHT = 0
    WAITING = 1  # on the ground until the other drone is ready
    TAKE_OFF = 2
    ACQUIRE = 3  # sender: fly to the target and find it
    FOLLOW = 4  # sender: keep the target in view; receiver: after the hand-over
    STAND_OFF = 5  # receiver: fly to the coarse rendezvous
    SEARCH = 6  # receiver: find the marker
    APPROACH = 7  # receiver: close in on marker measurements
    VERIFY = 8  # both: PATH runs
    DEPART = 9  # leave the other drone's way
    LAND = 10
    DONE = 11
    MISSION = 12  # of a mission of your own, from preflight to its end

    def reached(self, phase: int) -> bool:
        """Return whether a drone in ``phase`` has come so far on the course of a hand-over, or
        farther.

        A drone that flies a mission of its own is nowhere on that course.
        """
        return self <= phase <= Phase.DONE

    @property
    def title(self) -> str:
        return self.name.lower().replace("_", "-")


WORDS = {
    "preflight": "On the ground, checks",
    "waiting": "On the ground, waits",
    "take-off": "Takes off",
    "acquire": "Looks for the target",
    "follow": "Follows the target",
    "stand-off": "Flies to meeting place",
    "search": "Looks for D1's marker",
    "approach": "Closes in on the marker",
    "verify": "Compares both views",
    "depart": "Flies away",
    "land": "Lands",
    "done": "Down, at its end",
    "mission": "Flies its own mission",
}
"""Each phase for somebody who has two seconds to read it."""


def words_of(title: str) -> str:
    """Return a phase, by its title, in words for the crew; any other state as it is."""
    return WORDS.get(title, title)


COURSE: dict[Role, tuple[Phase, ...]] = {
    Role.SENDER: (Phase.PREFLIGHT, Phase.TAKE_OFF, Phase.ACQUIRE, Phase.FOLLOW, Phase.VERIFY, Phase.DEPART, Phase.LAND),
    Role.RECEIVER: (
        Phase.PREFLIGHT, Phase.WAITING, Phase.TAKE_OFF, Phase.STAND_OFF, Phase.SEARCH, Phase.APPROACH, Phase.VERIFY,
        Phase.FOLLOW, Phase.DEPART, Phase.LAND,
    ),
}  # fmt: skip
"""The phases that each drone passes when all goes well, before it is done."""

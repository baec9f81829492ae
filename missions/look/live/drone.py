"""One drone as its own log tells of it: what ``flight_state`` fills in and ``snapshot`` shows."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from missions.look.live.places import Sight, Stand
from path.camera.model import CameraModel

Record = Mapping[str, Any]
Snapshot = dict[str, Any]

TRAIL = 240  # places of a drone's way that are kept
STANDS = 64  # states that are kept, to find the one of an image: some seconds
OVERLAYS = 256  # frames whose boxes are kept, until their image is written
FRESH_NS = 1_500_000_000  # what a drone saw longer ago is not shown as seen
SHORT = {"sender": "D1", "receiver": "D2"}


class Drone:
    """One drone, by its own log."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.setup: Record | None = None
        self.camera: CameraModel | None = None
        self.phase = ""
        self.note = ""
        self.home_off_m = (0.0, 0.0)
        self.state: Record | None = None
        self.heard_radio = False
        self.stands: deque[Stand] = deque(maxlen=STANDS)
        self.trail: deque[tuple[float, float]] = deque(maxlen=TRAIL)
        self.trail_ns = 0
        self.newest_ns = 0
        self.heard_s = 0.0
        self.responsible = False
        self.responsible_until_ns: int | None = None
        self.offset_ns = 0  # of UTC from this program's own clock
        self.newest: dict[str, tuple[int, Record]] = {}
        self.link: dict[str, float] = {}
        self.links: deque[tuple[int, Record]] = deque(maxlen=3)
        self.overlays: deque[tuple[int, str, Any]] = deque(maxlen=OVERLAYS)
        self.image: tuple[int, bytes] | None = None
        self.target: Snapshot | None = None
        self.others: list[list[float]] = []
        self.outcome: Record | None = None

    @property
    def short(self) -> str:
        return SHORT.get(self.name, self.name)

    def lately(self, topic: str) -> Record | None:
        """Return the newest record of a topic, when it is of this moment."""
        stamp_ns, record = self.newest.get(topic, (0, None))
        return record if self.newest_ns - stamp_ns < FRESH_NS else None

    def in_crews_frame(self, place: Sequence[float]) -> list[float]:
        """Return north and east without what this drone's position was off at its home."""
        return [
            round(place[0] - self.home_off_m[0], 3),
            round(place[1] - self.home_off_m[1], 3),
        ]

    def stand_at(self, utc_ns: int) -> Stand | None:
        """Return where it was at an instant of the last seconds, to a tenth of a second."""
        return min(self.stands, key=lambda each: abs(each.utc_ns - utc_ns), default=None)

    def sight_at(self, utc_ns: int, pixel: tuple[float, float]) -> Sight | None:
        """Return the line of sight through a pixel of its image; None when it is not known."""
        stand = self.stand_at(utc_ns)
        if self.camera is None or self.setup is None or stand is None:
            return None
        return Sight.of(self.camera, self.setup["T_b_c"], stand, pixel)

    def target_down_m(self) -> float | None:
        """Return how far down a target on the ground is in this drone's frame; None of what
        flies.
        """
        target = {} if self.setup is None else self.setup["mission"]["target"]
        return None if target.get("flies", True) else -float(target["height_m"])

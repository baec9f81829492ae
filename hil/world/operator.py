"""The person beside the simulated field: points at the target again and again, and answers which
one it is.

What it says comes over the same interfaces as a real person's words (``drivers.operator``). Where
it points is off by an error that stays and one of each time, both by seed, and by what the target
has moved since it looked. Asked which object is the target it sees the frame that is shown, a
number at each object, and answers after a while, or not at all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Self

import numpy as np

from drivers.interfaces import PartError
from drivers.operator.interfaces import Chosen, PlaceTold, Question, Told
from drivers.rig.parts import PartContext
from hil.world.errors import Built
from hil.world.seam import harness_of
from hil.world.snapshot import Snapshot, TargetKind
from path.bounds import Bounds
from path.messages import Role, Vec3
from path.observations import Box
from path.values import frozen

STREAM = 0x6F706572
TARGET = 0  # of the objects of a snapshot
# above an object's own frame
MIDDLE_M: Mapping[TargetKind, float] = {"car": 0.08, "person": 0.875, "drone": 0.0}


@frozen
class PersonConfig:
    """How well it knows, and how soon it says so.

    Attributes:
        every_s: between two times that it points; 0: it never does.
        lasting_m, each_m: standard deviations per axis of where it points, of all a flight and of
            each time.
        late_s: at least and at most, between its look at the target and what it says; drawn each
            time.
        error_m: what it says of its own error; of the height of what flies as well.
        answers_after_s: at least and at most, once it is asked; drawn each time.
        silent: share of the questions that it does not answer; 1: it never does.
    """

    every_s: Annotated[float, Bounds(0.0, 3600.0)] = 3.0
    lasting_m: Annotated[float, Bounds(0.0, 20.0)] = 0.2
    each_m: Annotated[float, Bounds(0.0, 20.0)] = 0.15
    late_s: Annotated[tuple[float, float], Bounds(0.0, 60.0)] = (0.3, 0.9)
    error_m: Annotated[float, Bounds(0.01, 20.0)] = 0.3
    answers_after_s: Annotated[tuple[float, float], Bounds(0.0, 600.0)] = (1.5, 4.0)
    silent: Annotated[float, Bounds(0.0, 1.0, "of the questions")] = 0.1


@frozen
class Pointed:
    """Where it says the target is: north, east, down in m; down is None of what is on the
    ground.
    """

    place_m: tuple[float, float]
    down_m: float | None
    error_m: float


@frozen
class Answer:
    """Which object it says the target is."""

    question: int
    number: int


class Person:
    """What it says and when, by the world's clock."""

    def __init__(
        self,
        config: PersonConfig,
        built: Built,
        role: Role,
        seed: int,
    ) -> None:
        own = built.rig.role(role)
        self._config = config
        self._role = role
        self._camera = own.camera
        self._T_b_c = own.mount.T_b_c
        self._random = np.random.default_rng([seed, STREAM])
        north, east, down = (config.lasting_m * self._random.standard_normal(3)).tolist()
        self._lasting: Vec3 = (north, east, down)
        self._points_s = config.every_s
        self._due: list[tuple[float, Pointed | Answer]] = []

    def says(self, snapshot: Snapshot) -> list[Pointed | Answer]:
        """Return what it has said by the snapshot's time, since the last call."""
        now_s = snapshot.time_s
        if self._config.every_s > 0.0 and now_s >= self._points_s:
            self._points_s = now_s + self._config.every_s
            self._point(snapshot)
        said = [what for due_s, what in self._due if due_s <= now_s]
        self._due = [each for each in self._due if each[0] > now_s]
        return said

    def is_asked(
        self,
        question: int,
        shown: Sequence[tuple[int, Box]],
        age_s: float,
        snapshot: Snapshot,
    ) -> None:
        """Show a question: numbers and boxes in a frame that is so old."""
        if self._random.random() < self._config.silent:
            return
        least_s, most_s = self._config.answers_after_s
        at_s = snapshot.time_s + float(self._random.uniform(least_s, most_s))
        self._due.append((at_s, Answer(question, self._which(shown, snapshot.carried_on(-age_s)))))

    def _point(self, snapshot: Snapshot) -> None:
        least_s, most_s = self._config.late_s
        at_s = snapshot.time_s + float(self._random.uniform(least_s, most_s))
        east, north, up = snapshot.objects[TARGET].position_w_m
        new = (self._config.each_m * self._random.standard_normal(3)).tolist()
        off = [lasting + each for lasting, each in zip(self._lasting, new, strict=True)]
        down_m = off[2] - up if snapshot.kind == "drone" else None
        self._due.append(
            (at_s, Pointed((north + off[0], east + off[1]), down_m, self._config.error_m))
        )

    def _which(self, shown: Sequence[tuple[int, Box]], snapshot: Snapshot) -> int:
        """The number at the target in that frame; 0 when none is."""
        T_c_w = (snapshot.drones[self._role].T_w_b @ self._T_b_c).inverse()
        pixels: list[tuple[float, float]] = []
        for thing in snapshot.objects:
            east, north, up = thing.position_w_m
            x, y, z = T_c_w.apply(np.array((east, north, up + MIDDLE_M[snapshot.kind]))).tolist()
            pixels.append(
                self._camera.project_point((x, y, z)) if z > 0.0 else (math.inf, math.inf)
            )
        if not shown or math.isinf(pixels[TARGET][0]):
            return 0
        number, box = min(shown, key=lambda each: math.dist(each[1].center, pixels[TARGET]))
        away_px = [math.dist(box.center, pixel) for pixel in pixels]
        return number if min(away_px) == away_px[TARGET] else 0


class SimOperator:
    """Implements ``drivers.operator.interfaces.Operator`` for a rig whose harness is in this
    process.
    """

    Config = PersonConfig

    def __init__(self, config: PersonConfig, context: PartContext) -> None:
        self._harness = harness_of(context.harness, "a simulated operator", PartError)
        self._clock = context.clock
        assert self._harness.built is not None, "a person knows how the drones truly are"
        self._person = Person(config, self._harness.built, context.role, self._harness.seed)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None: ...

    def heard(self) -> Sequence[Told | Chosen]:
        """Return what it has said by now."""
        return [self._told(said) for said in self._person.says(self._harness.world.snapshot())]

    def ask(self, question: Question | None, picture: bytes | None) -> None:
        """Show a question."""
        del picture
        if question is not None:
            age_s = (self._clock.now_ns() - question.stamp_ns) * 1e-9
            shown = [(each.number, each.box) for each in question.shown]
            self._person.is_asked(question.number, shown, age_s, self._harness.world.snapshot())

    def _told(self, said: Pointed | Answer) -> Told | Chosen:
        if isinstance(said, Answer):
            return Chosen(said.question, said.number)
        north, east = said.place_m
        place = (north, east, said.down_m or 0.0)
        return PlaceTold(
            self._clock.now_ns(),
            place,
            said.error_m,
            height_told=said.down_m is not None,
        )

"""D1 hears what is said about its target, in its own frame, shows what it asks, and says where it
looks.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.operator.interfaces import (
    BearingTold,
    Chosen,
    PlaceTold,
    Question,
    RegionTold,
    Shown,
    Told,
)
from drivers.operator.words import MOST_BYTES, encode_question
from flight.config import MissionConfig
from missions.fly.leg.designating import Designating, shifted
from missions.fly.leg.numbered import numbered, pictured
from path.observations import Box
from tests.missions.fly.leg.session_bench import Bench, virtual

CONFIG = MissionConfig()
OFF = (1.0, -2.0, 0.5)
BOX = Box(100.0, 60.0, 50.0, 40.0)
QUESTION = Question(
    3, 5, tuple(Shown(k, BOX, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5) for k in (1, 2))
)


@dataclass
class Crew:
    """Somebody who says things, and what they were asked."""

    said: list[Told | Chosen] = field(default_factory=list[Told | Chosen])
    asked: list[tuple[Question | None, bytes | None]] = field(
        default_factory=list[tuple[Question | None, bytes | None]]
    )

    def heard(self) -> Sequence[Told | Chosen]:
        said, self.said = self.said, []
        return said

    def ask(self, question: Question | None, picture: bytes | None) -> None:
        self.asked.append((question, picture))


@dataclass
class Acquiring:
    """What looks for the target, as it is told."""

    question: Question | None = None
    ambiguous: bool = False
    told: list[Told] = field(default_factory=list[Told])
    chosen: list[Chosen] = field(default_factory=list[Chosen])
    found: tuple[tuple[float, float, float], float] | None = None
    taken: Any = None

    def tell(self, told: Told) -> None:
        self.told.append(told)

    def choose(self, chosen: Chosen) -> bool:
        self.chosen.append(chosen)
        return chosen.number == 1

    def where(self, _now_ns: int) -> tuple[tuple[float, float, float], float] | None:
        return self.found

    def look(self, _view: object, _T_n_c: object) -> Any:
        return self.taken

    def why(self) -> str:
        return "two are alike"


class Bed:
    def __init__(self, rig: Any) -> None:
        self.bench = Bench(rig)
        self.bench.session.off_n_m = OFF
        self.crew, self.acquiring = Crew(), Acquiring()
        self.points: PlaceTold | None = None
        self.held: list[bool] = []
        self.look_round: Any = SimpleNamespace(hold=lambda: self.held.append(True))
        camera = rig.sender.camera
        self.camera = camera
        self.designating = Designating(
            self.bench.session, camera, self.look_round, lambda: self.points
        )
        cast(Any, self.designating)._acquisition = self.acquiring


def with_bed(rig: Any, main: Callable[[Bed], Coroutine[Any, Any, None]]) -> None:
    async def run() -> None:
        await main(Bed(rig))

    virtual(run())


def test_the_mission_s_own_designation_is_told_once_and_in_the_drone_s_own_frame(rig: Any) -> None:
    async def main(bed: Bed) -> None:
        begun_ns = bed.bench.session.now_ns()
        await asyncio.sleep(1.0)
        bed.designating.hear()
        bed.designating.hear()
        (told,) = bed.acquiring.told
        expected = CONFIG.target.told(begun_ns)
        north, east, down = expected.place_n_m
        assert told == replace(expected, place_n_m=(north + 1.0, east - 2.0, down))
        assert len(bed.bench.log.of("/told")) == 1

    with_bed(rig, main)


def test_who_points_is_heard_each_time_instead_and_at_the_target_s_usual_height(rig: Any) -> None:
    async def main(bed: Bed) -> None:
        bed.points = PlaceTold(1, (4.0, 5.0, -9.0), 0.5)
        bed.designating.hear()
        bed.points = PlaceTold(2, (4.0, 5.0, -9.0), 0.5, height_told=True)
        bed.designating.hear()
        usual, said = bed.acquiring.told
        assert isinstance(usual, PlaceTold) and isinstance(said, PlaceTold)
        assert usual.place_n_m == (5.0, 3.0, -CONFIG.target.height_m)
        assert said.place_n_m == (5.0, 3.0, -9.0)
        bed.points = None
        bed.designating.hear()
        bed.designating.hear()
        assert len(bed.acquiring.told) == 3  # the mission's own, once

    with_bed(rig, main)


def test_what_the_crew_says_is_told_and_what_it_chooses_is_chosen(rig: Any) -> None:
    async def main(bed: Bed) -> None:
        bed.bench.session.operator = cast(Any, bed.crew)
        bed.crew.said = [BearingTold(1, (2.0, 3.0), 0.4, 0.1), Chosen(3, 1), Chosen(3, 2)]
        bed.designating.hear()
        assert bed.acquiring.told[1:] == [BearingTold(1, (3.0, 1.0), 0.4, 0.1)]
        assert bed.acquiring.chosen == [Chosen(3, 1), Chosen(3, 2)]
        used = [record["used"] for record in bed.bench.log.of("/told")]
        assert used == [True, True, True, False]

    with_bed(rig, main)


def test_a_question_is_shown_once_with_its_picture_and_taken_back_when_it_is_none_any_more(
    rig: Any,
) -> None:
    async def main(bed: Bed) -> None:
        bed.bench.session.operator = cast(Any, bed.crew)
        bed.designating.hear()
        assert bed.crew.asked == []
        view = SimpleNamespace(stamp_ns=5, image=lambda: np.full((240, 320, 3), 90, np.uint8))
        bed.designating.look(cast(Any, view), cast(Any, None))
        bed.acquiring.question = QUESTION
        bed.designating.hear()
        bed.designating.hear()
        ((asked, picture),) = bed.crew.asked
        assert asked is QUESTION and picture is not None
        shown = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
        assert shown is not None and shown.shape == (240, 320, 3) and shown.max() > 200
        assert bed.bench.log.of("/note") == [{"note": "which of 2 is the target? two are alike"}]
        assert len(bed.bench.log.of("/question")) == 1
        bed.acquiring.question = None
        bed.designating.hear()
        assert bed.crew.asked[1:] == [(None, None)]
        bed.designating.stop()
        assert bed.crew.asked[2:] == [(None, None)]

    with_bed(rig, main)


def test_a_question_without_a_picture_is_asked_all_the_same(rig: Any) -> None:
    async def main(bed: Bed) -> None:
        bed.bench.session.operator = cast(Any, bed.crew)
        bed.acquiring.question = QUESTION
        bed.designating.hear()
        view = SimpleNamespace(stamp_ns=5, image=lambda: None)
        bed.designating.look(cast(Any, view), cast(Any, None))
        bed.acquiring.question = replace(QUESTION, number=4)
        bed.designating.hear()
        assert [picture for _, picture in bed.crew.asked] == [None, None]

    with_bed(rig, main)


def test_it_listens_ten_times_a_second(rig: Any) -> None:
    async def main(bed: Bed) -> None:
        bed.points = PlaceTold(1, (4.0, 5.0, -9.0), 0.5)
        listening = asyncio.create_task(bed.designating.listen())
        await asyncio.sleep(0.95)
        listening.cancel()
        assert len(bed.acquiring.told) == 10

    with_bed(rig, main)


@pytest.mark.parametrize("ambiguous", [True, False])
def test_while_it_must_be_asked_it_does_not_go_round(rig: Any, ambiguous: bool) -> None:
    async def main(bed: Bed) -> None:
        bed.acquiring.ambiguous = ambiguous
        view: Any = SimpleNamespace(stamp_ns=5)
        assert bed.designating.look(view, cast(Any, None)) is None
        assert bed.held == [True] * ambiguous and bed.bench.log.of("/taken") == []

    with_bed(rig, main)


def test_where_nothing_is_known_it_looks_at_the_designation_from_twice_as_far(rig: Any) -> None:
    async def main(bed: Bed) -> None:
        place, wider = bed.designating.where(7)
        north, east, down = CONFIG.target.told(0).place_n_m
        assert (place, wider) == ((north + 1.0, east - 2.0, down + 0.5), 2.0)
        assert len(bed.acquiring.told) == 1  # it has told itself what the mission says

    with_bed(rig, main)


@pytest.mark.parametrize(("share", "wider"), [(0.5, 1.0), (1.0, 1.0), (1.5, 1.5), (3.0, 2.0)])
def test_it_looks_from_so_far_that_all_that_is_searched_fills_four_fifths_of_the_image(
    rig: Any, share: float, wider: float
) -> None:
    async def main(bed: Bed) -> None:
        range_m = math.hypot(
            CONFIG.follow.behind_m, CONFIG.follow.height_m - CONFIG.target.height_m
        )
        camera = bed.camera
        half_m = 0.4 * range_m * min(camera.width, camera.height) / camera.fx
        bed.acquiring.found = (1.0, 2.0, 3.0), share * half_m
        place, times = bed.designating.where(7)
        assert place == (1.0, 2.0, 3.0) and times == pytest.approx(wider)

    with_bed(rig, main)


def test_edges_that_are_told_are_shifted_too() -> None:
    region = RegionTold(1, ((0.0, 0.0), (1.0, 0.0), (1.0, 2.0)))
    assert shifted(region, OFF) == RegionTold(1, ((1.0, -2.0), (2.0, -2.0), (2.0, 0.0)))


def test_every_object_that_is_asked_about_is_framed_where_it_is() -> None:
    image: NDArray[np.uint8] = np.full((240, 320, 3), 90, np.uint8)
    drawn = numbered(image, replace(QUESTION, shown=QUESTION.shown[:1]))
    assert (image == 90).all() and drawn.shape == image.shape
    for row, column in ((80, 100), (80, 150), (60, 125), (100, 125)):  # the four sides
        assert (drawn[row, column] == 255).all()
    assert (drawn[75:90, 105:145] == 90).all()  # not over the object itself
    rows, columns = np.nonzero((drawn[:58] == 255).all(axis=2))
    # the number stands above it
    assert len(rows) > 20 and columns.min() >= 100 and rows.max() <= 54
    at_the_edge = numbered(
        image, Question(1, 1, (replace(QUESTION.shown[0], box=Box(10.0, 2.0, 50.0, 40.0)),))
    )
    # and is seen where there is no room for it
    assert (at_the_edge[4:26, 10:40] == 255).all(axis=2).any()


@pytest.mark.parametrize("size", [(480, 640), (720, 1280)])
def test_the_picture_of_a_question_fits_into_its_datagram_whatever_is_in_it(
    size: tuple[int, int],
) -> None:
    noise = np.random.default_rng(5).integers(0, 256, (*size, 3), np.uint8)
    line = encode_question(QUESTION, 0, pictured(noise, QUESTION))
    assert b'"jpeg"' in line
    assert len(line) <= MOST_BYTES

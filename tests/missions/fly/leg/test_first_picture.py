"""The picture of a question: the first is drawn on the ground, where nothing waits for it."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.operator.interfaces import Question
from missions.fly.leg import designating
from missions.fly.leg.numbered import NOTHING, pictured


def test_a_question_s_picture_is_a_jpeg() -> None:
    assert pictured(np.zeros((48, 64, 3), np.uint8), NOTHING).startswith(b"\xff\xd8")


@pytest.mark.parametrize(("asks", "pictures"), [(True, 1), (False, 0)])
def test_the_first_picture_is_drawn_before_anything_flies(
    asks: bool, pictures: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Question] = []

    def draw(_: object, question: Question) -> bytes:
        drawn.append(question)
        return b""

    monkeypatch.setattr(designating, "pictured", draw)
    monkeypatch.setattr(designating, "Acquisition", Unmade)
    designating.Designating(*session_of(operator=asks))  # type: ignore[arg-type]
    assert len(drawn) == pictures


class Unmade:
    def __init__(self, *_: object) -> None:
        pass


def session_of(*, operator: bool) -> tuple[object, ...]:
    class Target:
        def told(self, now_ns: int) -> int:
            return now_ns

    class Anything:
        target = Target()
        method = None

    class Session:
        rig = config = Anything()
        operator: object | None = None

        def now_ns(self) -> int:
            return 1

    session = Session()
    session.operator = object() if operator else None
    return session, None, None, lambda: None

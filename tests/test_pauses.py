"""What is measured in real time is measured again where the computer stood still, and not where it
did not.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager

import pytest

from tests.pauses import undisturbed

LONGEST_S = 0.5
STILL, EVEN = LONGEST_S, 0.01


@pytest.fixture
def stands_still(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Have the computer stand still for so long during one measurement after the other."""

    def script(*longest_s: float) -> None:
        left = list(longest_s)

        @contextmanager
        def pauses() -> Generator[list[float]]:
            yield [EVEN, left.pop(0)]

        monkeypatch.setattr("tests.pauses.pauses", pauses)

    return script


class Measurement:
    """Measurements that come out as their number, those that are ``wrong`` as a failure, and when
    was waited.
    """

    def __init__(self, *wrong: int) -> None:
        self.made = 0
        self.waits: list[int] = []
        self._wrong = wrong

    def __call__(self) -> int:
        self.made += 1
        assert self.made not in self._wrong, "wrong"
        return self.made

    def undisturbed(self) -> int:
        return undisturbed(self, LONGEST_S, tries=3, wait=lambda: self.waits.append(self.made))


@pytest.mark.parametrize("wrong", [(), (1,)])
def test_what_was_measured_while_the_computer_stood_still_is_measured_again_after_a_wait(
    stands_still: Callable[..., None], wrong: tuple[int, ...]
) -> None:
    stands_still(STILL, EVEN)
    measure = Measurement(*wrong)
    assert measure.undisturbed() == 2
    assert measure.waits == [1]


def test_what_fails_without_a_pause_has_failed(stands_still: Callable[..., None]) -> None:
    stands_still(EVEN)
    measure = Measurement(1)
    with pytest.raises(AssertionError, match="wrong"):
        measure.undisturbed()
    assert (measure.made, measure.waits) == (1, [])


def test_the_last_one_counts_whatever_the_computer_does(stands_still: Callable[..., None]) -> None:
    stands_still(STILL, STILL)
    measure = Measurement(3)
    with pytest.raises(AssertionError, match="wrong"):
        measure.undisturbed()
    assert (measure.made, measure.waits) == (3, [1, 2])

"""A computer that is busy is waited for, but not for ever."""

from __future__ import annotations

from tests.free_cores import FREE_SHARE, IN_A_ROW, Patience, least_share, wait_until_free


class Computer:
    """Looks that come out as they are to, the last one for good, and a clock that a wait moves
    on.
    """

    def __init__(self, *shares: float) -> None:
        self.now_s = 0.0
        self.looks = 0
        self._shares = list(shares)

    def look(self) -> float:
        self.looks += 1
        return self._shares.pop(0) if len(self._shares) > 1 else self._shares[0]

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def wait(self, limit_s: float = 100.0, patience: Patience | None = None) -> bool:
        return wait_until_free(
            limit_s, self.look, lambda: self.now_s, self.sleep, patience or Patience(1000.0)
        )


def test_free_cores_are_not_waited_for_longer_than_it_takes_to_be_sure() -> None:
    computer = Computer(1.0)
    assert computer.wait()
    assert computer.looks == IN_A_ROW


def test_a_neighbour_that_is_busy_for_a_while_is_waited_for() -> None:
    computer = Computer(*[0.5] * 40, 1.0)
    assert computer.wait()
    assert computer.looks == 40 + IN_A_ROW


def test_a_moment_without_the_neighbour_is_not_believed() -> None:
    computer = Computer(0.4, 0.9, 0.9, FREE_SHARE - 0.01, 0.95)
    assert computer.wait()
    assert computer.looks == 4 + IN_A_ROW


def test_a_neighbour_that_never_ends_is_not_waited_for_for_ever() -> None:
    computer = Computer(0.5)
    assert not computer.wait(100.0)
    assert 100.0 <= computer.now_s < 102.0


def test_a_neighbour_that_stays_is_waited_for_once_not_before_each_test() -> None:
    computer = Computer(0.5)
    patience = Patience(150.0)
    assert not any(computer.wait(100.0, patience) for _ in range(10))
    assert 150.0 <= computer.now_s < 153.0


def test_without_patience_a_busy_computer_is_looked_at_once() -> None:
    computer = Computer(0.5)
    assert not computer.wait(patience=Patience(0.0))
    assert computer.looks == 1


def test_more_threads_than_there_are_cores_do_not_find_them_free() -> None:
    assert 0.0 < least_share(0.3, threads=64) < FREE_SHARE

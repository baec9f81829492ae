"""Attitude history: interpolation, order, bounds."""

import math

import pytest

from drivers.interfaces import VehicleError
from drivers.perception.history import StateHistory
from path.geometry.rotation import quat_from_rpy, yaw_of


def turned(yaw: float) -> tuple[float, float, float, float]:
    return quat_from_rpy(0.1, -0.2, yaw)


def test_interpolates_on_the_shorter_arc() -> None:
    history = StateHistory()
    history.add(1_000, turned(math.radians(170)))
    history.add(2_000, turned(math.radians(-170)))
    assert math.degrees(yaw_of(history.attitude_at(1_500))) % 360 == pytest.approx(180, abs=0.2)
    assert math.degrees(yaw_of(history.attitude_at(1_250))) % 360 == pytest.approx(175, abs=0.2)


def test_gives_stored_attitudes_exactly_and_the_nearest_out_of_range() -> None:
    history = StateHistory()
    for k in range(5):
        history.add(100 * k, turned(0.1 * k))
    assert yaw_of(history.attitude_at(200)) == pytest.approx(0.2, abs=1e-12)
    assert history.attitude_at(-50) == turned(0.0)
    assert history.attitude_at(10_000) == turned(0.4)


def test_refuses_what_is_not_newer() -> None:
    history = StateHistory()
    assert history.add(100, turned(0.0))
    assert not history.add(100, turned(1.0))
    assert not history.add(50, turned(1.0))
    assert history.attitude_at(100) == turned(0.0)


def test_forgets_the_oldest_and_keeps_the_newest() -> None:
    history = StateHistory(capacity=4)
    for k in range(103):
        history.add(k, turned(0.01 * k))
    assert len(history) == 4
    assert yaw_of(history.attitude_at(99)) == pytest.approx(0.99)
    assert yaw_of(history.attitude_at(0)) > 0.9


def test_says_so_when_empty() -> None:
    with pytest.raises(VehicleError, match="no attitude"):
        StateHistory().attitude_at(0)

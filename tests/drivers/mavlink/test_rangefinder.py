"""What DISTANCE_SENSOR says of the distance downward, and what it does not say."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.mavlink.rangefinder import Rangefinder

MS = 1_000_000


def message(**changed: Any) -> dict[str, Any]:
    usual = {
        "time_boot_ms": 1000,
        "min_distance": 20,
        "max_distance": 1200,
        "current_distance": 650,
        "type": 0,
        "id": 1,
        "orientation": 25,
        "covariance": 9,
        "horizontal_fov": 0.0,
        "vertical_fov": 0.0,
        "quaternion": [0.0, 0.0, 0.0, 0.0],
        "signal_quality": 0,
    }
    return {**usual, **changed}


def after(*messages: dict[str, Any], later_ms: int = 10) -> Rangefinder:
    found = Rangefinder()
    for each in messages:
        found.on_distance(each, 0)
    return found


def test_a_distance_comes_in_metres_with_its_deviation() -> None:
    below = after(message()).at(10 * MS)
    assert below is not None
    assert (below.distance_m, below.sigma_m, below.stamp_ns) == (
        pytest.approx(6.5),
        pytest.approx(0.03),
        0,
    )


@pytest.mark.parametrize("covariance", [0, 255, None])
def test_a_deviation_that_is_not_known_is_none(covariance: int | None) -> None:
    below = after(message(covariance=covariance)).at(10 * MS)
    assert below is not None and below.sigma_m is None


@pytest.mark.parametrize(
    "changed",
    [
        {"current_distance": 1200},  # the limit is what some say when they see nothing
        {"current_distance": 65535},
        {"current_distance": 20},
        {"current_distance": 0},
        {"current_distance": None},
        {"signal_quality": 1},
        {"max_distance": 0},
    ],
)
def test_what_is_not_measured_is_no_distance_and_why_is_told(changed: dict[str, Any]) -> None:
    found = after(message(), message(**changed))
    assert found.at(10 * MS) is None
    assert found.heard and found.trouble


@pytest.mark.parametrize("quality", [0, 2, 100, None])
def test_a_signal_that_is_not_rated_or_rated_is_believed(quality: int | None) -> None:
    assert after(message(signal_quality=quality)).at(10 * MS) is not None


def test_senders_from_before_there_was_a_signal_quality_are_believed() -> None:
    older = message()
    del older["signal_quality"], older["quaternion"], older["horizontal_fov"], older["vertical_fov"]
    assert after(older).at(10 * MS) is not None


@pytest.mark.parametrize("orientation", [0, 24, 2, 90])
def test_a_sensor_that_looks_elsewhere_says_nothing_of_the_height(orientation: int) -> None:
    found = after(message(orientation=orientation))
    assert found.at(10 * MS) is None and not found.heard


def test_of_two_that_look_down_the_first_counts_whichever_speaks_last() -> None:
    for pair in ((1, 2), (2, 1)):
        found = after(
            *(message(id=number, current_distance=100 * number) for number in (*pair, *pair))
        )
        below = found.at(10 * MS)
        assert below is not None and below.distance_m == pytest.approx(1.0)


def test_what_is_old_is_unknown() -> None:
    found = after(message())
    assert found.at(400 * MS) is not None
    assert found.at(600 * MS) is None

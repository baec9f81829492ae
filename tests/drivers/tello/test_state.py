"""State packets as values, and the position reckoned from them."""

from __future__ import annotations

import math

import pytest

from drivers.tello.state import DeadReckoning, Placement, TelloReport, quaternion, read_report
from path.geometry.rotation import R_from_quat, yaw_of

FIELDS: dict[str, object] = {
    "mid": -1, "pitch": -3, "roll": 2, "yaw": 90, "vgx": 5, "vgy": -2, "vgz": 1, "templ": 65, "temph": 67, "tof": 83,
    "h": 80, "bat": 76, "baro": 150.2, "time": 12, "agx": 1.0, "agy": 2.0, "agz": -998.0,
}  # fmt: skip


def report(at_s: float, **changes: object) -> TelloReport:
    read = read_report({**FIELDS, "yaw": 0, **changes}, round(at_s * 1e9))
    assert read is not None
    return read


def test_a_packet_in_its_units() -> None:
    read = read_report(FIELDS, 7)
    assert read is not None
    assert read.velocity_mps == pytest.approx((0.5, -0.2, 0.1))
    assert (read.tof_m, read.height_m, read.battery, read.motors_s) == pytest.approx(
        (0.83, 0.80, 0.76, 12)
    )
    assert math.degrees(read.yaw_rad) == pytest.approx(90.0)
    assert read.arrival_ns == 7


@pytest.mark.parametrize(
    "changes",
    [
        {"yaw": "x"},
        {"bat": 101},
        {"bat": -1},
        {"pitch": 4000},
        {"vgx": math.nan},
        {"vgy": True},
        {"h": None},
    ],
)
def test_a_packet_that_cannot_be_is_none(changes: dict[str, object]) -> None:
    assert read_report({**FIELDS, **changes}, 0) is None


def test_a_packet_without_a_field_is_none() -> None:
    for name in ("pitch", "roll", "yaw", "vgx", "vgy", "vgz", "tof", "h", "bat", "time"):
        assert read_report({key: value for key, value in FIELDS.items() if key != name}, 0) is None


def test_angles_turn_about_the_body_s_axes() -> None:
    assert yaw_of(quaternion(0.0, 0.0, 0.3)) == pytest.approx(0.3)
    down_b = R_from_quat(quaternion(0.0, 0.2, 1.0))[2]  # nose up: down is towards the tail
    assert down_b[0] == pytest.approx(-math.sin(0.2))
    down_b = R_from_quat(quaternion(0.2, 0.0, 1.0))[2]  # right side down: down is to the right
    assert down_b[1] == pytest.approx(math.sin(0.2))


def reckoning(heading_deg: float = 0.0, frame: str = "start") -> DeadReckoning:
    placement = Placement(10.0, 20.0, math.radians(heading_deg), 0.05, 0.03)
    return DeadReckoning(placement, frame)  # type: ignore[arg-type]


def test_a_drone_put_down_looking_east_flies_east_along_its_x() -> None:
    where = reckoning(90.0)
    for tick in range(11):
        where.add(report(0.1 * tick, yaw=30, vgx=5, vgy=0, vgz=0))
    # switched on 30 degrees to the left of where it looks when it is connected, and x is of that
    # moment
    assert where.heading_rad == pytest.approx(math.pi / 2.0)
    north, east, _ = where.position_n_m
    way = 0.5 * 1.0
    assert (north - 10.0, east - 20.0) == pytest.approx(
        (way * math.cos(math.radians(60.0)), way * math.sin(math.radians(60.0)))
    )


def test_velocities_in_the_body_s_axes_turn_with_the_nose() -> None:
    where = reckoning(0.0, "body")
    for tick in range(11):
        where.add(report(0.1 * tick, yaw=0 if tick == 0 else 90, vgx=5, vgy=0))
    assert where.velocity_n_mps[:2] == pytest.approx((0.0, 0.5))


def test_what_stands_stays_and_its_uncertainty_too() -> None:
    where = reckoning()
    for tick in range(50):
        where.add(report(0.1 * tick, h=0, tof=10, vgx=1, vgy=0))
    assert where.position_n_m == (10.0, 20.0, 0.0)
    assert where.position_sigma_m == pytest.approx(0.05)


def test_uncertainty_grows_with_the_time_in_the_air() -> None:
    where = reckoning()
    for tick in range(301):
        where.add(report(0.1 * tick))
    assert where.position_sigma_m == pytest.approx(math.hypot(0.05, 0.03 * 30.0))


def test_the_height_is_the_rangefinder_s_but_not_over_a_table() -> None:
    where = reckoning()
    for tick in range(30):
        where.add(report(0.1 * tick, tof=100, h=100, vgz=0, pitch=0, roll=0))
    assert where.height_m == pytest.approx(1.0, abs=0.03)
    for tick in range(30, 35):
        where.add(report(0.1 * tick, tof=25, h=100, vgz=0, pitch=0, roll=0))
    assert where.height_m == pytest.approx(1.0, abs=0.05)


def test_a_gap_in_the_packets_is_not_flown_at_the_last_velocity() -> None:
    where = reckoning()
    where.add(report(0.0, vgx=10, vgy=0))
    where.add(report(20.0, vgx=10, vgy=0))
    assert where.position_n_m[0] - 10.0 <= 0.5

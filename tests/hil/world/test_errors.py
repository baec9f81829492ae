"""The table of errors: what is drawn of it, for whom, and that nothing is drawn by the name of
exact.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from drivers.rig.parts import Rig, with_errors
from drivers.rig.tables import RigError
from hil.world.errors import (
    LONGEST_S,
    SOURCES,
    TIMES,
    ErrorSizes,
    SensorErrors,
    StampErrors,
    as_built,
    level_of,
    sizes_of,
)
from hil.world.estimator import EstimatorConfig, reported
from missions.ground import rig_library
from path.geometry.transforms import Pose
from path.messages import Role

SEEDS = range(60)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_library.load("sim")


def turned_rad(a: Pose, b: Pose) -> float:
    return float(np.arccos(np.clip(0.5 * (np.trace(a.R.T @ b.R) - 1.0), -1.0, 1.0)))


def test_careful_is_the_default_and_every_size_says_where_it_comes_from(rig: Rig) -> None:
    assert level_of(rig) == "careful"
    assert set(SOURCES) == {each.name for each in fields(ErrorSizes)}
    said = reported(rig)
    assert said["level"] == "careful"
    assert said["mount_deg"] == 0.3
    assert (said["position_m"], said["height_m"]) == (0.5, 1.0)
    assert reported(rig_library.load("relay-sim"))["height_m"] == 1.0


def test_careless_is_three_times_careful_and_exact_is_none() -> None:
    for each in fields(ErrorSizes):
        careful = getattr(sizes_of("careful"), each.name)
        assert careful > 0.0
        assert getattr(sizes_of("careless"), each.name) == pytest.approx(3.0 * careful)
        assert getattr(sizes_of("exact"), each.name) == 0.0


def test_an_exact_world_is_built_as_the_rig_says(rig: Rig) -> None:
    built = as_built(with_errors(rig, "exact"), seed=3)
    for role in Role:
        said, true = rig.role(role), built.rig.role(role)
        assert true.camera == said.camera
        assert np.array_equal(true.mount.T_b_c.t, said.mount.T_b_c.t)
        assert np.allclose(true.mount.T_b_c.R, said.mount.T_b_c.R, atol=1e-15)
        sensor = built.sensors[role]
        assert (sensor.depth, sensor.depth_bias_m, sensor.depth_late_s, sensor.stamp_jitter_s) == (
            1.0,
            0.0,
            0.0,
            0.0,
        )
        assert (sensor.exposure_s, sensor.readout_s) == (0.0, 0.0)
        assert StampErrors(sensor, 50.0).next_ns() == 0
    assert built.rig.layout.markers[0].side_m == rig.layout.markers[0].side_m


def test_the_same_seed_builds_the_same_and_another_one_does_not(rig: Rig) -> None:
    first, again, other = as_built(rig, 5), as_built(rig, 5), as_built(rig, 6)
    assert first.rig.sender.camera == again.rig.sender.camera
    assert first.sensors == again.sensors
    assert first.rig.sender.camera != other.rig.sender.camera
    assert (
        first.rig.sender.camera.fx / rig.sender.camera.fx
        != first.rig.receiver.camera.fx / rig.receiver.camera.fx
    )


def test_both_roles_have_the_marker_at_the_same_true_place(rig: Rig) -> None:
    built = as_built(rig, 5)
    assert np.array_equal(built.rig.sender.mount.T_b_v.t, built.rig.receiver.mount.T_b_v.t)
    assert not np.array_equal(built.rig.sender.mount.T_b_v.t, rig.sender.mount.T_b_v.t)


@pytest.mark.parametrize("level", ["careful", "careless"])
def test_what_is_drawn_has_the_sizes_of_the_table(rig: Rig, level: str) -> None:
    sizes = sizes_of(level)  # type: ignore[arg-type]
    drawn = [as_built(with_errors(rig, level), seed) for seed in SEEDS]

    def spread(values: list[Any]) -> float:
        return float(np.sqrt(np.mean(np.square(np.array(values, float)))))

    said = rig.receiver
    trues = [each.rig.receiver for each in drawn]
    assert spread([t.camera.fx / said.camera.fx - 1.0 for t in trues]) == pytest.approx(
        sizes.focal, rel=0.3
    )
    assert spread([t.camera.cx - said.camera.cx for t in trues]) == pytest.approx(
        sizes.centre_px, rel=0.3
    )
    assert spread([t.mount.T_b_c.t - said.mount.T_b_c.t for t in trues]) == pytest.approx(
        sizes.mount_m, rel=0.2
    )
    turns = [turned_rad(t.mount.T_b_c, said.mount.T_b_c) for t in trues]
    assert spread(turns) == pytest.approx(np.radians(sizes.mount_deg) * np.sqrt(3.0), rel=0.2)
    sides = [
        each.rig.layout.markers[0].side_m / rig.layout.markers[0].side_m - 1.0 for each in drawn
    ]
    assert spread(sides) == pytest.approx(sizes.side, rel=0.3)
    depths = [each.sensors[Role.SENDER] for each in drawn]
    assert spread([each.depth - 1.0 for each in depths]) == pytest.approx(sizes.depth, rel=0.3)
    assert spread([each.depth_bias_m for each in depths]) == pytest.approx(
        sizes.depth_bias_m, rel=0.3
    )
    assert spread([each.edges_px for each in depths]) == pytest.approx(sizes.edge_px, rel=0.2)


def test_exposure_and_read_out_are_within_their_bounds_and_no_longer_than_a_period(
    rig: Rig,
) -> None:
    for level, exposures_s, readouts_s in (
        ("careful", (0.002, 0.010), (0.010, 0.020)),
        ("careless", (0.006, LONGEST_S), (LONGEST_S, LONGEST_S)),
    ):
        drawn = [as_built(with_errors(rig, level), seed).sensors[Role.RECEIVER] for seed in SEEDS]
        assert all(exposures_s[0] <= each.exposure_s <= exposures_s[1] for each in drawn)
        assert all(readouts_s[0] <= each.readout_s <= readouts_s[1] for each in drawn)
        assert len({each.exposure_s for each in drawn}) > 3


def test_a_lens_is_off_by_as_much_as_the_table_says_in_the_corner(rig: Rig) -> None:
    sizes, said = sizes_of("careful"), rig.sender.camera
    point = (0.5 * said.width / said.fx, 0.5 * said.height / said.fy, 1.0)
    off: list[float] = []
    for seed in SEEDS:
        true = as_built(rig, seed).rig.sender.camera
        alike = type(said)(
            said.width, said.height, said.fx, said.fy, said.cx, said.cy, true.distortion
        )
        off.append(np.hypot(*np.subtract(alike.project_point(point), said.project_point(point))))
    assert 0.5 * sizes.distortion_px < np.sqrt(np.mean(np.square(off))) < 2.0 * sizes.distortion_px


def test_stamps_wander_around_their_offset_and_never_run_backwards() -> None:
    rate_hz = 50.0
    stamps = StampErrors(SensorErrors(stamp_late_s=0.004, stamp_jitter_s=0.020, seed=9), rate_hz)
    off_s = np.array([stamps.next_ns() for _ in range(500)]) * 1e-9
    assert abs(off_s.mean() - 0.004) < 0.002
    assert (np.diff(np.arange(500) / rate_hz + off_s) > 0.0).all()


def test_depth_is_scaled_and_shifted_and_a_hole_stays_a_hole() -> None:
    sensor = SensorErrors(depth=1.01, depth_bias_m=0.003)
    measured = sensor.measured_mm(np.array([[0, 1000, 2000]], np.uint16))
    assert measured.dtype == np.uint16
    assert measured.tolist() == [[0, 1013, 2023]]


def test_attitudes_are_as_much_worse_as_the_level_says() -> None:
    said = EstimatorConfig()
    for level, times in TIMES.items():
        worse = said.times(sizes_of(level))
        assert worse.tilt_bias_deg == pytest.approx(times * said.tilt_bias_deg)
        assert worse.yaw_bias_deg == pytest.approx(times * said.yaw_bias_deg)
        assert worse.position_m == said.position_m


def test_a_rig_that_flies_in_the_real_world_has_no_errors_to_choose(rig: Rig) -> None:
    field = replace(rig, harness=None)
    with pytest.raises(RigError, match="no world of its own"):
        with_errors(field, "exact")
    assert with_errors(field, None) is field

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.cost.compute import trial as compute
from missions.trials.cost.compute.film import PERIOD_NS, Film, camera_of, shoot_film
from missions.trials.cost.compute.path import GEOMETRY, SUMS, PathPair
from missions.trials.cost.compute.rounds import one_thread
from missions.trials.cost.compute.stopwatch import Stopwatch
from missions.trials.shared.trial import TrialRequest, TrialResult
from path.messages import Role


@pytest.fixture(scope="module")
def request_(tmp_path_factory: pytest.TempPathFactory) -> TrialRequest:
    with open_work(1) as work:
        return TrialRequest(
            rig_library.load("sim-rendered"), tmp_path_factory.mktemp("trial"), 5, True, work
        )


@pytest.fixture(scope="module")
def film(request_: TrialRequest) -> Film:
    return shoot_film(request_, "640x480", 4)


@pytest.fixture(scope="module")
def result(request_: TrialRequest) -> TrialResult:
    return compute.run(request_)


def test_the_summary_has_every_stage_and_its_ratios(result: TrialResult) -> None:
    stages = result.summary["stages"]["640x480"]
    assert {*GEOMETRY, *SUMS, "d2_marker_detect", "d2_marker_fit", "orb_boxes", "orb_whole"} <= set(
        stages
    )
    assert all(stage["median_ms"] <= stage["p99_ms"] for stage in stages.values())
    ratios = result.summary["ratios"]["640x480"]
    assert {"geometry_alone_vs_orb_whole", "path_vs_orb_boxes"} <= set(ratios)
    for name, ratio in ratios.items():
        counted, method = name.split("_vs_")
        assert ratio["low"] <= ratio["ratio"] <= ratio["high"]
        assert (ratio["ratio"] > 1.0) == (
            stages[method]["median_ms"] > stages[counted]["median_ms"]
        )


def test_without_weights_xfeat_is_left_out_and_that_is_told(result: TrialResult) -> None:
    assert not [name for name in result.summary["stages"]["640x480"] if name.startswith("xfeat")]
    assert any("XFeat was left out" in note for note in result.notes)


def test_the_timed_cycles_are_cycles_that_agree(request_: TrialRequest, film: Film) -> None:
    """The cycles that are timed are the method at work: nearly every pair that is judged agrees."""
    written: list[str] = []

    class Noted:
        def write(self, topic: str, stamp_ns: int, record: Mapping[str, Any]) -> None:
            assert stamp_ns and record
            written.append(topic)

        def image(self, topic: str, stamp_ns: int, image: NDArray[np.uint8]) -> None:
            raise AssertionError(topic)

    log = Noted()
    path = PathPair(
        request_.rig, rig_library.mission_of(request_.rig), film, 1, dict.fromkeys(Role, log)
    )
    us = [path.cycle() for _ in range(8)][-1]
    assert set(written) >= {
        "/frame",
        "/target",
        "/agreement",
        "/heard_candidate",
        "/heard_target",
        "/marker",
    }
    assert {*written} >= {"/motion", "/candidate"} and written.count("/motion") == 8
    for side in ("d1", "d2"):
        assert us[f"{side}_cycle"] > us[f"{side}_log"] > 0.0
    before = path.agreed
    assert before >= 6
    path.geometry()
    assert path.agreed == before + 1
    assert us["geometry"] == pytest.approx(sum(us[stage] for stage in GEOMETRY))
    assert us["d2_marker"] >= us["d2_marker_corners"] >= us["d2_marker_detect"]
    assert us["path"] > us["path_without_messages"] > us["geometry_and_depth"] > us["geometry"]


def test_a_film_repeats_without_a_jump(film: Film) -> None:
    """The drones' velocities are those of their places, and their attitudes come round again."""
    first, last = film.moments[0], film.moments[-1]
    for role in Role:
        speeds = np.array([moment.velocity_n_mps[role] for moment in film.moments])
        assert np.abs(speeds.sum(axis=0) * PERIOD_NS * 1e-9).max() < 1e-6
        assert np.abs(first.R_n_b[role] - last.R_n_b[role]).max() < 0.03
    assert not np.array_equal(first.color[Role.RECEIVER], last.color[Role.RECEIVER])


def test_a_larger_camera_sees_as_high_and_farther_to_the_sides(request_: TrialRequest) -> None:
    for role in Role:
        small, large = (
            camera_of(request_.rig, role, "640x480"),
            camera_of(request_.rig, role, "1280x720"),
        )
        assert small == request_.rig.role(role).camera
        assert large.fy / large.height == pytest.approx(small.fy / small.height)
        _, top = small.ray(small.cx, -0.5)
        assert large.ray(large.cx, -0.5)[1] == pytest.approx(top, abs=1e-6)
        assert large.ray(-0.5, large.cy)[0] < small.ray(-0.5, small.cy)[0]


def test_the_stopwatch_times_work_and_takes_off_its_own_time() -> None:
    watch, none = Stopwatch(0), Stopwatch(10**12)
    assert watch("work", sum, range(200_000)) == none("work", sum, range(200_000)) == 19999900000
    assert watch.us["work"] > 100.0
    assert none.us["work"] == 0.0


def test_ratios_compare_medians_of_blocks() -> None:
    ours, theirs = np.full((6, 5), 2.0), np.full((6, 3), 50.0)
    timing = {
        "path": ours, "geometry": ours / 2.0, "geometry_alone": ours / 4.0, "orb_whole": theirs,
    }  # fmt: skip
    ratios = compute._ratios(timing, np.random.default_rng(1))
    assert {name: ratio["ratio"] for name, ratio in ratios.items()} == {
        "geometry_alone_vs_orb_whole": 100.0, "geometry_vs_orb_whole": 50.0, "path_vs_orb_whole": 25.0,
    }  # fmt: skip


def test_opencv_has_its_threads_again_after_an_error() -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    with pytest.raises(KeyError), one_thread():
        assert cv2.getNumThreads() == 1
        raise KeyError
    assert cv2.getNumThreads() == 3
    cv2.setNumThreads(before)

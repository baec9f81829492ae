"""D2's cycle: where it looks, what it picks, and what it says when there is nothing to pick."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from path.camera.kernels import lens_of
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior, Ray, predict
from path.cycle.receiver import ReceiverCycle
from path.geometry.rigid import rigid, rigid_from_quat
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.messages import Candidate, Target
from path.observations import Box, Detection, Missed, MissReason
from path.target.place import across_sigma

MS = 1_000_000
CONFIG = MethodConfig()
CAMERA = CameraModel(640, 480, 615.0, 616.0, 320.0, 240.0, (-0.1, 0.05, 0.001, -0.001, 0.0))
POSE = Pose(exp(np.array([0.2, 0.4, -0.1])), np.array([-0.7, 0.1, 1.2]))
COVARIANCE = np.diag([0.004**2] * 3 + [0.003**2] * 3)
POINT = (0.1, -0.05, 1.4)


def target(sequence: int = 0, **changes: Any) -> Target:
    """D1's message of frame ``sequence`` of a 50 Hz stream; both drones' clocks are one here."""
    message = Target(1, 2, 3, sequence % 65_536, sequence * 20 * MS, POINT, (0.0, 0.0, 1.0), 0.01)
    return replace(message, **changes)


def cycle(config: MethodConfig = CONFIG) -> ReceiverCycle:
    return ReceiverCycle(CAMERA, config, handoff_id=1, epoch=2, target_id=3)


def feed(receiver: ReceiverCycle, message: Target, late_ms: float = 5.0) -> Missed | None:
    return receiver.on_target(message, message.capture_ns, message.capture_ns + round(late_ms * MS))


def primed(moving_mps: float = 0.0) -> ReceiverCycle:
    """A receiver that has had five samples, 0 to 80 ms."""
    receiver = cycle()
    for i in range(5):
        point = (POINT[0] + moving_mps * i * 0.02, POINT[1], POINT[2])
        assert feed(receiver, target(i, point_v_m=point)) is None
    return receiver


def prior_at(receiver: ReceiverCycle, ms: float) -> Prior | Missed:
    return receiver.prior(POSE, COVARIANCE, round(ms * MS))


def pixel_of(point_v: tuple[float, float, float]) -> tuple[float, float]:
    x, y, z = POSE.apply(np.array(point_v)).tolist()
    return CAMERA.project_point((x, y, z))


def detection(u: float, v: float, w: float = 60.0, h: float = 40.0) -> Detection:
    return Detection(Box(u - w / 2, v - h / 2, w, h), 0.9)


def sound_prior(receiver: ReceiverCycle, ms: float = 90.0) -> Prior:
    prior = prior_at(receiver, ms)
    assert isinstance(prior, Prior)
    return prior


def answer(
    receiver: ReceiverCycle, frame_id: int, found: list[Detection], prior: Prior | Missed
) -> Candidate:
    candidate = receiver.candidate(frame_id, frame_id * 20 * MS, found, prior)
    assert isinstance(candidate, Candidate)
    return candidate


@pytest.mark.parametrize("ms", [30.0, 80.0, 95.0, 150.0])
def test_a_moving_target_is_expected_where_it_is_at_the_frames_instant(ms: float) -> None:
    prior = sound_prior(primed(moving_mps=1.0), ms)
    assert prior.pixel == pytest.approx(
        pixel_of((POINT[0] + ms / 1000.0, POINT[1], POINT[2])), abs=1e-6
    )
    assert prior.target_sequence == 4


def test_the_prior_widens_the_longer_the_last_sample_is_ago() -> None:
    receiver = primed()
    now, later = sound_prior(receiver, 81.0), sound_prior(receiver, 270.0)
    assert later.covariance_px2[0] > now.covariance_px2[0]


def test_without_fresh_samples_there_is_no_prior() -> None:
    receiver = primed()
    assert prior_at(cycle(), 0.0) == Missed(MissReason.LINK_SILENT)
    assert prior_at(receiver, 80.0 + 1000.0 * CONFIG.max_extrapolation_s + 1.0) == Missed(
        MissReason.LINK_SILENT
    )
    assert prior_at(receiver, -1.0) == Missed(MissReason.NO_TRACK)


def test_nothing_is_interpolated_across_a_gap_in_the_samples() -> None:
    receiver = cycle()
    feed(receiver, target(0))
    feed(receiver, target(30))
    assert prior_at(receiver, 300.0) == Missed(MissReason.NO_TRACK)


@pytest.mark.parametrize(
    ("message", "late_ms", "reason"),
    [
        (target(4), 5.0, MissReason.DUPLICATE),
        (target(3), 5.0, MissReason.STALE),
        (target(5, capture_ns=80 * MS), 5.0, MissReason.STALE),
        (target(5, capture_ns=-1), 5.0, MissReason.STALE),
        (target(5), 600.0, MissReason.STALE),
        (target(5), -100.0, MissReason.CLOCK),
        (target(5, epoch=1), 5.0, MissReason.STALE),
        (target(5, handoff_id=9), 5.0, MissReason.STALE),
        (target(5, target_id=4), 5.0, MissReason.STALE),
        (target(5, point_v_m=(math.nan, 0.0, 1.0)), 5.0, MissReason.NON_FINITE),
        (target(5, sigma_m=math.inf), 5.0, MissReason.NON_FINITE),
        (target(5, sigma_m=-1.0), 5.0, MissReason.NON_FINITE),
        (target(5, gravity_v=(0.0, 0.0, 0.0)), 5.0, MissReason.NON_FINITE),
        (target(5, gravity_v=(0.0, math.nan, 1.0)), 5.0, MissReason.NON_FINITE),
    ],
)
def test_a_message_that_is_no_fresh_sample_is_counted_and_changes_nothing(
    message: Target, late_ms: float, reason: MissReason
) -> None:
    receiver = primed()
    expected = sound_prior(receiver)
    assert feed(receiver, message, late_ms) == Missed(reason, ignored=True)
    assert sound_prior(receiver) == expected
    assert receiver.misses == {reason: 1}


def test_sequences_wrap() -> None:
    receiver = cycle()
    for i in range(65_533, 65_540):
        assert feed(receiver, target(i)) is None
    assert sound_prior(receiver, 65_539 * 20.0).target_sequence == 3


def test_gravity_is_that_of_the_instant() -> None:
    receiver = cycle()
    assert receiver.gravity_v(0) is None
    feed(receiver, target(0, gravity_v=(0.0, 0.0, 1.0)))
    feed(receiver, target(1, gravity_v=(0.6, 0.0, 0.8)))
    assert receiver.gravity_v(20 * MS) == pytest.approx((0.6, 0.0, 0.8))
    assert receiver.gravity_v(100 * MS) == pytest.approx((0.6, 0.0, 0.8))
    middle = receiver.gravity_v(10 * MS)
    assert middle is not None
    assert math.hypot(*middle) == pytest.approx(1.0)
    assert middle[0] == pytest.approx(0.3 / math.hypot(0.3, 0.9))
    assert receiver.gravity_v(-1) is None
    assert receiver.gravity_v(230 * MS) is None


def test_the_candidate_says_what_was_found_and_with_which_pose() -> None:
    receiver = primed()
    prior = sound_prior(receiver)
    u, v = prior.pixel
    found = detection(u + 4.0, v - 3.0)
    candidate = answer(receiver, 70_000, [detection(u + 250.0, v), found], prior)
    assert (candidate.handoff_id, candidate.epoch, candidate.target_id) == (1, 2, 3)
    assert candidate.sequence == 70_000 - 65_536
    assert candidate.target_sequence == 4
    assert candidate.capture_ns == 70_000 * 20 * MS
    assert (candidate.box, candidate.reason) == (found.box, None)
    T_v_c2 = rigid_from_quat(candidate.rotation_v_c2, candidate.position_v_m)
    np.testing.assert_allclose(T_v_c2, rigid(POSE.inverse()), atol=1e-12)
    assert 0.0 < candidate.sigma_m < CONFIG.max_pose_sigma_m


def test_a_numpy_detection_goes_out_as_plain_floats() -> None:
    receiver = primed()
    prior = sound_prior(receiver)
    u, v = prior.pixel
    box = Box(np.float64(u - 30.0), np.float64(v - 20.0), np.float64(60.0), np.float64(40.0))
    candidate = answer(receiver, 1, [Detection(box, 0.9)], prior)
    assert candidate.box is not None
    assert all(
        type(part) is float
        for part in (candidate.box.x, candidate.box.y, candidate.box.w, candidate.box.h)
    )


def test_the_gate_is_an_ellipse_around_the_prior() -> None:
    receiver = primed()
    prior = sound_prior(receiver)
    u, v = prior.pixel
    reach = CONFIG.search_sigmas * math.sqrt(prior.covariance_px2[0])
    inside, outside = detection(u + 0.9 * reach, v), detection(u + 1.1 * reach, v)
    assert answer(receiver, 1, [inside], prior).box == inside.box
    missed = answer(receiver, 2, [outside], prior)
    assert (missed.box, missed.reason) == (None, MissReason.NO_CANDIDATE)
    assert missed.rotation_v_c2 != (1.0, 0.0, 0.0, 0.0)  # the pose goes out all the same
    assert answer(receiver, 3, [], prior).reason is MissReason.NO_CANDIDATE
    assert receiver.misses == {MissReason.NO_CANDIDATE: 2}
    assert receiver.found == 1


def test_two_that_cannot_be_told_apart_are_not_guessed_between() -> None:
    receiver = primed()
    prior = sound_prior(receiver)
    u, v = prior.pixel
    sigma = math.sqrt(prior.covariance_px2[0])
    look_alikes = [detection(u - 1.0 * sigma, v, w=sigma), detection(u + 1.2 * sigma, v, w=sigma)]
    assert answer(receiver, 1, look_alikes, prior).reason is MissReason.AMBIGUOUS_TARGET
    clear = [detection(u - 0.2 * sigma, v, w=sigma), detection(u + 3.0 * sigma, v, w=sigma)]
    assert answer(receiver, 2, clear, prior).box == clear[0].box


def test_one_object_found_twice_is_not_ambiguous() -> None:
    receiver = primed()
    prior = sound_prior(receiver)
    u, v = prior.pixel
    twice = [detection(u + 1.0, v), detection(u + 4.0, v + 2.0)]
    assert answer(receiver, 1, twice, prior).box == twice[0].box


def test_one_object_in_two_boxes_is_that_object_and_two_objects_are_not() -> None:
    """As a colour detector showed a car for single frames of video (handoff --rig sim-tello --seed
    12015).
    """
    receiver = primed()
    prior = sound_prior(receiver)
    u, v = prior.pixel
    left, top, right, bottom = u - 40.0, v - 25.0, u + 40.0, v + 25.0
    pieces = [
        Detection(Box(left, top + 8.0, 60.0, bottom - top - 8.0), 0.2),
        Detection(Box(left + 22.0, top, right - left - 22.0, 44.0), 0.9),
    ]
    # how large it is nobody knows yet
    assert answer(receiver, 1, pieces, prior).reason is MissReason.AMBIGUOUS_TARGET
    answer(receiver, 2, [detection(u, v, w=80.0, h=50.0)], prior)
    assert answer(receiver, 3, pieces, prior).box == Box(left, top, 80.0, 50.0)
    apart = [detection(u - 20.0, v, w=38.0, h=50.0), detection(u + 20.0, v, w=40.0, h=50.0)]
    assert answer(receiver, 4, apart, prior).reason is MissReason.AMBIGUOUS_TARGET
    two = [detection(u - 24.0, v, w=60.0, h=50.0), detection(u + 24.0, v, w=60.0, h=50.0)]
    assert answer(receiver, 5, two, prior).reason is MissReason.AMBIGUOUS_TARGET


@pytest.mark.parametrize(
    "box",
    [
        Box(math.nan, 200.0, 60.0, 40.0),
        Box(320.0, 240.0, 0.0, 0.0),
        Box(320.0, 240.0, 60.0, 0.0),
        Box(320.0, 240.0, 0.0, 40.0),
        Box(320.0, 240.0, -1.0, 40.0),
        Box(320.0, 240.0, 60.0, -1.0),
    ],
)
def test_a_detection_that_is_none_is_never_picked(box: Box) -> None:
    receiver = primed()
    prior = sound_prior(receiver)
    u, v = prior.pixel
    box = replace(box, y=v) if math.isnan(box.x) else replace(box, x=u, y=v)
    assert answer(receiver, 1, [Detection(box, 1.0)], prior).reason is MissReason.NO_CANDIDATE


def test_a_box_smaller_than_a_pixel_can_be_picked() -> None:
    receiver = primed()
    prior = sound_prior(receiver)
    assert answer(receiver, 1, [detection(*prior.pixel, w=0.4, h=0.4)], prior).box is not None


def test_a_marker_miss_goes_out_as_the_reason() -> None:
    receiver = primed()
    candidate = answer(receiver, 1, [detection(320.0, 240.0)], Missed(MissReason.MARKER_OBLIQUE))
    assert (candidate.box, candidate.reason) == (None, MissReason.MARKER_OBLIQUE)
    assert (candidate.rotation_v_c2, candidate.sigma_m) == ((1.0, 0.0, 0.0, 0.0), 0.0)
    assert (candidate.position_v_m, candidate.target_sequence) == ((0.0, 0.0, 0.0), 0)


def test_an_old_or_repeated_frame_is_not_answered() -> None:
    receiver = primed()
    answer(receiver, 5, [], Missed(MissReason.NO_MARKER))
    nothing = Missed(MissReason.NO_MARKER)
    assert receiver.candidate(5, 120 * MS, [], nothing) == Missed(
        MissReason.DUPLICATE, ignored=True
    )
    assert receiver.candidate(4, 120 * MS, [], nothing) == Missed(MissReason.STALE, ignored=True)
    assert receiver.candidate(6, 100 * MS, [], nothing) == Missed(MissReason.STALE, ignored=True)
    assert isinstance(receiver.candidate(6, 120 * MS, [], nothing), Candidate)


def test_the_region_grows_by_the_box_once_one_was_found() -> None:
    receiver = primed()
    first = sound_prior(receiver)
    answer(receiver, 1, [detection(*first.pixel, w=100.0)], first)
    second = sound_prior(receiver)
    assert second.region.x0 == pytest.approx(first.region.x0 - 50.0)


def test_a_range_by_size_widens_the_search_along_the_sender_s_line_of_sight_only() -> None:
    config = replace(CONFIG, target_error="ray")

    def spread(config: MethodConfig, beside_m: float) -> float:
        """Area of the prior's ellipse, with D1's camera so far beside D2's."""
        eye_v = tuple((POSE.inverse().apply(np.array([beside_m, 0.0, 0.0]))).tolist())
        sender = (CAMERA, (eye_v[0], eye_v[1], eye_v[2]))
        receiver = ReceiverCycle(CAMERA, config, handoff_id=1, epoch=2, target_id=3, sender=sender)
        for i in range(5):
            feed(receiver, target(i, sigma_m=0.15))
        uu, uv, vv = sound_prior(receiver).covariance_px2
        return math.sqrt(uu * vv - uv * uv)

    assert spread(config, 0.8) < 0.5 * spread(CONFIG, 0.8)
    # D2 looks along it: the range does not matter
    assert spread(config, 0.0) < 0.2 * spread(CONFIG, 0.0)


# --- to the bound

LATE_NS = 10**15


def test_gravity_is_told_for_as_long_as_a_sample_may_be_carried_on_however_late_the_clock() -> None:
    receiver = cycle()
    assert receiver.on_target(target(gravity_v=(0.6, 0.0, 0.8)), LATE_NS, LATE_NS) is None
    bound_ns = round(CONFIG.max_extrapolation_s * 1e9)
    assert receiver.gravity_v(LATE_NS + bound_ns) == pytest.approx((0.6, 0.0, 0.8))
    assert receiver.gravity_v(LATE_NS + bound_ns + 1) is None


@pytest.mark.parametrize(
    ("changes", "taken"),
    [
        ({"sigma_m": 0.0}, True),
        ({"gravity_v": (0.0, 0.0, 0.951)}, True),
        ({"gravity_v": (0.0, 0.0, 1.049)}, True),
        ({"gravity_v": (0.0, 0.0, 0.95)}, False),
        ({"gravity_v": (0.0, 0.0, 1.05)}, False),
    ],
)
def test_a_direction_may_have_lost_a_twentieth_of_its_length_on_the_way(
    changes: dict[str, Any], taken: bool
) -> None:
    assert (feed(cycle(), target(1, **changes)) is None) is taken


@pytest.mark.parametrize("more_ns", [0, 1])
def test_a_message_is_taken_as_old_and_as_early_as_the_settings_say(more_ns: int) -> None:
    old_ns, early_ns = round(CONFIG.max_age_s * 1e9), round(CONFIG.max_future_s * 1e9)
    old, early = (cycle().on_target(target(), LATE_NS, LATE_NS + age + sign) for age, sign in
                  ((old_ns, more_ns), (-early_ns, -more_ns)))  # fmt: skip
    assert old == (Missed(MissReason.STALE, ignored=True) if more_ns else None)
    assert early == (Missed(MissReason.CLOCK, ignored=True) if more_ns else None)


def region_of(prior: Prior) -> tuple[float, ...]:
    region = prior.region
    return region.x0, region.y0, region.x1, region.y1, region.near_m, region.far_m


def test_the_prior_is_as_wide_as_the_sample_the_clocks_and_an_unknown_acceleration_make_it() -> (
    None
):
    config = replace(CONFIG, clock_sigma_s=0.004, relative_speed_mps=1.5, relative_accel_mps2=2.0)
    receiver = cycle(config)
    for i in range(5):
        feed(receiver, target(i))
    for late_s in (0.0, 0.1):
        stamp_ns = 80 * MS + round(late_s * 1e9)
        sigma_m = math.hypot(0.01, 0.004 * 1.5, 0.5 * 2.0 * late_s**2)
        expected = predict(lens_of(CAMERA), rigid(POSE), COVARIANCE, POINT, sigma_m, 4, config)
        found = receiver.prior(POSE, COVARIANCE, stamp_ns)
        assert isinstance(found, Prior) and isinstance(expected, Prior)
        assert found.pixel == pytest.approx(expected.pixel)
        assert found.covariance_px2 == pytest.approx(expected.covariance_px2)
        assert region_of(found) == pytest.approx(region_of(expected))


def test_across_the_sender_s_line_of_sight_count_pixels_mounting_and_what_moved() -> None:
    config = replace(CONFIG, target_error="ray", clock_sigma_s=0.004, relative_speed_mps=1.5)
    eye_v = (0.5, -0.3, -0.2)
    receiver = ReceiverCycle(
        CAMERA, config, handoff_id=1, epoch=2, target_id=3, sender=(CAMERA, eye_v)
    )
    for i in range(5):
        feed(receiver, target(i, sigma_m=0.15))
    away = np.array(POINT) - np.array(eye_v)
    distance_m = float(np.linalg.norm(away))
    moved_m = 0.004 * 1.5
    across_m = math.hypot(across_sigma(CAMERA, distance_m, config), config.mount_sigma_m, moved_m)
    x, y, z = (away / distance_m).tolist()
    ray = Ray((x, y, z), across_m)
    expected = predict(
        lens_of(CAMERA),
        rigid(POSE),
        COVARIANCE,
        POINT,
        math.hypot(0.15, moved_m),
        4,
        config,
        ray=ray,
    )
    assert isinstance(expected, Prior)
    assert sound_prior(receiver, 80.0).covariance_px2 == pytest.approx(expected.covariance_px2)


def test_a_target_in_the_sender_s_own_eye_has_no_line_of_sight() -> None:
    config = replace(CONFIG, target_error="ray")
    with_eye = ReceiverCycle(
        CAMERA, config, handoff_id=1, epoch=2, target_id=3, sender=(CAMERA, POINT)
    )
    without = cycle()
    for receiver in (with_eye, without):
        for i in range(5):
            feed(receiver, target(i))
    assert sound_prior(with_eye, 80.0) == sound_prior(without, 80.0)


def test_two_boxes_that_overlap_by_half_are_one_object() -> None:
    receiver = primed()
    prior = sound_prior(receiver)._replace(pixel=(300.0, 200.0))
    half = [detection(290.0, 200.0), detection(310.0, 200.0)]
    assert answer(receiver, 1, half, prior).box == half[0].box
    receiver = primed()
    less = [detection(290.0, 200.0), detection(310.5, 200.0)]
    assert answer(receiver, 1, less, prior).reason is MissReason.AMBIGUOUS_TARGET


def test_an_answer_to_nothing_is_not_counted_as_a_find() -> None:
    receiver = primed()
    prior = sound_prior(receiver)
    for frame in (1, 2, 3):
        answer(receiver, frame, [detection(*prior.pixel)], prior)
    answer(receiver, 4, [], prior)
    assert receiver.found == 3 and receiver.misses == {MissReason.NO_CANDIDATE: 1}

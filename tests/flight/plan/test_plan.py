"""A plan follows from a rig's facts: it grows with the bodies and refuses what cannot be."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.rig.facts import TargetFacts
from drivers.rig.parts import Mount, Rig
from drivers.rig.tables import RigError
from flight.config import SeparationConfig
from flight.plan.checks import problems
from flight.plan.complete import derived_of
from flight.plan.derive import derive
from flight.plan.errors import predict, usual_m
from flight.plan.facts import Eye, Facts, facts_of
from flight.plan.flown import Flown, flown
from flight.plan.geometry import Layout, apparent
from flight.plan.predictions import predictions
from flight.rendezvous.viewpoint import NoViewpoint
from hil.world.targets import LookAlikeConfig
from missions.ground import rig_library
from missions.ground.rig_library import mission_of
from path.config import MethodConfig
from path.geometry.transforms import Pose

CAR = """
[target]
length_m = 0.32
width_m = 0.22
height_m = 0.16
max_speed_mps = 0.3
"""


STRAIGHT = "distortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
RigOf = Callable[..., Rig]


@pytest.fixture
def rig_of(tmp_path: Path) -> RigOf:
    def written(text: str, name: str = "own") -> Rig:
        file = tmp_path / f"{name}.toml"
        file.write_text(f'name = "{name}"\nlike = "sim"\nlevel = "sim"\n{text}')
        return rig_library.load_unchecked(str(file))

    return written


def of(rig: Rig) -> Flown:
    mission = mission_of(rig)
    return flown(facts_of(rig, mission), mission)


def values(rig: Rig) -> dict[str, float]:
    return {each.key: each.value for each in derived_of(rig)}


def test_a_car_of_the_shipped_size_is_flown_round_about_as_the_shipped_rig_does(
    rig_of: RigOf,
) -> None:
    rig = rig_of(CAR)
    follow, shipped = mission_of(rig).follow, mission_of(rig_library.load("sim")).follow
    assert follow.height_m == pytest.approx(shipped.height_m, rel=0.1)
    assert follow.behind_m == pytest.approx(shipped.behind_m, rel=0.1)
    assert rig.method.evidence.offset_sigma_m == pytest.approx(0.03, rel=0.35)
    assert list(problems(of(rig))) == []


def test_a_rig_without_a_target_stays_as_it_is() -> None:
    rig = rig_library.load("sim")
    assert rig.target is None
    assert values(rig) == {}


def test_what_the_rig_names_is_not_derived(rig_of: RigOf) -> None:
    rig = rig_of(CAR + "[mission.follow]\nheight_m = 2.4\n")
    assert mission_of(rig).follow.height_m == 2.4
    assert "mission.follow.height_m" not in values(rig)
    assert mission_of(rig).take_off_height_m == 2.4  # as high as D1 follows


def test_what_another_rig_says_of_its_own_target_is_not_taken(
    tmp_path: Path, rig_of: RigOf
) -> None:
    rig_of("[mission.follow]\nheight_m = 2.9\n[method.evidence]\nspan_m = 3.0\n", "base")
    file = tmp_path / "child.toml"
    file.write_text(f'name = "child"\nlike = "base.toml"\nlevel = "sim"\n{CAR}')
    rig = rig_library.load_unchecked(str(file))
    assert mission_of(rig).follow.height_m < 2.0
    assert rig.method.evidence.span_m == pytest.approx(math.hypot(0.32, 0.22), rel=1e-3)


# What does not grow with the world, and why: an acceleration of a tilt has gravity in it, and waits
# have the times of take-off and landing, which are the vehicles' own. So is the speed of a landing,
# which the way out has in it. Air weighs the same at any size.
ABSOLUTE = (
    "wash",
    "mission.depart_m",
    "mission.max_accel_mps2",
    "method.relative_accel_mps2",
    "mission.deadlines.",
    "_px",
    "response_s",
)


def scaled(facts: Facts, k: float) -> Facts:
    """Return facts of a world in which every length and speed is k times as large, and every time
    as it is.
    """

    def grown(pose: Pose) -> Pose:
        return Pose(pose.R, k * pose.t)

    def eye(of: Eye) -> Eye:
        return replace(of, mount=Mount(grown(of.mount.T_b_c), grown(of.mount.T_b_v)))

    target, drone = facts.target, facts.drone
    return replace(
        facts,
        sender=eye(facts.sender),
        receiver=eye(facts.receiver),
        marker_side_m=k * facts.marker_side_m,
        target=TargetFacts(
            k * target.length_m,
            k * target.width_m,
            k * target.height_m,
            k * target.max_speed_mps,
            k * target.max_accel_mps2,
        ),
        drone=replace(
            drone,
            diameter_m=k * drone.diameter_m,
            hold_m=k * drone.hold_m,
            max_speed_mps=k * drone.max_speed_mps,
        ),
        method=replace(facts.method, mount_sigma_m=k * facts.method.mount_sigma_m),
    )


@pytest.mark.parametrize("k", [0.2, 1.0, 5.0, 20.0])
def test_lengths_and_speeds_grow_with_the_world(rig_of: RigOf, k: float) -> None:
    facts = of(rig_of(CAR)).facts
    base = {each.key: each.value for each in derive(facts, {})}
    grown = {each.key: each.value for each in derive(scaled(facts, k), {})}
    assert grown.keys() == base.keys()
    for key, value in base.items():
        if not any(word in key for word in ABSOLUTE):
            # a depth camera's bias is what it is: it is the part of an offset that does not grow
            near = 0.05 if "offset_sigma" in key or "apart" in key else 2e-3
            assert grown[key] == pytest.approx(k * value, rel=near), key
    assert len([key for key in base if not any(word in key for word in ABSOLUTE)]) > 20


def test_the_room_below_a_drone_follows_from_its_mass_its_propellers_and_what_it_holds(
    rig_of: RigOf,
) -> None:
    def keep_out(said: str) -> tuple[float, float, float]:
        found = values(rig_of(said))
        keys = ("wash_m", "wash_per_m", "wash_lean")
        wide_m, per_m, lean = (found[f"mission.separation.{key}"] for key in keys)
        return wide_m, per_m, lean

    usual = keep_out("[drone]\ndiameter_m = 0.6\n")
    settings = SeparationConfig()
    assert usual == pytest.approx(
        (settings.wash_m, settings.wash_per_m, settings.wash_lean), rel=0.02
    )
    small = keep_out("[drone]\ndiameter_m = 0.2\nmass_kg = 0.08\n")
    large = keep_out("[drone]\ndiameter_m = 0.8\nmass_kg = 2.5\n")
    assert small[0] < usual[0] < large[0]
    assert small[2] > usual[2] > large[2]  # slow air is carried farther
    steady = keep_out("[drone]\nhold_m = 0.2\nresponse_s = 0.5\n")
    assert steady[0] < usual[0]
    narrow = keep_out("[drone]\npropeller_m = 0.12\n")
    assert narrow[2] < usual[2]  # the same thrust by smaller discs: faster air
    world = rig_of("[drone]\nmass_kg = 2.0\npropellers = 6\n").world["air"]["drone"]
    assert world == {"diameter_m": 0.6, "mass_kg": 2.0, "propellers": 6}


def cameras(times: float) -> str:
    """Return cameras with so many times the usual pixels."""
    return "".join(
        f"[{role}.camera]\nwidth = {640 * times:.0f}\nheight = {480 * times:.0f}\nfx = {615.0 * times}\n"
        f"fy = {615.0 * times}\ncx = {319.5 * times}\ncy = {239.5 * times}\n{STRAIGHT}"
        for role in ("sender", "receiver")
    )


def test_more_pixels_change_no_distance(rig_of: RigOf) -> None:
    def seen_by(times: float) -> dict[str, float]:
        return values(rig_of(CAR + cameras(times), f"px{times:g}"))

    # twice as many: with four times as many the box would be larger than detectors were measured
    # with
    few, many = seen_by(1.0), seen_by(2.0)
    for key in (
        "mission.follow.behind_m",
        "mission.follow.height_m",
        "mission.separation.viewpoint_m",
    ):
        assert many[key] == pytest.approx(few[key], rel=1e-3), key


def test_ten_metres_above_a_small_car_are_refused_with_a_range_that_would_do(rig_of: RigOf) -> None:
    rig = rig_of(
        "[depth]\nmax_m = 20.0\n[mission]\ntake_off_height_m = 10.0\nreceiver_take_off_height_m = 11.0\n"
        "[mission.guard]\nfence_height_m = 15.0\nfence_radius_m = 40.0\n[mission.follow]\nbehind_m = 9.9\n"
        "height_m = 10.0\n[mission.rendezvous]\nmax_range_m = 16.0\n"
    )
    said = {problem.where: str(problem) for problem in problems(of(rig))}
    assert "16 px" in said["mission.follow"]
    assert "11.1 m would do" in said["mission.follow"]
    assert "would do" in said["method"]
    with pytest.raises(RigError, match="16 px"):
        rig_library.load(str(rig.file))


def test_a_plate_that_is_too_small_is_named_the_least_that_would_do(rig_of: RigOf) -> None:
    camera = "width = 848\nheight = 480\nfx = 425.0\nfy = 425.0\ncx = 423.5\ncy = 239.5\n"
    camera += STRAIGHT
    small = rig_of(f"[sender.camera]\n{camera}[receiver.camera]\n{camera}")
    (problem,) = problems(of(small))
    assert "marker too small" in problem.what
    side_mm = int(problem.change.split(" mm")[0].rsplit(" ", 1)[1])

    def with_side(side_m: float) -> Flown:
        plain = of(small)
        return flown(plain.facts.with_side(side_m), plain.mission)

    assert isinstance(with_side(1e-3 * (side_mm - 1)).placed.viewpoint, NoViewpoint)
    assert not isinstance(with_side(1e-3 * side_mm).placed.viewpoint, NoViewpoint)


def test_more_wind_than_the_drones_can_lean_against_is_refused_with_what_can_be_borne(
    rig_of: RigOf,
) -> None:
    rig = rig_of("[site]\nwind_mps = 10.0\ngust_mps = 2.0\n")
    said = [problem for problem in problems(of(rig)) if problem.where == "site.wind_mps"]
    assert said
    borne = min(float(each.change.split(" m/s can be borne")[0].split()[-1]) for each in said)
    assert 1.0 < borne < 9.0
    calm = rig_of(f"[site]\nwind_mps = {borne - 0.1:.2f}\ngust_mps = 2.0\n", "calm")
    assert [each for each in problems(of(calm)) if each.where == "site.wind_mps"] == []


def test_the_world_of_a_simulated_rig_has_the_wind_that_it_says(rig_of: RigOf) -> None:
    rig = rig_of("[world.wind]\nspeed_mps = 10.0\ngust_mps = 2.0\n")
    assert any(problem.where == "site.wind_mps" for problem in problems(of(rig)))


def test_a_target_faster_than_what_follows_it_is_refused(rig_of: RigOf) -> None:
    rig = rig_of(CAR.replace("0.3\n", "6.0\n"))
    said = [
        str(problem)
        for problem in problems(of(rig))
        if problem.where == "mission.follow.max_speed_mps"
    ]
    assert said
    assert "6.9 m/s would do" in said[0]


def test_frames_that_come_slowly_are_given_longer_gaps(rig_of: RigOf) -> None:
    slow = rig_of("[sender.perception]\nrate_hz = 5.0\n[receiver.perception]\nrate_hz = 5.0\n")
    assert slow.method.max_bracket_s == pytest.approx(0.5)
    assert slow.method.max_gap_s == pytest.approx(0.6)
    fast = rig_library.load("sim")
    assert fast.method.max_bracket_s == 0.2


def test_depth_over_a_large_target_may_spread_and_its_perception_knows(rig_of: RigOf) -> None:
    rig = rig_of("[target]\nlength_m = 4.5\nwidth_m = 1.8\nheight_m = 1.5\n[depth]\nmax_m = 30.0\n")
    assert rig.method.max_depth_spread_m > 3.0
    for role in (rig.sender, rig.receiver):
        assert role.perception.options["method"]["max_depth_m"] == 30.0
        assert (
            role.perception.options["method"]["max_depth_spread_m"] == rig.method.max_depth_spread_m
        )


def test_an_offset_is_what_its_sources_add_up_to_and_grows_with_each(rig_of: RigOf) -> None:
    plain = of(rig_of(CAR))
    expected = predict(plain.facts, plain.placed)
    total = math.sqrt(sum(source.sigma_m**2 for source in expected.sources))
    assert expected.offset_sigma_m == pytest.approx(total, rel=1e-9)
    assert all(np.all(np.linalg.eigvalsh(source.adds) >= -1e-12) for source in expected.sources)
    method = plain.facts.method
    for worse in (
        replace(plain.facts, attitude_sigma_rad=3.0 * plain.facts.attitude_sigma_rad),
        replace(plain.facts, method=replace(method, mount_sigma_deg=3.0 * method.mount_sigma_deg)),
        replace(plain.facts, method=replace(method, mount_sigma_m=5.0 * method.mount_sigma_m)),
    ):
        assert predict(worse, plain.placed).offset_sigma_m > expected.offset_sigma_m


def test_an_error_of_depth_alone_moves_the_box_by_the_angle_between_both_views(
    rig_of: RigOf,
) -> None:
    plain = of(rig_of(CAR))
    depth = next(s for s in predict(plain.facts, plain.placed).sources if s.name == "D1's range")
    z_m = plain.range_m
    error_m = math.hypot(0.01 * z_m, 0.003)
    # by hand: the point slides along D1's ray, D2 sees it beside by error * sin(angle), D1 maps
    # that back
    by_hand_m = error_m * math.sin(between_rad(plain.placed)) / math.sqrt(2.0)
    assert depth.sigma_m == pytest.approx(by_hand_m, rel=0.35)


def test_what_is_predicted_is_finite_and_named_once(rig_of: RigOf) -> None:
    expected = predictions(of(rig_of(CAR)))
    assert len({each.key for each in expected}) == len(expected)
    assert all(math.isfinite(each.value) and each.value > 0.0 for each in expected)


def test_the_target_fills_the_image_as_its_cylinder_does(rig_of: RigOf) -> None:
    facts: Facts = of(rig_of(CAR)).facts
    seen = apparent(facts, 2.0)
    assert seen.width_px == pytest.approx(facts.sender.camera.fx * facts.target.span_m / 2.0)
    level, upright = math.cos(math.radians(45.0)), math.sin(math.radians(45.0))
    assert seen.height_m == pytest.approx(0.16 * level + facts.target.span_m * upright, rel=1e-6)


def test_a_body_that_hides_the_target_is_helped_by_a_range(rig_of: RigOf) -> None:
    near = rig_of("[mission.follow]\nbehind_m = 0.55\nheight_m = 0.6\n")
    (problem,) = [each for each in problems(of(near)) if each.where == "mission.rendezvous"]
    assert "from the target" in problem.change
    range_m = float(problem.change.split(" m from the target")[0].split()[-1])
    assert of(near).range_m < range_m < 10.0 * of(near).range_m


def test_a_link_that_is_late_is_given_time_and_one_that_is_too_late_is_refused(
    rig_of: RigOf,
) -> None:
    late = rig_of("[link]\nlatency_s = 0.15\nloss = 0.2\n", "late")
    assert mission_of(late).clock_uncertainty_s == pytest.approx(0.225)
    assert late.method.max_extrapolation_s > 0.25
    assert list(problems(of(late))) == []
    plain = rig_library.load("sim")
    assert mission_of(plain).clock_uncertainty_s == 0.1
    (problem,) = problems(of(rig_of("[link]\nlatency_s = 0.5\n", "too-late")))
    assert problem.where == "link.latency_s"
    most_s = float(problem.change.split(" s would do")[0])
    assert list(problems(of(rig_of(f"[link]\nlatency_s = {most_s - 0.01}\n", "just-so")))) == []


def test_look_alikes_of_a_large_target_keep_so_far_from_it_as_it_is_large(rig_of: RigOf) -> None:
    """Where the world says nothing of them; boats 1.2 m apart would be one boat."""
    boat = rig_of("[target]\nlength_m = 2.5\nwidth_m = 1.0\nheight_m = 0.8")
    assert boat.world["look_alikes"]["min_distance_m"] == pytest.approx(
        1.8 * math.hypot(2.5, 1.0), abs=0.01
    )
    car = rig_of(CAR)
    assert car.world["look_alikes"]["min_distance_m"] == LookAlikeConfig().min_distance_m
    assert car.world["look_alikes"]["max_distance_m"] == LookAlikeConfig().max_distance_m


def test_d2_searches_as_wide_an_angle_with_any_camera(rig_of: RigOf) -> None:
    """Of a 4K image 200 px are a quarter of that: no prior was good enough."""
    few, many = (rig_of(CAR + cameras(times), f"px{times:g}").method for times in (1.0, 4.0))
    assert many.max_search_px == pytest.approx(4.0 * few.max_search_px, rel=1e-3)
    assert many.min_search_px == pytest.approx(4.0 * few.min_search_px, rel=1e-3)
    assert few.max_search_px == pytest.approx(MethodConfig().max_search_px, rel=0.01)


HALL = """
[site]
corners_m = [[-2.0, -2.0], [-2.0, 2.0], [2.0, 2.0], [2.0, -2.0]]
"""


def test_walls_are_kept_from_by_what_positions_are_worth(rig_of: RigOf) -> None:
    """D2 landed 0.2 m from a wall, and touched it: a body's radius was all that it kept."""
    drones = "[drone]\nhold_m = 0.1\n"
    near = "[mission.target]\nnorth_m = 0.9\n"
    beacons = rig_of(CAR + drones + HALL + "position_m = 0.1\n" + near, "beacons")
    assert mission_of(beacons).fence.body_m == pytest.approx(0.3 + 0.1 + 0.2)
    assert list(problems(of(beacons))) == []
    satellites = rig_of(CAR + drones + HALL + near, "satellites")
    assert [each.where for each in problems(of(satellites))] == ["site.corners_m"]


def test_a_ceiling_too_low_for_the_upper_drone_is_refused(rig_of: RigOf) -> None:
    drones = "[drone]\nhold_m = 0.1\n"
    near = "position_m = 0.1\n[mission.target]\nnorth_m = 0.9\n"
    high, low = (
        rig_of(CAR + drones + HALL + f"ceiling_m = {ceiling_m}\n" + near, f"ceiling-{ceiling_m}")
        for ceiling_m in (3.0, 2.4)
    )
    assert list(problems(of(high))) == []
    (found,) = problems(of(low))
    assert found.where == "site.ceiling_m"
    assert "D2 would fly 2.2 m high" in found.what
    assert "a ceiling at 2.8 m would do" in found.change


def test_a_depth_that_does_not_tell_a_person_from_who_stands_behind_is_refused(
    rig_of: RigOf,
) -> None:
    """Both were one box, D1 went over to the one behind, and that one was handed over."""
    person = "[target]\nlength_m = 0.6\nwidth_m = 0.5\nheight_m = 1.75\n[depth]\nmax_m = 30.0\n"
    far = "[mission.follow]\nbehind_m = 5.7\nheight_m = 6.5\n[[markers]]\nid = 0\nside_m = 0.08\nside_sigma_m = 1e-4\n"
    stereo = rig_of(person + "sigma_at_1m_m = 0.005\n" + far, "stereo")
    (found,) = problems(of(stereo))
    assert "right behind it" in found.what
    assert "7.2 m would do" in found.change
    lidar = rig_of(person + "sigma_at_1m_m = 0.0002\n" + far, "lidar")
    assert list(problems(of(lidar))) == []


def test_what_flies_is_refused_until_it_is_said_how_high(rig_of: RigOf) -> None:
    flier = CAR + "flies = true\n"
    said = {each.where: each for each in problems(of(rig_of(flier, "flier")))}
    assert "how high" in said["mission.target.height_m"].what
    told = rig_of(flier + "[mission.target]\nheight_m = 0.8\n", "told")
    assert "mission.target.height_m" not in {each.where for each in problems(of(told))}


def test_a_truck_that_outruns_a_landing_is_refused_in_a_crews_words(rig_of: RigOf) -> None:
    truck = "[target]\nlength_m = 5.2\nwidth_m = 2.0\nheight_m = 1.9\nmax_speed_mps = 6.0\n"
    said = {each.where: each for each in problems(of(rig_of(truck)))}
    assert "aside first" in said["target.max_speed_mps"].what
    depth = said["mission.follow"]
    assert "[depth] min_m and max_m" in depth.what
    assert "[height] rangefinder_max_m" in depth.change
    # nearer than depth reaches the truck would not be in the image any more
    assert "[depth] max_m = " in depth.change


def test_positions_that_walk_are_allowed_for_where_they_matter(rig_of: RigOf) -> None:
    usual = mission_of(rig_of(CAR))
    walking = mission_of(rig_of(CAR + "[site]\nposition_m = 2.0\n", "walking"))
    assert (usual.target.own_m, usual.rendezvous.positions_within_m) == (0.0, 1.1)
    assert walking.target.own_m == 2.0
    assert walking.rendezvous.positions_within_m == pytest.approx(4.4)


def between_rad(placed: Layout) -> float:
    """Return the angle at the target between both lines of sight, D1's body standing for its
    camera.
    """
    assert placed.T_h_c2 is not None
    to_sender = -placed.target_h
    to_receiver = placed.T_h_c2.t - placed.target_h
    lengths = float(np.linalg.norm(to_sender) * np.linalg.norm(to_receiver))
    return math.acos(float(to_sender @ to_receiver) / lengths)


def test_d2_reads_the_turn_of_a_large_plate_off_the_plate_and_not_off_gravity(
    rig_of: RigOf,
) -> None:
    """Of 4K images D2 was expected at 5 mm, by the attitude's error alone; 1 mm was flown."""
    few, many = (of(rig_of(CAR + cameras(times), f"turn{times:g}")) for times in (1.0, 4.0))
    small, large = (predict(each.facts, each.placed).receiver_m for each in (few, many))
    assert large < 0.6 * small
    assert large < 1.05 * many.facts.attitude_sigma_rad / 3.0


def test_without_depth_the_target_errs_by_its_range_by_size_and_height() -> None:
    """Of a pair of Tellos 39 mm were expected, as of a depth camera; 50 to 117 mm were flown."""
    tellos = of(rig_library.load("sim-tello"))
    expected_m = predict(tellos.facts, tellos.placed).target_m
    assert 0.07 < expected_m < 0.14
    as_by_depth = predict(replace(tellos.facts, size_sigma=0.0), tellos.placed)
    assert as_by_depth.target_m < 0.5 * expected_m


@pytest.mark.parametrize(
    ("sigmas", "median"), [((1, 1, 1), 1.538), ((1, 0, 0), 0.674), ((3, 1, 1), 2.546)]
)
def test_a_usual_error_is_the_median_of_its_length(
    sigmas: tuple[float, ...], median: float
) -> None:
    assert usual_m(tuple(s**2 for s in sigmas)) == pytest.approx(median, rel=0.03)


def test_common_views_are_allowed_what_they_err_and_told_what_they_take_of_the_link(
    rig_of: RigOf,
) -> None:
    usual = rig_of(CAR)
    common = rig_of(f"{CAR}\n[method]\ncommon_view = true\n", "common")
    assert "method.evidence.max_pose_sigma_m" not in values(usual)
    range_m = of(common).range_m
    pose_m = values(common)["method.evidence.max_pose_sigma_m"]
    assert pose_m == pytest.approx(0.05 * range_m, rel=0.05)
    offset = "method.evidence.offset_sigma_m"
    wider_m = math.sqrt(values(common)[offset] ** 2 - values(usual)[offset] ** 2)
    assert wider_m == pytest.approx(0.04 * range_m, rel=0.05)
    taken = "common_view_bytes_per_s"
    assert taken not in {each.key for each in predictions(of(usual))}
    (rate,) = [each.value for each in predictions(of(common)) if each.key == taken]
    assert 10_000 < rate <= 12_000


def test_a_rig_without_a_target_is_allowed_them_too(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text('name = "own"\nlike = "sim"\nlevel = "sim"\n[method]\ncommon_view = true\n')
    evidence = rig_library.load_unchecked(str(file)).method.evidence
    usual = MethodConfig().evidence
    assert evidence.max_pose_sigma_m > usual.max_pose_sigma_m
    assert evidence.offset_sigma_m > usual.offset_sigma_m


@pytest.mark.parametrize(
    ("place", "told"),
    [
        ("[-3.0, 2.5]", "D2 would take off too near to one"),
        ("[0.0, -1.0]", "D1 would take off too near to one"),
        ("[4.0, 0.1]", "the target is designated inside one"),
        ("[8.0, 6.0]", ""),
    ],
)
def test_obstacles_leave_room_where_drones_stand_and_at_the_target(
    rig_of: RigOf, place: str, told: str
) -> None:
    rig = rig_of(
        f"""
[site]
position_m = 0.2

[[site.obstacles]]
place_m = {place}
size_m = [1.0, 1.0]
top_m = 2.0
round = true
"""
    )
    found = [str(each) for each in problems(of(rig)) if each.where == "site.obstacles"]
    assert (found[0] if found else "").startswith(told)
    assert bool(found) == bool(told)

"""A drone's air: momentum theory at its rotors, a turbulent jet below, and what it does to another."""

from __future__ import annotations

import math

import pytest

from drivers.rig.facts import DroneFacts
from flight.wash import (
    AIR_KGPM3,
    EDGE,
    GRAVITY_MPS2,
    ORIGIN,
    SPREAD,
    jet_mps,
    keep_out_m,
    lift_share,
    push_mps2,
    rotors_of,
    sinks_s,
)

SIZES = {
    "tello": DroneFacts(diameter_m=0.2, mass_kg=0.08),
    "small": DroneFacts(diameter_m=0.35, mass_kg=0.35),
    "usual": DroneFacts(),
    "heavy": DroneFacts(diameter_m=0.8, mass_kg=2.5),
}


@pytest.mark.parametrize("drone", SIZES.values(), ids=SIZES)
def test_the_jet_carries_no_more_than_the_thrust_and_most_of_it(drone: DroneFacts) -> None:
    rotors = rotors_of(drone)
    discs_m2 = 4 * math.pi * (0.5 * (drone.diameter_m - rotors.size_m)) ** 2
    thrust_n = 2.0 * AIR_KGPM3 * discs_m2 * rotors.hover_mps**2
    step_m = 0.002
    for below_m in (1.0, 3.0):
        flux_n = sum(
            AIR_KGPM3
            * jet_mps(below_m, step_m * k, rotors.size_m, rotors.hover_mps) ** 2
            * 2.0
            * math.pi
            * step_m**2
            * k
            for k in range(1000)
        )
        assert 0.6 < flux_n / thrust_n < 1.0


def test_a_jet_decays_spreads_and_has_an_edge() -> None:
    rotors = rotors_of(DroneFacts())
    near, far = (jet_mps(s, 0.0, rotors.size_m, rotors.hover_mps) for s in (1.0, 3.0))
    assert near > far > 0.5 * near
    half_m = SPREAD * (1.0 - ORIGIN * rotors.size_m)
    assert jet_mps(1.0, half_m, rotors.size_m, rotors.hover_mps) == pytest.approx(
        0.5 * near, rel=0.03
    )
    assert jet_mps(1.0, EDGE * half_m, rotors.size_m, rotors.hover_mps) == 0.0
    assert jet_mps(-0.01, 0.0, rotors.size_m, rotors.hover_mps) == 0.0  # nothing above


def test_air_sinks_as_fast_as_it_is_on_the_axis() -> None:
    rotors = rotors_of(DroneFacts())
    step_m = 0.001
    summed_s = sum(
        step_m / jet_mps(step_m * (k + 0.5), 0.0, rotors.size_m, rotors.hover_mps)
        for k in range(1500)
    )
    assert sinks_s(1.5, rotors.size_m, rotors.hover_mps) == pytest.approx(summed_s, rel=1e-4)


@pytest.mark.parametrize("u", [0.0, 0.05, 0.5, 1.0, 2.0, 3.0, -0.3])
def test_a_rotor_keeps_the_lift_that_its_power_gives_in_an_inflow(u: float) -> None:
    w = 1.0 / lift_share(u * 4.0, 4.0)
    assert w * w * (w - u) == pytest.approx(1.0, abs=1e-4)
    assert lift_share(0.2, 4.0) == pytest.approx(1.0 - 0.05 / 3.0, abs=2e-3)


def test_a_crazyflie_loses_about_what_was_measured_of_one() -> None:
    crazyflie = rotors_of(DroneFacts(diameter_m=0.15, mass_kg=0.034, propeller_m=0.047))
    lost_share_per_mps = 1.0 - lift_share(1.0, crazyflie.hover_mps)
    assert 0.05 < lost_share_per_mps < 0.1  # 0.05 to 0.07 in arXiv 2207.09645


@pytest.mark.parametrize("drone", SIZES.values(), ids=SIZES)
def test_at_the_keep_out_a_drone_is_pushed_by_what_it_holds(drone: DroneFacts) -> None:
    rotors = rotors_of(drone)
    for below_m in (0.3, 1.0, 2.0):
        beside_m = keep_out_m(rotors, below_m, 0.6)
        assert push_mps2(rotors, below_m, beside_m) == pytest.approx(0.6, rel=0.01)
    assert keep_out_m(rotors, 1.0, GRAVITY_MPS2) == 0.0


def test_heavier_drones_on_the_same_propellers_keep_farther_apart() -> None:
    light, heavy = (rotors_of(DroneFacts(mass_kg=mass_kg)) for mass_kg in (0.8, 3.0))
    assert heavy.hover_mps == pytest.approx(light.hover_mps * math.sqrt(3.0 / 0.8))
    # what is lost is a share of the lift: by the drag alone a heavy one is pushed harder
    assert push_mps2(heavy, 1.0, 0.0) == pytest.approx(push_mps2(light, 1.0, 0.0), rel=0.1)
    own = [keep_out_m(rotors_of(SIZES[name]), 1.0, 0.6) for name in SIZES]
    assert own == sorted(own)

"""Settings that cannot be right are refused, naming field and value."""

import math
from typing import Any

import pytest

from path.config import EvidenceConfig, MethodConfig


def test_defaults_are_valid_and_are_the_papers_where_it_gives_any() -> None:
    config = MethodConfig()
    assert (config.hold_frames, config.hold_s, config.box_mapping) == (350, 7.0, "center")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("box_mapping", "middle"),
        ("hold_frames", 0),
        ("hold_frames", 350.0),
        ("hold_frames", True),
        ("hold_s", 0.0),
        ("max_gap_s", -0.1),
        ("z0_m", math.nan),
        ("max_age_s", math.inf),
        ("tau_max", 1.5),
        ("tau_min", 0.6),  # above tau_max
        ("min_depth_m", 7.0),  # above max_depth_m
        ("min_search_px", 500.0),  # above max_search_px
        ("max_incidence_deg", 90.0),
        ("track_length", 3),
        ("pixel_sigma_px", -1.0),
        ("z0_m", "1.5"),
    ],
)
def test_a_wrong_value_is_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{field}:"):
        MethodConfig(**{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("alpha", 0.0),
        ("alpha", 1.0),
        ("block_s", 0.0),
        ("block_pairs", 0),
        ("block_pairs", 8.0),
        ("strength", 1.0),
        ("first_rate", 0.6),  # above next_rate
        ("next_rate", 1.0),
        ("min_s", math.nan),
        ("min_pairs", 1.5),
        ("max_pose_sigma_m", -0.01),
    ],
)
def test_a_wrong_value_of_the_evidence_gate_is_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{field}:"):
        EvidenceConfig(**{field: value})


def test_a_gate_is_one_of_three() -> None:
    assert MethodConfig().gate == "evidence"
    with pytest.raises(ValueError, match=r'^gate: .*"count", "evidence" and "likelihood"'):
        MethodConfig(gate="evidense")  # pyright: ignore[reportArgumentType]


def test_the_evidence_gate_asks_for_a_better_pose_and_fewer_pairs() -> None:
    papers, evidence = MethodConfig(gate="count"), MethodConfig(gate="evidence")
    assert (papers.needed_pairs, papers.pose_sigma_limit_m) == (350, papers.max_pose_sigma_m)
    assert (evidence.needed_pairs, evidence.pose_sigma_limit_m) == (
        30,
        evidence.evidence.max_pose_sigma_m,
    )
    assert MethodConfig(gate="evidence", max_pose_sigma_m=0.01).pose_sigma_limit_m == 0.01


def test_noise_may_be_none_at_all() -> None:
    assert MethodConfig(pixel_sigma_px=0, clock_sigma_s=0.0).pixel_sigma_px == 0

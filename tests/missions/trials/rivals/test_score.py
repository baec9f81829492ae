"""Outcomes by the paper's definitions, and the best thresholds, on cases made by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.trials.rivals.score import (
    Ballot,
    FrameTally,
    Outcome,
    Rule,
    best_rule,
    outcome,
    tally,
)
from missions.trials.rivals.variants import ORB_VARIANTS, XFEAT_VARIANTS, same_look
from path.baselines.features import FeatureSearch


@pytest.mark.parametrize(
    ("present", "chosen", "right", "expected"),
    [
        (True, True, True, "tp"),
        # somebody else, although the target is there: false, and not also missed
        (True, True, False, "fp"),
        (True, False, False, "fn"),
        (False, True, False, "fp"),
        (False, True, True, "fp"),  # a target that is not in view cannot be acquired
        (False, False, False, "tn"),
    ],
)
def test_outcomes_are_the_papers(
    present: bool, chosen: bool, right: bool, expected: Outcome
) -> None:
    assert outcome(present, chosen, right) == expected


def test_the_papers_own_counts_give_the_papers_own_rates() -> None:
    summary = FrameTally(tp=310, tn=26, fp=7, fn=7).summary()
    assert summary["accuracy"] == pytest.approx(0.96)
    assert summary["fp_rate"] == summary["fn_rate"] == pytest.approx(0.02)
    low, high = summary["fp_interval"]
    assert low == pytest.approx(0.0097, abs=1e-4)  # Wilson
    assert high == pytest.approx(0.0407, abs=1e-4)


def test_a_baselines_box_is_judged_by_who_is_really_in_it() -> None:
    votes = ((9, 4, 0),)
    rule = Rule(0, 6, 2)
    assert Ballot(True, (0, 1, None), votes).outcome(rule) == "tp"
    assert Ballot(True, (1, 0, None), votes).outcome(rule) == "fp"
    assert Ballot(True, (None, 0, 1), votes).outcome(rule) == "fp"
    assert Ballot(True, (0, 1, None), votes).outcome(Rule(0, 10, 2)) == "fn"
    assert Ballot(True, (0, 1, None), votes).outcome(Rule(0, 6, 6)) == "fn"
    assert Ballot(False, (1, 2, None), votes).outcome(Rule(0, 10, 2)) == "tn"
    assert Ballot(True, (), ((),)).outcome(rule) == "fn"


def test_the_best_rule_is_found_over_variants_and_thresholds() -> None:
    ballots = [
        Ballot(True, (0, 1), ((5, 9), (12, 3))),  # the first variant prefers somebody else
        Ballot(True, (1, 0), ((7, 2), (1, 11))),
        Ballot(False, (2, 1), ((8, 1), (10, 0))),
    ]
    rule = best_rule(ballots, 2)
    assert rule.variant == 1
    assert rule.min_inliers == 11
    assert tally(ballots, rule) == FrameTally(tp=2, tn=1)


def test_of_rules_as_good_the_one_with_fewer_false_positives_is_taken() -> None:
    # 3 votes for the target, 3 for somebody else: right and wrong come together, so rather take
    # neither
    ballots = [Ballot(True, (0,), ((3,),)), Ballot(False, (1,), ((3,),))]
    assert tally(ballots, best_rule(ballots, 1)) == FrameTally(tn=1, fn=1)


def test_fewer_variants_keep_their_votes() -> None:
    ballot = Ballot(True, (0,), ((1,), (2,), (3,)))
    assert ballot.only((0, 2)).votes == ((1,), (3,))
    assert same_look(ORB_VARIANTS, 0) == tuple(
        i for i, each in enumerate(ORB_VARIANTS) if each.look == FeatureSearch(1.0)
    )
    assert 0 < len(same_look(XFEAT_VARIANTS, 1)) < len(XFEAT_VARIANTS)


BALLOT = st.integers(0, 4).flatmap(
    lambda boxes: st.builds(
        Ballot,
        st.booleans(),
        st.tuples(*[st.sampled_from((0, 1, 2, None))] * boxes),
        st.tuples(*[st.tuples(*[st.integers(0, 20)] * boxes)] * 2),
    )
)


@given(
    st.lists(BALLOT, min_size=1, max_size=8),
    st.builds(Rule, st.integers(0, 1), st.integers(1, 20), st.integers(0, 12)),
)
def test_no_rule_is_better_than_the_best(ballots: list[Ballot], other: Rule) -> None:
    best, any_ = tally(ballots, best_rule(ballots, 2)), tally(ballots, other)
    assert best.tp + best.tn >= any_.tp + any_.tn

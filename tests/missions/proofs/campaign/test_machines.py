"""Runs of the machines: the same again from their arguments, clean when the machines are right, and
not when not.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from hil.link.faulty import faulty_channel
from missions.ground.options.words import LevelName
from missions.proofs.campaign.levels import LEVELS
from missions.proofs.campaign.machines import Machines
from missions.proofs.campaign.plan import Crash, Outage, RunPlan, Stall, draw
from missions.proofs.verify.mutants import MUTANTS, wrong
from path.messages import Role

CALM = replace(draw(0, "none", 1), disk_s=0.0, late_s=0.0, agree_s=1.0, wrong=False)


def story(plan: RunPlan) -> list[tuple[float, str, str]]:
    told: list[tuple[float, str, str]] = []
    Machines(plan, faulty_channel, lambda at_s, who, what: told.append((at_s, who, what))).run()
    return told


def commit_s(plan: RunPlan) -> float:
    return next(at_s for at_s, _, what in story(plan) if what.startswith("sends COMMIT"))


@pytest.mark.parametrize("level", LEVELS)
def test_a_run_is_the_same_again_and_violates_nothing(level: LevelName) -> None:
    for number in range(5):
        run = Machines(draw(7, level, number), faulty_channel).run()
        assert run == Machines(draw(7, level, number), faulty_channel).run()
        assert run.violations == ()


def test_other_numbers_and_seeds_are_other_runs() -> None:
    plans = [draw(0, "harsh", 0), draw(0, "harsh", 1), draw(1, "harsh", 0), draw(0, "hostile", 0)]
    assert len({plan.seed for plan in plans}) == len({plan.link["loss"] for plan in plans}) == 4


def test_a_good_link_commits_within_a_few_hundredths_of_a_second() -> None:
    run = Machines(CALM, faulty_channel).run()
    assert (run.outcome, run.violations) == ("commit", ())
    assert run.figures["commit_s"] < 0.05
    assert run.figures["gap_s"] < 0.05


def test_a_link_that_dies_with_the_commit_is_taken_back_after_the_lease() -> None:
    at_s = commit_s(CALM)
    run = Machines(
        replace(CALM, outages=(Outage(at_s - 0.01, at_s + 1.6, None),)), faulty_channel
    ).run()
    assert run.violations == ()
    assert 1.5 < run.figures["gap_s"] < 1.6


def test_a_confirm_that_never_comes_leaves_an_orphan_and_says_so() -> None:
    at_s = commit_s(CALM)
    accepted = replace(CALM, outages=(Outage(at_s + 0.002, at_s + 20.0, Role.SENDER),))
    assert Machines(accepted, faulty_channel).run().outcome == "orphaned"


@pytest.mark.parametrize("role", list(Role))
@pytest.mark.parametrize("after", range(1, 8))
def test_a_program_may_die_between_any_two_effects_of_the_hand_over(role: Role, after: int) -> None:
    for halfway in (False, True):
        crash = Crash(role, commit_s(CALM) - 0.001, after, halfway, 0.5, reboot=False, flying=True)
        assert Machines(replace(CALM, crashes=(crash,)), faulty_channel).run().violations == ()


def test_what_was_handed_over_before_a_landing_is_not_taken_for_its_own_by_a_later_restart() -> (
    None
):
    at_s = commit_s(CALM) + 1.0
    landed = Crash(Role.SENDER, at_s, 1, True, 0.5, reboot=False, flying=False)
    crashes = (landed, replace(landed, at_s=at_s + 1.0, flying=True))
    run = Machines(replace(CALM, crashes=crashes), faulty_channel).run()
    assert (run.outcome, run.violations) == ("commit", ())


@pytest.mark.parametrize("after", range(1, 5))
def test_a_sender_may_die_before_its_first_epoch_is_on_the_disk(after: int) -> None:
    offered_s = next(at_s for at_s, _, what in story(CALM) if what.startswith("is responsible"))
    for before_s in (0.02, 0.04, 0.06):
        crash = Crash(
            Role.SENDER, offered_s - before_s, after, False, 0.5, reboot=False, flying=False
        )
        assert (
            Machines(replace(CALM, crashes=(crash,), disk_s=0.04), faulty_channel).run().violations
            == ()
        )


@pytest.mark.parametrize(
    ("level", "number"), [("harsh", number) for number in (2846, 9474, 14750, 30898, 56034)]
)
def test_a_run_that_went_wrong_once_stays_right(level: LevelName, number: int) -> None:
    assert Machines(draw(21, level, number), faulty_channel).run().violations == ()


@pytest.mark.parametrize(
    "rule",
    [
        "the sender says COMMIT, and then releases",
        "any agreement is good enough for a COMMIT",
        "the receiver never lets go",
        "the sender never takes back",
        "the sender begins again in the epoch it had",
    ],
)
def test_machines_that_skip_a_rule_are_caught(rule: str) -> None:
    mutant = next(one for one in MUTANTS if one.rule == rule)
    with wrong(mutant):
        for number in range(150):
            level: LevelName = "hostile" if number % 2 else "harsh"
            if Machines(draw(0, level, number), faulty_channel).run().violations:
                return
    raise AssertionError("not caught")


@pytest.mark.parametrize("role", list(Role))
@pytest.mark.parametrize("for_s", [0.1, 0.39, 2.0])
def test_a_program_may_stand_still_between_any_two_effects_for_any_time(
    role: Role, for_s: float
) -> None:
    # no ACCEPT: the lease runs out
    lost = Outage(commit_s(CALM) + 0.001, commit_s(CALM) + 3.0, Role.RECEIVER)
    for after in range(1, 5):
        for begins_s in (-0.01, 1.3):
            stall = Stall(role, commit_s(CALM) + begins_s, after, for_s)
            for outages in ((), (lost,)):
                run = Machines(
                    replace(CALM, stalls=(stall,), outages=outages), faulty_channel
                ).run()
                assert run.violations == (), (stall, outages)


def test_a_disk_that_loses_a_record_breaks_what_the_promises_rest_on_and_is_counted_apart() -> None:
    apart: list[str] = []
    for after in range(1, 8):
        for role in Role:
            crash = Crash(
                role,
                commit_s(CALM) - 0.001,
                after,
                True,
                0.5,
                reboot=True,
                flying=True,
                forgets="newest",
            )
            run = Machines(replace(CALM, crashes=(crash,)), faulty_channel).run()
            assert (run.violations, run.broken) == ((), ("disk",))
            apart += run.beyond
    assert any(what.startswith(("S1", "S2", "S4")) for what in apart), (
        "the assumption is not needed?"
    )


def test_what_a_disk_forgets_is_drawn_beside_all_else() -> None:
    plans = [draw(7301, "hostile", number) for number in range(200)]
    assert {crash.forgets for plan in plans for crash in plan.crashes} == {
        "nothing",
        "newest",
        "all",
    }
    assert all(
        crash.forgets == "nothing"
        for number in range(50)
        for crash in draw(7301, "harsh", number).crashes
    )

"""The sweep over kills and links: what is asked for, and what the logs are judged to say."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.log.mcap_log import McapLog, new_part
from missions.ground import rig_library
from missions.trials.cost.processes.duty import RoleEvent, judge, read
from missions.trials.cost.processes.trial import bound_s, runs
from path.messages import Role

D1, D2 = Role.SENDER, Role.RECEIVER
S = 1_000_000_000


def told(
    at_s: float,
    role: Role,
    responsible: bool | None = None,
    *,
    alive: bool = True,
    duty: str | None = None,
) -> RoleEvent:
    return RoleEvent(round(at_s * S), role, alive, responsible, duty)


def test_a_hand_over_has_a_gap_of_a_message_and_a_holder_in_the_end() -> None:
    found = judge(
        [told(1, D1, True), told(9, D1, False), told(9.02, D2, True), told(12, D1), told(20, D2)],
        9 * S,
    )
    assert (found.both_s, round(found.gap_s, 6), found.dead_s) == (0.0, 0.02, 0.0)
    assert found.holder is D2 and not found.orphaned
    assert found.commit_s == pytest.approx(8.0)


def test_two_at_a_time_are_seen() -> None:
    found = judge([told(1, D1, True), told(5, D2, True), told(5.3, D1, False), told(9, D2)])
    assert found.both_s == pytest.approx(0.3)


def test_only_the_time_is_excused_in_which_the_program_is_dead_whose_turn_it_is() -> None:
    """A sender that released and died is waited for; when it is back its own waiting counts again,
    with what was.
    """
    found = judge([
        told(1, D1, True), told(5, D1, duty="released"), told(5, D1, False), told(5.1, D1, alive=False),
        told(6.1, D1, False), told(7.4, D1, True), told(9, D1),
    ])  # fmt: skip
    assert (round(found.dead_s, 6), round(found.gap_s, 6)) == (1.0, 1.4)
    assert found.holder is D1


def test_a_dead_receiver_excuses_nothing_before_the_target_is_handed_over() -> None:
    before = [
        told(1, D1, True),
        told(5, D1, duty="released"),
        told(5, D1, False),
        told(5.1, D2, True),
    ]
    found = judge([*before, told(5.2, D2, alive=False), told(6.6, D1, True), told(9, D1)])
    assert round(found.gap_s, 6) == 1.4
    given = judge(
        [*before, told(5.2, D1, duty="handed_over"), told(5.3, D2, alive=False), told(9, D1)]
    )
    assert (round(given.dead_s, 6), round(given.gap_s, 6)) == (3.7, 0.1)
    assert given.holder is None


def test_an_orphan_is_one_when_somebody_said_so_and_nobody_holds() -> None:
    orphan = [
        told(1, D1, True),
        told(5, D1, False),
        told(5, D2, True),
        told(6, D2, False),
        told(9, D1),
    ]
    assert judge(orphan, alarm=True).orphaned
    assert not judge(orphan).orphaned
    assert not judge([*orphan, told(10, D1, True)], alarm=True).orphaned


def test_a_run_s_folder_is_read_with_all_its_programs(tmp_path: Path) -> None:
    for number, responsible in enumerate((True, False)):
        with McapLog(new_part(tmp_path, "sender")) as log:
            log.write("/phase", (1 + 10 * number) * S, {"phase": "verify"})
            log.write(
                "/responsibility",
                (2 + 10 * number) * S,
                {"responsible": responsible, "until_ns": None},
            )
            log.write("/state", (5 + 10 * number) * S, {})
            if number:
                log.write("/outcome", 16 * S, {"outcome": "restarted"})
    found = read(tmp_path)
    assert (found.dead_s, found.gap_s) == (pytest.approx(6.0), pytest.approx(5.0))


def test_every_phase_and_every_record_of_both_is_killed_at(tmp_path: Path) -> None:
    asked = runs.kills("sim", [1], (0.0, 2.0), (None, 0.5), tmp_path)
    assert len({(one.faults, one.seed) for one in asked}) == len(asked) == (17 * 2 + 5) * 2
    assert {one.where for one in asked if one.killed is D1} >= {
        "preflight",
        "land+2",
        "released",
        "handed_over",
    }
    assert len({one.folder for one in asked}) == len(asked)


def test_one_kill_in_virtual_time(tmp_path: Path) -> None:
    (asked,) = [
        one
        for one in runs.kills("sim", [1], (), (0.5,), tmp_path)
        if one.killed is D1 and one.where == "released"
    ]  # fmt: skip
    came = runs.fly(asked)
    assert came.outcome == "restarted" and came.landed and not came.violations
    assert came.duty.both_s == 0.0 and came.duty.gap_s <= bound_s()
    assert 0.4 < came.duty.dead_s < 0.7
    assert not asked.folder.exists()  # nothing to look at


def test_live_runs_are_signed(tmp_path: Path) -> None:
    rig = rig_library.load(runs.signed_rig(runs.LIVE, tmp_path))
    keys = {rig.role(role).link.options["key_file"] for role in Role}
    assert keys == {"pair.key"}
    assert (tmp_path / "pair.key").stat().st_mode & 0o077 == 0

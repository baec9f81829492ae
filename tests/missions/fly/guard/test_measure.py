"""The guard's reaction, read from logs as a flight would leave them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.log.mcap_log import McapLog
from missions.fly.guard.measure import (
    KINDS,
    MOMENTS,
    RADIO,
    cases,
    kinds_of,
    table,
    with_patient_failsafe,
)
from missions.fly.guard.reaction import TAKEOVER, Reaction, is_met, read_reaction
from missions.ground import rig_library
from path.messages import Role

S = 1_000_000_000


def leave_logs(folder: Path, modes: list[tuple[float, str, bool]], fault_s: float | None) -> None:
    with McapLog(folder / "world.mcap") as log:
        for at_s, mode, armed in modes:
            log.write(
                "/autopilot", round(at_s * S), {"role": "sender", "mode": mode, "armed": armed}
            )
            log.write(
                "/autopilot", round(at_s * S), {"role": "receiver", "mode": "other", "armed": True}
            )
        if fault_s is not None:
            log.write("/fault", round(fault_s * S), {"fault": "stop_sender"})
            log.write("/fault", 0, {"fault": "no_failsafe"})
    with McapLog(folder / "sender.guard.mcap") as log:
        log.write("/guard", 6 * S, {"stage": "holding", "act": "hold", "reason": "silent"})


MODES = [
    (1.0, "hold", False),
    (2.0, "takeoff", True),
    (4.0, "offboard", True),
    (6.4, "hold", True),
    (8.4, "land", True),
]


def test_times_are_counted_from_the_signal(tmp_path: Path) -> None:
    leave_logs(tmp_path, [*MODES, (12.0, "hold", False)], 6.0)
    reaction = read_reaction(tmp_path, "stop", Role.SENDER, "follow+3", "crashed", {})
    assert (reaction.mode, reaction.after, reaction.reason) == (
        "offboard",
        ("hold", "land"),
        "silent",
    )
    assert (round(reaction.held_s or 0.0, 3), round(reaction.landed_s or 0.0, 3)) == (0.4, 6.0)
    assert reaction.reached
    shown = table([reaction])
    assert shown.row_count == 1
    assert [column.header for column in shown.columns] == ["program", "phase", "mode", "stop"]
    assert [next(iter(column.cells)) for column in shown.columns] == [
        "sender",
        "follow+3",
        "offboard",
        "0.40 / 6.00",
    ]


@pytest.mark.parametrize(
    ("disarmed_s", "after"), [(12.0, ("hold", "land")), (14.0, ("hold", "land", "other"))]
)
def test_what_a_px4_restores_as_it_disarms_is_no_change_of_the_mode(
    tmp_path: Path, disarmed_s: float, after: tuple[str, ...]
) -> None:
    leave_logs(tmp_path, [*MODES, (11.5, "other", True), (disarmed_s, "other", False)], 6.0)
    assert read_reaction(tmp_path, "stop", Role.SENDER, "follow+3", "crashed", {}).after == after


def test_what_never_came_is_said(tmp_path: Path) -> None:
    leave_logs(tmp_path, MODES[:3], 6.0)
    reaction = read_reaction(tmp_path, "stop", Role.SENDER, "follow+3", "crashed", {})
    assert (reaction.held_s, reaction.landed_s) == (None, None)
    assert "never / never" in list(table([reaction]).columns[3].cells)


def test_a_phase_that_was_not_reached_is_no_reaction(tmp_path: Path) -> None:
    leave_logs(tmp_path, MODES, None)
    assert (
        read_reaction(tmp_path, "stop", Role.SENDER, "verify+1", "crashed", {}).mode
        == "not reached"
    )


def leave_takeover(folder: Path, last_s: float | None) -> None:
    with McapLog(folder / "world.mcap") as log:
        log.write("/autopilot", 8 * S, {"role": "sender", "mode": "hold", "armed": False})
        for at_s, mode in ((4.0, "offboard"), (6.02, "other")):
            log.write(
                "/autopilot", round(at_s * S), {"role": "receiver", "mode": mode, "armed": True}
            )
        log.write("/fault", 6 * S, {"fault": "pilot_takeover"})
        for role, stamp_s in (("sender", 9.0), ("receiver", last_s)):
            last_ns = None if stamp_s is None else round(stamp_s * S)
            log.write("/setpoint_gap", 9 * S, {"role": role, "gap_s": 0.05, "last_ns": last_ns})
    with McapLog(folder / "receiver.guard.mcap"):
        pass


@pytest.mark.parametrize(
    ("last_s", "outcome", "violations", "shown", "met"),
    [
        (6.03, "pilot_override", {}, "+0.030 s", True),
        (5.99, "pilot_override", {}, "-0.010 s", True),
        (None, "pilot_override", {}, "never sent", True),
        (6.03, "committed", {}, "+0.030 s", False),  # nobody was told
        (6.6, "pilot_override", {}, "+0.600 s", False),
        (6.03, "pilot_override", {"S10": 1}, "+0.030 s", False),
    ],
)
def test_a_script_lets_go_of_a_vehicle_whose_mode_was_changed(
    tmp_path: Path,
    last_s: float | None,
    outcome: str,
    violations: dict[str, int],
    shown: str,
    met: bool,
) -> None:
    leave_takeover(tmp_path, last_s)
    reaction = read_reaction(
        tmp_path, "pilot_takeover", Role.RECEIVER, "approach+1", outcome, violations
    )
    assert (reaction.mode, reaction.after) == ("offboard", ("other",))
    assert list(table([reaction]).columns[3].cells) == [shown]
    assert is_met(reaction) is met


def test_a_script_that_changes_the_mode_again_has_not_let_go(tmp_path: Path) -> None:
    leave_takeover(tmp_path, 6.0)
    reaction = read_reaction(
        tmp_path, "pilot_takeover", Role.RECEIVER, "approach+1", "pilot_override", {}
    )
    assert is_met(reaction)
    assert not is_met(replace(reaction, after=("other", "land")))


def test_a_px4s_own_failsafe_waits_for_the_guard(tmp_path: Path) -> None:
    plain = rig_library.load("sitl-px4")
    patient = with_patient_failsafe(plain, tmp_path)
    for role in Role:
        was, now = (rig.role(role).vehicle.options["parameters"] for rig in (plain, patient))
        assert now == {**was, "COM_OF_LOSS_T": 5.0}
    assert patient.file.parent == tmp_path
    assert (patient.method, patient.mission, patient.world) == (
        plain.method,
        plain.mission,
        plain.world,
    )
    embedded = rig_library.load("sitl-light")
    assert with_patient_failsafe(embedded, tmp_path) is embedded


def test_every_program_fails_in_every_way_in_every_phase() -> None:
    every = list(cases("both", ()))
    failures = len(KINDS) - 1
    assert {fault for fault, _, _ in cases("both", (), kinds_of(rig_library.load("sim")))} == {
        TAKEOVER,
        *RADIO,
    }
    # its simulator has no transmitter here
    assert not set(RADIO) & set(kinds_of(rig_library.load("sitl-px4")))
    assert len(every) == failures * sum(map(len, MOMENTS.values())) + len(MOMENTS[Role.RECEIVER])
    assert {role for _, role, _ in cases("sender", ())} == {Role.SENDER}
    assert list(cases("both", ("stop_sender@take-off",))) == [("stop", Role.SENDER, "take-off+2")]


@pytest.mark.parametrize(
    ("fault", "let_go_s", "after", "other_down", "met"),
    [
        ("rc_mode", 0.1, ("other",), True, True),
        ("rc_mode", 0.1, ("other",), False, False),
        ("rc_mode", 0.6, ("other",), True, False),
        ("rc_kill", 1.1, (), True, True),
        ("rc_kill", 1.1, ("offboard",), True, False),
        ("rc_lost", 0.6, ("hold", "land"), True, True),
        ("rc_lost", 0.6, ("land",), True, True),
        ("rc_lost", 0.6, ("hold", "offboard"), True, False),
    ],
)
def test_what_a_pilots_radio_does_is_undone_by_nobody(
    fault: str, let_go_s: float, after: tuple[str, ...], other_down: bool, met: bool
) -> None:
    seen = (None, None, let_go_s, after, "", "pilot_override", dict[str, int]())
    reaction = Reaction(
        fault, "sender", "verify+1", "offboard", *seen, apart_m=1.3, other_down=other_down
    )
    assert is_met(reaction) is met
    assert not is_met(replace(reaction, outcome="no_agreement"))

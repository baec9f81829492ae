"""The guard's reaction, read from logs as a flight would leave them."""

from __future__ import annotations

from pathlib import Path

from drivers.log import McapLog
from missions.guard_measure import KINDS, MOMENTS, cases, read_reaction, table
from path.messages import Role

S = 1_000_000_000


def leave_logs(folder: Path, modes: list[tuple[float, str, bool]], fault_s: float | None) -> None:
    with McapLog(folder / "world.mcap") as log:
        for at_s, mode, armed in modes:
            log.write("/autopilot", round(at_s * S), {"role": "sender", "mode": mode, "armed": armed})
            log.write("/autopilot", round(at_s * S), {"role": "receiver", "mode": "other", "armed": True})
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
    assert (reaction.mode, reaction.after, reaction.reason) == ("offboard", ("hold", "land"), "silent")
    assert (round(reaction.held_s or 0.0, 3), round(reaction.landed_s or 0.0, 3)) == (0.4, 6.0)
    assert reaction.reached
    shown = table([reaction])
    assert shown.row_count == 1
    assert [next(iter(column.cells)) for column in shown.columns] == [
        "sender",
        "follow+3",
        "offboard",
        "-",
        "0.40 / 6.00",
        "-",
    ]


def test_what_never_came_is_said(tmp_path: Path) -> None:
    leave_logs(tmp_path, MODES[:3], 6.0)
    reaction = read_reaction(tmp_path, "stop", Role.SENDER, "follow+3", "crashed", {})
    assert (reaction.held_s, reaction.landed_s) == (None, None)
    assert "never / never" in list(table([reaction]).columns[4].cells)


def test_a_phase_that_was_not_reached_is_no_reaction(tmp_path: Path) -> None:
    leave_logs(tmp_path, MODES, None)
    assert read_reaction(tmp_path, "stop", Role.SENDER, "verify+1", "crashed", {}).mode == "not reached"


def test_every_program_fails_in_every_way_in_every_phase() -> None:
    every = list(cases("both", ()))
    assert len(every) == len(KINDS) * sum(len(moments) for moments in MOMENTS.values())
    assert {role for _, role, _ in cases("sender", ())} == {Role.SENDER}
    assert list(cases("both", ("kill_sender@take-off",))) == [("kill", Role.SENDER, "take-off+2")]

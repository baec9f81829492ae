"""The ends of a mission. Every failure has a name, an exit code and a sentence for the crew."""

from __future__ import annotations

from collections.abc import Collection
from enum import Enum

from path.messages import AbortReason


class Outcome(Enum):
    """Named end of a mission: (name, exit code, what it means)."""

    COMMITTED = ("committed", 0, "the receiver holds the target, confirmed by both sides")
    FLOWN = ("flown", 0, "a mission of your own came to its own end, and its drones are down")
    NO_AGREEMENT = (
        "no_agreement",
        10,
        "the views did not agree for long enough before the deadline",
    )
    TARGET_NOT_FOUND = (
        "target_not_found",
        11,
        "the sender saw no object that is surely the one that is meant",
    )
    TARGET_LOST = ("target_lost", 12, "the target left the view and did not come back in time")
    MARKER_NOT_FOUND = (
        "marker_not_found",
        13,
        "the receiver never saw the sender's marker from its stand-off",
    )
    MARKER_LOST = (
        "marker_lost",
        14,
        "the marker left the receiver's view and did not come back in time",
    )
    NO_VIEWPOINT = (
        "no_viewpoint",
        15,
        "no place keeps marker and target in view at a safe separation",
    )
    PEER_LOST = ("peer_lost", 16, "nothing was heard from the other drone for too long")
    CAMERA_LOST = ("camera_lost", 17, "the camera gave no new frame in time")
    VEHICLE_LOST = ("vehicle_lost", 18, "the flight controller's telemetry stopped")
    VEHICLE_REFUSED = ("vehicle_refused", 19, "the vehicle did not do what it was told")
    PILOT_OVERRIDE = (
        "pilot_override",
        20,
        "the pilot changed the mode, or stopped the motors: the script let go",
    )
    GUARD = ("guard", 21, "fence or battery limit reached, or the guard took the vehicle")
    ORPHANED = (
        "orphaned",
        22,
        "the link died inside the hand-over: both observe, nobody is responsible",
    )
    PEER_ABORTED = ("peer_aborted", 23, "the other drone ended the handoff")
    CLOCK_FAULT = (
        "clock_fault",
        24,
        "the drones' clocks could not be aligned, or one was set in flight",
    )
    APPROACH_FAILED = ("approach_failed", 25, "the planned viewpoint was not reached in time")
    STATE_LOST = ("state_lost", 26, "what must survive a restart could not be written: disk full?")
    UNFIT = ("unfit", 27, "a part of the rig cannot do what the mission needs")
    GUARD_LOST = (
        "guard_lost",
        28,
        "the guard's process does not answer, or does not see the vehicle",
    )
    TOO_CLOSE = ("too_close", 29, "the drones came nearer to each other than their separation")
    INTERRUPTED = ("interrupted", 30, "stopped by Ctrl-C, SIGTERM, or a terminal that went away")
    CRASHED = ("crashed", 31, "the role's program died")
    RESTARTED = (
        "restarted",
        32,
        "the role's program was started again in the air: it settled the handoff and landed",
    )
    NO_RELIEF = (
        "no_relief",
        33,
        "no relief was ready in time: the responsible drone gave the target up and landed",
    )
    LOST_AFTER = (
        "lost_after_taking_over",
        34,
        "the receiver took the target over, and lost it within ten seconds",
    )
    LOG_FAILED = ("log_failed", 35, "all went well, but a log could not be written: disk full?")
    MISSION_FAILED = (
        "mission_failed",
        36,
        "a mission of your own gave up, or one of its waits was over",
    )
    RIGS_DIFFER = (
        "rigs_differ",
        37,
        "the two drones' rigs or versions of PATH differ in what both must have alike",
    )
    NOT_STARTED = (
        "not_started",
        38,
        "a world was served, and nobody started a role's program in time",
    )
    MARKER_SIZE = (
        "marker_size",
        39,
        "depth that is measured on the sender's marker contradicts its size in the rig",
    )
    MONITOR_VIOLATED = ("monitor_violated", 40, "a safety monitor of the harness was violated")
    HARNESS_FAILED = ("harness_failed", 41, "the simulation itself failed: not the mission's fault")
    OVERLOADED = (
        "overloaded",
        43,
        "the computer was too slow for a run in real time: it says nothing of the mission",
    )
    WRONG_OBJECT = (
        "wrong_object",
        42,
        "another object was handed over than the one that was designated",
    )

    def __init__(
        self,
        label: str,
        exit_code: int,
        meaning: str,
    ) -> None:
        self.label = label
        self.exit_code = exit_code
        self.meaning = meaning

    @classmethod
    def from_label(cls, label: str) -> Outcome:
        """The outcome a log or a process names; KeyError when there is none such."""
        return _BY_LABEL[label]


_BY_LABEL = {outcome.label: outcome for outcome in Outcome}


def name_of(exit_code: int) -> str:
    """Return the name of the end with this exit code, for the crew; another version may have ends
    unknown here.
    """
    return next(
        (each.label for each in Outcome if each.exit_code == exit_code),
        f"an end with exit code {exit_code}",
    )


_ABORT_REASONS = {
    Outcome.NO_AGREEMENT: AbortReason.TIMEOUT,
    Outcome.TARGET_NOT_FOUND: AbortReason.TARGET_LOST,
    Outcome.TARGET_LOST: AbortReason.TARGET_LOST,
    Outcome.LOST_AFTER: AbortReason.TARGET_LOST,
    Outcome.MARKER_NOT_FOUND: AbortReason.MARKER_LOST,
    Outcome.MARKER_LOST: AbortReason.MARKER_LOST,
    Outcome.MARKER_SIZE: AbortReason.MARKER_LOST,
    Outcome.CAMERA_LOST: AbortReason.CAMERA,
    Outcome.VEHICLE_LOST: AbortReason.VEHICLE,
    Outcome.VEHICLE_REFUSED: AbortReason.VEHICLE,
    Outcome.PILOT_OVERRIDE: AbortReason.PILOT,
    Outcome.GUARD: AbortReason.GUARD,
    Outcome.TOO_CLOSE: AbortReason.GUARD,
    Outcome.GUARD_LOST: AbortReason.GUARD,
}


def abort_reason(outcome: Outcome) -> AbortReason:
    """Return the reason that the other drone is told when a mission ends this way."""
    return _ABORT_REASONS.get(outcome, AbortReason.SHUTDOWN)


KEPT_S = 10.0
"""For so long a target that was handed over is to be kept; one that is lost sooner was not handed
over well.
"""

OBJECT_MONITOR = "S12"
"""Counts hand-overs of another object than the one that was designated."""


def violated_outcome(monitors: Collection[str]) -> Outcome:
    """Return the end of a run in which these monitors were violated; there is at least one."""
    return Outcome.WRONG_OBJECT if OBJECT_MONITOR in monitors else Outcome.MONITOR_VIOLATED


def exit_code_of_runs(monitors: Collection[str]) -> int:
    """Return the exit code of many runs in which these monitors were violated: 0 for none."""
    return violated_outcome(monitors).exit_code if monitors else Outcome.COMMITTED.exit_code


class MissionEnd(Exception):
    """The mission cannot go on; ``outcome`` says how it ends and ``detail`` what was seen."""

    def __init__(self, outcome: Outcome, detail: str) -> None:
        super().__init__(f"{outcome.label}: {detail}")
        self.outcome = outcome
        self.detail = detail

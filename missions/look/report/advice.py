"""Advice on what to do next, by how a run ended. One sentence each, for whoever stands in the
field.
"""

from __future__ import annotations

from flight.outcome import Outcome

_ADVICE: dict[Outcome, str] = {
    Outcome.COMMITTED: "Nothing: look at the figures below their limits, and keep the folder.",
    Outcome.FLOWN: "Nothing: look at the figures below, and keep the folder.",
    Outcome.MISSION_FAILED: "Read what your own mission says went wrong, and mend that.",
    Outcome.NO_AGREEMENT: "See which misses there are below; replay the run with another gate or threshold "
    "(path-handoff replay).",
    Outcome.TARGET_NOT_FOUND: "Check the designated place, and try the detector on this run's images "
    "(path-handoff detect).",
    Outcome.LOST_AFTER: "Look at the receiver's last images below: was the target hidden, or at the edge?",
    Outcome.TARGET_LOST: "Look at the target's last images below: too fast, hidden, or out of view?",
    Outcome.MARKER_NOT_FOUND: "Check that the marker faces the receiver, its size in the rig, and the positions.",
    Outcome.MARKER_LOST: "Look at the marker's side in px and at the light; a larger marker is seen from farther.",
    Outcome.NO_VIEWPOINT: "Change the mount, the marker's place or the limits that the note names.",
    Outcome.PEER_LOST: "Look at the link below: what was dropped, and how far apart the drones were.",
    Outcome.CAMERA_LOST: "Check the camera's cable and port: path-handoff doctor measures its frames.",
    Outcome.VEHICLE_LOST: "Check the line to the flight controller: path-handoff doctor measures its telemetry.",
    Outcome.VEHICLE_REFUSED: "Read what the autopilot said in the notes, and mend that first.",
    Outcome.PILOT_OVERRIDE: "Ask the pilot why, before the next flight.",
    Outcome.GUARD: "Charge, or widen the fence, if it is right to.",
    Outcome.ORPHANED: "Both drones observed and nobody was responsible: fly closer together, or mend the link.",
    Outcome.PEER_ABORTED: "The other drone's log has the cause.",
    Outcome.CLOCK_FAULT: "Keep time services from stepping the clocks in flight, and look at the link's delay.",
    Outcome.APPROACH_FAILED: "Look at wind and reported positions: docs/rendezvous.md.",
    Outcome.STATE_LOST: "Free some disk.",
    Outcome.UNFIT: "Run path-handoff doctor.",
    Outcome.RIGS_DIFFER: "Copy one rig file to both companions, and install the same version of PATH on both.",
    Outcome.MARKER_SIZE: "Measure the marker's black square with a caliper, and say it as side_m in both rigs.",
    Outcome.GUARD_LOST: "Start the guard again, and see why it ended: its log and what it printed.",
    Outcome.TOO_CLOSE: "Do not fly again before the cause is known: wind, gains or positions.",
    Outcome.INTERRUPTED: "Nothing: it was told to stop.",
    Outcome.CRASHED: "Report it, with this folder: a program died.",
    Outcome.RESTARTED: "See what ended the program the first time: the log before, and *.stderr.txt.",
    Outcome.NO_RELIEF: "Call reliefs earlier, or have more drones ready.",
    Outcome.LOG_FAILED: "Free some disk: this run's logs are not whole.",
    Outcome.NOT_STARTED: "Serve the world again, and type what it prints in two other shells once it says so.",
    Outcome.MONITOR_VIOLATED: "Report it, with this folder: a rule of safety was broken.",
    Outcome.HARNESS_FAILED: "Run it again; it was the simulation.",
    Outcome.OVERLOADED: "Free the computer and fly again, or take a rig with smaller pictures or a lower rate.",
    Outcome.WRONG_OBJECT: "Report it, with this folder; designate with an example, and see docs/gates.md.",
}


def advice(label: str) -> str:
    """Return the advice for the outcome that a log or a summary names."""
    try:
        return _ADVICE[Outcome.from_label(label)]
    except KeyError:
        return "The run was cut off: fly again; its logs hold what there was."

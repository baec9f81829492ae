"""What a run folder holds, and what the records in its logs mean: the contract between those who log and who report.

    sender.mcap, receiver.mcap   one log per role, stamps of the role's own clock; sender.2.mcap and so on of a role
                                 whose program was started again
    world.mcap                   truth, at levels with a simulated world, stamps of the world's clock
    run.json                     what was asked for and what the harness saw (``RunFacts``)
    summary.json, run.png        made from the others by ``missions.report.command`` and ``missions.report.picture``

Topics of a role (fields in the order of interest; a field that does not apply is null):

    /frame           frame_id, age_ns (from its capture to the begin of its cycle); the stamp is the capture instant.
                     Every distinct camera frame.
    /cpu             spent_ns {stage: processor time of the main thread since the start, and of the whole of it as
                     "thread", of all threads as "program"}; once a second, in real time only
    /phase           phase, note.  /note  note.
    /state           position_n_m, velocity_n_mps, q_n_b, mode, armed, battery; ten times a second
    /setpoint        velocity_n_mps, yaw_rad
    /responsibility  responsible, until_ns (own clock; null: for good). It is over at until_ns, whether or not a
                     record says so
    /link            packets_sent, packets_received, bytes_sent, bytes_received, dropped, clock_offset_ns
    /image           foxglove.CompressedImage; the stamp is the capture instant
    /outcome         outcome, detail, responsible, landed

Topics of the sender:

    /target          sequence, capture_ns, box [x, y, w, h], point_v_m, gravity_v, sigma_m, reason
    /agreement       agreed, counted, reason, iou, tau (null when nothing was compared), count, needed,
                     evidence, evidence_needed (both null unless the gate is "evidence"), capture_ns (sender's clock),
                     sequence, target_sequence, target_id, epoch, own_box, mapped_box. One per candidate that was
                     judged.
    /commit          target_id, epoch, lease_end_ns

Topics of the receiver:

    /marker          capture_ns, position_v_m, rotation_v_c2 (wxyz), sigma_m, side_px, corners_px [[u, v] * 4], reason
    /motion          with each /marker, what the relative-pose filter was given: own_stamp_ns, own_n_mps, peer_stamp_ns
                     (receiver's clock), peer_n_mps, q_n_c, q_n_v (wxyz, as both vehicles report them; null when D1's
                     gravity is not known), covariance (the pose T_c_v's, lower triangle by rows; null without a pose)
    /candidate       sequence, target_sequence, capture_ns, box, reason, position_v_m, rotation_v_c2, sigma_m,
                     point_v_m (the target's point as carried to the capture instant), prior_px [u, v],
                     region [x0, y0, x1, y1]

Topics of the world (frame ``w`` is ENU; poses are position and quaternion wxyz):

    /scene           once, first: target_id, min_separation_m, boxes [[cx, cy, cz, sx, sy, sz], ...] of every object
                     in its own frame, clock_offset_ns {role: role clock minus world clock}, cameras {role: {width,
                     height, fx, fy, cx, cy, distortion}}, mounts {role: {"T_b_c": pose, "T_b_v": pose}} with pose =
                     {"t": [3], "q": [4]}
    /truth           at 20 Hz or more: sender, receiver {"t", "q", "in_air"} (body in w), objects [[id, x, y, z, yaw]]
    /setpoint_gap    role, gap_s, last_ns (stamp of the last setpoint; None without any)
    /violation       monitor, detail
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord, parts, read_log
from missions.run_folder import RunKind
from path.messages import Role

SENDER_LOG, RECEIVER_LOG, WORLD_LOG = "sender.mcap", "receiver.mcap", "world.mcap"
FACTS, SUMMARY, PICTURE = "run.json", "summary.json", "run.png"

RUN = RunKind(FACTS, (SUMMARY, PICTURE), ("sender", "receiver", "world", "attack"))

Records = Mapping[str, Sequence[LogRecord]]
"""Records of one log by topic, in the order written."""


class RunFolderError(PartError):
    """A folder that is not a run's."""


@dataclass(frozen=True, slots=True)
class RunFacts:
    """What the logs of the roles cannot tell: what was asked for, and what the harness saw.

    Attributes:
        outcome: label of the whole run's ``flight.outcome.Outcome``.
        detail: what was seen when it ended so; empty after a commit.
        simulated_s, wall_s: duration on the mission's clock and on the wall.
        violations: number of violations by monitor name.
        notes: lines for the crew, details of violations.
        errors: of the world, as ``flight.harness.flights.FlightReport`` has them.
    """

    rig: str
    level: str
    seed: int
    outcome: str
    exit_code: int
    detail: str = ""
    faults: tuple[str, ...] = ()
    simulated_s: float = 0.0
    wall_s: float = 0.0
    violations: dict[str, int] = field(default_factory=dict[str, int])
    notes: tuple[str, ...] = ()
    errors: dict[str, str | float] = field(default_factory=dict[str, str | float])


@dataclass(frozen=True, slots=True)
class Run:
    """A whole run as read back. ``facts`` is None when the run was cut off before its end."""

    facts: RunFacts | None
    sender: Records
    receiver: Records
    world: Records

    def role(self, role: Role) -> Records:
        return self.sender if role is Role.SENDER else self.receiver


def write_facts(folder: Path, facts: RunFacts) -> None:
    """Raises OSError."""
    (folder / FACTS).write_bytes(msgspec.json.format(msgspec.json.encode(facts), indent=2) + b"\n")


def load_run(folder: Path) -> Run:
    """Read a run folder; what is missing in it is empty. Raises RunFolderError when it holds no log at all."""
    names = (SENDER_LOG, RECEIVER_LOG, WORLD_LOG)
    logs = [parts(folder, Path(name).stem) for name in names]
    if not any(logs):
        raise RunFolderError(
            f"{folder} is not the folder of a run: it holds none of {', '.join(names)}",
            "name the folder that `path-handoff handoff` printed, such as runs/20261104-101500",
        )
    return Run(load_facts(folder), *(by_topic(*files) for files in logs))


def load_facts(folder: Path) -> RunFacts | None:
    """How a run ended; None when it was cut off before its end."""
    try:
        return msgspec.json.decode((folder / FACTS).read_bytes(), type=RunFacts)
    except (OSError, msgspec.DecodeError):  # the marker of an unfinished run is not all of it
        return None


def by_topic(*paths: Path) -> dict[str, list[LogRecord]]:
    """All records of a log's parts by topic; empty when there is no such file. Raises RunFolderError for what is no
    log."""
    topics: dict[str, list[LogRecord]] = {}
    try:
        for path in paths:
            for record in read_log(path):
                topics.setdefault(record.topic, []).append(record)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise RunFolderError(str(error), "the file is damaged; fly again") from error
    return topics


def first(records: Records, topic: str) -> dict[str, Any] | None:
    """The first record of a topic; None when there is none."""
    found = records.get(topic)
    return found[0].record if found else None


def judged_pairs(run: Run) -> list[LogRecord]:
    """One record for every candidate that the sender judged, up to the commit."""
    commit = last(run.sender, "/commit")
    return [r for r in run.sender.get("/agreement", ()) if commit is None or r.stamp_ns <= commit.stamp_ns]


def last(records: Records, topic: str) -> LogRecord | None:
    found = records.get(topic)
    return found[-1] if found else None

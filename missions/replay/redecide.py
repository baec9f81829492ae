"""Decides again what a drone decided, from its log, through the very cycles that flew. Pure.

A log holds what a cycle was given, in the order it was given it: on D1 what the camera saw of the target (``/target``)
and the answers of D2 (``/heard_candidate``); on D2 the messages of D1 (``/heard_target``), the marker's pose
(``/marker``, ``/motion``) and what the detector found (``found`` of ``/candidate``). What the cycles make of it is held
against the decisions in the same log.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from drivers.log.mcap_log import LogRecord, encode_other
from drivers.rig.tables import decode_table
from missions.leg.journal import agreement_record, beside_of, candidate_record, counted, target_record
from path.camera import CameraModel
from path.config import MethodConfig
from path.geometry import Pose
from path.messages import Candidate, Role, Target
from path.observations import Box, Depth, Detection, Missed, MissReason
from path.receiver import ReceiverCycle
from path.sender import SenderCycle

Record = Mapping[str, Any]
Answers = Mapping[tuple[int, int], Record]
Change = Callable[[MethodConfig], MethodConfig]

_NAN3 = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class DecisionPair:
    """One decision, as it was logged and as it comes out again; None: there is none."""

    topic: str
    stamp_ns: int
    logged: Record | None
    again: Record | None

    @property
    def same(self) -> bool:
        return self.logged == self.again


@dataclass(frozen=True, slots=True)
class Complete:
    """The gate is complete for the first time in an attempt: D1 commits as soon as it may."""

    stamp_ns: int
    epoch: int


def redecide(
    records: Iterable[LogRecord], change: Change = lambda method: method, answers: Answers | None = None
) -> Iterator[DecisionPair | Complete]:
    """Every decision of one drone's log, in its order.

    Args:
        change: of the method's settings, to see what would have been otherwise.
        answers: what the other drone answers instead of what was heard of it, by epoch and sequence.
    """
    again: _SenderReplay | _ReceiverReplay | None = None
    for each in records:
        if each.topic == "/setup":
            if again is not None:
                yield from again.rest()
            again = _again(each.record, change, answers or {})
        elif again is not None:
            yield from again.take(each)
    if again is not None:
        yield from again.rest()


def other_answers(decided: Iterable[DecisionPair | Complete]) -> dict[tuple[int, int], Record]:
    """Returns what D2 answers otherwise than it did, for ``redecide`` of D1's log."""
    changed: dict[tuple[int, int], Record] = {}
    for each in decided:
        if isinstance(each, DecisionPair) and each.topic == "/candidate" and not each.same and each.again is not None:
            fields = ("target_sequence", "box", "reason", "position_v_m", "rotation_v_c2", "sigma_m")
            changed[each.again["epoch"], each.again["sequence"]] = {name: each.again[name] for name in fields}
    return changed


def _again(setup: Record, change: Change, answers: Answers) -> _SenderReplay | _ReceiverReplay:
    method = change(decode_table(setup["method"], MethodConfig, "/setup: method"))
    return (
        _SenderReplay(setup, method, answers) if setup["role"] == Role.SENDER.value else _ReceiverReplay(setup, method)
    )


class _SenderReplay:
    """D1's cycle, for one session."""

    def __init__(self, setup: Record, method: MethodConfig, answers: Answers) -> None:
        self._setup, self._method, self._answers = setup, method, answers
        self._cycle: SenderCycle | None = None
        self._epoch = 0
        self._complete = False
        self._due: deque[tuple[int, dict[str, Any]]] = deque()  # verdicts that the log must hold next

    def take(self, each: LogRecord) -> Iterator[DecisionPair | Complete]:
        record, cycle = each.record, self._cycle
        if each.topic == "/attempt":
            yield from self.rest()
            self._begin(record)
        elif cycle is None:
            return
        elif each.topic == "/heard_candidate":
            otherwise = self._answers.get((record["epoch"], record["sequence"]), {})
            cycle.offer(_candidate({**record, **otherwise}), record["capture_ns"], each.stamp_ns)
        elif each.topic == "/target":
            yield from self._observe(cycle, record)
        elif each.topic == "/agreement":
            _, again = self._due.popleft() if self._due else (0, None)
            yield DecisionPair(each.topic, each.stamp_ns, record, again)

    def rest(self) -> Iterator[DecisionPair]:
        """Verdicts that the log does not hold: it ended before them."""
        while self._due:
            stamp_ns, again = self._due.popleft()
            yield DecisionPair("/agreement", stamp_ns, None, again)

    def _begin(self, attempt: Record) -> None:
        setup, self._epoch, self._complete = self._setup, attempt["epoch"], False
        self._cycle = SenderCycle(
            _camera(setup["camera"]),
            _camera(setup["peer_camera"]),
            _pose(setup["T_v_c1"]),
            self._method,
            handoff_id=attempt["handoff_id"],
            epoch=attempt["epoch"],
            target_id=attempt["target_id"],
        )

    def _observe(self, cycle: SenderCycle, record: Record) -> Iterator[DecisionPair | Complete]:
        yield from self.rest()
        box = _box(record["box"])
        depth = None if record["depth_m"] is None else Depth(record["depth_m"], record["depth_sigma_m"])
        frame_id, capture_ns, judged_ns = record["frame_id"], record["capture_ns"], record["judged_ns"]
        beside = beside_of(record["beside"])
        message = cycle.observe(frame_id, capture_ns, box, depth, record["gravity_v"] or _NAN3, beside)
        again = target_record(message, frame_id, capture_ns, box)
        if box is None:  # why, was said by what looked for it
            again["reason"] = record["reason"]
        given = {name: record[name] for name in ("judged_ns", "depth_m", "depth_sigma_m", "beside")}
        yield DecisionPair("/target", capture_ns, record, _as_logged({**again, **given}))
        for pair in cycle.evaluate_ready(judged_ns):
            count, evidence = counted(pair, cycle.gate)
            verdict = agreement_record(pair, count, self._method.needed_pairs, evidence, self._setup["target_id"])
            self._due.append((judged_ns, _as_logged(verdict)))
        if cycle.gate.complete and not self._complete:
            self._complete = True
            yield Complete(judged_ns, self._epoch)


class _ReceiverReplay:
    """D2's cycle, for one session."""

    def __init__(self, setup: Record, method: MethodConfig) -> None:
        self._setup, self._method = setup, method
        self._camera = _camera(setup["camera"])
        self._cycle: ReceiverCycle | None = None
        self._newest: dict[str, Record] = {}

    def take(self, each: LogRecord) -> Iterator[DecisionPair | Complete]:
        record, cycle = each.record, self._cycle
        if each.topic == "/attempt":
            self._begin(record)
        elif each.topic in ("/frame", "/marker", "/motion"):
            self._newest[each.topic] = record
        elif cycle is not None and each.topic == "/heard_target":
            cycle.on_target(_target(record), record["capture_ns"], each.stamp_ns)
        elif cycle is not None and each.topic == "/candidate":
            yield DecisionPair(each.topic, each.stamp_ns, record, self._answer(cycle, each.stamp_ns, record))

    def rest(self) -> Iterator[DecisionPair]:
        """Returns nothing: nothing is decided here before it is logged."""
        return iter(())

    def _begin(self, attempt: Record) -> None:
        setup = self._setup
        x, y, z = _pose(setup["T_v_c1"]).t.tolist()
        self._cycle = ReceiverCycle(
            self._camera,
            self._method,
            handoff_id=attempt["handoff_id"],
            epoch=attempt["epoch"],
            target_id=attempt["target_id"],
            sender=(_camera(setup["peer_camera"]), (x, y, z)),
        )

    def _answer(self, cycle: ReceiverCycle, stamp_ns: int, record: Record) -> dict[str, Any] | None:
        marker, motion = self._newest["/marker"], self._newest["/motion"]
        if marker["reason"] is None:
            prior = cycle.prior(
                _pose(motion["T_c_v"]), np.reshape(np.array(motion["covariance"], float), (6, 6)), stamp_ns
            )
        else:
            prior = Missed(MissReason(marker["reason"]))
        found = [Detection(Box(*each["box"]), each["score"]) for each in record["found"]]
        candidate = cycle.candidate(self._newest["/frame"]["frame_id"], stamp_ns, found, prior)
        if isinstance(candidate, Missed):
            return None
        return _as_logged(candidate_record(candidate, prior, self._camera, found))


def _as_logged(record: Record) -> dict[str, Any]:
    """Returns a record as it comes back from a log."""
    return msgspec.json.decode(msgspec.json.encode(record, enc_hook=encode_other))


def _camera(record: Record) -> CameraModel:
    values: dict[str, Any] = {**record, "distortion": tuple(record["distortion"])}
    return CameraModel(**values)


def _pose(rows: Any) -> Pose:
    matrix = np.reshape(np.array(rows, float), (3, 4))
    return Pose(np.ascontiguousarray(matrix[:, :3]), matrix[:, 3].copy())


def _box(box: Any) -> Box | None:
    return None if box is None else Box(*box)


def _numbers(values: Any) -> Any:
    """Returns numbers as they were before the log: what was not finite is null in it."""
    return tuple(math.nan if value is None else value for value in values)


def _candidate(record: Record) -> Candidate:
    return Candidate(
        record["handoff_id"],
        record["epoch"],
        record["target_id"],
        record["sequence"],
        record["target_sequence"],
        record["peer_capture_ns"],
        None if record["box"] is None else Box(*_numbers(record["box"])),
        None if record["reason"] is None else MissReason(record["reason"]),
        _numbers(record["position_v_m"]),
        _numbers(record["rotation_v_c2"]),
        math.nan if record["sigma_m"] is None else record["sigma_m"],
    )


def _target(record: Record) -> Target:
    return Target(
        record["handoff_id"],
        record["epoch"],
        record["target_id"],
        record["sequence"],
        record["peer_capture_ns"],
        _numbers(record["point_v_m"]),
        _numbers(record["gravity_v"]),
        math.nan if record["sigma_m"] is None else record["sigma_m"],
    )

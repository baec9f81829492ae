"""Decides again what a drone decided, from its log, through the very cycles that flew. Pure.

A log holds what a cycle was given, in the order it was given it: on D1 what the camera saw of the
target (``/target``) and the answers of D2 (``/heard_candidate``); on D2 the messages of D1
(``/heard_target``), the marker's pose (``/marker``, ``/motion``) and what the detector found
(``found`` of ``/candidate``). What the cycles make of it is held against the decisions in the same
log. With ``missions.look.replay.perceivers`` what was seen comes from recorded frames instead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from drivers.log.mcap_log import LogRecord
from drivers.rig.tables import decode_table
from flight.frame.receiver import ReceiverSide
from flight.frame.records import AttemptId, candidate_record, sighting_of, target_record
from flight.frame.sender import PairCameras, SenderSide
from flight.rendezvous.marker_view import MarkerFix
from flight.tracking.association import Sighting
from missions.look.replay.logged import (
    NAN3,
    as_logged,
    box_of,
    camera_of,
    candidate_of,
    pose_of,
    target_of,
)
from missions.look.replay.perceivers import ReceiverPerceiver, SenderPerceiver
from path.config import MethodConfig
from path.messages import Role
from path.observations import Box, Detection, Missed, MissReason
from path.values import frozen

Record = Mapping[str, Any]
Answers = Mapping[tuple[int, int], Record]
Change = Callable[[MethodConfig], MethodConfig]
Perceiver = SenderPerceiver | ReceiverPerceiver
Open = Callable[[Record, int, MethodConfig], Perceiver]
"""The perceiver of a session, from its ``/setup`` and that record's stamp."""


@frozen
class DecisionPair:
    """One decision, as it was logged and as it comes out again; None: there is none."""

    topic: str
    stamp_ns: int
    logged: Record | None
    again: Record | None

    @property
    def same(self) -> bool:
        """Return whether all that the log says of it comes out again."""
        if self.logged is None or self.again is None:
            return False
        return {
            name: value for name, value in self.again.items() if name in self.logged
        } == self.logged

    @property
    def unsaid(self) -> list[str]:
        """The things that the log does not say of it: an earlier version of PATH wrote it."""
        return [
            name for name in self.again or () if self.logged is not None and name not in self.logged
        ]


@frozen
class Complete:
    """The gate is complete for the first time in an attempt: D1 commits as soon as it may."""

    stamp_ns: int
    epoch: int


def redecide(
    records: Iterable[LogRecord],
    change: Change = lambda method: method,
    answers: Answers | None = None,
    open_perceiver: Open | None = None,
) -> Iterator[DecisionPair | Complete]:
    """Every decision of one drone's log, in its order.

    Args:
        change: of the method's settings, to see what would have been otherwise.
        answers: what the other drone answers instead of what was heard of it, by epoch and
            sequence.
        open_perceiver: for what is seen in recorded frames; None: what the log says.
    """
    again: _SenderReplay | _ReceiverReplay | None = None
    for each in records:
        if each.topic == "/setup":
            if again is not None:
                yield from again.rest()
            again = _again(each, change, answers or {}, open_perceiver)
        elif again is not None:
            yield from again.take(each)
    if again is not None:
        yield from again.rest()


def other_answers(decided: Iterable[DecisionPair | Complete]) -> dict[tuple[int, int], Record]:
    """Return what D2 answers otherwise than it did, for ``redecide`` of D1's log."""
    changed: dict[tuple[int, int], Record] = {}
    for each in decided:
        if (
            isinstance(each, DecisionPair)
            and each.topic == "/candidate"
            and not each.same
            and each.again is not None
        ):
            fields = (
                "target_sequence",
                "box",
                "reason",
                "position_v_m",
                "rotation_v_c2",
                "sigma_m",
            )
            changed[each.again["epoch"], each.again["sequence"]] = {
                name: each.again[name] for name in fields
            }
    return changed


def _again(
    setup: LogRecord,
    change: Change,
    answers: Answers,
    open_perceiver: Open | None,
) -> _SenderReplay | _ReceiverReplay:
    record = setup.record
    method = change(decode_table(record["method"], MethodConfig, "/setup: method"))
    perceiver = None if open_perceiver is None else open_perceiver(record, setup.stamp_ns, method)
    if record["role"] == Role.SENDER.value:
        return _SenderReplay(
            record,
            method,
            answers,
            perceiver if isinstance(perceiver, SenderPerceiver) else None,
        )
    return _ReceiverReplay(
        record,
        method,
        perceiver if isinstance(perceiver, ReceiverPerceiver) else None,
    )


class _SenderReplay:
    """D1's cycle, for one session."""

    def __init__(
        self,
        setup: Record,
        method: MethodConfig,
        answers: Answers,
        perceiver: SenderPerceiver | None,
    ) -> None:
        self._setup = setup
        self._method = method
        self._answers = answers
        self._perceiver = perceiver
        self._side: SenderSide | None = None
        self._epoch = 0
        self._complete = False
        # verdicts that the log must hold next
        self._due: deque[tuple[int, dict[str, Any]]] = deque()

    def take(self, each: LogRecord) -> Iterator[DecisionPair | Complete]:
        record = each.record
        side = self._side
        if each.topic == "/told" and self._perceiver is not None:
            self._perceiver.note_told(record)
        if each.topic == "/frame" and self._perceiver is not None:
            self._perceiver.look(each.stamp_ns, record)
        elif each.topic == "/attempt":
            yield from self.rest()
            self._begin(record)
        elif side is None:
            return
        elif each.topic in ("/estimator_step", "/peer_step"):
            side.begin_evidence_anew(each.stamp_ns)
        elif each.topic == "/heard_candidate":
            otherwise = self._answers.get((record["epoch"], record["sequence"]), {})
            side.hear(candidate_of({**record, **otherwise}), record["capture_ns"], each.stamp_ns)
        elif each.topic == "/target":
            yield from self._observe(side, record)
        elif each.topic == "/agreement":
            _, again = self._due.popleft() if self._due else (0, None)
            yield DecisionPair(each.topic, each.stamp_ns, record, again)

    def rest(self) -> Iterator[DecisionPair]:
        """Verdicts that the log does not hold: it ended before them."""
        while self._due:
            stamp_ns, again = self._due.popleft()
            yield DecisionPair("/agreement", stamp_ns, None, again)

    def _begin(self, attempt: Record) -> None:
        setup = self._setup
        self._epoch = attempt["epoch"]
        self._complete = False
        cameras = PairCameras(
            camera_of(setup["camera"]),
            camera_of(setup["peer_camera"]),
            pose_of(setup["T_v_c1"]),
        )
        self._side = SenderSide(cameras, self._method, _attempt_of(attempt))

    def _observe(self, side: SenderSide, record: Record) -> Iterator[DecisionPair | Complete]:
        yield from self.rest()
        seen, gravity_v = self._seen(record)
        capture_ns = record["capture_ns"]
        judged_ns = record["judged_ns"]
        frame = side.observe(record["frame_id"], capture_ns, seen, gravity_v)
        yield DecisionPair(
            "/target",
            capture_ns,
            record,
            as_logged(target_record(frame, judged_ns)),
        )
        for pair in side.judge(judged_ns):
            self._due.append((judged_ns, as_logged(side.record(pair))))
        if side.gate.complete and not self._complete:
            self._complete = True
            yield Complete(judged_ns, self._epoch)

    def _seen(self, record: Record) -> tuple[Sighting | MissReason, Any]:
        """The observations in the frame of a ``/target``, by the log or perceived again, and down
        in frame ``v``.
        """
        if self._perceiver is not None and self._perceiver.seen is not None:
            return self._perceiver.seen
        gravity_v = tuple(record["gravity_v"] or NAN3)
        box = box_of(record["box"])
        if box is None:
            return MissReason(record["reason"]), gravity_v
        return sighting_of(record, box), gravity_v


class _ReceiverReplay:
    """D2's cycle, for one session."""

    def __init__(
        self,
        setup: Record,
        method: MethodConfig,
        perceiver: ReceiverPerceiver | None,
    ) -> None:
        self._setup = setup
        self._method = method
        self._perceiver = perceiver
        self._side: ReceiverSide | None = None
        self._newest: dict[str, Record] = {}

    def take(self, each: LogRecord) -> Iterator[DecisionPair | Complete]:
        record = each.record
        side = self._side
        if each.topic == "/attempt":
            self._begin(record)
        elif each.topic in ("/frame", "/marker", "/motion"):
            self._newest[each.topic] = record
            if each.topic == "/motion" and self._perceiver is not None and side is not None:
                self._perceiver.look(each.stamp_ns, record, side.gravity_v(each.stamp_ns))
        elif side is not None and each.topic == "/heard_target":
            side.hear(target_of(record), record["capture_ns"], each.stamp_ns)
        elif side is not None and each.topic == "/candidate":
            yield DecisionPair(
                each.topic,
                each.stamp_ns,
                record,
                self._answer(side, each.stamp_ns, record),
            )

    def rest(self) -> Iterator[DecisionPair]:
        """Return nothing: nothing is decided here before it is logged."""
        return iter(())

    def _begin(self, attempt: Record) -> None:
        setup = self._setup
        cameras = PairCameras(
            camera_of(setup["peer_camera"]),
            camera_of(setup["camera"]),
            pose_of(setup["T_v_c1"]),
        )
        self._side = ReceiverSide(cameras, self._method, _attempt_of(attempt))

    def _answer(
        self,
        side: ReceiverSide,
        stamp_ns: int,
        record: Record,
    ) -> dict[str, Any] | None:
        perceiver = self._perceiver
        fix = self._fix() if perceiver is None or perceiver.fix is None else perceiver.fix
        prior = side.prior(fix, stamp_ns)
        found = None if perceiver is None else perceiver.find(prior)
        if found is None:
            found = [Detection(Box(*each["box"]), each["score"]) for each in record["found"]]
        answer = side.answer(self._newest["/frame"]["frame_id"], stamp_ns, found, prior)
        return None if answer is None else as_logged(candidate_record(answer))

    def _fix(self) -> MarkerFix | Missed:
        """The marker's pose in the newest frame as logged; its corners are not asked for again."""
        marker = self._newest["/marker"]
        motion = self._newest["/motion"]
        if marker["reason"] is not None:
            return Missed(MissReason(marker["reason"]))
        covariance = np.reshape(np.array(motion["covariance"], float), (6, 6))
        return MarkerFix(pose_of(motion["T_c_v"]), covariance, marker["side_px"], ())


def _attempt_of(record: Record) -> AttemptId:
    return AttemptId(record["handoff_id"], record["epoch"], record["target_id"])

"""The figures of a run, from its records alone (``summary.json``). Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from drivers.log.mcap_log import LogRecord
from missions.look.report.following import following_of
from missions.look.report.in_a_row import longest_row
from missions.look.report.kept import kept_of
from missions.look.report.link_shares import link_shares
from missions.look.report.records import Records, RunRecords, judged_pairs, last, phase_changes
from missions.look.report.tables import sum_of
from missions.look.report.truth import Truth, box_center, handed_over, truth_of
from path.geometry.rotation import R_from_quat
from path.geometry.transforms import Pose
from path.messages import Role
from path.values import frozen


def summarize(run: RunRecords) -> dict[str, Any]:
    """Everything ``summary.json`` holds. What the records do not tell is null.

    Errors are medians over the agreeing pairs before the commit: ``d2_error_m`` of the position of
    D2's camera in the marker's frame, ``target_error_m`` of the target's point as D2 has it in its
    own camera frame, against the true place of the very point on the target that D1 measured;
    ``target_both_error_m`` of what D2 makes of that and of its own view.
    """
    truth = truth_of(run.world)
    span = _verification(run)
    return {
        **_outcome(run),
        **_times(run, span),
        **_agreement(run, span),
        **_errors(run, span, truth),
        **_separation(run, truth),
        **_following(run, truth),
        **_kept(run, truth),
        **_link(run, span),
        "frames": {role.value: _frames(run.role(role), span) for role in Role},
        "slow": dict(run.facts.slow) if run.facts else {},
        "shed": {role.value: shed_s(run.role(role)) for role in Role},
        "setpoint_gap_s": {
            r.record["role"]: _rounded(r.record["gap_s"])
            for r in run.world.get("/setpoint_gap", ())
        },
        "estimator_steps": {
            role.value: len(run.role(role).get("/estimator_step", ())) for role in Role
        },
        "monitors": dict(run.facts.violations) if run.facts else {},
        "phases": {role.value: phases(run, role) for role in Role},
    }


@frozen
class Verification:
    """The time from the sender's entry into the verify phase to its commit, or to where its log
    ends.

    Sender's clock.
    """

    start_ns: int
    end_ns: int
    committed: bool

    @property
    def seconds(self) -> float:
        return (self.end_ns - self.start_ns) * 1e-9


def _verification(run: RunRecords) -> Verification | None:
    begins = [r.stamp_ns for r in run.sender.get("/phase", ()) if r.record["phase"] == "verify"]
    if not begins:
        return None
    commit = last(run.sender, "/commit")
    outcome = last(run.sender, "/outcome")
    ends = commit or outcome or last(run.sender, "/agreement")
    return Verification(begins[0], ends.stamp_ns if ends else begins[0], commit is not None)


def start_ns(run: RunRecords, role: Role) -> int:
    """Beginning of the run on a role's clock: its first phase."""
    records = run.role(role).get("/phase", ())
    return records[0].stamp_ns if records else 0


def phases(run: RunRecords, role: Role) -> list[dict[str, Any]]:
    """The phases of a role in order, times since its own start."""
    changes = phase_changes(run.role(role))
    begin_ns = start_ns(run, role)
    ends = [r.stamp_ns for r in changes[1:]] + [_end_ns(run.role(role))]
    return [
        {
            "phase": r.record["phase"],
            "start_s": _rounded((r.stamp_ns - begin_ns) * 1e-9),
            "duration_s": _rounded((end_ns - r.stamp_ns) * 1e-9),
        }
        for r, end_ns in zip(changes, ends, strict=False)
    ]


def _end_ns(records: Records) -> int:
    return max((topic[-1].stamp_ns for topic in records.values()), default=0)


def _outcome(run: RunRecords) -> dict[str, Any]:
    facts = run.facts
    roles: dict[str, Any] = {}
    for role in Role:
        end = last(run.role(role), "/outcome")
        roles[role.value] = dict(end.record) if end else None
    return {
        "outcome": facts.outcome if facts else "unfinished",
        "exit_code": facts.exit_code if facts else None,
        "detail": facts.detail if facts else "the run was cut off before its end",
        "rig": facts.rig if facts else None,
        "level": facts.level if facts else None,
        "seed": facts.seed if facts else None,
        "faults": list(facts.faults) if facts else [],
        "notes": [*(facts.notes if facts else ()), *_marker_causes(run)],
        "errors": dict(facts.errors) if facts else {},
        "scene": facts.scene if facts else "",
        "roles": roles,
    }


def _marker_causes(run: RunRecords) -> list[str]:
    """What was likely wrong with the marker where the receiver got no pose of it, each kind
    once.
    """
    missed = [r.record for r in run.receiver.get("/marker", ()) if r.record.get("cause")]
    causes = {record["reason"]: record["cause"] for record in missed}
    return [f"the sender's marker: {cause}" for cause in causes.values()]


def _times(run: RunRecords, span: Verification | None) -> dict[str, Any]:
    committed = span is not None and span.committed
    facts = run.facts
    return {
        "t_commit_s": _rounded((span.end_ns - start_ns(run, Role.SENDER)) * 1e-9)
        if span and committed
        else None,
        "agreement_s": _rounded(span.seconds) if span and committed else None,
        "simulated_s": _rounded(facts.simulated_s) if facts else None,
        "wall_s": _rounded(facts.wall_s) if facts else None,
        "realtime_factor": _rounded(facts.simulated_s / facts.wall_s)
        if facts and facts.wall_s > 0.0
        else None,
    }


def _agreement(run: RunRecords, span: Verification | None) -> dict[str, Any]:
    pairs = judged_pairs(run)
    agreed = [r.record for r in pairs if r.record["agreed"]]
    evidence = [reached for r in pairs if (reached := r.record.get("evidence")) is not None]
    misses = Counter(r.record["reason"] for r in pairs if not r.record["agreed"]) + _own_misses(
        run, span
    )
    row = longest_row(run)
    return {
        "iou_median": _median(record["iou"] for record in agreed),
        "tau_median": _median(record["tau"] for record in agreed),
        "gate": ("evidence" if evidence else "count") if pairs else None,
        "count_max": max((r.record["count"] for r in pairs), default=0),
        "evidence_max": _rounded(max(evidence)) if evidence else None,
        "in_a_row": None if row is None else {**row, "seconds": _rounded(row["seconds"])},
        "pairs_judged": len(pairs),
        "pairs_agreed": len(agreed),
        "pairs_hz": _rounded(len(pairs) / span.seconds) if span and span.seconds > 0.0 else None,
        "misses": dict(sorted(misses.items())),
    }


def _own_misses(run: RunRecords, span: Verification | None) -> Counter[str]:
    """The sender's own frames that could not be half of a pair, while it verified: no target, no
    depth.
    """
    if span is None:
        return Counter()
    frames = run.sender.get("/target", ())
    return Counter(
        r.record["reason"]
        for r in frames
        if r.record["reason"] and span.start_ns <= r.stamp_ns <= span.end_ns
    )


def _separation(run: RunRecords, truth: Truth | None) -> dict[str, Any]:
    if truth is not None:
        return {
            "min_separation_m": _minimum(truth.separation_m),
            "separation_limit_m": truth.scene.min_separation_m,
        }
    measured = [
        r.record["position_v_m"]
        for r in run.receiver.get("/marker", ())
        if r.record["position_v_m"]
    ]
    return {
        "min_separation_m": _minimum(np.linalg.norm(p) for p in measured),
        "separation_limit_m": None,
    }


def _following(run: RunRecords, truth: Truth | None) -> dict[str, Any]:
    """Of D1 behind its target, in truth."""
    followed = following_of(run, truth)
    errors_m = [] if followed is None else followed.errors_m.tolist()
    return {
        "follow_overshoot_m": None if followed is None else _rounded(followed.overshoot_m),
        "follow_error_m": _median(errors_m),
        "follow_error_p95_m": _p95(errors_m),
        "target_unseen_s": None if followed is None else _rounded(followed.unseen_s),
    }


def _kept(run: RunRecords, truth: Truth | None) -> dict[str, Any]:
    """Of the target after D2 took it over."""
    kept = kept_of(run, truth)
    return {
        "kept_s": None if kept is None else _rounded(kept.seconds, 2),
        "lost_after_taking_over": None if kept is None else kept.lost,
    }


def _errors(run: RunRecords, span: Verification | None, truth: Truth | None) -> dict[str, Any]:
    d2: list[float] = []
    target: list[float] = []
    both: list[float] = []
    if truth is not None:
        sent = {
            r.record["sequence"]: r.record
            for r in run.sender.get("/target", ())
            if r.record["reason"] is None
        }
        answers = {r.record["sequence"]: r.record for r in run.receiver.get("/candidate", ())}
        reckoned = {r.record["sequence"]: r.record for r in run.receiver.get("/both_views", ())}
        for pair in (r.record for r in judged_pairs(run) if r.record["agreed"]):
            answer = answers.get(pair["sequence"])
            point = sent.get(pair["target_sequence"])
            if answer is None or answer["box"] is None:
                continue
            d2.append(d2_error_m(truth, answer))
            if point is not None and (error := target_error_m(truth, answer, point)) is not None:
                target.append(error)
            found = reckoned.get(pair["sequence"])
            if found is None or point is None:
                continue
            if (
                error := target_error_m(truth, {**answer, "point_v_m": found["point_v_m"]}, point)
            ) is not None:
                both.append(error)
    handed = None if truth is None else handed_over(run, truth)
    return {
        "d2_error_m": _median(d2),
        "d2_error_p95_m": _p95(d2),
        "target_error_m": _median(target),
        "target_error_p95_m": _p95(target),
        "target_both_error_m": _median(both),
        "target_both_error_p95_m": _p95(both),
        "object_handed_over": handed,
        "wrong_handover": None if truth is None else handed not in (None, truth.scene.target_id),
    }


def d2_error_m(truth: Truth, answer: Mapping[str, Any]) -> float:
    """Return the error of a candidate's position of D2's camera, m, in the marker's frame."""
    return float(
        np.linalg.norm(np.array(answer["position_v_m"]) - truth.T_v_c2(answer["capture_ns"]).t)
    )


def target_error_m(
    truth: Truth, answer: Mapping[str, Any], sent: Mapping[str, Any]
) -> float | None:
    """Return the error of the target's point in D2's camera frame, m.

    None when D1's box was not centred on the target.

    The true point is where D1's line of sight met the body of the target, carried along with that
    body to the instant of D2's frame.
    """
    if answer["point_v_m"] is None:
        return None
    object_id = truth.scene.target_id
    hit_o = truth.hit_o(Role.SENDER, sent["capture_ns"], box_center(sent["box"]), object_id)
    if hit_o is None:
        return None
    stamp_ns = answer["capture_ns"]
    point_w = truth.T_w_o(object_id, Role.RECEIVER, stamp_ns).apply(hit_o)
    true_c2 = truth.T_w_c(Role.RECEIVER, stamp_ns).inverse().apply(point_w)
    w, x, y, z = answer["rotation_v_c2"]
    T_v_c2 = Pose(R_from_quat((w, x, y, z)), np.array(answer["position_v_m"], float))
    estimated_c2 = T_v_c2.inverse().apply(np.array(answer["point_v_m"], float))
    return float(np.linalg.norm(estimated_c2 - true_c2))


def _link(run: RunRecords, span: Verification | None) -> dict[str, Any]:
    """Rates while the views are compared (else over the whole log), both ways and each way, at the
    socket.
    """
    rates: dict[str, float | None] = {}
    for role in Role:
        records = run.role(role).get("/link", ())
        # the two clocks differ, the receiver's verify phase begins and ends with the sender's
        window = [r for r in records if _verifying(run.role(role), r.stamp_ns)] if span else []
        rates[role.value] = _rate(window if len(window) > 1 else records)
    known = [rate for rate in rates.values() if rate is not None]
    return {
        "link_bytes_per_s": _rounded(sum(known), 1) if known else None,
        "link_sent_bytes_per_s": rates,
        "link_dropped": {role.value: _dropped(run.role(role).get("/link", ())) for role in Role},
        **link_shares({role: run.role(role).get("/link", ()) for role in Role}),
    }


def _dropped(records: Sequence[LogRecord]) -> dict[str, int]:
    """Return packets dropped by reason, of all programs of a role: each counts from nothing."""
    ends = [*records[-1:], *(r for r, after in pairwise(records) if _anew(r, after))]
    return dict(sum_of(r.record["dropped"] for r in ends))


def _anew(before: LogRecord, after: LogRecord) -> bool:
    return after.record["packets_sent"] < before.record["packets_sent"]


def _verifying(records: Records, stamp_ns: int) -> bool:
    before = [r.record["phase"] for r in records.get("/phase", ()) if r.stamp_ns <= stamp_ns]
    return bool(before) and before[-1] == "verify"


def _rate(records: Sequence[LogRecord]) -> float | None:
    if len(records) < 2 or records[-1].stamp_ns <= records[0].stamp_ns:
        return None
    steps = pairwise(records)
    sent = sum(
        b.record["bytes_sent"] - (0 if _anew(a, b) else a.record["bytes_sent"]) for a, b in steps
    )
    return _rounded(sent / ((records[-1].stamp_ns - records[0].stamp_ns) * 1e-9), 1)


def _frames(records: Records, span: Verification | None) -> dict[str, Any]:
    """Rate of distinct frames while the views are compared, and how many the camera took that
    nobody looked at.
    """
    frames = [
        r for r in records.get("/frame", ()) if span is None or _verifying(records, r.stamp_ns)
    ]
    if len(frames) < 2:
        return {"hz": None, "missed": None}
    ids = [r.record["frame_id"] for r in frames]
    seconds = (frames[-1].stamp_ns - frames[0].stamp_ns) * 1e-9
    return {"hz": _rounded((len(frames) - 1) / seconds), "missed": ids[-1] - ids[0] + 1 - len(ids)}


def shed_s(records: Records) -> dict[str, float]:
    """Return for how long each thing was given up because the computer did not keep up, s, in the
    order it went.
    """
    gone_ns: dict[str, int] = {}
    total_s: dict[str, float] = {}
    for r in records.get("/shed", ()):
        what = r.record["what"]
        total_s.setdefault(what, 0.0)
        if r.record["gone"]:
            gone_ns[what] = r.stamp_ns
        elif what in gone_ns:
            total_s[what] += (r.stamp_ns - gone_ns.pop(what)) * 1e-9
    end_ns = _end_ns(records)
    for what, since_ns in gone_ns.items():
        total_s[what] += (end_ns - since_ns) * 1e-9
    return {what: _rounded(seconds, 1) for what, seconds in total_s.items()}


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return _rounded(float(np.median(known))) if known else None


def _p95(values: Sequence[float]) -> float | None:
    return _rounded(float(np.percentile(values, 95))) if values else None


def _minimum(values: Iterable[Any]) -> float | None:
    known = [float(value) for value in values if np.isfinite(value)]
    return _rounded(min(known)) if known else None


def _rounded(value: float, digits: int = 4) -> float:
    return round(float(value), digits)

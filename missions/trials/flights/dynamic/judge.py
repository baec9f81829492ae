"""One flight of the trial judged: by its beacons, as in the field, and by the truth, as only a
harness can.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from drivers.beacons.log import BeaconTruth
from drivers.rig.parts import Rig
from missions.look.report.records import RunFacts, RunRecords, load_run
from missions.look.report.summary import target_error_m
from missions.look.report.truth import Truth, truth_of
from missions.trials.flights.beacon.offset_fit import fit_offset
from missions.trials.flights.beacon.session import BeaconSession
from missions.trials.flights.dynamic.coast import Coasts, coasts
from missions.trials.flights.dynamic.flight import (
    STEADY_S,
    BeaconTrace,
    Motions,
    between,
    heard_of,
    load_motions,
    reference_of,
)
from missions.trials.shared.trajectory import (
    Alignment,
    MotionPair,
    align,
    ape,
    blocks_of,
    coarse_offset,
    rpe_after,
    rpe_along,
)
from path.arrays import Array, Whole
from path.geometry.rotation import R_from_yaw
from path.messages import Role
from path.target.kernels import MAD_TO_SIGMA
from path.values import frozen

SUBJECTS = ("d2", "target")
LEAST_AT_REST = 3  # positions: of no more nothing is said
WANDER_S = 4.0  # within this a vehicle's own position drifts by less than the beacons' noise
RPE_S = 1.0
RPE_M = 1.0


@frozen
class Compared:
    """One trajectory against one reference.

    Attributes:
        t: (n,) by the receiver's clock, s; ``error_m`` (n,) of each.
        rpe_s, rpe_m: relative errors over a second and over a metre of way.
        expected_m: rms error from the reference's noise alone; 0 for the truth.
    """

    t: Array
    error_m: Array
    rpe_s: Array
    rpe_m: Array
    expected_m: float = 0.0

    @property
    def blocks(self) -> Whole:
        return blocks_of(self.t)


@frozen
class SessionErrors:
    """A session as its records alone give it: how they lie to each other, and how far apart they
    are.

    Attributes:
        clock: the beacons' clock and frame against what both vehicles believe of their own motion;
            its offset and that one's deviation are of ``fit_offset``.
        frame, free: their frame against PATH's trajectories: about the vertical, and by any
            rotation.
        noise_m: of a beacon position per axis, from the spread of D2's before it was armed.
        beacons: by subject.
    """

    heard: BeaconTrace
    motions: Motions
    clock: Alignment
    frame: Alignment
    free: Alignment
    noise_m: float
    noise_samples: int
    beacons: dict[str, Compared]


@frozen
class HarnessVerdict(SessionErrors):
    """The same, judged by the harness.

    Attributes:
        offset_error_s, yaw_error_rad: of ``clock`` and ``frame``.
        truth: by subject.
    """

    session: BeaconSession
    facts: RunFacts
    offset_error_s: float
    yaw_error_rad: float
    truth: dict[str, Compared]
    coasts: Coasts


def measure(
    run: RunRecords,
    heard: BeaconTrace,
    rig: Rig,
    seed: int,
) -> SessionErrors:
    """Everything that the records say. Raises ValueError when they are too short or have nothing in
    common.
    """
    motions = load_motions(run, rig)
    rng = np.random.default_rng([seed, 1])
    clock = clock_of(motions, heard, rng)
    pairs, noise_factors = pairs_of(motions, heard)
    frame = align(pairs, clock.offset_s, rng, fit_offset=False)
    free = align(pairs, clock.offset_s, rng, fit_offset=False, turn="any")
    noise_m, samples = noise_at_rest(motions, heard, clock.offset_s)
    beacons = {
        name: _against_beacons(pair, frame, k, noise_m, noise_factors[k])
        for k, (name, pair) in enumerate(zip(SUBJECTS, pairs, strict=True))
    }
    return SessionErrors(heard, motions, clock, frame, free, noise_m, samples, beacons)


def judge(session: BeaconSession, rig: Rig) -> HarnessVerdict:
    """Everything the trial says of one flight."""
    run = load_run(session.folder)
    facts = run.facts
    truth = truth_of(run.world)
    beacons = session.truth
    assert facts is not None, "the flight came to its end"
    assert truth is not None, "trials are flown where there is truth"
    assert beacons is not None, "the harness made the beacons up"
    heard = heard_of(session.fixes, reference_of(rig).mounted)
    measured = measure(run, heard, rig, facts.seed)
    return HarnessVerdict(
        *(getattr(measured, part.name) for part in fields(measured)),
        session=session,
        facts=facts,
        offset_error_s=offset_error_s(measured, beacons, truth),
        yaw_error_rad=_yaw_error(measured.frame, beacons),
        truth=against_truth(run, truth, measured.motions),
        coasts=coasts(run, rig, truth),
    )


def offset_error_s(
    measured: SessionErrors,
    beacons: BeaconTruth,
    truth: Truth,
) -> float:
    """Return the error of the offset between the receiver's clock and the listener's, as the
    harness set them.
    """
    return (
        measured.clock.offset_s
        - beacons.offset_s
        - truth.scene.clock_offset_ns[Role.RECEIVER] * 1e-9
    )


def clock_of(
    motions: Motions,
    heard: BeaconTrace,
    rng: np.random.Generator,
) -> Alignment:
    """The beacons' clock and frame from the whole flight of both drones, as both believe it to have
    been.

    Robust first, so that outliers are known; then by what errs together. Raises ValueError.
    """
    offset_s = coarse_offset(motions.own, heard.paths["receiver"])
    pairs = [
        MotionPair(motions.own, heard.paths["receiver"], WANDER_S),
        MotionPair(motions.own_1, heard.paths["sender"], WANDER_S),
    ]
    robust = align(pairs, offset_s, rng)
    found = fit_offset(pairs, robust, STEADY_S)
    return replace(
        align(pairs, found.offset_s, rng, fit_offset=False), offset_sigma_s=found.offset_sigma_s
    )


def pairs_of(motions: Motions, heard: BeaconTrace) -> tuple[list[MotionPair], list[Array]]:
    """PATH's trajectories from D1 with what the beacons say, and how much noisier that is than one
    position.
    """
    d2, d2_noise = between(heard.paths["receiver"], heard.paths["sender"])
    target, target_noise = between(heard.paths["target"], heard.paths["sender"])
    return [MotionPair(motions.d2, d2), MotionPair(motions.target, target)], [
        d2_noise,
        target_noise,
    ]


def noise_at_rest(
    motions: Motions,
    heard: BeaconTrace,
    offset_s: float,
) -> tuple[float, int]:
    """Standard deviation of a position per axis while D2 had not been armed yet, and from how many.

    Of D2 alone: the target may move from the first second, and D1 takes off first.
    From the median deviation: a few reflections in a row pass the check for jumps, and would say
    all positions are bad.
    """
    path = heard.paths["receiver"]
    rest = path.p[path.t + offset_s < motions.still_until_s - 0.5]
    if len(rest) <= LEAST_AT_REST:
        return math.nan, 0
    off = np.abs(rest - np.median(rest, axis=0))
    return MAD_TO_SIGMA * float(np.median(off)), off.size


def _against_beacons(
    pair: MotionPair,
    frame: Alignment,
    k: int,
    noise_m: float,
    factors: Array,
) -> Compared:
    used = frame.used[k]
    t = pair.samples.t[used] + frame.offset_s
    residuals = frame.residuals[k][used]
    places = pair.curve.at(t)
    return Compared(
        t,
        ape(residuals),
        rpe_after(t, residuals, RPE_S),
        rpe_along(places, residuals, RPE_M),
        noise_m * math.sqrt(3.0 * float(np.mean(factors[used]))),
    )


def against_truth(
    run: RunRecords,
    truth: Truth,
    motions: Motions,
) -> dict[str, Compared]:
    """D2's camera in ``v``; the very point of the target that D1 measured, in D2's camera frame."""
    seen = [r for r in run.receiver["/marker"] if r.record["position_v_m"] is not None]
    t = np.array([r.stamp_ns for r in seen]) * 1e-9
    errors = np.array(
        [np.array(r.record["position_v_m"]) - truth.T_v_c2(r.stamp_ns).t for r in seen]
    )
    d2 = Compared(
        t,
        ape(errors),
        rpe_after(t, errors, RPE_S),
        rpe_along(motions.d2.at(t), errors, RPE_M),
    )
    sent = {
        r.record["sequence"]: r.record for r in run.sender["/target"] if r.record["reason"] is None
    }
    times = list[float]()
    lengths = list[float]()
    for r in run.receiver.get("/candidate", ()):
        point = sent.get(r.record["target_sequence"])
        error_m = None if point is None else target_error_m(truth, r.record, point)
        if error_m is not None:
            times.append(r.record["capture_ns"] * 1e-9)
            lengths.append(error_m)
    none = np.zeros(0)
    return {"d2": d2, "target": Compared(np.array(times), np.array(lengths), none, none)}


def _yaw_error(frame: Alignment, beacons: BeaconTruth) -> float:
    """The truth turns ENU; ``u`` is north, west, up. What D1's heading errs is in it."""
    return math.remainder(frame.yaw_rad - beacons.yaw_rad - 0.5 * math.pi, 2.0 * math.pi)


def true_places(judged: HarnessVerdict) -> Callable[[str, Array], Array]:
    """Return a body's true places in the beacons' frame, (n, 3), by instants of the receiver's
    clock.
    """
    truth = truth_of(load_run(judged.session.folder).world)
    beacons = judged.session.truth
    assert truth is not None
    assert beacons is not None
    return lambda name, t: true_path(truth, name, beacons, t)


def true_path(
    truth: Truth,
    name: str,
    beacons: BeaconTruth,
    t: Array,
) -> Array:
    """A body's true way in the beacons' frame, (n, 3), at instants of the receiver's clock."""
    offset_s = truth.scene.clock_offset_ns[Role.RECEIVER] * 1e-9
    places = truth_positions(truth, name)
    return np.column_stack(
        [np.interp(t - offset_s, truth.stamps_ns * 1e-9, places[:, k]) for k in range(3)]
    ) @ R_from_yaw(beacons.yaw_rad).T + np.array(beacons.origin_m)


def truth_positions(truth: Truth, name: str) -> Array:
    """(n, 3) at ``truth.stamps_ns``, in the world."""
    role = Role.RECEIVER
    shift = truth.scene.clock_offset_ns[role]
    if name == "target":
        return np.array(
            [truth.T_w_o(truth.scene.target_id, role, int(s) + shift).t for s in truth.stamps_ns]
        )
    own = Role(name)
    T_c_b = truth.scene.T_b_c[own].inverse()
    return np.array(
        [
            (truth.T_w_c(own, int(s) + truth.scene.clock_offset_ns[own]) @ T_c_b).t
            for s in truth.stamps_ns
        ]
    )

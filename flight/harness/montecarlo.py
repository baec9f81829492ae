"""The seam between a trial and hand-overs without flights: what an attempt is asked for and what
came of it.

A rig names what runs them (``[trials] montecarlo = "hil.montecarlo.run:MonteCarloHandovers"``);
nothing imports that. Each is the hand-over alone: D2 is at its viewpoint, both drones hold their
places and verify until D1's window is complete or the time is over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Literal, NamedTuple, Protocol, Self

import numpy as np

from drivers.rig.parts import Rig
from path.arrays import Array, Flags, Whole
from path.config import MethodConfig
from path.gate.agreement import threshold
from path.gate.evidence import strength
from path.gate.window import FramePair, Gate, Offsets
from path.values import frozen

FaultName = Literal[
    "none",
    "marker_occlusion",
    "marker_dropouts",
    "flip",
    "depth_holes",
    "link_loss",
    "link_delay",
    "clock_error",
    "camera_freeze",
    "attitude_jump",
    "look_alike_near",
    "look_alike_crossing",
    "detector_swap",
    "mixed",
]
WrongKind = Literal["shift", "turn", "lock"]
Outcome = Literal["commit", "timeout"]

PAIR = 0
MISS = 1
OWN_MISS = 2
"""The kinds of entry in a series: boxes were compared; D2's frame is a miss; D1's own frame is a
miss.
"""


@frozen
class WrongAssociation:
    """A wrong association that is forced: D2 answers with a look-alike all the time, the rest is as
    ever.

    Attributes:
        kind: "shift", "turn": D2's pose is off by a constant translation or rotation, so that the
            prior falls on the look-alike; "lock": pose and prior are right, but D2 sees only the
            look-alike.
        distance_m: from the target to the look-alike.
        residual_m: standard deviation per axis of how far beside the look-alike the prior falls.
        crossing: the look-alike does not stay: it drives past the target, at this distance at the
            closest.
    """

    kind: WrongKind
    distance_m: float
    residual_m: float = 0.06
    crossing: bool = False


@frozen
class Attempt:
    """One hand-over to run. All that is drawn depends on ``seed`` and ``index`` alone.

    Attributes:
        fault: what goes wrong now and then; errors that last (calibration, print, attitude, boxes)
            always do.
        reach: how much farther from the target D1 stays than it usually does.
        roll_deg: by which D2's camera is turned about its optical axis on its mount, as both drones
            know.
        limit_s: after so long without a commit it is a timeout.
        whole: go on until the limit, whatever D1's window says. Otherwise it ends with the commit,
            or as soon as there can be none any more, unless more is asked for.
    """

    seed: int
    index: int
    fault: FaultName = "none"
    wrong: WrongAssociation | None = None
    reach: float = 1.0
    roll_deg: float = 0.0
    limit_s: float = 20.0
    whole: bool = False


@frozen
class Series:
    """The entries that D1's window was given, in order: one for every pair that was judged and
    every own miss.

    Attributes:
        kind: (n,) ``PAIR``, ``MISS`` or ``OWN_MISS``.
        reason: (n,) why there was nothing to compare, as an index into ``MissReason``; -1 for a
            ``PAIR``.
        now_ns: (n,) when it was judged, D1's clock.
        sequence: (n,) u16 of D2's frame.
        capture_ns: (n,) when D2's frame was taken, or D1's own one for an ``OWN_MISS``; D1's clock.
        own: (n, 4) D1's frames before and after that instant: number, stamp, number, stamp.
        iou: (n, 2) S_k with the box's centre mapped, and with its corner mapped as in the paper.
        z_m: (n,) the target's distance along D1's optical axis.
        pose_sigma_m: (n,) standard deviation of D2's position that came with its box.
        right: (n,) whether D2's box is of the object that D1 was told to hand over.
        same: (n,) whether both boxes are of one object: D1 may have gone over to another one
            itself.
        offsets: of D2's box from the target and from what D1 saw beside it, by entry; of a ``PAIR``
            only.
        oversize: by how many standard deviations a box is larger than the target can be, by entry
            of a ``PAIR``.
        placed_iou: the overlap that a block's strength is of, where a size is stated, by entry of a
            ``PAIR``.
    """

    kind: Whole
    reason: Whole
    now_ns: Whole
    sequence: Whole
    capture_ns: Whole
    own: Whole
    iou: Array
    z_m: Array
    pose_sigma_m: Array
    right: Flags
    same: Flags
    offsets: Mapping[int, Offsets] = field(default_factory=dict[int, Offsets])
    oversize: Mapping[int, float] = field(default_factory=dict[int, float])
    placed_iou: Mapping[int, float] = field(default_factory=dict[int, float])

    def __len__(self) -> int:
        return len(self.kind)


class StatedIdentity(NamedTuple):
    """The probability with which D1 holds what it follows for the designated object in a frame, and
    whether it is.
    """

    probability: float
    right: bool


@frozen
class Circumstances:
    """The circumstances of a hand-over at its beginning, in truth.

    ``look_alike_m``: the nearest look-alike's distance from the target; ``closest_m``: the smallest
    that there is until the attempt's limit. ``relative_roll_deg``: of D2's camera against D1's,
    about the line of sight to the target.
    """

    range_1_m: float
    range_2_m: float
    marker_m: float
    look_alike_m: float
    closest_m: float
    relative_roll_deg: float
    target_mps: float


@frozen
class MonteCarloHandover:
    """The result of an attempt. Times are since its beginning, by D1's clock.

    Attributes:
        start_s: D2's first frame whose boxes overlapped as much as the threshold asks; None when
            none did.
        commit_s: when D1's window was complete; None when it never was.
        right: whether the box that completed the window is of the right object; None without a
            commit.
        same: whether it is of the object that D1's box was of.
        misses: number of entries by reason, until D1's window had decided.
        simulated_s: how much time was run.
        series: what D1's window was told.
        identity: what D1 believed of the object that it followed, frame by frame.
    """

    attempt: Attempt
    outcome: Outcome
    start_s: float | None
    commit_s: float | None
    right: bool | None
    same: bool | None
    misses: Mapping[str, int]
    simulated_s: float
    circumstances: Circumstances
    series: Series
    identity: Sequence[StatedIdentity] = ()

    @property
    def reason(self) -> str:
        """The most frequent miss of a timeout; empty for a commit."""
        if self.outcome == "commit":
            return ""
        return max(self.misses, key=lambda name: self.misses[name], default="no pair")


def agreeing(series: Series, method: MethodConfig) -> Flags:
    """(n,) which entries are pairs that overlap as much as the method's thresholds and mapping
    ask.
    """
    iou = series.iou[:, 0 if method.box_mapping == "center" else 1]
    z = np.where(series.kind == PAIR, series.z_m, 1.0)
    tau = method.tau_min + (method.tau_max - method.tau_min) * np.minimum(
        1.0, (method.z0_m / z) ** 2
    )
    return (series.kind == PAIR) & (series.pose_sigma_m <= method.pose_sigma_limit_m) & (iou >= tau)


class Telling:
    """Tells a gate what D1's cycle would have told it, from a series that grows. One instance for
    one gate.

    Attributes:
        done: the pair with which the gate was complete for the first time; None until then. Nothing
            is told after it. By the same frame D1 may have judged entries after it that changed
            nothing, such as a miss.
    """

    def __init__(self, gate: Gate, method: MethodConfig) -> None:
        self.gate = gate
        self._method = method
        self._told = 0
        self._judged_ns: int | None = None
        self._agreed: int | None = None  # the newest pair that the gate counted
        self.done: int | None = None

    def on(self, series: Series) -> int | None:
        """Go on with the entries that are new, which end with all that D1 judged by a frame.
        Returns ``done``.
        """
        first = self._told
        self._told = len(series)
        if self.done is not None or first == len(series):
            return self.done
        gate = self.gate
        method = self._method
        column = 0 if method.box_mapping == "center" else 1
        agrees = agreeing(series, method)
        entries = zip(
            series.kind[first:].tolist(), series.now_ns[first:].tolist(), series.sequence[first:].tolist(),
            series.capture_ns[first:].tolist(), series.own[first:].tolist(), series.iou[first:, column].tolist(),
            series.z_m[first:].tolist(), series.pose_sigma_m[first:].tolist(), agrees[first:].tolist(),
            strict=True,
        )  # fmt: skip
        for k, (kind, now_ns, sequence, capture_ns, own, iou, z_m, sigma_m, agreed) in enumerate(
            entries, first
        ):
            # D1 looks once it has judged all that came in by a frame
            if now_ns != self._judged_ns and gate.complete:
                self.done = self._agreed
                return self.done
            self._judged_ns = now_ns
            if kind == OWN_MISS:
                gate.restart(capture_ns)
                continue
            gate.expire(capture_ns)
            if agreed:
                frames = (own[0], own[1]), (own[2], own[3])
                offsets = series.offsets.get(k)
                oversize = series.oversize.get(k, 0.0)
                pair = FramePair(
                    sequence,
                    capture_ns,
                    frames,
                    offsets,
                    oversize,
                    series.placed_iou.get(k),
                )
                if gate.agree(pair, iou, threshold(z_m, method)) is None:
                    self._agreed = k
            else:
                compared = kind == PAIR and sigma_m <= method.pose_sigma_limit_m
                gate.disagree(
                    sequence,
                    capture_ns,
                    strength(iou, threshold(z_m, method)) if compared else None,
                )
        if gate.complete:
            self.done = self._agreed
        return self.done


def tell(
    series: Series,
    gate: Gate,
    method: MethodConfig,
) -> int | None:
    """Tell a gate what D1's cycle would have told it; the pair with which it was complete, None
    when it never was.
    """
    return Telling(gate, method).on(series)


class HandoverRunner(Protocol):
    """Runs attempts with a rig's cameras, mounts, marker and method."""

    def __init__(self, rig: Rig, method: MethodConfig | None = None) -> None:
        """``method`` in place of the rig's. Raises PartError for a rig that it cannot run."""
        ...

    def run(
        self, attempt: Attempt, until: Callable[[Series], bool] | None = None
    ) -> MonteCarloHandover:
        """Through the method itself: ``MarkerView``, ``ReceiverCycle`` and ``SenderCycle``.

        ``until``: asked now and then with the series so far; True ends the attempt. Of one that is
        not ``whole`` it is asked once D1's window has decided.
        """
        ...

    def warmed(self) -> Self:
        """Itself, with everything compiled or loaded."""
        ...

    def conditions(self) -> tuple[tuple[str, str], ...]:
        """The drawn conditions of the world as (what, how), for the reader."""
        ...

    def meanings(self) -> Mapping[FaultName, str]:
        """The meaning of each fault."""
        ...

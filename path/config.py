"""Settings of the method. Degrees appear here only; everything computed is in radians."""

from __future__ import annotations

from dataclasses import field, replace
from typing import Annotated, Literal

from path.bounds import Bounds, check_bounds
from path.values import frozen

BoxMapping = Literal["center", "corner"]
GateKind = Literal["count", "evidence", "likelihood"]
TargetError = Literal["point", "ray"]


@frozen
class EvidenceConfig:
    """Settings of the gate "evidence" (``path.gate.evidence``, which says what they mean and what
    they promise).

    Attributes:
        alpha: bound on the probability that one attempt is accepted although the boxes show
            different things, for what the persistent errors do not explain.
        block_s, block_pairs: a block is complete when it has this length on capture stamps and so
            many compared pairs.
        strength, block_share: the median of (S - tau) / (1 - tau), and the share of agreeing pairs,
            that a block needs.
        first_rate, next_rate: measured bounds on the probability that, under different things, the
            first block of a run agrees; and that a later one does, whatever those before it did.
        setback: what a later block that does not agree multiplies the evidence by; a larger one
            makes those that agree worth less.
        patient_block_s: length of the blocks of a second test beside the first, for boxes that
            errors that last put far apart all the time: longer blocks waver less, and may be
            weaker. 0: there is none.
        patient_strength, patient_first_rate, patient_next_rate, patient_setback: as those above, of
            its blocks.
        accident_share: of ``alpha``, what this test may spend on boxes that agree by accident; the
            second one takes ``patient_share`` of that. Errors that last are drawn once, and asked
            for the same by both.
        max_gap_s: a run ends after so long without an agreeing pair.
        min_s, min_pairs: no run is accepted that is shorter, whatever its evidence.
        max_pose_sigma_m: as ``MethodConfig.max_pose_sigma_m``, for this gate: what bounds the
            persistent errors.
        offset_sigma_m, offset_known: standard deviation per axis of how far D2's box of the target
            is off D1's for as long as a run lasts, in D1's image at the target's depth; and from
            how many measurements that is known.
        unseen: share of the hand-overs in which D2 may see another object than the target that D1
            does not see.
        rival_s: for so long an object that D1 saw beside the target is taken to be there still.
        apart_m, swap: D1 itself may have gone over to an object that is nearer to the target than
            that in its image, in so many of the hand-overs with one.
        span_m, height_m: of the target: no box is of it alone that is larger than an upright
            cylinder of this diameter and height (``path.target.size``), and the middle of its box
            lies accordingly (``path.target.cylinder``); 0 when its size is not known.
        size_sigmas, size_sigma, growth_sigma: a pair disagrees when a box is more than so many
            standard deviations larger than the target can be; the standard deviation of a box's
            size against such a cylinder's, and of what a box grows by within ``SETTLE_S``, both of
            its logarithm and besides noise of box and range.
    """

    alpha: Annotated[float, Bounds(0.0, 0.5, "of 1", above=True)] = 1e-3
    block_s: Annotated[float, Bounds(0.01, 30.0)] = 0.4
    block_pairs: Annotated[int, Bounds(1, 10000, "pairs")] = 8
    strength: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 0.35
    first_rate: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 1e-2
    next_rate: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 0.35
    setback: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 0.05
    block_share: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.6
    patient_block_s: Annotated[float, Bounds(0.0, 30.0)] = 0.0
    patient_strength: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 0.12
    patient_first_rate: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 0.07
    patient_next_rate: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 0.4
    patient_setback: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 0.2
    patient_share: Annotated[float, Bounds(0.0, 0.999, "of 1", above=True)] = 0.2
    accident_share: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 1.0
    max_gap_s: Annotated[float, Bounds(0.02, 60.0)] = 1.0
    min_s: Annotated[float, Bounds(0.05, 600.0)] = 1.0
    min_pairs: Annotated[int, Bounds(1, 100_000, "pairs")] = 30
    max_pose_sigma_m: Annotated[float, Bounds(0.0005, 1.0)] = 0.03
    offset_sigma_m: Annotated[float, Bounds(0.001, 1.0)] = 0.03
    offset_known: Annotated[int, Bounds(1, 10_000, "measurements")] = 20
    unseen: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 1e-3
    rival_s: Annotated[float, Bounds(0.0, 30.0)] = 3.0
    apart_m: Annotated[float, Bounds(0.0, 10.0)] = 0.45
    swap: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.05
    span_m: Annotated[float, Bounds(0.0, 20.0)] = 0.0
    height_m: Annotated[float, Bounds(0.0, 20.0)] = 0.0
    size_sigmas: Annotated[float, Bounds(0.5, 1000.0, "sigmas")] = 3.0
    size_sigma: Annotated[float, Bounds(0.001, 1.0, "of 1")] = 0.03
    growth_sigma: Annotated[float, Bounds(0.001, 1.0, "of 1")] = 0.08

    def __post_init__(self) -> None:
        """Raise ValueError naming the first field that cannot be right, and what is allowed."""
        check_bounds(self)
        if self.first_rate > self.next_rate:
            raise ValueError(
                f"first_rate: {self.first_rate!r} is above next_rate = {self.next_rate!r}"
            )
        if not self.patient_block_s:
            return
        if self.patient_block_s <= self.block_s:
            raise ValueError(
                f"patient_block_s: {self.patient_block_s!r} is not above block_s = {self.block_s!r}"
            )
        if self.patient_first_rate > self.patient_next_rate:
            above = f"{self.patient_first_rate!r} is above patient_next_rate = {self.patient_next_rate!r}"
            raise ValueError(f"patient_first_rate: {above}")

    @property
    def paces(self) -> tuple[EvidenceConfig, ...]:
        """The settings of each test that is to be made: they share ``accident_share``, and any of
        them decides.
        """
        if not self.patient_block_s:
            return (self,)
        alone = replace(
            self,
            patient_block_s=0.0,
            accident_share=self.accident_share * (1.0 - self.patient_share),
        )
        patient = replace(
            alone,
            accident_share=self.accident_share * self.patient_share,
            block_s=self.patient_block_s,
            strength=self.patient_strength,
            first_rate=self.patient_first_rate,
            next_rate=self.patient_next_rate,
            setback=self.patient_setback,
        )
        return alone, patient


@frozen
class MethodConfig:
    """Everything the method can be told; the same on both drones.

    ``tau_min``, ``tau_max`` and ``z0_m`` are not published: these defaults are ours, held against a
    sweep of false accepts and rejected true pairs
    (docs/decisions/0209-a-pair-is-two-frames-mapped-by-the-boxs-centre.md).

    Attributes:
        box_mapping: map the centre of D2's box, then rescale ("center"), or its corner as the paper
            does ("corner", which drifts with the cameras' relative roll).
        tau_min, tau_max: IoU needed far away and at ``z0_m`` or nearer (eq. adaptive_threshold).
        z0_m: reference viewing distance (eq. scale_factor).
        gate: what decides that the views have agreed for long enough: all of the last
            ``hold_frames`` pairs, as the paper has it ("count"), the strength of the agreement as
            well ("evidence", ``path.gate.evidence``), or where D2's box lies alone ("likelihood",
            ``path.gate.likelihood``, which is not the default yet).
        hold_frames, hold_s: of the gate "count": distinct fresh agreeing frame pairs, and the time
            from the first to the last of them on capture stamps; both are needed.
        max_gap_s: longest time between two consecutive agreeing pairs; a longer one restarts the
            count.
        max_age_s: a message whose frame is older than this when it comes in, is stale.
        max_future_s: one whose frame is further in the future than this shows that the clocks do
            not agree.
        max_bracket_s: D1's track is interpolated only between samples at most this far apart.
        max_extrapolation_s: how far D2 carries the target's point beyond its newest sample.
        slope_span_s: stretch of the newest samples from which D2 takes the target's motion.
        track_length: samples kept of each track.
        min_depth_m, max_depth_m: what the depth camera can be trusted with.
        depth_center_fraction: central part of the box, per side, that is asked for depth.
        min_depth_valid, min_depth_pixels: share and number of its pixels that must carry depth.
        max_depth_spread_m: largest robust spread of depth over the target; more is not one surface.
        depth_sigma_at_1m_m: depth noise at 1 m; it grows with the square of the distance.
        pixel_sigma_px: noise of a box centre.
        mount_sigma_m, mount_sigma_deg: uncertainty of ``T_v_c1``, per axis.
        target_center_sigma_m: how far apart the two cameras' box centres are on the body of the
            target.
        target_error: the standard deviation that D1 sends is the target's in every direction
            ("point"), or, where D1's range is much worse than its bearing (ranges by the target's
            size), only along D1's line of sight ("ray"); across it D2 then takes what pixels and
            mounting give.
        clock_sigma_s: uncertainty of a capture instant between the drones.
        relative_speed_mps: speed of the target in ``v`` that this uncertainty is multiplied with.
        relative_accel_mps2: acceleration of the target in ``v`` that the extrapolation does not
            know of.
        max_pose_sigma_m: position standard deviation of ``T_v_c2`` above which the pose is not
            used.
        max_incidence_deg: largest angle between marker normal and line of sight.
        search_sigmas: the search region reaches this many standard deviations around the prior.
        min_search_px, max_search_px: the region's half sides are at least the first; a prior that
            would need more than the second (without the target's own size) is too uncertain to be
            used.
        ambiguity_margin: two candidates whose squared Mahalanobis distances from the prior differ
            by less than this are not told apart.
        common_view: D1 sends keyframes of what its depth camera sees, and D2 takes its pose from
            what both see of one place where it does not see the marker (docs/common-view.md).
        evidence: settings of that gate.
    """

    box_mapping: BoxMapping = "center"
    tau_min: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.25
    tau_max: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.45
    z0_m: Annotated[float, Bounds(0.05, 50.0)] = 1.5
    hold_frames: Annotated[int, Bounds(1, 100_000, "frames")] = 350
    hold_s: Annotated[float, Bounds(0.01, 600.0)] = 7.0
    max_gap_s: Annotated[float, Bounds(0.005, 10.0)] = 0.2
    max_age_s: Annotated[float, Bounds(0.01, 10.0)] = 0.5
    max_future_s: Annotated[float, Bounds(0.001, 1.0)] = 0.05
    max_bracket_s: Annotated[float, Bounds(0.005, 10.0)] = 0.2
    max_extrapolation_s: Annotated[float, Bounds(0.001, 10.0)] = 0.2
    slope_span_s: Annotated[float, Bounds(0.005, 10.0)] = 0.2
    track_length: Annotated[int, Bounds(4, 100_000, "samples")] = 64
    min_depth_m: Annotated[float, Bounds(0.05, 50.0)] = 0.3
    max_depth_m: Annotated[float, Bounds(0.1, 100.0)] = 6.0
    depth_center_fraction: Annotated[float, Bounds(0.01, 1.0, "of 1")] = 0.2
    min_depth_valid: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.5
    min_depth_pixels: Annotated[int, Bounds(1, 1_000_000, "px")] = 12
    max_depth_spread_m: Annotated[float, Bounds(0.001, 10.0)] = 0.3
    depth_sigma_at_1m_m: Annotated[float, Bounds(0.0, 1.0, above=True)] = 0.005
    pixel_sigma_px: Annotated[float, Bounds(0.0, 100.0)] = 1.5
    mount_sigma_m: Annotated[float, Bounds(0.0, 1.0)] = 0.002
    mount_sigma_deg: Annotated[float, Bounds(0.0, 45.0)] = 0.2
    target_center_sigma_m: Annotated[float, Bounds(0.0, 5.0)] = 0.05
    target_error: TargetError = "point"
    clock_sigma_s: Annotated[float, Bounds(0.0, 1.0)] = 0.005
    relative_speed_mps: Annotated[float, Bounds(0.0, 50.0, above=True)] = 1.0
    relative_accel_mps2: Annotated[float, Bounds(0.0, 50.0, above=True)] = 3.0
    max_pose_sigma_m: Annotated[float, Bounds(0.0005, 10.0)] = 0.1
    max_incidence_deg: Annotated[float, Bounds(1.0, 89.9)] = 70.0
    search_sigmas: Annotated[float, Bounds(0.1, 20.0, "sigmas")] = 3.5
    min_search_px: Annotated[float, Bounds(0.5, 4000.0)] = 16.0
    max_search_px: Annotated[float, Bounds(0.5, 16384.0)] = 200.0
    ambiguity_margin: Annotated[float, Bounds(0.0, 1000.0, "(squared distances)", above=True)] = 6.0
    gate: GateKind = "evidence"
    common_view: bool = False
    evidence: EvidenceConfig = field(default_factory=EvidenceConfig)

    def __post_init__(self) -> None:
        """Raise ValueError naming the first field that cannot be right, and what is allowed."""
        if self.box_mapping not in ("center", "corner"):
            raise ValueError(f'box_mapping: {self.box_mapping!r} is neither "center" nor "corner"')
        if self.target_error not in ("point", "ray"):
            raise ValueError(f'target_error: {self.target_error!r} is neither "point" nor "ray"')
        if self.gate not in ("count", "evidence", "likelihood"):
            raise ValueError(f'gate: {self.gate!r} is none of "count", "evidence" and "likelihood"')
        check_bounds(self)
        for low, high in (
            ("tau_min", "tau_max"),
            ("min_depth_m", "max_depth_m"),
            ("min_search_px", "max_search_px"),
        ):
            if getattr(self, low) > getattr(self, high):
                raise ValueError(
                    f"{low}: {getattr(self, low)!r} is above {high} = {getattr(self, high)!r}"
                )

    @property
    def needed_pairs(self) -> int:
        """Agreeing pairs without which the gate lets nothing be handed over."""
        return self.hold_frames if self.gate == "count" else self.evidence.min_pairs

    @property
    def pose_sigma_limit_m(self) -> float:
        """Position standard deviation of ``T_v_c2`` above which the sender compares nothing."""
        if self.gate != "count":
            return min(self.max_pose_sigma_m, self.evidence.max_pose_sigma_m)
        return self.max_pose_sigma_m

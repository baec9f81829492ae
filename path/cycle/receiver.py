"""One cycle of D2, the receiver: where to look, and which of the things there is the target.

``flight.frame.receiver`` calls it for every frame of D2 and every word of D1. Like D1's cycle it is
pure, and decides nothing about responsibility.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from operator import itemgetter

from path.camera.kernels import lens_of
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior, Ray, predict
from path.gate.agreement import iou, plain_box
from path.gate.window import serial_difference
from path.geometry.rigid import inverse_as_quat, rigid
from path.geometry.rotation import IDENTITY
from path.geometry.transforms import Matrix, Pose
from path.messages import Candidate, Target, Vec3
from path.observations import Box, Detection, Missed, MissReason
from path.target.pieces import whole_of
from path.target.place import across_sigma
from path.timeline import Sample, Track

SAME_OBJECT_IOU = 0.5  # two boxes that overlap more are one object found twice
NOWHERE: Vec3 = (0.0, 0.0, 0.0)


class ReceiverCycle:
    """D2's side of the method for one handoff of one target.

    For each frame: ``prior``, a look for targets in ``prior.region``, ``candidate``. What
    ``candidate`` returns is sent even when it is a miss: D1 must know that D2 looked and did not
    see.
    """

    def __init__(
        self,
        camera: CameraModel,
        config: MethodConfig,
        *,
        handoff_id: int,
        epoch: int,
        target_id: int,
        sender: tuple[CameraModel, Vec3] | None = None,
    ) -> None:
        """Begin an attempt.

        Args:
            sender: D1's camera and its place in the marker frame, for ``target_error = "ray"``.
        """
        self.misses: Counter[MissReason] = Counter()
        self.found = 0
        self._lens = lens_of(camera)
        self._config = config
        self._sender = sender
        self._identity = (handoff_id, epoch, target_id)
        self._track = Track(config.track_length, config.max_bracket_s)
        # frame id and stamp of the newest frame that was answered
        self._last: tuple[int, int] | None = None
        self._box_size_at_1m_px = (0.0, 0.0)

    def on_target(
        self,
        target: Target,
        capture_ns: int,
        now_ns: int,
    ) -> Missed | None:
        """Take in D1's message, and return why it is not used; None when it is.

        Args:
            capture_ns: ``target.capture_ns`` converted to D2's clock.
            now_ns: D2's clock.

        Returns:
            A miss is always ``ignored``.
        """
        reason = self._unusable(target, capture_ns, now_ns)
        if reason is not None:
            self.misses[reason] += 1
            return Missed(reason, ignored=True)
        newest = self._track.newest
        frame = target.sequence
        if newest is not None:
            ahead = serial_difference(target.sequence, newest.frame)
            frame = newest.frame + ahead
        # point, gravity, sigma of the point: ``gravity_v`` and ``prior`` take them apart
        values = (*target.point_v_m, *target.gravity_v, target.sigma_m)
        sample = Sample(capture_ns, frame, values)
        self._track.add(sample)
        return None

    def gravity_v(self, stamp_ns: int) -> Vec3 | None:
        """Return D1's gravity direction in ``v`` at an instant of D2's clock; None when unknown.

        For the marker's pose. Interpolated between D1's samples; beyond the newest one that one, for
        ``max_extrapolation_s``.
        """
        newest = self._track.newest
        if newest is None or newest.values is None:
            return None
        if stamp_ns < newest.stamp_ns:
            between = self._track.at(stamp_ns)
            if between is None:
                return None
            values = between.values
        else:
            beyond_ns = stamp_ns - newest.stamp_ns
            if beyond_ns > self._config.max_extrapolation_s * 1e9:
                return None
            values = newest.values
        x, y, z = values[3:6]
        norm = math.hypot(x, y, z)
        # Between two directions it is a little shorter than 1.
        return (
            x / norm,
            y / norm,
            z / norm,
        )

    def prior(
        self,
        T_c2_v: Pose,
        covariance: Matrix,
        stamp_ns: int,
    ) -> Prior | Missed:
        """Return the expected place of the target in D2's frame of this stamp (D2's clock).

        The target's point is interpolated to that instant, or carried on from its newest samples
        for at most ``max_extrapolation_s``; clock error and unknown acceleration widen the prior.

        Args:
            covariance: of ``T_c2_v``, (6, 6), convention in ``path.cycle.prior``.

        Returns:
            Missed LINK_SILENT when D1's newest sample is too old, NO_TRACK when the frame is older
            than D1's samples or falls into a gap of them, else as ``path.cycle.prior.predict``.
        """
        newest = self._track.newest
        if newest is None:
            return Missed(MissReason.LINK_SILENT)
        config = self._config
        if stamp_ns <= newest.stamp_ns:
            between = self._track.at(stamp_ns)
            if between is None:
                return Missed(MissReason.NO_TRACK)
            values = between.values
            sigma_m = between.values[6]
            beyond_s = 0.0
        else:
            values = self._track.ahead(
                stamp_ns,
                config.slope_span_s,
                config.max_extrapolation_s,
            )
            if values is None or newest.values is None:
                return Missed(MissReason.LINK_SILENT)
            sigma_m = newest.values[6]
            beyond_s = (stamp_ns - newest.stamp_ns) / 1e9
        skew_m = config.clock_sigma_s * config.relative_speed_mps
        accel_mps2 = config.relative_accel_mps2
        drift_m = 0.5 * accel_mps2 * beyond_s * beyond_s
        point_v = (values[0], values[1], values[2])
        return predict(
            lens=self._lens,
            T_c2_v=rigid(T_c2_v),
            covariance=covariance,
            point_v=point_v,
            point_sigma_m=math.hypot(sigma_m, skew_m, drift_m),
            target_sequence=newest.frame & 0xFFFF,
            config=config,
            box_size_at_1m_px=self._box_size_at_1m_px,
            ray=self._ray(point_v, math.hypot(skew_m, drift_m)),
        )

    def _ray(self, point_v: Vec3, moved_sigma_m: float) -> Ray | None:
        """Return D1's line of sight to the target; None unless its errors differ along it."""
        if self._sender is None or self._config.target_error == "point":
            return None
        camera, eye_v = self._sender
        x = point_v[0] - eye_v[0]
        y = point_v[1] - eye_v[1]
        z = point_v[2] - eye_v[2]
        distance2 = x * x + y * y + z * z
        distance_m = math.sqrt(distance2)
        if distance_m <= 0.0:
            return None
        seen_m = across_sigma(camera, distance_m, self._config)
        across_m = math.hypot(seen_m, self._config.mount_sigma_m, moved_sigma_m)
        direction = (x / distance_m, y / distance_m, z / distance_m)
        return Ray(direction, across_m)

    def candidate(
        self,
        frame_id: int,
        stamp_ns: int,
        detections: Sequence[Detection],
        prior: Prior | Missed,
    ) -> Candidate | Missed:
        """Return the answer to send for one frame.

        For an old or repeated frame there is none: an ``ignored`` miss.

        Args:
            frame_id: strictly increasing; its low 16 bits are the message's sequence.
            stamp_ns: mid-exposure, D2's clock.
            detections: what D2's own detector found in ``prior.region``; empty without a prior.
            prior: of this frame, or why there is none (also a marker's miss): it goes out as the
                candidate's reason.
        """
        old = self._old(frame_id, stamp_ns)
        if old is not None:
            self.misses[old] += 1
            return Missed(old, ignored=True)
        self._last = (frame_id, stamp_ns)
        box: Box | None = None
        why: MissReason | None = None
        chosen = self._choose(detections, prior)
        if isinstance(chosen, Missed):
            why = chosen.reason
            self.misses[why] += 1
        else:
            box = plain_box(chosen.box)

        rotation = IDENTITY
        position = NOWHERE
        sigma_m = 0.0
        answered = 0
        if isinstance(prior, Prior):
            rotation, position = inverse_as_quat(prior.T_c2_v)
            sigma_m = prior.pose_sigma_m
            answered = prior.target_sequence
            if box is not None:
                self.found += 1
                self._box_size_at_1m_px = (box.w * prior.depth_m, box.h * prior.depth_m)

        handoff_id, epoch, target_id = self._identity
        return Candidate(
            handoff_id=handoff_id,
            epoch=epoch,
            target_id=target_id,
            sequence=frame_id & 0xFFFF,
            target_sequence=answered,
            capture_ns=stamp_ns,
            box=box,
            reason=why,
            position_v_m=position,
            rotation_v_c2=rotation,
            sigma_m=sigma_m,
        )

    def _old(self, frame_id: int, stamp_ns: int) -> MissReason | None:
        """Return why a frame is not the next one; None when it is."""
        if self._last is None:
            return None
        last_id, last_ns = self._last
        if frame_id == last_id:
            return MissReason.DUPLICATE
        if frame_id < last_id or stamp_ns <= last_ns:
            return MissReason.STALE
        return None

    def _choose(self, detections: Sequence[Detection], prior: Prior | Missed) -> Detection | Missed:
        """Return the detection nearest to the prior.

        A miss when none is near, or a second one nearly as near.
        """
        if isinstance(prior, Missed):
            return prior
        farthest2 = self._config.search_sigmas**2
        near: list[tuple[float, Detection]] = []
        for detection in detections:
            distance2 = prior.distance2(*detection.box.center)
            has_area = detection.box.w > 0.0 and detection.box.h > 0.0
            if distance2 <= farthest2 and has_area:
                near.append((distance2, detection))
        near.sort(key=itemgetter(0))
        if not near:
            return Missed(MissReason.NO_CANDIDATE)

        near = self._joined(near, prior)
        nearest2, best = near[0]
        for distance2, other in near[1:]:
            nearly_as_near = distance2 - nearest2 < self._config.ambiguity_margin
            if nearly_as_near and iou(best.box, other.box) < SAME_OBJECT_IOU:
                return Missed(MissReason.AMBIGUOUS_TARGET)
        return best

    def _joined(
        self,
        near: list[tuple[float, Detection]],
        prior: Prior,
    ) -> list[tuple[float, Detection]]:
        """Return them with the nearest in one piece, where it is shown as two that overlap."""
        w, h = self._box_size_at_1m_px
        if not w * h > 0.0:
            return near
        expected_px = (w / prior.depth_m, h / prior.depth_m)
        _, best = near[0]
        others = near[1:]
        for other in others:
            _, piece = other
            whole = whole_of(best.box, piece.box, expected_px)
            if whole is None or not iou(best.box, piece.box) > 0.0:
                continue
            joined = Detection(whole, max(best.score, piece.score))
            distance2 = prior.distance2(*whole.center)
            rest = [each for each in others if each is not other]
            return [(distance2, joined), *rest]
        return near

    def _unusable(  # noqa: PLR0911
        self,
        target: Target,
        capture_ns: int,
        now_ns: int,
    ) -> MissReason | None:
        """Return why D1's message is not used; None when it is."""
        identity = (
            target.handoff_id,
            target.epoch,
            target.target_id,
        )
        if identity != self._identity:
            return MissReason.STALE

        total = sum(target.point_v_m) + target.sigma_m
        is_finite = math.isfinite(total)
        is_unit = 0.95 < math.hypot(*target.gravity_v) < 1.05
        if not (is_finite and is_unit):
            return MissReason.NON_FINITE
        if target.sigma_m < 0.0:
            return MissReason.NON_FINITE

        newest = self._track.newest
        if newest is not None:
            ahead = serial_difference(target.sequence, newest.frame)
            if ahead == 0:
                return MissReason.DUPLICATE
            if ahead < 0:
                return MissReason.STALE
            if capture_ns <= newest.stamp_ns:
                return MissReason.STALE

        age_ns = now_ns - capture_ns
        if -age_ns > self._config.max_future_s * 1e9:
            return MissReason.CLOCK
        if age_ns > self._config.max_age_s * 1e9:
            return MissReason.STALE
        return None

"""All objects that a drone sees as tracks, and the probability of each that it is the designated
one: ``path.belief.mixing``. What a box says of an object: ``path.belief.boxes``.

A new track may be nothing: detectors invent, and show an object in two pieces. Its log odds begin
at those of NEW_SHARE and rise by dt / SPELL_S with each frame that shows it, since inventions last
SPELL_S in the mean; they fall by as much times log 1 / (1 - p) with each frame that does not. Once
CONFIRMED it stays until it was out of sight for FORGET_S.

A box that is larger than the target can be has another one in it. If none that is known may be in
there, it is one whom nobody has seen: a track begins that is anywhere in the box and as large as
the target. Its log odds rise and fall as above with boxes that are as large and that are not, and
it competes for what comes out of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from path.belief.boxes import UNKNOWN_SIZE, Fit, Measured, inside, is_part, within
from path.belief.frame import SHOWN, Frame
from path.belief.mixing import FORGOTTEN, mix
from path.belief.motion import FLYING, ON_GROUND, Array, Motion, renewal
from path.belief.track import LOG_ODDS_CONFIRMED, SPELL_S, ObjectTrack

NEW_SHARE = 0.1
FORGET_S = 5.0
_DEAD = 0.02
_MISSED = math.log(1.0 / (1.0 - SHOWN))
_SIZE_RATE = 0.1  # by which the logarithm of a box's side changes within a second: an object turns
# times the noise of its box: the standard deviation of the place of what was designated
_DESIGNATED = 2.0
# of an identity: what is out of sight for long, with more than that, may be the object
_WORTH_KEEPING = 0.01
_MAY_BE = 0.02  # the least probability with which somebody known is the other one in a box
_MOST_TRACKS = 16
_LOG_ODDS_NEW = math.log(NEW_SHARE / (1.0 - NEW_SHARE))
_LOG_ODDS_DEAD = math.log(_DEAD / (1.0 - _DEAD))


class Belief:
    """All tracks. Frames are given in the order of their stamps.

    Args:
        accel_mps2: how hard an object speeds up, brakes and turns at most.
        flies: it moves up and down too.
    """

    def __init__(self, accel_mps2: float, *, flies: bool = True) -> None:
        self.tracks: list[ObjectTrack] = []
        self._accel_mps2 = accel_mps2 * (FLYING if flies else ON_GROUND)
        self._numbers = 0
        self._stamp_ns: int | None = None
        # by measurement of the newest frame: number of its track
        self._assigned: list[int | None] = []
        self._alone: list[bool] = []  # and whether nothing else is in its box

    def designate(self, place_m: Array, measured: Measured, stamp_ns: int) -> None:
        """Begin with the object that was designated: it is at a place, and a box like that is of
        it.

        In a box that is larger than it can be it is anywhere, how large it is is not known, and
        there is another one in it, which may as well be the one: when the box comes apart, one half
        of it is as likely as the other.

        Args:
            place_m: shape (3,).
        """
        track = self._begin(measured, stamp_ns)
        track.motion.mean[:3] = place_m
        track.motion.covariance[:3, :3] *= _DESIGNATED**2
        if np.any(np.asarray(measured.sides_m) > measured.most_m):
            track.motion.covariance[:3, :3] += within(np.asarray(measured.sides_m), measured.axes)
            track.size_variances[:] = UNKNOWN_SIZE
            other = self._begin(measured, stamp_ns)
            other.motion.covariance[:3, :3] = track.motion.place_covariance_m2
            other.size_variances[:] = UNKNOWN_SIZE
            other.log_odds = LOG_ODDS_CONFIRMED
        track.log_odds = LOG_ODDS_CONFIRMED
        track.identity = 1.0
        self._stamp_ns = stamp_ns

    def update(
        self, measured: Sequence[Measured], sees: Callable[[Array], bool], stamp_ns: int
    ) -> None:
        """Take in a frame.

        Args:
            sees: whether the frame shows what is at a place, if nothing hides it.
        """
        dt_s = 0.0 if self._stamp_ns is None else max(0.0, (stamp_ns - self._stamp_ns) * 1e-9)
        self._stamp_ns = stamp_ns
        for track in self.tracks:
            track.motion.advance(stamp_ns, self._accel_mps2)
            track.size_variances += _SIZE_RATE**2 * dt_s
        frame = Frame(self.tracks, measured, sees, dt_s)
        mix(self.tracks, frame, stamp_ns)
        for k, track in enumerate(self.tracks):
            own = frame.fit(k)
            held = frame.held[k]
            if own is not None:
                self._shown(track, *own, stamp_ns, dt_s)
                continue
            unseen = held is None and sees(track.motion.place_m)
            if held is not None:
                track.motion.update(held.place_m, held.noise_m2)
                unseen = track.inferred and frame.holders[k] not in frame.together
            track.shown = track.shown and held is None and not unseen
            if unseen and (track.inferred or not track.confirmed):
                missed = track.log_odds - _MISSED * dt_s / SPELL_S
                track.log_odds = max(missed, _LOG_ODDS_DEAD)  # one that may be the one is kept
        numbers = {
            column: self.tracks[k].number
            for k, column in enumerate(frame.assigned)
            if column is not None
        }
        self._assigned = [numbers.get(column) for column in range(len(measured))]
        self._alone = [column not in frame.together for column in range(len(measured))]
        known = list(self.tracks)
        self._open(frame, stamp_ns)
        self._infer(known, frame, stamp_ns)
        self._settle(stamp_ns)

    def carry(self, place_m: Array, stamp_ns: int) -> None:
        """Keep the likeliest track, which this frame has not shown, by where a body of its size
        stands out in depth.

        Nothing else came there meanwhile. It is somewhere in that body.
        """
        track = self.likeliest
        if track is None or track.seen_ns >= stamp_ns:
            return
        half_m = 0.5 * float(np.max(np.exp(track.log_sides)))
        track.motion.update(place_m, half_m * half_m * np.eye(3))

    def identity_of(self, column: int) -> float:
        """Return the probability that a measurement of the newest frame is of the designated
        object.
        """
        number = self._assigned[column]
        return 0.0 if number is None else self.probability(number)

    def track_of(self, column: int) -> ObjectTrack | None:
        """Return the track whose object a measurement of the newest frame is of, and of nothing
        else.
        """
        number = self._assigned[column] if self._alone[column] else None
        return next((track for track in self.tracks if track.number == number), None)

    def probability(self, number: int) -> float:
        """Return the probability that a track's object is the designated one."""
        by_number = {track.number: track for track in self.tracks}
        own = by_number.get(number)
        if own is None:
            return 0.0
        owing = sum(each.existence * each.owed.get(number, 0.0) for each in self.tracks)
        owed = sum(
            by_number[other].identity * share * own.existence
            for other, share in own.owed.items()
            if other in by_number
        )
        return own.identity * max(0.0, 1.0 - owing) * (1.0 - own.doubt) + owed

    @property
    def likeliest(self) -> ObjectTrack | None:
        """The track that is the designated object most likely."""
        return max(self.tracks, key=lambda each: self.probability(each.number), default=None)

    def _begin(self, measured: Measured, stamp_ns: int) -> ObjectTrack:
        beyond = np.maximum(np.asarray(measured.sides_m) - measured.most_m, 0.0)
        covariance = measured.covariance_m2 + within(beyond, measured.axes)
        motion = Motion.at(measured.place_m, covariance, self._accel_mps2, stamp_ns)
        sides = np.log(np.minimum(measured.sides_m, measured.most_m))
        variances = np.where(measured.cut, UNKNOWN_SIZE, measured.side_sigma**2)
        track = ObjectTrack(self._numbers, motion, sides, variances, _LOG_ODDS_NEW, stamp_ns)
        self._numbers += 1
        self.tracks.append(track)
        return track

    def _shown(
        self, track: ObjectTrack, measured: Measured, fit: Fit, stamp_ns: int, dt_s: float
    ) -> None:
        track.motion.update(fit.place_m, fit.noise_m2)
        track.replaced *= (1.0 - SHOWN) ** (dt_s / SPELL_S)
        track.hidden *= math.exp(-dt_s / FORGET_S)
        track.shown = not fit.larger
        track.inferred = False
        track.seen_ns = stamp_ns
        if not track.confirmed:
            track.log_odds += dt_s / SPELL_S
        if fit.larger:
            return
        off = np.log(measured.sides_m) - track.log_sides
        variances = track.size_variances + measured.side_sigma**2
        cut = np.asarray(measured.cut)  # it is as large as that at least
        told = ~(cut & (off < 0.0))
        # else more is in its box, or less of it is seen
        if float(np.sum((off * off)[told] / variances[told])) <= 9.0:
            gains = np.where(told, track.size_variances / variances, 0.0)
            track.log_sides = track.log_sides + gains * off
            track.size_variances = track.size_variances * (1.0 - np.where(cut, 0.0, gains))

    def _open(self, frame: Frame, stamp_ns: int) -> None:
        """Begin tracks of what no track was updated with, and is no part of an object."""
        known = list(self.tracks)
        own = [None if (pair := frame.fit(k)) is None else pair[0] for k in range(len(known))]
        for column, each in enumerate(frame.measured):
            if self._assigned[column] is not None or len(self.tracks) >= _MOST_TRACKS:
                continue
            if any(is_part(each, track, box) for track, box in zip(known, own, strict=True)):
                continue
            if any(other.confirmed and frame.is_around(i, column) for i, other in enumerate(known)):
                continue  # it is around an object that is known, and more
            track = self._begin(each, stamp_ns)
            self._assigned[column] = track.number
            for i, other in enumerate(known):
                apart = each.place_m - other.motion.place_m
                share = frame.marginals[i, column] * renewal(
                    other.motion.place_covariance_m2, frame.fits[i][column].noise_m2, apart
                )
                share = max(float(share), other.doubt)  # what was replaced may be this
                if share > FORGOTTEN:
                    track.owed[other.number] = share

    def _infer(self, known: Sequence[ObjectTrack], frame: Frame, stamp_ns: int) -> None:
        """Begin a track of another one that is in a box of what may be the designated object, where
        that box is larger than the target can be and nobody known who is not shown may be in it.
        """
        for track, column in zip(known, frame.assigned, strict=True):
            if column is None or self.probability(track.number) <= _WORTH_KEEPING:
                continue
            each = frame.measured[column]
            if not np.any(np.asarray(each.sides_m) > each.most_m):
                continue
            others = [
                other
                for other, own in zip(known, frame.assigned, strict=True)
                if own is None
                and (other.confirmed or other.inferred)
                and inside(other.motion, each) > _MAY_BE
            ]
            for other in others:
                if other.inferred:
                    other.log_odds += frame.dt_s / SPELL_S
                    other.seen_ns = stamp_ns
            if not others and len(self.tracks) < _MOST_TRACKS:
                other = self._begin(each, stamp_ns)
                other.motion.covariance[:3, :3] += within(np.asarray(each.sides_m), each.axes)
                other.log_sides = track.log_sides.copy()
                other.size_variances = track.size_variances.copy()
                other.shown = False
                other.inferred = True

    def _settle(self, stamp_ns: int) -> None:
        """New tracks that exist take what they are owed; dead and forgotten ones go."""
        by_number = {track.number: track for track in self.tracks}
        for track in self.tracks:
            if track.confirmed and track.owed:
                for number, share in track.owed.items():
                    other = by_number.get(number)
                    if other is not None:
                        track.identity += share * other.identity
                        other.identity *= 1.0 - share
                        left = max(0.0, 1.0 - share / max(other.doubt, FORGOTTEN))
                        other.replaced *= left
                        other.hidden *= left
                track.owed = {}
        forgotten_ns = stamp_ns - round(FORGET_S * 1e9)
        self.tracks = [
            track
            for track in self.tracks
            if track.identity > _WORTH_KEEPING
            or (track.log_odds > _LOG_ODDS_DEAD and track.seen_ns >= forgotten_ns)
        ]

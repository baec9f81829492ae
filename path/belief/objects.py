"""All objects that a drone sees as tracks, and the probability of each that it is the designated
one.

Boxes
    A box is a measurement of its object's place. Its noise is what the rig states for such a box at
    its own range. Where the box is larger than its object, something else is in it; where it is
    smaller, a part of the object is hidden or outside the image. Either way the object's middle is
    within half the difference d of the sides:

        R = R_box + (d/2)^2    along each side

    That stays off for as long as it lasts, so that many frames say no more than one: a place is
    never known better by it than to d/2, and one that is known better already is told nothing. One
    box may so be of two objects: whoever is expected inside a box that is assigned to another, by
    its direction and at any range, is held by it, and not missed.

    A side is as uncertain as an object may have turned since it was seen. Where a box holds somebody
    else, whom no other box shows, what it is larger by is that one's: d is all that exceeds the
    sides that were known.

Existence
    A new track may be nothing: detectors invent, and show an object in two pieces. Its log odds
    begin at those of NEW_SHARE and rise by dt / SPELL_S with each frame that shows it, since
    inventions last SPELL_S in the mean; they fall by as much times log 1 / (1 - p) with each frame
    that does not. Once CONFIRMED it stays until it was out of sight for FORGET_S.

    A box that is larger than the target can be has another one in it. If none that is known may be
    in there, it is one whom nobody has seen: a track begins that is anywhere in the box and as
    large as the target. Its log odds rise and fall as above with boxes that are as large and that
    are not, and it competes for what comes out of them.

Identity
    q_i is the probability that the object of track i is the designated one; what is missing from
    their sum to 1 is for an object that no track follows. Let beta_ij be the marginals of a frame
    (``path.belief.assignment``), and j(i) the measurement that track i was updated with. If
    measurement j(k) was of i, then track k follows from now on what i followed before:

        q <- A q,     A_ki = g beta_{i j(k)}  for k != i

    g is how much of i's place the measurement makes new (``path.belief.motion.renewal``): a track
    whose place is known well is not carried off by one frame, and one that nobody saw for a while
    is whatever it is found as. (Identity
    management: Shin, Guibas, Zhao 2003.) A new track takes its share only as far as it exists.

    A measurement may also be of somebody who was out of sight, or of an object that came into view,
    while the track's own object is not shown. That is a doubt: if it were so, the object would be
    around here, and be shown before long, where nothing hides it (HIDDEN). So the rest of the doubt
    goes by (1 - SHOWN) with each SPELL_S in which the track is seen and nothing else comes up; what
    does come up is owed it. What was out of sight for a time t is not shown before long: misses go
    on so long by exp(-t / SPELL_S), and

        P(hidden) = HIDDEN / (HIDDEN + (1 - HIDDEN) exp(-t / SPELL_S))

    and what is hidden comes up within FORGET_S in the mean. Where both a track and a CONFIRMED one
    that competes for its box were out of sight, neither is more likely to be shown next: the doubt
    is the other one's identity, and stays.

    Who was out of sight may be one whom no track follows. Of n others that are known, n HIDDEN more
    are hidden, spread about a measurement z as those are: with s^2 their mean square distance level,
    for each of two axes, and v^2 that in height,

        lambda = n HIDDEN / ((2 pi)^(3/2) s^2 v)
        P(unknown | z) = u / (u + a p(z | track)),   u = (1 - a) lambda dt / SPELL_S

    where a is the probability that the frame shows the track's object again. p falls as its place
    becomes unknown, so that seconds in a crowd leave little; alone, there is nobody else.

    A box around what is expected in it, and larger than that, tells nothing of which is which: it
    mixes nothing, and nothing is learnt of sizes. But places become unknown while it lasts, and
    when it comes apart its boxes mix what was in it, as far as that went.

    Nothing here makes two that were mixed up come apart again, and no wait does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from path.belief.assignment import associate
from path.belief.motion import ODD_TIMES, Array, Motion, density, mahalanobis2, renewal
from path.values import value

GATE2 = (2.0 * ODD_TIMES) ** 2
"""The squared distance from which on a box is of something else, however odd it may be."""
SHOWN = 0.9
"""The probability that a detector shows an object that it showed in the frame before."""
SPELL_S = 0.1
"""For so long, in the mean, a detector goes on to miss an object, or to invent one."""
NEW_SHARE = 0.1
HIDDEN = 0.05
"""The share of objects that are not shown, where one is looked for, because something hides
them.
"""
CONFIRMED = 0.95
FORGET_S = 5.0
_DEAD = 0.02
_MISSED = math.log(1.0 / (1.0 - SHOWN))
_SIZE_RATE = 0.1  # by which the logarithm of a box's side changes within a second: an object turns
_SIZE_TAIL = 3.0
# standard deviations of a side's logarithm: what is farther off has more in its box, or less
_FITS = 2.0
_SIZE_DENSITY = 0.5  # of a side's logarithm, of anything: between 1 / e and e times as large
# times the noise of its box: the standard deviation of the place of what was designated
_DESIGNATED = 2.0
_FORGOTTEN = 1e-9
# of an identity: what is out of sight for long, with more than that, may be the object
_WORTH_KEEPING = 0.01
# the share of an axis' variance with which a measurement along it counts for nothing
_NOTHING = 1e-4
_MOST_TRACKS = 16
_NOWHERE_ELSE = np.zeros((3, 3))


@value
class Measured:
    """A box as a measurement of a place in the local frame.

    Attributes:
        place_m: shape (3,). covariance_m2: (3, 3), of the frame's noise.
        eye_m: (3,) place of the camera.
        axes: (3, 3) rotation of the camera in the local frame; columns right, down, ahead.
        sides_m: width and height of the box at its range.
        side_sigma: standard deviation of either side's logarithm.
        most_m: the largest sides that a box of the target alone can have there; infinite where that
            is not known.
        elsewhere_m3: density per m^3 of boxes of nothing that is known, inventions among them.
        newcomers_m3_s: of objects that come into view, per m^3 and s.
    """

    place_m: Array
    covariance_m2: Array
    eye_m: Array
    axes: Array
    sides_m: tuple[float, float]
    side_sigma: float
    most_m: tuple[float, float]
    elsewhere_m3: float
    newcomers_m3_s: float


@dataclass(slots=True)
class ObjectTrack:
    """One object.

    Attributes:
        log_sides: logarithm of the sides of its box in m. size_variance: of either.
        log_odds: that it exists. owed: of new ones, by other track, the share of its identity that
            is this one's if it exists.
        shown: whether the newest frame that could have did show it, in a box of its own.
        seen_ns: when it was last shown, alone or not.
        inferred: whether it was never shown in a box of its own: it is the other one in a box that
            is larger than the target can be.
        identity: the probability that it is the designated object, without what new tracks are
            owed, and doubts.
        replaced: the probability that it follows something else than before, and the object is near
            and can be seen;
        hidden: and cannot.
    """

    number: int
    motion: Motion
    log_sides: Array
    size_variance: float
    log_odds: float
    seen_ns: int
    shown: bool = True
    inferred: bool = False
    identity: float = 0.0
    owed: dict[int, float] = field(default_factory=dict[int, float])
    replaced: float = 0.0
    hidden: float = 0.0

    def doubted(self, share: float, unseen_s: float = 0.0) -> None:
        """Something else may have come to where the object was, with this probability, and the
        object be near: hidden rather than missed, the longer it was not seen.
        """
        added = (1.0 - self.doubt) * share
        hidden = HIDDEN / (HIDDEN + (1.0 - HIDDEN) * math.exp(-unseen_s / SPELL_S))
        self.replaced += added * (1.0 - hidden)
        self.hidden += added * hidden

    @property
    def doubt(self) -> float:
        return min(1.0, self.replaced + self.hidden)

    @property
    def existence(self) -> float:
        return 1.0 / (1.0 + math.exp(-self.log_odds))

    @property
    def confirmed(self) -> bool:
        return self.log_odds >= _LOG_ODDS_CONFIRMED

    def sides_m(self, most_m: tuple[float, float]) -> Array:
        return np.minimum(np.exp(self.log_sides), most_m)


_LOG_ODDS_CONFIRMED = math.log(CONFIRMED / (1.0 - CONFIRMED))
_LOG_ODDS_NEW = math.log(NEW_SHARE / (1.0 - NEW_SHARE))
_LOG_ODDS_DEAD = math.log(_DEAD / (1.0 - _DEAD))


class Belief:
    """All tracks. Frames are given in the order of their stamps.

    Args:
        accel_mps2: how hard an object speeds up, brakes and turns at most.
    """

    def __init__(self, accel_mps2: float) -> None:
        self.tracks: list[ObjectTrack] = []
        self._accel_mps2 = accel_mps2
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
            track.motion.covariance[:3, :3] += _within(np.asarray(measured.sides_m), measured.axes)
            track.size_variance = 1.0
            other = self._begin(measured, stamp_ns)
            other.motion.covariance[:3, :3] = track.motion.place_covariance_m2
            other.size_variance = 1.0
            other.log_odds = _LOG_ODDS_CONFIRMED
        track.log_odds = _LOG_ODDS_CONFIRMED
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
            track.size_variance += _SIZE_RATE**2 * dt_s
        fits = [[_fit(track, each) for each in measured] for track in self.tracks]
        holders = [self._holder(track, measured) for track in self.tracks]
        weights = self._weights(measured, fits, holders, sees, dt_s)
        assigned, marginals = associate(weights)
        for k, column in enumerate(assigned):
            if column is not None and self._holds_another(k, column, holders, assigned):
                fits[k][column] = _fit(self.tracks[k], measured[column], shared=True)
        together = {
            column
            for k, column in enumerate(assigned)
            if column is not None and fits[k][column].larger
        }
        self._mix(measured, fits, holders, assigned, marginals, stamp_ns, dt_s)
        for k, track in enumerate(self.tracks):
            column = assigned[k]
            if column is not None:
                self._shown(track, measured[column], fits[k][column], stamp_ns, dt_s)
            elif (held := holders[k]) is not None:
                _hold(track.motion, measured[held])
                track.shown = False  # one of those in a box may be hidden
                if track.inferred and held not in together:
                    track.log_odds -= _MISSED * dt_s / SPELL_S
            elif sees(track.motion.place_m):
                track.shown = False
                if track.inferred or not track.confirmed:
                    track.log_odds -= _MISSED * dt_s / SPELL_S
        taken = {
            column: self.tracks[k].number for k, column in enumerate(assigned) if column is not None
        }
        self._assigned = [taken.get(column) for column in range(len(measured))]
        self._alone = [column not in together for column in range(len(measured))]
        known = list(self.tracks)
        self._open(measured, marginals, fits, holders, stamp_ns)
        self._infer(known, measured, assigned, stamp_ns, dt_s)
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
        covariance = measured.covariance_m2 + _within(beyond, measured.axes)
        motion = Motion.at(measured.place_m, covariance, self._accel_mps2, stamp_ns)
        sides = np.log(np.minimum(measured.sides_m, measured.most_m))
        track = ObjectTrack(
            self._numbers, motion, sides, measured.side_sigma**2, _LOG_ODDS_NEW, stamp_ns
        )
        self._numbers += 1
        self.tracks.append(track)
        return track

    def _weights(
        self,
        measured: Sequence[Measured],
        fits: Sequence[Sequence[_Fit]],
        holders: Sequence[int | None],
        sees: Callable[[Array], bool],
        dt_s: float,
    ) -> Array:
        weights = np.zeros((len(self.tracks), len(measured)))
        for i, track in enumerate(self.tracks):
            likely = track.existence * _again(track, dt_s)
            unshown = 1.0 - (
                likely if sees(track.motion.place_m) and holders[i] is None else 0.5 * likely
            )
            for j, each in enumerate(measured):
                if track.inferred and fits[i][j].larger:
                    continue  # that is the box of the one that it is in there with
                off_m = each.place_m - track.motion.place_m
                known_m2 = track.motion.place_covariance_m2
                anywhere_m2 = known_m2 + fits[i][j].within_m2
                if mahalanobis2(off_m, anywhere_m2 + each.covariance_m2) > GATE2:
                    continue
                likelihood = density(off_m, anywhere_m2, each.covariance_m2) * _size_fits(
                    track, each
                )
                weights[i, j] = likely * likelihood / (unshown * each.elsewhere_m3)
        return weights

    def _holder(self, track: ObjectTrack, measured: Sequence[Measured]) -> int | None:
        """Return the measurement whose box the track is expected inside; None when there is
        none.
        """
        inside = (column for column, each in enumerate(measured) if _inside(track.motion, each))
        return next(inside, None)

    def _holds_another(
        self, k: int, column: int, holders: Sequence[int | None], assigned: Sequence[int | None]
    ) -> bool:
        """Return whether a track's box has another object in it, that is not shown otherwise."""
        return any(
            other.confirmed and i != k and holders[i] == column and assigned[i] is None
            for i, other in enumerate(self.tracks)
        )

    def _mix(
        self,
        measured: Sequence[Measured],
        fits: Sequence[Sequence[_Fit]],
        holders: Sequence[int | None],
        assigned: Sequence[int | None],
        marginals: Array,
        stamp_ns: int,
        dt_s: float,
    ) -> None:
        """q <- A q for the tracks that there are. A box around more than what is expected in it
        tells nothing.
        """
        before = [track.identity for track in self.tracks]
        for k, column in enumerate(assigned):
            if column is None:
                continue
            follower = self.tracks[k]
            each = measured[column]
            known_m2 = follower.motion.place_covariance_m2
            fit = fits[k][column]
            new = renewal(known_m2, fit.noise_m2, each.place_m - follower.motion.place_m)
            of_known = float(marginals[:, column].sum() + marginals[k].sum() - marginals[k, column])
            newcomers = min(1.0, each.newcomers_m3_s * dt_s / each.elsewhere_m3)
            doubt = newcomers * max(0.0, 1.0 - of_known)
            again = _again(follower, dt_s)
            off_m = each.place_m - follower.motion.place_m
            of_it = again * density(off_m, known_m2 + fit.within_m2, each.covariance_m2)
            of_others = (1.0 - again) * self._others_m3(follower, each) * min(1.0, dt_s / SPELL_S)
            doubt += of_others / (of_others + of_it)
            for i, track in enumerate(self.tracks):
                share = float(marginals[i, column])
                around = holders[i] == column and fit.larger and fits[i][column].larger
                if i == k or around or not share > _FORGOTTEN:
                    continue
                apart = follower.motion.place_m - track.motion.place_m
                if not apart.any():  # as much is known of either: what they part by is what tells
                    apart = each.place_m - track.motion.place_m
                moved = (
                    before[i]
                    * share
                    * renewal(track.motion.place_covariance_m2, fits[i][column].noise_m2, apart)
                )
                track.identity -= moved
                follower.identity += moved
                if assigned[i] is not None:
                    continue
                if follower.shown or not track.confirmed:  # it is out of sight, as that one was
                    doubt += share
                else:  # both were: whichever it is not stays so
                    moved = before[k] * share * new
                    follower.identity -= moved
                    track.identity += moved
            if not (holders[k] == column and fit.larger):
                unseen_s = (stamp_ns - follower.seen_ns) * 1e-9 - dt_s
                follower.doubted(new * min(1.0, doubt), unseen_s)

    def _others_m3(self, follower: ObjectTrack, measured: Measured) -> float:
        """Return the density per m^3 of objects that no track follows, at a measurement: a share
        HIDDEN of as many as there are others, and as far from there as those are, or a body's width.
        """
        off_m = [
            measured.place_m - other.motion.place_m
            for other in self.tracks
            if other is not follower and other.confirmed
        ]
        if not off_m:
            return 0.0
        north, east, down = np.mean(np.square(off_m), axis=0).tolist()
        level_m2 = max(0.5 * (north + east), math.exp(2.0 * float(follower.log_sides[0])))
        own_m2 = follower.motion.covariance[2, 2] + measured.covariance_m2[2, 2]
        volume_m3 = math.sqrt((2.0 * math.pi) ** 3 * (down + own_m2)) * level_m2
        return HIDDEN * len(off_m) / volume_m3

    def _shown(
        self, track: ObjectTrack, measured: Measured, fit: _Fit, stamp_ns: int, dt_s: float
    ) -> None:
        track.motion.update(measured.place_m, fit.noise_m2)
        track.replaced *= (1.0 - SHOWN) ** (dt_s / SPELL_S)
        track.hidden *= math.exp(-dt_s / FORGET_S)
        track.shown = not fit.larger
        track.inferred = False
        track.seen_ns = stamp_ns
        if not track.confirmed:
            track.log_odds += dt_s / SPELL_S
        off = np.log(measured.sides_m) - track.log_sides
        variance = track.size_variance + measured.side_sigma**2
        # else more is in its box, or less of it is seen
        if not fit.larger and float(off @ off) <= 9.0 * variance:
            gain = track.size_variance / variance
            track.log_sides = track.log_sides + gain * off
            track.size_variance *= 1.0 - gain

    def _open(
        self,
        measured: Sequence[Measured],
        marginals: Array,
        fits: Sequence[Sequence[_Fit]],
        holders: Sequence[int | None],
        stamp_ns: int,
    ) -> None:
        """Begin tracks of what no track was updated with, and is no part of an object."""
        known = list(self.tracks)
        taken = {n: each for n, each in zip(self._assigned, measured, strict=True) if n is not None}
        for column, each in enumerate(measured):
            if self._assigned[column] is not None or len(self.tracks) >= _MOST_TRACKS:
                continue
            if any(_is_part(each, track, taken.get(track.number)) for track in known):
                continue
            if any(
                holders[i] == column and fits[i][column].larger
                for i, other in enumerate(known)
                if other.confirmed
            ):
                continue  # it is around an object that is known, and more
            track = self._begin(each, stamp_ns)
            self._assigned[column] = track.number
            for i, other in enumerate(known):
                apart = each.place_m - other.motion.place_m
                share = marginals[i, column] * renewal(
                    other.motion.place_covariance_m2, fits[i][column].noise_m2, apart
                )
                share = max(float(share), other.doubt)  # what was replaced may be this
                if share > _FORGOTTEN:
                    track.owed[other.number] = share

    def _infer(
        self,
        known: Sequence[ObjectTrack],
        measured: Sequence[Measured],
        assigned: Sequence[int | None],
        stamp_ns: int,
        dt_s: float,
    ) -> None:
        """Begin a track of another one that is in a box of what may be the designated object, where
        that box is larger than the target can be and nobody known who is not shown may be in it.
        """
        for track, column in zip(known, assigned, strict=True):
            if column is None or self.probability(track.number) <= _WORTH_KEEPING:
                continue
            each = measured[column]
            if not np.any(np.asarray(each.sides_m) > each.most_m):
                continue
            inside = [
                other
                for other, own in zip(known, assigned, strict=True)
                if own is None
                and (other.confirmed or other.inferred)
                and _inside(other.motion, each, _FITS)
            ]
            for other in inside:
                if other.inferred:
                    other.log_odds += dt_s / SPELL_S
                    other.seen_ns = stamp_ns
            if not inside and len(self.tracks) < _MOST_TRACKS:
                other = self._begin(each, stamp_ns)
                other.motion.covariance[:3, :3] += _within(np.asarray(each.sides_m), each.axes)
                other.log_sides = track.log_sides.copy()
                other.size_variance = track.size_variance
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
                        left = max(0.0, 1.0 - share / max(other.doubt, _FORGOTTEN))
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


def _again(track: ObjectTrack, dt_s: float) -> float:
    """Return the probability that a frame shows an object that exists: misses last SPELL_S."""
    return SHOWN if track.shown else min(SHOWN, dt_s / SPELL_S)


def _halves(beyond_m: Array) -> Array:
    """Return the variances of a middle that is within half of so much, right, down and ahead: there
    by default as much as the larger one.
    """
    ahead_m = beyond_m[2] if len(beyond_m) > 2 else max(beyond_m)
    halves = 0.5 * np.array([beyond_m[0], beyond_m[1], ahead_m])
    return halves * halves


def _times_as_far(place_m: Array, measured: Measured) -> float:
    """Return how many times as far ahead of the camera as a box's middle a place is."""
    ahead = measured.axes[:, 2]
    box_m = float(ahead @ (measured.place_m - measured.eye_m))
    return float(ahead @ (place_m - measured.eye_m)) / box_m


def _inside(motion: Motion, measured: Measured, sigmas: float = 0.0) -> bool:
    """Return whether an object is seen in a box, by its direction and at any range, or may be
    within so many standard deviations.
    """
    times = _times_as_far(motion.place_m, measured)
    if not times > 0.0:
        return False
    across = measured.axes[:, :2]
    seen_m = measured.eye_m + (motion.place_m - measured.eye_m) / times
    off = np.abs(across.T @ (seen_m - measured.place_m))
    spread = np.sqrt(np.diag(across.T @ motion.place_covariance_m2 @ across)) / times
    return bool(np.all(off <= 0.5 * np.asarray(measured.sides_m) + sigmas * spread))


def _hold(motion: Motion, measured: Measured) -> None:
    """Keep an object in a box that is another one's: in its direction, at any range."""
    times = max(_times_as_far(motion.place_m, measured), 1e-9)
    wide, high = measured.sides_m
    ahead = measured.axes[:, 2]
    known_m = math.sqrt(float(ahead @ motion.place_covariance_m2 @ ahead))
    bounds = _bounded(motion, np.array([times * wide, times * high, 2.0 * known_m]), measured.axes)
    place_m = measured.eye_m + times * (measured.place_m - measured.eye_m)
    motion.update(place_m, measured.covariance_m2 + bounds)


def _within(beyond_m: Array, axes: Array) -> Array:
    """Return the covariance (3, 3) of a middle that is within half of so much of a box's."""
    return (axes * _halves(beyond_m)) @ axes.T


def _bounded(motion: Motion, beyond_m: Array, axes: Array) -> Array:
    """Return what to add to a noise so that a place is known to half of so much afterwards, and no
    better.

    What is off stays off for as long as it lasts: however many frames say it, they are one. An axis
    along which the place is known better already is told nothing.
    """
    bounds = _halves(beyond_m)
    known = np.einsum("ij,ik,kj->j", axes, motion.place_covariance_m2, axes)
    left = np.maximum(known - bounds, _NOTHING * bounds + 1e-12)
    return (axes * (bounds * np.maximum(known, bounds) / left)) @ axes.T


@dataclass(frozen=True, slots=True)
class _Fit:
    """A measurement, if it is of a track's object.

    Attributes:
        within_m2: covariance (3, 3) of the object's middle in its box, beside the box's own noise.
            It is bounded: a box may err more than its noise has it, but an object is inside its
            box.
        noise_m2: what the track is updated with.
        larger: whether something else is in its box.
    """

    within_m2: Array
    noise_m2: Array
    larger: bool


def _fit(track: ObjectTrack, measured: Measured, *, shared: bool = False) -> _Fit:
    """Return how a measurement is of a track's object. ``shared``: another one that is not shown is
    in its box too, so that what it is larger by than the object was is that one's: the object need
    not have turned.
    """
    sides = np.asarray(measured.sides_m)
    turned = 0.0 if shared else track.size_variance
    factor = math.exp(_FITS * math.sqrt(turned + measured.side_sigma**2))
    expected = np.minimum(np.exp(track.log_sides), measured.most_m)
    more = np.maximum(sides - np.minimum(factor * expected, measured.most_m), 0.0)
    beyond = np.maximum(expected / factor - sides, more)
    if more.any():  # it may be as small as that, anywhere in there
        beyond = np.maximum(sides - expected / factor, beyond)
    if not beyond.any():
        return _Fit(_NOWHERE_ELSE, measured.covariance_m2, larger=False)
    noise = measured.covariance_m2 + _bounded(track.motion, beyond, measured.axes)
    return _Fit(_within(beyond, measured.axes), noise, bool(more.any()))


def _size_fits(track: ObjectTrack, measured: Measured) -> float:
    """Return how much likelier the sides of a box are, if it is of this track's object, than of
    anything.
    """
    variance = track.size_variance + measured.side_sigma**2
    off = np.log(measured.sides_m) - track.log_sides
    tails = (1.0 + off * off / (variance * _SIZE_TAIL)) ** (-0.5 * (_SIZE_TAIL + 1.0))
    return float(np.prod(0.3675 / math.sqrt(variance) * tails)) / _SIZE_DENSITY**2


def _is_part(measured: Measured, track: ObjectTrack, taken: Measured | None) -> bool:
    """Return whether a box is of a track's object, a second time.

    It is when what it covers together with the box that the track has in this frame, or is expected
    to have, is no larger than that object.
    """
    if not track.confirmed:
        return False
    expected = track.sides_m(measured.most_m)
    place_m, sides = (
        (track.motion.place_m, expected)
        if taken is None
        else (taken.place_m, np.asarray(taken.sides_m))
    )
    off = np.abs(measured.axes[:, :2].T @ (place_m - measured.place_m))
    own = np.asarray(measured.sides_m)
    covered = np.maximum(np.maximum(sides, own), off + 0.5 * (sides + own))
    spread = math.exp(_FITS * math.sqrt(track.size_variance + measured.side_sigma**2))
    return bool(np.all(covered <= np.minimum(expected * spread, measured.most_m)))

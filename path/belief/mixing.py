"""How the identity of what was designated goes over from track to track in a frame.

q_i is the probability that the object of track i is the designated one; what is missing from
their sum to 1 is for an object that no track follows. Let beta_ij be the marginals of a frame
(``path.belief.assignment``), and j(i) the measurement that track i was updated with. If
measurement j(k) was of i, then track k follows from now on what i followed before:

    q <- A q,     A_ki = g beta_{i j(k)}  for k != i

g is how much of i's place the measurement makes new (``path.belief.motion.renewal``): a track
whose place is known well is not carried off by one frame, and one that nobody saw for a while
is whatever it is found as. (Identity management: Shin, Guibas, Zhao 2003.) A new track takes its
share only as far as it exists.

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
from collections.abc import Sequence

import numpy as np

from path.belief.boxes import Measured
from path.belief.frame import Frame, again
from path.belief.motion import density, renewal
from path.belief.track import HIDDEN, SPELL_S, ObjectTrack

FORGOTTEN = 1e-9


def mix(tracks: Sequence[ObjectTrack], frame: Frame, stamp_ns: int) -> None:
    """q <- A q for the tracks that there are. A box around more than what is expected in it tells
    nothing.
    """
    before = [track.identity for track in tracks]
    for k, column in enumerate(frame.assigned):
        if column is None:
            continue
        follower = tracks[k]
        each = frame.measured[column]
        fit = frame.fits[k][column]
        off_m = fit.place_m - follower.motion.place_m
        new = renewal(follower.motion.place_covariance_m2, fit.noise_m2, off_m)
        doubt = _of_unknown(tracks, k, column, frame)
        for i, track in enumerate(tracks):
            share = float(frame.marginals[i, column])
            around = fit.larger and frame.is_around(i, column)
            if i == k or around or not share > FORGOTTEN:
                continue
            apart = follower.motion.place_m - track.motion.place_m
            if not apart.any():  # as much is known of either: what they part by is what tells
                apart = each.place_m - track.motion.place_m
            known_m2 = track.motion.place_covariance_m2
            moved = before[i] * share * renewal(known_m2, frame.fits[i][column].noise_m2, apart)
            track.identity -= moved
            follower.identity += moved
            if frame.assigned[i] is not None:
                continue
            if follower.shown or not track.confirmed:  # it is out of sight, as that one was
                doubt += share
            else:  # both were: whichever it is not stays so
                moved = before[k] * share * new
                follower.identity -= moved
                track.identity += moved
        if not frame.is_around(k, column):
            unseen_s = (stamp_ns - follower.seen_ns) * 1e-9 - frame.dt_s
            follower.doubted(new * min(1.0, doubt), unseen_s)


def _of_unknown(tracks: Sequence[ObjectTrack], k: int, column: int, frame: Frame) -> float:
    """Return how likely a track's measurement is of an object that no track follows: of one that
    came into view, or that was out of sight.
    """
    follower = tracks[k]
    each = frame.measured[column]
    marginals = frame.marginals
    of_known = float(marginals[:, column].sum() + marginals[k].sum() - marginals[k, column])
    newcomers = min(1.0, each.newcomers_m3_s * frame.dt_s / each.elsewhere_m3)
    shown_again = again(follower, frame.dt_s)
    fit = frame.fits[k][column]
    off_m = fit.place_m - follower.motion.place_m
    anywhere_m2 = follower.motion.place_covariance_m2 + fit.within_m2
    of_it = shown_again * density(off_m, anywhere_m2, each.covariance_m2)
    unseen_m3 = (1.0 - shown_again) * others_m3(tracks, follower, each)
    of_others = unseen_m3 * min(1.0, frame.dt_s / SPELL_S)
    return newcomers * max(0.0, 1.0 - of_known) + of_others / (of_others + of_it)


def others_m3(tracks: Sequence[ObjectTrack], follower: ObjectTrack, measured: Measured) -> float:
    """Return the density per m^3 of objects that no track follows, at a measurement: a share
    HIDDEN of as many as there are others, and as far from there as those are, or a body's width.
    """
    off_m = [
        measured.place_m - other.motion.place_m
        for other in tracks
        if other is not follower and other.confirmed
    ]
    if not off_m:
        return 0.0
    north, east, down = np.mean(np.square(off_m), axis=0).tolist()
    level_m2 = max(0.5 * (north + east), math.exp(2.0 * float(follower.log_sides[0])))
    own_m2 = follower.motion.covariance[2, 2] + measured.covariance_m2[2, 2]
    volume_m3 = math.sqrt((2.0 * math.pi) ** 3 * (down + own_m2)) * level_m2
    return HIDDEN * len(off_m) / volume_m3

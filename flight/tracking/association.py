"""Finding one object again from frame to frame: its track (``target_track``) is associated in the
image.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.interfaces import View
from flight.guidance import Vec3
from flight.tracking.identity import LEAST_IDENTITY
from flight.tracking.objects import (
    LARGER,
    ImageObject,
    Pixel,
    by_distance,
    cut_sides,
    is_larger,
)
from flight.tracking.places import at_height, place, point_in_camera, to_local
from flight.tracking.standing_out import ABOVE, standing_out
from flight.tracking.target_track import TargetTrack
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Detection, MissReason, Region, common_area
from path.target.range import LEAST_DESCENT, Ranged
from path.target.rivals import MOST, Rival
from path.values import value

# Shares of the object's distance along the optical axis.
RIVAL_REACH = 0.29
_BESIDE = 0.48  # around the object, what else is told of
# how far a depth may put the object from its prediction, besides what is not known of either
DEPTH_FLOOR = 0.096
# after so long anything else that the object may have come to might as well be the object
UNSEEN_S = 0.5
SURE = 0.95
"""The probability by the belief with which an object is taken again that others stood around."""
_RATHER = 0.5  # the least probability with which an object in sight is followed when none was kept
_OUTSIDE_PX = 60.0  # so far outside the image an object's middle may be, and a part of it inside
AMBIGUITY = 0.6
DEPTH_SIGMAS = 3.0
_SIDE_PX = 3.0  # noise of a box's side
# after it was seen whole, an object is taken to be in a larger box; then what is there may be
# anything
_HELD_S = 5.0


@value
class Sighting:
    """The tracked object in one frame.

    ``depth`` is None where nothing gave a range to be trusted. ``beside``: the objects nearest to
    it that look like it, of those that were looked for. ``ranged``: what the depth rests on.
    """

    box: Box
    depth: Depth | None
    beside: tuple[Rival, ...] = ()
    ranged: Ranged | None = None


def follow(
    view: View, T_n_c: Pose, camera: CameraModel, track: TargetTrack
) -> Sighting | MissReason:
    """Find the tracked object in a view and update the track.

    The object must be where the track predicts it, and clearly nearer to there than anything that
    looks alike. Where such a thing was seen beside it, the gate does not reach it, however long the
    object is missed; and an object that was out of sight for a while is taken again only when
    nothing else is as far as it can have come, nor lately was (a detector misses objects), or the
    belief is sure of it. Nor is what is much smaller than the object was, whose box may have been
    around two. What depth shows to be farther behind than the object can have come counts for none
    of this while another is in sight. Without depth, or with a range that is only estimated, it is
    taken to be as high as it was: so the drone keeps following while the frame is a miss, and does
    not follow a range that changes with the target's heading. A depth that puts it elsewhere on its ray is of something
    else, such as the other drone in front of it: that is no depth. A box that the image's border
    cuts is not the object's: it keeps the track, and the frame is a miss. Two boxes that are the
    object's size together are the object, and not something beside it. A box that has suddenly
    grown has something else in it as well: the object is somewhere in there, and the frame is a
    miss too. Where no box is, what stands out there by its depth carries the track for a while: a
    miss all the same, and OCCLUDED where depth shows something nearer.
    """
    looked = _looked(view, T_n_c, camera, track)
    if looked is None:
        return MissReason.NO_TARGET
    found, (predicted_n, sigma_m), (u, v), z = looked
    track.range_m = z
    gate_m = track.gate_m(sigma_m, view.stamp_ns)
    px_per_m = camera.fx / z
    unseen = _unseen(track, view.stamp_ns)
    around = by_distance(found, (u, v), camera, track.size_m, track.usual_m, z)
    seen = around
    if track.identity is not None:
        own = [each for each in found if not track.identity.is_other(each.box)]
        seen = by_distance(own, (u, v), camera, track.size_m, track.usual_m, z)
    ranked = seen if len(seen) < 2 else _not_behind(seen, view, z + track.reach_m(view.stamp_ns))
    if unseen and len(ranked) > 1:
        track.note_company(view.stamp_ns)
    side_px = (
        None if track.size_m is None else (px_per_m * track.size_m[0], px_per_m * track.size_m[1])
    )
    if (
        not ranked
        or ranked[0].off_px > px_per_m * gate_m
        or ranked[0].more
        or _has_more(ranked[0].box, z, sigma_m, T_n_c, track)
    ):
        return _unfound(
            view, T_n_c, camera, track, (seen, around), ((u, v), z, sigma_m), px_per_m * gate_m
        )
    chosen = ranked[0]
    nearly = False
    if len(ranked) > 1:
        track.note_rival(_nearest_m(ranked, px_per_m), view.stamp_ns)
        nearly = _nearly_as_near(ranked)
    doubtful = track.accompanied(view.stamp_ns) and not _is_surely(track, chosen.box)
    if nearly or (unseen and (doubtful or _is_part(chosen.box, side_px))):
        return MissReason.AMBIGUOUS_TARGET
    if chosen.cut:
        _bound(track, chosen.pixel, camera, T_n_c, view.stamp_ns)
        return MissReason.NO_TARGET
    box = chosen.box
    sides_m = box.w * z / camera.fx, box.h * z / camera.fy
    if (
        track.outgrown(sides_m, _SIDE_PX / max(1.0, min(box.w, box.h)), view.stamp_ns)
        and side_px is not None
    ):
        _bound(track, _within(box, (u, v), side_px, camera), camera, T_n_c, view.stamp_ns)
        return MissReason.AMBIGUOUS_TARGET
    track.note_size(sides_m, view.stamp_ns)
    depth = view.depth(box)
    if depth is not None:
        shown = to_local(point_in_camera(box, depth.z_m, camera), T_n_c)
        reach_m = DEPTH_FLOOR * z + DEPTH_SIGMAS * math.hypot(sigma_m, depth.sigma_m)
        depth = depth if math.dist(shown, predicted_n) <= reach_m else None
    down_m = track.position_n_m[2]
    measured = (
        at_height(box.center, camera, T_n_c, down_m)
        if depth is None
        else place(box, depth, camera, T_n_c, down_m)
    )
    if measured is not None:
        track.update(measured, view.stamp_ns)
    others = [each for each in around if common_area(each.box, box) < 0.9 * each.box.area]
    return _offered(Sighting(box, depth, _beside(view, box, others, camera)), camera, T_n_c, track)


def _looked(
    view: View, T_n_c: Pose, camera: CameraModel, track: TargetTrack
) -> tuple[Sequence[Detection], tuple[Vec3, float], Pixel, float] | None:
    """Look where the object can be, and what is around it; take the track to where the object
    surely is.

    Returns:
        what was found; the place at which the object is expected, and its standard deviation; the
        pixel and the depth of that. None when it is outside the image.
    """
    expected = _expected(track, T_n_c, camera, view.stamp_ns)
    region = None if expected is None else _region(expected, track, camera, view.stamp_ns)
    identity = track.identity
    if identity is None:
        return None if expected is None or region is None else (view.targets(region), *expected)
    whole = identity.region(region, T_n_c, camera)
    if whole is None:
        return None
    found = view.targets(whole)
    predicted_n, sigma_m = track.predict(view.stamp_ns)
    identity.note(
        view,
        T_n_c,
        camera,
        whole,
        found,
        (predicted_n, track.range_m if expected is None else expected[2]),
    )
    # who nobody has kept for a while is rather looked for where it most likely is
    shown = identity.shown(_RATHER if _unseen(track, view.stamp_ns) else LEAST_IDENTITY)
    if shown is not None:
        north, east, _ = shown.mean[:3].tolist()
        off_m = math.hypot(north - predicted_n[0], east - predicted_n[1])
        if expected is None or off_m > track.gate_m(sigma_m, view.stamp_ns):
            track.found_again(shown)
            expected = _expected(track, T_n_c, camera, view.stamp_ns)
    return None if expected is None else (found, *expected)


def _expected(
    track: TargetTrack, T_n_c: Pose, camera: CameraModel, stamp_ns: int
) -> tuple[tuple[Vec3, float], Pixel, float] | None:
    predicted_n, sigma_m = track.predict(stamp_ns)
    x, y, z = T_n_c.inverse().apply(np.asarray(predicted_n)).tolist()
    if z <= 0.0 or not camera.sees((x, y, z), -_OUTSIDE_PX):
        return None
    return (predicted_n, sigma_m), camera.project_point((x, y, z)), z


def _region(
    expected: tuple[tuple[Vec3, float], Pixel, float],
    track: TargetTrack,
    camera: CameraModel,
    stamp_ns: int,
) -> Region:
    """Return where the object may be, and what can be mistaken for it."""
    (_, sigma_m), (u, v), z = expected
    track.range_m = z
    reach_m = track.reach_m(stamp_ns) if _unseen(track, stamp_ns) else 0.0
    gate_m = track.gate_m(sigma_m, stamp_ns)
    reach_px = camera.fx / z * max(reach_m, gate_m / AMBIGUITY, RIVAL_REACH * z)
    side_px = max(track.usual_m or (0.0, 0.0)) * camera.fx / z
    return Region(u - reach_px, v - reach_px, u + reach_px, v + reach_px, side_px=side_px)


def _offered(
    seen: Sighting, camera: CameraModel, T_n_c: Pose, track: TargetTrack
) -> Sighting | MissReason:
    """The sighting to be offered; none where it may be of another object than the designated
    one.
    """
    if track.identity is not None and track.identity.of(seen.box) < LEAST_IDENTITY:
        return MissReason.AMBIGUOUS_TARGET
    return _ranged(seen, camera, T_n_c, track)


def _ranged(seen: Sighting, camera: CameraModel, T_n_c: Pose, track: TargetTrack) -> Sighting:
    """The sighting with everything that says how far away it is; what stands beside it is as far as
    that, about.
    """
    ranging = track.ranging
    if ranging is None:
        return seen
    beside: list[Rival] = []
    for each in seen.beside:
        found = ranging.ranged(each.depth, each.box, camera, T_n_c, track.range_m)
        beside.append(Rival(each.box, None if found is None else found.depth))
    ranged = ranging.ranged(seen.depth, seen.box, camera, T_n_c, track.range_m)
    return Sighting(seen.box, None if ranged is None else ranged.depth, tuple(beside), ranged)


def _unfound(
    view: View,
    T_n_c: Pose,
    camera: CameraModel,
    track: TargetTrack,
    objects: tuple[Sequence[ImageObject], Sequence[ImageObject]],
    expected: tuple[Pixel, float, float],
    reach_px: float,
) -> MissReason:
    """Keep the track, where there is no box of the object's own, by a box around it, or by what
    stands out there.

    A track that nothing kept for a while is not taken up again by depth.

    Args:
        objects: those that may be the object, and all there are.
        expected: pixel and depth of the object, and its standard deviation. reach_px: how far from
            there it may be.
    """
    (pixel, z_m, sigma_m), size_m = expected, track.size_m
    if size_m is None:
        return MissReason.NO_TARGET
    side_px = camera.fx / z_m * size_m[0], camera.fx / z_m * size_m[1]
    lately = view.stamp_ns - track.whole_ns <= _HELD_S * 1e9
    carriable = not _unseen(track, view.stamp_ns) and track.carriable(view.stamp_ns)
    holder = _holder(objects[0], pixel, side_px, camera) if lately else None
    if holder is not None:
        _bound(track, holder, camera, T_n_c, view.stamp_ns)
    body = None
    if carriable:
        row = pixel[1] - ABOVE * side_px[1]
        (x, y), (x_row, y_row) = camera.ray(*pixel), camera.ray(pixel[0], row)
        # an upright body is as far along the ground in the row above its middle, and not as deep in
        # a view from above
        along = _level(T_n_c, (x, y, 1.0))
        along_row = _level(T_n_c, (x_row, y_row, 1.0))
        if along_row > LEAST_DESCENT:
            body = standing_out(
                view, (pixel[0], row), z_m * along / along_row, side_px[0], reach_px
            )
    others = [
        each.box
        for each in objects[1]
        if not (
            _is_around(each.box, pixel, side_px)
            and (holder is not None or _has_more(each.box, z_m, sigma_m, T_n_c, track))
        )
    ]
    # else it is what has that box
    if body is not None and not any(_is_in(body[0], box) for box in others):
        (x, y), depth_m = camera.ray(*body[0]), body[1]
        place_n = to_local((x * depth_m, y * depth_m, depth_m), T_n_c)
        track.carry(place_n, view.stamp_ns)
        if track.identity is not None:
            track.identity.carry(place_n, view.stamp_ns)
    if holder is not None:
        return MissReason.AMBIGUOUS_TARGET
    hidden = _is_hidden(view, pixel, side_px, z_m - reach_px * z_m / camera.fx)
    return MissReason.OCCLUDED if hidden else MissReason.NO_TARGET


def _is_hidden(view: View, pixel: Pixel, side_px: tuple[float, float], nearest_m: float) -> bool:
    """Return whether something stands before the place of an object that is no nearer than that."""
    width, height = side_px
    depth = view.depth(Box(pixel[0] - 0.5 * width, pixel[1] - 0.5 * height, width, height))
    if depth is None:
        return False
    return (1.0 + DEPTH_FLOOR) * depth.z_m + DEPTH_SIGMAS * depth.sigma_m < nearest_m


def _unseen(track: TargetTrack, stamp_ns: int) -> bool:
    """Return whether nothing has kept a track for so long that what stands there by now may be
    anything.
    """
    return stamp_ns - track.stamp_ns > UNSEEN_S * 1e9


def _is_surely(track: TargetTrack, box: Box) -> bool:
    """Return whether the belief, which tracks what is around too, takes a box for the object's."""
    return track.identity is not None and track.identity.of(box) >= SURE


def _not_behind(seen: list[ImageObject], view: View, most_m: float) -> list[ImageObject]:
    """The objects of several that may be no deeper than that, as far as depth tells; all of them if
    it tells of none.

    A depth in front of it says nothing: it may be of what hides the object.
    """
    return [each for each in seen if each.cut or _least_m(view.depth(each.box)) <= most_m] or seen


def _least_m(depth: Depth | None) -> float:
    """The least that something is away by its depth; 0 when there is none."""
    return 0.0 if depth is None else (1.0 - DEPTH_FLOOR) * depth.z_m - DEPTH_SIGMAS * depth.sigma_m


def _has_more(box: Box, z_m: float, sigma_m: float, T_n_c: Pose, track: TargetTrack) -> bool:
    """Return whether a box, if it is where the object is, has something else in it, however long
    it has been so.
    """
    return track.largest is not None and not track.largest.holds(box, z_m, sigma_m, T_n_c)


def _level(T_n_c: Pose, ray_c: Vec3) -> float:
    """The part of a ray that is along the ground."""
    north, east, _ = (T_n_c.R @ ray_c).tolist()
    return math.hypot(north, east)


def _is_in(pixel: Pixel, box: Box) -> bool:
    return box.x <= pixel[0] <= box.x + box.w and box.y <= pixel[1] <= box.y + box.h


def _bound(
    track: TargetTrack, pixel: Pixel, camera: CameraModel, T_n_c: Pose, stamp_ns: int
) -> None:
    """Keep the track by where the object about is, as high as it was; the velocity learns
    nothing.
    """
    bounded = at_height(pixel, camera, T_n_c, track.position_n_m[2])
    if bounded is not None:
        track.update(bounded, stamp_ns, cut=True)


def _holder(
    ranked: Sequence[ImageObject],
    expected: Pixel,
    side_px: tuple[float, float],
    camera: CameraModel,
) -> Pixel | None:
    """The place of the object in a box that it no longer has to itself: one around where it is
    expected, and larger.
    """
    for each in ranked:
        if _is_around(each.box, expected, side_px):
            return _within(each.box, expected, side_px, camera)
    return None


def _is_part(box: Box, side_px: tuple[float, float] | None) -> bool:
    """Return whether a box is so much smaller than the object's own was, both ways, that the other
    may be of two.
    """
    return side_px is not None and LARGER * box.w < side_px[0] and LARGER * box.h < side_px[1]


def _is_around(box: Box, expected: Pixel, side_px: tuple[float, float]) -> bool:
    return _is_in(expected, box) and is_larger(box, side_px)


def _within(box: Box, expected: Pixel, side_px: tuple[float, float], camera: CameraModel) -> Pixel:
    """The pixel nearest to the expected one around which an object with these sides is in the box.

    A side that the image's border cuts bounds nothing.
    """
    (u, v), (middle_u, middle_v) = expected, box.center
    cut_u = cut_sides(box.x, box.w, camera.width)
    cut_v = cut_sides(box.y, box.h, camera.height)
    return _nearest(u, middle_u, box.w - side_px[0], cut_u), _nearest(
        v, middle_v, box.h - side_px[1], cut_v
    )


def _nearest(expected: float, middle: float, room: float, cut: tuple[bool, bool]) -> float:
    """The place nearest to the expected one that is within half the room of a middle, and anywhere
    past a cut side.
    """
    room = room if any(cut) else max(0.0, room)
    first = -math.inf if cut[0] else middle - 0.5 * room
    last = math.inf if cut[1] else middle + 0.5 * room
    return max(first, min(last, expected))


def _beside(
    view: View, own: Box, others: Sequence[ImageObject], camera: CameraModel
) -> tuple[Rival, ...]:
    """The whole objects nearest to a box, with their depth."""
    near = [
        each.box
        for each in others
        if not each.cut and math.dist(each.pixel, own.center) <= camera.fx * _BESIDE
    ]
    near.sort(key=lambda box: math.dist(box.center, own.center))
    return tuple(Rival(box, view.depth(box)) for box in near[:MOST])


def _nearest_m(ranked: Sequence[ImageObject], px_per_m: float) -> float:
    """From the first object to the nearest other one."""
    first, *others = (each.pixel for each in ranked)
    return min(math.dist(first, other) for other in others) / px_per_m


def _nearly_as_near(ranked: Sequence[ImageObject]) -> bool:
    """True when the second object might be the one expected as well as the first."""
    return ranked[0].off_px > AMBIGUITY * ranked[1].off_px

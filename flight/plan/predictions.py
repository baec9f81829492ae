"""What to expect of a hand-over at a planned geometry: pixels, errors, times, and what can be
borne. Pure.
"""

from __future__ import annotations

import math

from drivers.detectors.measured import recall_at
from drivers.link.wire import PART_WIRE_BYTES
from flight.common_view import parts_hz
from flight.plan.errors import Predicted, predict
from flight.plan.facts import Facts
from flight.plan.flown import Flown
from flight.plan.geometry import Apparent, apparent
from flight.plan.room import CATCH_UP, agreement_s, most_wind_mps
from flight.plan.sight import nearest_told_apart_m
from flight.rendezvous.viewpoint import Viewpoint
from path.values import frozen


@frozen
class Prediction:
    """One expected figure: by key for a program, in words for a person. NaN: it cannot be told."""

    key: str
    what: str
    value: float
    said: str


def predictions(of: Flown) -> tuple[Prediction, ...]:
    """Predict all that can be told."""
    return (*_sight(of), *_errors(of), *_limits(of), *_link(of))


def _sight(of: Flown) -> list[Prediction]:
    facts = of.facts
    seen = apparent(facts, of.range_m)
    found = [
        Prediction(
            "range_m",
            "D1 follows from",
            of.range_m,
            f"{of.range_m:.2f} m, {of.mission.follow.height_m:.2f} m above the ground",
        ),
        Prediction(
            "target_px",
            "the target in D1's image",
            seen.short_px,
            f"{seen.width_px:.0f} x {seen.height_px:.0f} px",
        ),
    ]
    viewpoint = of.placed.viewpoint
    if not isinstance(viewpoint, Viewpoint):
        return found
    distance_m = math.hypot(*viewpoint.camera_h_m)
    share = of.range_m / of.placed.receiver_range_m
    zoom = facts.receiver.camera.fx / facts.sender.camera.fx
    theirs_px = share * zoom * seen.short_px
    return [
        *found,
        Prediction(
            "marker_px",
            "the plate in D2's image",
            viewpoint.marker_px,
            f"{viewpoint.marker_px:.0f} px, from {distance_m:.2f} m,"
            f" {math.degrees(viewpoint.incidence_rad):.0f} deg aslant",
        ),
        Prediction(
            "receiver_target_px",
            "the target in D2's image",
            theirs_px,
            f"{theirs_px:.0f} px, from {of.placed.receiver_range_m:.2f} m",
        ),
        *_found(facts, seen, share * zoom),
        Prediction(
            "margin_px",
            "room to the border of D2's image",
            viewpoint.margin_px,
            f"{viewpoint.margin_px:.0f} px",
        ),
    ]


def _found(facts: Facts, seen: Apparent, zoom: float) -> list[Prediction]:
    """Predict how often both detectors find the target, where that was measured."""
    if not facts.found:
        return []
    side_px = max(seen.width_px, seen.height_px)
    ours = recall_at(facts.found, side_px)
    theirs = recall_at(facts.found, zoom * side_px)
    said = f"{100.0 * ours:.0f} % of D1's, {100.0 * theirs:.0f} % of D2's"
    return [Prediction("found_share", "frames in which it is found", ours * theirs, said)]


def _errors(of: Flown) -> list[Prediction]:
    if not isinstance(of.placed.viewpoint, Viewpoint):
        return []
    expected = predict(of.facts, of.placed)
    apart_m = nearest_told_apart_m(of)
    rates = [eye.rate_hz for eye in (of.facts.sender, of.facts.receiver) if eye.rate_hz is not None]
    found = [
        Prediction(
            "receiver_error_m",
            "error of D2",
            expected.receiver_m,
            f"{1e3 * expected.receiver_m:.0f} mm, median",
        ),
        Prediction(
            "target_error_m",
            "error of the target",
            expected.target_m,
            f"{1e3 * expected.target_m:.0f} mm, median",
        ),
        Prediction(
            "offset_sigma_m",
            "between both boxes",
            expected.offset_sigma_m,
            f"{1e3 * expected.offset_sigma_m:.0f} mm (one sigma), most of it: {_foremost(expected)}",
        ),
        Prediction(
            "apart_m",
            "nearest look-alike told apart",
            apart_m,
            f"{apart_m:.2f} m beside the target",
        ),
    ]
    if rates:
        takes_s = agreement_s(of.facts, min(rates))
        said = f"{takes_s:.1f} s at {min(rates):g} frames a second, when nothing is missed"
        found.append(Prediction("agreement_s", "time to agreement", takes_s, said))
    return found


def _foremost(expected: Predicted) -> str:
    worst = sorted(expected.sources, key=lambda source: -source.sigma_m)[:2]
    return ", ".join(f"{source.name} {1e3 * source.sigma_m:.0f} mm" for source in worst)


def _limits(of: Flown) -> list[Prediction]:
    speed_mps = of.mission.follow.max_speed_mps / CATCH_UP
    wind_mps = most_wind_mps(of)
    return [
        Prediction(
            "speed_mps", "fastest target that is followed", speed_mps, f"{speed_mps:.1f} m/s"
        ),
        Prediction("wind_mps", "wind that can be borne", wind_mps, f"{wind_mps:.1f} m/s"),
    ]


def _link(of: Flown) -> list[Prediction]:
    """Predict what common views take of the link, besides all else that is said on it."""
    if not of.facts.method.common_view:
        return []
    rate = PART_WIRE_BYTES * parts_hz()
    said = f"{rate:.0f} B/s from D1 to D2, at the most: common views"
    return [Prediction("common_view_bytes_per_s", "keyframes on the link", rate, said)]

"""The map from above of a run's page, and what was found in its images.

What is drawn is what the live page is told: the logs are played to its ``FlightState`` once more. It is
SVG and CSS, without a script: many a CI that keeps such pages runs none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from drivers.log.mcap_log import LogRecord
from missions.look.live.drone import Snapshot
from missions.look.live.flight_state import TRAIL_NS, FlightState
from missions.look.report.palette import DIM, FAULT, INK, NEEDED, ROLE
from missions.look.report.records import Records
from path.messages import Role
from path.values import frozen

TOPICS = (
    "/setup", "/home", "/phase", "/state", "/target", "/candidate", "/track", "/marker", "/agreement",
    "/question", "/responsibility", "/outcome",
)  # fmt: skip
WIDTH_PX = 400.0
HIGHEST_PX = 460.0
ROUND = 1.3  # of what is shown, with some room around
LEAST_M = 4.0
MOST_MOMENTS = 24
MOST_RECORDS = 6000  # of one topic of a drone: of hours, every so-manieth
MOST_PLACES = 500  # of one way
STEPS_M = (0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)
STEP_PX = 48.0
COLORS = {role.value: color for role, color in ROLE.items()}  # of boxes in images
INKS = {role.value: color for role, color in INK.items()}  # of the map
MAPPED = "mapped"
KINDS = {"target": "target", MAPPED: "D2's box", "marker": "marker"}

Place = Sequence[float]
"""North and east, m."""


@frozen
class Moment:
    """What was so when a phase began, or at the end."""

    title: str
    now: Snapshot


@frozen
class Played:
    """A run as the live page would have shown it.

    Attributes:
        ways: places of each drone, by its name.
        target: the target's.
        found: of each drone, what was found in its frames: stamp, kind, px.
    """

    moments: Sequence[Moment]
    ways: Mapping[str, Sequence[Place]]
    target: Sequence[Place]
    site: Snapshot | None
    found: Mapping[str, Sequence[tuple[int, str, Any]]]


def played(logs: Mapping[str, Records]) -> Played:
    """Play the logs of a run's drones, each by its name."""
    state = FlightState()
    moments: list[Moment] = []
    ways: dict[str, list[Place]] = {}
    found: dict[str, list[tuple[int, str, Any]]] = {name: [] for name in logs}
    target: list[Place] = []
    target_ns = 0
    for name, record in _in_order(logs):
        before = state.drones[name].phase if name in state.drones else ""
        state.take_record(name, record.topic, record.utc_ns, record.record)
        drone = state.drones.get(name)
        if drone is None:
            continue
        found[name] += drone.overlays
        drone.overlays.clear()
        if drone.phase != before:
            now = state.now(0.0, record.utc_ns)
            moments.append(Moment(f"{drone.short} {drone.phase} {now['since_s']:.0f} s", now))
        if record.topic == "/state" and drone.trail and drone.trail_ns == record.utc_ns:
            ways.setdefault(name, []).append(drone.trail[-1])
        if drone.target is not None and record.utc_ns - target_ns >= TRAIL_NS:
            target_ns = record.utc_ns
            target.append(drone.target["place_m"])
    if moments:
        moments = moments[:: math.ceil(len(moments) / MOST_MOMENTS)]
        moments.append(Moment("the end", state.now(0.0, state.newest_ns)))
    return Played(moments, ways, target, state.slow()["site"], found)


def _in_order(logs: Mapping[str, Records]) -> list[tuple[str, LogRecord]]:
    every: list[tuple[str, LogRecord]] = []
    for name, own in logs.items():
        for topic in TOPICS:
            records = own.get(topic, ())
            thinned = records[:: math.ceil(len(records) / MOST_RECORDS) or 1]
            every += ((name, each) for each in thinned)
    return sorted(every, key=lambda each: each[1].utc_ns)


# --- the map


class Sheet:
    """A map's scale: north is up; px of the drawing."""

    def __init__(self, places: Sequence[Place]) -> None:
        norths = [place[0] for place in places]
        easts = [place[1] for place in places]
        tall_m = ROUND * max(max(norths) - min(norths), LEAST_M)
        broad_m = ROUND * max(max(easts) - min(easts), LEAST_M)
        self.scale = min(WIDTH_PX / broad_m, HIGHEST_PX / tall_m)
        self.height_px = min(HIGHEST_PX, tall_m * self.scale)
        self._middle = (min(norths) + max(norths)) / 2, (min(easts) + max(easts)) / 2

    def px(self, place: Place) -> tuple[float, float]:
        """Return where a place is drawn."""
        x = WIDTH_PX / 2 + (place[1] - self._middle[1]) * self.scale
        y = self.height_px / 2 - (place[0] - self._middle[0]) * self.scale
        return round(x, 1), round(y, 1)

    def points(self, places: Sequence[Place]) -> str:
        """Return places as the points of a line, thinned."""
        every = math.ceil(len(places) / MOST_PLACES) or 1
        return " ".join("{},{}".format(*self.px(place)) for place in places[::every])


def map_of(run: Played) -> Iterator[str]:
    """Yield the map as HTML; nothing where no drone knew its place."""
    places = [place for way in run.ways.values() for place in way]
    if not places:
        return
    seen = [each.now["target"]["place_m"] for each in run.moments if each.now["target"]]
    sheet = Sheet([*places, *seen])
    numbers = range(len(run.moments))
    shown = ",".join(f"#m{k}:checked~* .m{k}" for k in numbers)
    chosen = ",".join(f"#m{k}:checked~nav [for=m{k}]" for k in numbers)
    yield "<h2>Map from above, north up, m</h2><div class='moments'>"
    yield f"<style>.moments {shown}{{display:inline}}{chosen}{{background:#222;color:#fff}}</style>"
    decisive = next(
        (k for k in reversed(numbers) if run.moments[k].now["evidence"]), len(run.moments) - 1
    )
    for k in numbers:
        yield f"<input type='radio' name='moment' id='m{k}'{' checked' * (k == decisive)}>"
    labels = (
        f"<label for='m{k}'>{escape(each.title)}</label>" for k, each in enumerate(run.moments)
    )
    yield f"<nav>{''.join(labels)}</nav>"
    yield f"<svg class='map' viewBox='0 0 {WIDTH_PX:.0f} {sheet.height_px:.0f}' role='img'>"
    yield from _grid(sheet)
    yield from _site(sheet, run.site)
    for name, way in run.ways.items():
        dashes = "4 3" if name == Role.RECEIVER.value else "none"
        yield _line(sheet.points(way), INKS.get(name, NEEDED), 1.5, dashes)
    yield _line(sheet.points(run.target), DIM, 1.5, "1 3")
    for k, each in enumerate(run.moments):
        yield f"<g class='m m{k}'>{''.join(_moment(sheet, each.now, run.site))}</g>"
    yield "</svg><div>"
    for k, each in enumerate(run.moments):
        yield f"<span class='m m{k}'>{escape(_words(each.now))}</span>"
    yield "</div></div>"


def _words(now: Snapshot) -> str:
    said = [f"{drone['short']}: {drone['words'] or drone['phase']}" for drone in now["drones"]]
    matters = now["matters"]
    return " · ".join([*said, f"{matters['what']} {matters['value']} {matters['of']}"])


def _grid(sheet: Sheet) -> Iterator[str]:
    step = next((each for each in STEPS_M if each * sheet.scale > STEP_PX), 1000)
    x_px, y_px = sheet.px((0.0, 0.0))
    pace_px = step * sheet.scale
    for k in range(math.ceil(-x_px / pace_px), math.floor((WIDTH_PX - x_px) / pace_px) + 1):
        x = x_px + k * pace_px
        yield f"<path d='M{x:.1f} 0V{sheet.height_px:.0f}' stroke='#e2e2e2'/>"
        yield _text(f"E {k * step:g}", x + 2, sheet.height_px - 4, DIM)
    low = math.ceil((y_px - sheet.height_px) / pace_px)
    for k in range(low, math.floor(y_px / pace_px) + 1):
        y = y_px - k * pace_px
        yield f"<path d='M0 {y:.1f}H{WIDTH_PX:.0f}' stroke='#e2e2e2'/>"
        yield _text(f"N {k * step:g}", 2, y - 3, DIM)


def _site(sheet: Sheet, site: Snapshot | None) -> Iterator[str]:
    """The fence, and walls with the strip that is kept from."""
    if site is None:
        return
    x, y = sheet.px((0.0, 0.0))
    fence_px = site["radius_m"] * sheet.scale
    yield _circle(x, y, fence_px, NEEDED, "8 5")
    if site["corners_m"]:
        edge = f"<polygon points='{sheet.points(site['corners_m'])}' fill='none'"
        strip_px = 2.0 * site["clear_m"] * sheet.scale
        yield f"{edge} stroke='{FAULT}' stroke-opacity='.14' stroke-width='{strip_px:.1f}'/>"
        yield f"{edge} stroke='{NEEDED}' stroke-width='3'/>"


def _moment(
    sheet: Sheet,
    now: Snapshot,
    site: Snapshot | None,
) -> Iterator[str]:
    for place in now["others"]:
        x, y = sheet.px(place)
        yield f"<rect x='{x - 5}' y='{y - 5}' width='10' height='10' fill='none' stroke='{DIM}' stroke-width='2'/>"
    target = now["target"]
    if target is not None:
        x, y = sheet.px(target["place_m"])
        long_px, wide_px = (max(each * sheet.scale, 6.0) for each in target["ellipse_m"])
        # a bearing is clockwise from north, SVG's angle clockwise from east
        turned = math.degrees(target["turned_rad"]) - 90.0
        yield f"<g transform='translate({x} {y})' fill='none' stroke='{NEEDED}' stroke-width='2'>"
        yield f"<ellipse rx='{long_px:.1f}' ry='{wide_px:.1f}' transform='rotate({turned:.0f})'/>"
        yield f"<path d='M-12 0H12M0-12V12'/></g>{_text('target', x + 10, y - 8)}"
    for drone in now["drones"]:
        if drone["place_m"] is None:
            continue
        x, y = sheet.px(drone["place_m"])
        color = INKS.get(drone["name"], NEEDED)
        hollow = drone["name"] == Role.RECEIVER.value
        turned = math.degrees(drone["heading_rad"])
        if site is not None and drone["armed"]:
            yield _circle(x, y, site["apart_m"] * sheet.scale, FAULT, "2 4")
        yield (
            f"<path d='M0-14L8 10L0 5L-8 10Z' transform='translate({x} {y}) rotate({turned:.0f})'"
            f" fill='{'#fff' if hollow else color}' stroke='{color}' stroke-width='2.5'/>"
        )
        yield _text(
            drone["short"],
            x - 34 if drone["name"] == Role.SENDER.value else x + 12,
            y + 12,
            color,
        )


def _line(
    points: str,
    color: str,
    width: float,
    dashes: str,
) -> str:
    stroke = f"stroke='{color}' stroke-width='{width}' stroke-dasharray='{dashes}'"
    return f"<polyline points='{points}' fill='none' {stroke}/>"


def _circle(
    x: float,
    y: float,
    radius_px: float,
    color: str,
    dashes: str,
) -> str:
    stroke = f"stroke='{color}' stroke-width='2' stroke-dasharray='{dashes}'"
    return f"<circle cx='{x}' cy='{y}' r='{radius_px:.1f}' fill='none' {stroke}/>"


def _text(
    words: str,
    x: float,
    y: float,
    color: str = NEEDED,
) -> str:
    return f"<text x='{x:.0f}' y='{y:.0f}' fill='{color}'>{escape(words)}</text>"


# --- images


def marked(
    image: str,
    size: tuple[int, int],
    overlays: Sequence[Snapshot],
    name: str,
) -> str:
    """Return an image with what was found in its frame, as SVG.

    Args:
        image: where it is, as a ``data:`` address.
        size: of the frame, px.
        name: whose frame it is.
    """
    width, height = size
    parts = [f"<image href='{image}' width='{width}' height='{height}'/>"]
    unit = width / 320.0
    for each in sorted(overlays, key=lambda found: found["kind"] == MAPPED):
        px = each["px"]
        color = COLORS[Role.RECEIVER.value] if each["kind"] == MAPPED else COLORS.get(name, NEEDED)
        shape = f"<rect x='{px[0]}' y='{px[1]}' width='{px[2]}' height='{px[3]}'"
        if each["kind"] == "marker":
            color = NEEDED
            shape = f"<polygon points='{' '.join(map(str, px))}'"
        dashes = f" stroke-dasharray='{5 * unit} {3 * unit}'" if each["kind"] == MAPPED else ""
        if not dashes:
            parts.append(f"{shape} stroke='#fff' stroke-width='{4 * unit}'/>")
        parts.append(f"{shape} stroke='{color}' stroke-width='{2 * unit}'{dashes}/>")
        below = px[1] + px[3] + 13 * unit if each["kind"] == MAPPED else px[1] - 4 * unit
        parts.append(_text(KINDS[each["kind"]], max(px[0], 2), max(below, 14 * unit), color))
    style = f"font-size:{13 * unit:.0f}px"
    return (
        f"<svg class='seen' viewBox='0 0 {width} {height}' style='{style}'>{''.join(parts)}</svg>"
    )

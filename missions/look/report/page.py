"""run.html: a run on one page that needs nothing else, for whoever was not there.

How it ended and why, what to do next, figures with their limits, the map and the picture, when each
phase began with an image of it and what was found there, the link and the load, and the command that
made it; of a handoff, of a relay, of one drone's flight in the field, of a failed test's, and of two
films.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

from drivers.log.mcap_log import LogRecord
from missions.look.live.snapshot import overlays_at
from missions.look.report.above import Played, map_of, marked, played
from missions.look.report.advice import advice
from missions.look.report.records import Records, first, phase_changes
from missions.look.report.tables import counts_text
from path.messages import Role
from path.values import frozen

MAX_IMAGES = 16  # of one drone: the page stays below some megabytes
BEGINS = ("/phase", "/setup")  # what a drone's seconds count from
NEAR_S = 1.0  # an image is of a phase when it is no farther from its beginning

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 66rem;
  margin: 1.5rem auto; padding: 0 .8rem }
h1 { font-size: 1.4rem } h2 { font-size: 1.1rem; margin: 2rem 0 .4rem }
.badge { color: #fff; padding: .15rem .6rem; border-radius: .3rem }
.good { background: #2a7d3a } .bad { background: #c0392b }
table { border-collapse: collapse; margin-top: .6rem }
td, th { padding: .15rem 1.2rem .15rem 0; text-align: left; vertical-align: top }
th, .dim { color: #666; font-weight: normal }
code { background: #f2f2f2; padding: .15rem .4rem; border-radius: .2rem; overflow-wrap: anywhere }
.wide { overflow-x: auto } img.whole { width: 100%; margin-top: .6rem }
.phases { display: flex; flex-wrap: wrap; gap: .8rem }
figure { margin: 0; flex: 1 1 15rem; max-width: 22rem } figcaption { font-size: .85rem }
figure img, .seen, .map { width: 100%; display: block }
svg text { font: 700 11px system-ui, sans-serif; paint-order: stroke;
  stroke: #fff; stroke-width: 3px }
.seen { fill: none } .seen text { font-size: inherit }
.map { max-width: 44rem; border: 1px solid #999 }
.moments input { position: absolute; opacity: 0 } .moments .m { display: none }
.moments nav { display: flex; flex-wrap: wrap; gap: .3rem; margin-bottom: .4rem }
.moments label { border: 1px solid #999; border-radius: .2rem; padding: .15rem .45rem;
  font-size: .85rem }
@media (max-width: 600px) {
  img.whole { width: 60rem } td, th { padding-right: .6rem } figure { max-width: none }
}
"""


@frozen
class PageOf:
    """The facts of a run beside its drones' logs.

    Attributes:
        advice: what to do next; empty: as after every run that ended so.
    """

    outcome: str
    good: bool
    why: str
    command: str
    figures: Sequence[tuple[str, str]]
    notes: Sequence[str]
    pictures: Sequence[Path]
    advice: str = ""


def write_page(
    path: Path,
    run: PageOf,
    logs: Mapping[str, Records],
) -> None:
    """``logs``: of each drone, by its name. Raises OSError."""
    logs = dict(sorted(logs.items(), key=lambda each: each[0] != Role.SENDER.value))  # D1 first
    badge = "good" if run.good else "bad"
    parts = [
        f"<h1><span class='badge {badge}'>{escape(run.outcome)}</span> {escape(run.why)}</h1>",
        f"<p><b>What to do next.</b> {escape(run.advice or advice(run.outcome))}</p>",
        *(f"<p>{escape(note)}</p>" for note in run.notes),
        f"<p class='dim'>Made by <code>{escape(run.command)}</code></p>",
    ]
    seen = played(logs)
    parts += map_of(seen)
    for picture in run.pictures:
        if picture.is_file():
            source = f"alt='{picture.stem}' src='{_embedded(picture.read_bytes(), 'png')}'"
            parts.append(f"<div class='wide'><img class='whole' {source}></div>")
    parts += ["<h2>Figures</h2>", _table(run.figures)]
    for name, records in sorted(logs.items(), key=lambda each: each[0] != Role.SENDER.value):
        parts += _drone(name, records, seen)
    title = f"<title>{escape(f'{run.outcome}: {path.parent.resolve().name}')}</title>"
    path.write_text(whole(title, "\n".join(parts)), "utf-8")


def whole(title: str, body: str) -> str:
    """Return a page, as it is written; for a phone as well."""
    view = "<meta name='viewport' content='width=device-width, initial-scale=1'>"
    head = f"<meta charset='utf-8'>{view}{title}<style>{STYLE}</style>"
    return f"<!doctype html>\n<html lang='en'><head>{head}</head><body>\n{body}\n</body></html>\n"


def _drone(
    name: str,
    records: Records,
    seen: Played,
) -> Iterator[str]:
    begin_ns = next((each.stamp_ns for topic in BEGINS for each in records.get(topic, ())), 0)
    yield f"<h2>{escape(name)}</h2>"
    yield "<div class='phases'>"
    images = records.get("/image", ())
    phases = phase_changes(records)
    shown = 0
    for phase in phases:
        image = min(images, key=lambda each: abs(each.stamp_ns - phase.stamp_ns), default=None)
        near = image is not None and abs(image.stamp_ns - phase.stamp_ns) < NEAR_S * 1e9
        picture = ""
        if image is not None and near and shown < MAX_IMAGES:
            picture = _pictured(name, image, records, seen)
            shown = shown + 1
        at_s = (phase.stamp_ns - begin_ns) * 1e-9
        yield _figure(picture, phase.record["phase"], at_s, phase.record["note"])
    if not phases:  # of a film: nobody flies
        for image in images[:: math.ceil(len(images) / MAX_IMAGES) or 1]:
            at_s = (image.stamp_ns - begin_ns) * 1e-9
            yield _figure(_pictured(name, image, records, seen), "", at_s, "")
    yield "</div>"
    yield _table(list(_link_and_load(records)))


def _figure(
    picture: str,
    title: str,
    at_s: float,
    note: str | None,
) -> str:
    said = f"<br><span class='dim'>{escape(note)}</span>" if note else ""
    caption = f"<figcaption><b>{escape(title)}</b> at {at_s:.1f} s{said}</figcaption>"
    return f"<figure>{picture}{caption}</figure>"


def _pictured(
    name: str,
    image: LogRecord,
    records: Records,
    seen: Played,
) -> str:
    """An image with what was found in its frame."""
    data = _embedded(image.record["data"], "jpeg")
    setup = first(records, "/setup")
    if setup is None:
        return f"<img alt='' src='{data}'>"
    size = setup["camera"]["width"], setup["camera"]["height"]
    return marked(data, size, overlays_at(image.utc_ns, seen.found[name]), name)


def _link_and_load(records: Records) -> Iterator[tuple[str, str]]:
    of = {topic: records.get(topic, ()) for topic in ("/link", "/cpu", "/frame")}
    if of["/link"]:
        end = of["/link"][-1].record
        dropped = counts_text(end["dropped"], "nothing")
        yield (
            "link",
            f"{end['packets_sent']} packets sent, {end['packets_received']} received; dropped: {dropped}",
        )
        known = [r.record for r in of["/link"] if r.record["clock_uncertainty_ns"] is not None]
        if known:
            offset_s = known[-1]["clock_offset_ns"] * 1e-9
            within_ms = known[-1]["clock_uncertainty_ns"] * 1e-6
            yield "other drone's clock", f"{offset_s:+.6f} s, known within {within_ms:.1f} ms"
    if len(of["/cpu"]) > 1:
        first = of["/cpu"][0]
        end = of["/cpu"][-1]
        share = (end.record["spent_ns"]["program"] - first.record["spent_ns"]["program"]) / (
            end.stamp_ns - first.stamp_ns
        )
        yield "processor", f"{100.0 * share:.0f} % of a core"
    ages = sorted(
        age_ns * 1e-6 for record in of["/frame"] if (age_ns := record.record["age_ns"]) is not None
    )
    if ages:
        yield (
            "age of a frame when its cycle begins",
            (
                f"{ages[len(ages) // 2]:.1f} ms median, {ages[int(0.95 * (len(ages) - 1))]:.1f} ms p95"
            ),
        )


def _table(rows: Sequence[tuple[str, str]]) -> str:
    cells = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows
    )
    return f"<table>{cells}</table>"


def _embedded(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"

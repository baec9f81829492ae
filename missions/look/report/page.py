"""run.html: a run on one page that needs nothing else, for whoever was not there.

How it ended and why, what to do next, figures with their limits, the picture, when each phase began
with an image of it, the link and the load, and the command that made it; of a handoff, of a relay,
and of one drone's flight in the field.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

from missions.look.report.advice import advice
from missions.look.report.records import Records, phase_changes
from missions.look.report.tables import counts_text
from path.values import frozen

MAX_IMAGES = 16  # of one drone: the page stays below some megabytes
NEAR_S = 1.0  # an image is of a phase when it is no farther from its beginning

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 66rem; padding: 0 1rem; color: #222 }
h1 { font-size: 1.4rem } h2 { font-size: 1.1rem; margin: 2rem 0 .4rem }
.good { background: #2a9d3a } table { margin-top: .6rem }
.bad { background: #c0392b } .badge { color: #fff; padding: .15rem .6rem; border-radius: .3rem }
table { border-collapse: collapse } td, th { padding: .15rem 1.2rem .15rem 0; text-align: left; vertical-align: top }
th, .dim { color: #777; font-weight: normal } code { background: #f2f2f2; padding: .15rem .4rem; border-radius: .2rem }
img.whole { width: 100%; margin-top: .6rem } .phases { display: flex; flex-wrap: wrap; gap: .8rem }
figure { margin: 0; width: 15rem } figure img { width: 100%; border-radius: .2rem } figcaption { font-size: .85rem }
"""


@frozen
class PageOf:
    """The facts of a run beside its drones' logs."""

    outcome: str
    good: bool
    why: str
    command: str
    figures: Sequence[tuple[str, str]]
    notes: Sequence[str]
    pictures: Sequence[Path]


def write_page(path: Path, run: PageOf, logs: Mapping[str, Records]) -> None:
    """``logs``: of each drone, by its name. Raises OSError."""
    badge = "good" if run.good else "bad"
    parts = [
        f"<h1><span class='badge {badge}'>{escape(run.outcome)}</span> {escape(run.why)}</h1>",
        f"<p><b>What to do next.</b> {escape(advice(run.outcome))}</p>",
        *(f"<p>{escape(note)}</p>" for note in run.notes),
        f"<p class='dim'>Made by <code>{escape(run.command)}</code></p>",
        "<h2>Figures</h2>",
        _table(run.figures),
        *(f"<img class='whole' alt='{picture.stem}' src='{_embedded(picture.read_bytes(), 'png')}'>"
          for picture in run.pictures if picture.is_file()),
    ]  # fmt: skip
    for name, records in logs.items():
        parts += _drone(name, records)
    title = escape(f"{run.outcome}: {path.parent.resolve().name}")
    head = f"<meta charset='utf-8'><title>{title}</title><style>{STYLE}</style>"
    body = "\n".join(parts)
    path.write_text(
        f"<!doctype html>\n<html lang='en'><head>{head}</head><body>\n{body}\n</body></html>\n",
        "utf-8",
    )


def _drone(name: str, records: Records) -> Iterator[str]:
    begin_ns = next((record.stamp_ns for record in records.get("/phase", ())), 0)
    yield f"<h2>{escape(name)}</h2>"
    yield "<div class='phases'>"
    images = records.get("/image", ())
    shown = 0
    for phase in phase_changes(records):
        image = min(images, key=lambda each: abs(each.stamp_ns - phase.stamp_ns), default=None)
        picture = ""
        if (
            image is not None
            and abs(image.stamp_ns - phase.stamp_ns) < NEAR_S * 1e9
            and shown < MAX_IMAGES
        ):
            picture = f"<img alt='' src='{_embedded(image.record['data'], 'jpeg')}'>"
            shown = shown + 1
        at_s = (phase.stamp_ns - begin_ns) * 1e-9
        note = (
            f"<br><span class='dim'>{escape(phase.record['note'])}</span>"
            if phase.record["note"]
            else ""
        )
        caption = (
            f"<figcaption><b>{escape(phase.record['phase'])}</b> at {at_s:.1f} s{note}</figcaption>"
        )
        yield f"<figure>{picture}{caption}</figure>"
    yield "</div>"
    yield _table(list(_link_and_load(records)))


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

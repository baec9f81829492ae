"""The page: A4, black on white, one sheet."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from html import escape

from drivers.rig.parts import Rig
from flight.plan.flown import Flown
from missions.field.checklist.drawings import draw_print, draw_side, faces, sizes
from missions.field.checklist.steps import numbers, radios, sections, switches, words

_STYLE = """
@page { size: A4; margin: 9mm }
* { box-sizing: border-box }
body { font: 8pt/1.22 'DejaVu Sans', system-ui, sans-serif; color: #000; background: #fff }
body { width: 192mm; margin: 0 auto }
h1 { font-size: 13pt; margin: 0 }
h2 { font-size: 9pt; margin: 1.6mm 0 .6mm; border-bottom: .3mm solid #000 }
p { margin: .6mm 0 }
code { font: 7.2pt 'DejaVu Sans Mono', monospace; white-space: nowrap }
.fill { display: flex; justify-content: space-between; margin: 1mm 0 0 }
.note { border: .5mm solid #000; padding: .5mm 1mm }
.two { display: grid; grid-template-columns: 102mm 86mm; gap: 4mm }
.plate { display: flex; gap: 2mm; align-items: center }
ul { list-style: none; margin: 0; padding: 0 }
li { padding: .25mm 0 .25mm 5mm; position: relative }
li::before { content: ''; position: absolute; left: 0; top: .6mm }
li::before { width: 2.8mm; height: 2.8mm; border: .3mm solid #000 }
li.done::before { content: '✓'; line-height: 2.4mm; font-weight: bold }
table { border-collapse: collapse; width: 100% }
td, th { padding: .2mm 1.5mm .2mm 0; text-align: left; vertical-align: top }
th { white-space: nowrap }
svg { fill: none; stroke: #000; stroke-width: .25; flex: none }
svg text { font: 2.6px 'DejaVu Sans', sans-serif; fill: #000; stroke: none }
"""


def checklist_page(
    rig: Rig,
    of: Flown,
    name: str,
    done: Mapping[str, str],
) -> str:
    """Return the page as HTML.

    Args:
        name: of the rig as ``--rig`` takes it.
        done: the steps of first flights, each with when it was ticked, "" for never.
    """
    body = "\n".join(_body(rig, of, name, done))
    title = f"<title>{escape(rig.name)}: checklist</title>"
    head = f"<meta charset='utf-8'>{title}<style>{_STYLE}</style>"
    page = f"<html lang='en'><head>{head}</head><body>\n{body}\n</body></html>"
    return f"<!doctype html>\n{page}\n"


def _body(
    rig: Rig,
    of: Flown,
    name: str,
    done: Mapping[str, str],
) -> Iterator[str]:
    yield f"<h1>{escape(rig.name)}</h1><p>{escape(rig.description)}</p>"
    if rig.harness is not None:
        yield "<p class='note'>This rig flies in a simulated world: a page to look at.</p>"
    blanks = ("date", "place", "pilot D1", "pilot D2", "computer")
    lines = "".join(f"<span>{each} ____________</span>" for each in blanks)
    yield f"<p class='fill'>{lines}</p><div class='two'><div>"
    for title, steps in sections(rig, of, name):
        yield _titled(title, f"<ul>{''.join(f'<li>{_typed(step)}</li>' for step in steps)}</ul>")
    who = "“mine” or “stop”" if radios(rig) else "“stop”"
    otherwise = f"{who}, land, read the log, and begin that part anew."
    yield f"<p class='note'><b>If anything is otherwise:</b> {otherwise}</p>"
    yield _titled("Who says what", _table(words(rig)))
    yield "</div><div>"
    yield _titled("This rig's numbers", _table(numbers(rig, of)))
    said = [faces(rig.sender.mount.T_b_v), *sizes(rig)]
    beside = f"<div>{''.join(f'<p>{escape(line)}</p>' for line in said)}</div>"
    plate = f"<div class='plate'>{draw_print(rig)}{beside}</div>"
    yield _titled("D1's marker from before it; D1 from its right", plate)
    yield draw_side(rig, of.facts.drone.diameter_m)
    for whose, rows in switches(rig):
        yield _titled(f"Switches of the radio: {whose}", _table(rows))
    flights = "".join(_flight(step, when) for step, when in done.items())
    yield _titled("First flights, each only after the one before", f"<ul>{flights}</ul>")
    yield "</div></div>"


def _flight(step: str, when: str) -> str:
    kind = " class='done'" if when else ""
    return f"<li{kind}>{escape(step)} <i>{escape(when)}</i></li>"


def _titled(title: str, what: str) -> str:
    return f"<h2>{escape(title)}</h2>{what}"


def _typed(step: str) -> str:
    """Return a step whose commands break between their words alone."""
    parts = escape(step).split("`")
    for at in range(1, len(parts), 2):
        parts[at] = " ".join(f"<code>{word}</code>" for word in parts[at].split())
    return "".join(parts)


def _table(rows: Iterable[tuple[str, str]]) -> str:
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(said)}</td></tr>" for name, said in rows)
    return f"<table>{''.join(cells)}</table>"

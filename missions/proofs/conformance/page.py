"""The table of the vehicles: on the terminal, and as the page of the documentation that the suite
writes itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rich.table import Table
from rich.text import Text

from missions.proofs.conformance.record import EMBEDDED, Record
from missions.proofs.conformance.rows import SECTIONS, Row, likeness, said

NAMES = {EMBEDDED: "embedded", "px4": "PX4", "ardupilot": "ArduCopter"}
LAST = "embedded is like"
WRITTEN_BY = "Written by `path-handoff conformance`"

HEAD = """# How the vehicles behave

Written by `path-handoff conformance`, through MAVSDK and the driver that missions use:

```sh
path-handoff conformance --px4 PATH --ardupilot PATH --out conformance --page docs/conformance.md
path-handoff conformance --no-fly --out conformance --page docs/conformance.md   # the page alone, from what was flown
```

{flights} flights of each vehicle, one of a kind: examples, not means. Heights and speeds are the
simulations' truth, modes are what heartbeats show. The embedded world has wind (1.5 m/s, gusts 0.4 m/s). On
the wire the embedded vehicle is a PX4: what is like a PX4's is left out, and the terminal has it.
"""
AS_MEANT = ("both", NAMES["px4"])


def cells(records: Mapping[str, Record]) -> Iterator[tuple[str, list[tuple[Row, list[str]]]]]:
    """Section by section, each row with its texts: one a vehicle, then whom the embedded one is
    like.
    """
    embedded = records.get(EMBEDDED)
    real = {NAMES[name]: record.values for name, record in records.items() if name != EMBEDDED}
    for section, rows in SECTIONS.items():
        made: list[tuple[Row, list[str]]] = []
        for row in rows:
            if not any(row.name in record.values for record in records.values()):
                continue
            like = "" if embedded is None else likeness(row, embedded.values, real)
            made.append((row, [*(said(row, record.values) for record in records.values()), like]))
        if made:
            yield section, made


def terminal_table(records: Mapping[str, Record]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("", overflow="fold", min_width=40)
    for title in (*(NAMES[name] for name in records), LAST):
        table.add_column(title, overflow="fold")
    for section, rows in cells(records):
        table.add_row(Text(section, "bold"))
        for row, texts in rows:
            like = Text(texts[-1].replace("*", ""), "yellow" if "*" in texts[-1] else "dim")
            table.add_row(f"  {row.title}".replace("`", ""), *texts[:-1], like)
    return table


def page(records: Mapping[str, Record], flights: int) -> str:
    """The page as Markdown."""
    titles = ["", *(NAMES[name] for name in records)]
    lines = [HEAD.format(flights=flights), *_conditions(records), ""]
    lines += [_line(titles), _line(["---"] * len(titles))]
    for section, rows in cells(records):
        told = list(_differing(rows))
        if told:
            lines.append(f"| **{section}** |")
            lines += [_line(texts) for texts in told]
    failures = [
        f"- {NAMES[name]}, {flight}: {why}"
        for name, own in records.items()
        for flight, why in own.failed.items()
    ]
    if failures:
        lines += ["", "Flights that did not come to their end, and why:", "", *failures]
    return "\n".join(lines) + "\n"


def _differing(rows: list[tuple[Row, list[str]]]) -> Iterator[list[str]]:
    """Yield the rows that are not like a PX4's, and those that such a one goes on from ("...")."""
    goes_on = False
    kept: list[list[str]] = []
    for row, texts in reversed(rows):
        if goes_on or texts[-1] not in AS_MEANT:
            kept.append([row.title, *texts[:-1]])
            goes_on = row.title.startswith("...")
    yield from reversed(kept)


def _conditions(records: Mapping[str, Record]) -> Iterator[str]:
    for name, record in records.items():
        again = (
            f"; switched off and on {record.restarts} times to arm again" if record.restarts else ""
        )
        yield (
            f"- {NAMES[name]}: {record.made}, rig `{record.rig}`, {record.cores} cores, "
            f"load {record.load_before:.1f} before and {record.load_after:.1f} after{again}"
        )


def _line(texts: list[str]) -> str:
    return f"| {' | '.join(text.replace('|', '·') for text in texts)} |"

"""``path-handoff calibrate marker``: D1's marker, or a plate of several in a row, as a drawing in
millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TextIO

from drivers.interfaces import PartError
from missions.ground.options.calibrate import CalibrateMarkerOptions
from missions.ground.run_folder import check_file
from path.marker.layout import DICTIONARIES, QUIET_CELLS
from path.marker.photometric.texture import cells
from path.marker.turned import OFFICIAL

BORDER_CELLS = 1.5  # white around the outermost black frames; the outline is cut along
RULER_MM = 50.0
BELOW_MM = 12.0


def draw_marker(options: CalibrateMarkerOptions, out: TextIO) -> int:
    """Write the drawing, and say what belongs into the rig. Raises PartError."""
    bits, count = DICTIONARIES.get(options.dictionary, (0, 0))
    if not bits:
        raise PartError(
            f"--dictionary {options.dictionary!r} is not known", f"one of {', '.join(DICTIONARIES)}"
        )
    wrong = [each for each in options.ids if each >= count]
    if wrong or not options.ids or len(set(options.ids)) < len(options.ids):
        raise PartError(
            f"--ids {' '.join(map(str, options.ids)) or '(none)'}: each once, and within 0..{count - 1} of "
            f"{options.dictionary}",
            "write for example --ids 0 1",
        )
    cell_mm = 1e3 * options.side_m / (bits + 2)
    if len(options.ids) > 1 and 1e3 * options.gap_m < QUIET_CELLS * cell_mm:
        raise PartError(
            f"--gap-m {options.gap_m:g} is less than a cell of {cell_mm:.2f} mm",
            "leave at least a cell of white",
        )
    check_file(options.out)
    drawing = _drawing(options, cell_mm)
    try:
        with options.out.open("x", encoding="utf-8") as file:
            file.write(drawing)
    except FileExistsError:
        if options.out.read_text("utf-8", errors="replace") != drawing:
            raise PartError(
                f"{options.out} is there, and is another drawing: it is not written over",
                "name another --out",
            ) from None
    except OSError as error:
        raise PartError(
            f"cannot write {options.out}: {error.strerror}", "name another file with --out"
        ) from error
    out.write(
        f"{options.out}: print it at 100 %, see that its ruler is {RULER_MM:g} mm long, glue it to something flat and "
        "stiff, dull, cut along the outline.\n"
        f"Leave the white around it: {QUIET_CELLS * cell_mm:.1f} mm are needed, "
        f"{BORDER_CELLS * cell_mm:.1f} mm are drawn.\n"
        f"{_turned(options.dictionary)}"
        "Then measure the black frames with a calliper, and write what you measured into the rig:\n\n"
        f"{_tables(options)}"
    )
    return 0


def _turned(dictionary: str) -> str:
    """What to know of a family whose pictures exist twice, turned by half a turn."""
    if "APRILTAG" not in dictionary:
        return ""
    return f"This drawing is the right way up for the rig; of other prints know that {OFFICIAL}.\n"


def _drawing(options: CalibrateMarkerOptions, cell_mm: float) -> str:
    side_mm = 1e3 * options.side_m
    border_mm = BORDER_CELLS * cell_mm
    step_mm = side_mm + 1e3 * options.gap_m
    wide_mm = 2.0 * border_mm + side_mm + step_mm * (len(options.ids) - 1)
    high_mm = 2.0 * border_mm + side_mm
    page_mm = max(wide_mm, RULER_MM) + 2.0, high_mm + BELOW_MM
    parts = [f'<rect x="1" y="1" width="{wide_mm:.4f}" height="{high_mm:.4f}" class="cut"/>']
    for number, marker_id in enumerate(options.ids):
        parts += black_cells(
            options.dictionary,
            marker_id,
            1.0 + border_mm + step_mm * number,
            1.0 + border_mm,
            cell_mm,
        )
    y = high_mm + 5.0
    parts += [
        f'<path d="M1 {y:.4f} h{RULER_MM:g} M1 {y - 1.5:.4f} v3 M{1 + RULER_MM:g} {y - 1.5:.4f} v3" class="cut"/>',
        f'<text x="1" y="{y + 5.0:.4f}">{RULER_MM:g} mm; frames {side_mm:g} mm, {options.dictionary}, '
        f"{' '.join(map(str, options.ids))}</text>",
    ]
    width_mm, height_mm = page_mm
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_mm:.4f}mm" height="{height_mm:.4f}mm" '
        f'viewBox="0 0 {width_mm:.4f} {height_mm:.4f}">\n'
        "<style>.cut{fill:white;stroke:#888;stroke-width:.1} text{font:3px sans-serif}</style>\n"
        f"{body}\n</svg>\n"
    )


def black_cells(
    dictionary: str,
    marker_id: int,
    left_mm: float,
    top_mm: float,
    cell_mm: float,
) -> Sequence[str]:
    """One path of a marker's black cells, whose edges meet without a gap."""
    black = [
        f"M{left_mm + cell_mm * column:.4f} {top_mm + cell_mm * row:.4f}h{cell_mm:.4f}v{cell_mm:.4f}h{-cell_mm:.4f}z"
        for row, line in enumerate(cells(dictionary, marker_id))
        for column, white in enumerate(line)
        if not white
    ]
    return [
        f'<path id="marker-{marker_id}" d="{"".join(black)}" fill="black" stroke="black" stroke-width="0.005"/>'
    ]


def _tables(options: CalibrateMarkerOptions) -> str:
    """The tables of a rig about the print; the frame ``v`` is in the middle of the row."""
    step_m = options.side_m + options.gap_m
    begin = (
        ""
        if options.dictionary == "DICT_4X4_50"
        else f'marker_dictionary = "{options.dictionary}"\n\n'
    )
    tables = list[str]()
    for number, marker_id in enumerate(options.ids):
        x_m = step_m * (number - 0.5 * (len(options.ids) - 1))
        place = (
            ""
            if len(options.ids) == 1
            else f"position_v_m = [{x_m:.6g}, 0.0, 0.0] # drawn; measure it\n"
        )
        tables.append(
            f"[[markers]]\nid = {marker_id}\nside_m = {options.side_m:g} # drawn; measure it\n{place}"
        )
    return begin + "\n".join(tables)

"""``path-handoff calibrate``: which of its commands, and the boards they share."""

from __future__ import annotations

import sys
from typing import TextIO

from missions.field.calibrate.board import draw_print
from missions.field.calibrate.camera import calibrate_camera
from missions.field.calibrate.export import export_camera
from missions.field.calibrate.foreign import import_camera
from missions.field.calibrate.marker_print import draw_marker
from missions.field.calibrate.mount import calibrate_mount
from missions.ground.options.calibrate import (
    CalibrateCameraOptions,
    CalibrateExportOptions,
    CalibrateImportOptions,
    CalibrateMarkerOptions,
    CalibrateMountOptions,
    CalibrateOptions,
)


def run(options: CalibrateOptions, out: TextIO | None = None) -> int:
    """Carry out one of them; 0 when a file was written. Raises PartError with what is wrong and
    what to do.
    """
    stream = out or sys.stdout
    what = options.what
    if isinstance(what, CalibrateCameraOptions):
        return calibrate_camera(what, stream)
    if isinstance(what, CalibrateMountOptions):
        return calibrate_mount(what, stream)
    if isinstance(what, CalibrateImportOptions):
        return import_camera(what, stream)
    if isinstance(what, CalibrateExportOptions):
        return export_camera(what, stream)
    if isinstance(what, CalibrateMarkerOptions):
        return draw_marker(what, stream)
    return draw_print(what, stream)

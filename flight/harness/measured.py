"""The imaging of a camera that was measured on photographs: the one that the simulated drones
carry.

A D435's colour camera, of the D415's family, by 28 public photographs of a board at 1280x720,
stored without compression (docs/real.md has what corners and poses are on them).
"""

from __future__ import annotations

from collections.abc import Mapping

from flight.harness.renderer import Imaging

MEASURED = Imaging(
    blur_sigma_px=0.75,
    read_sigma=1.16,
    shot_gain=0.0,
    mosaic=True,
    sharpen=1.75,
    sharpen_sigma_px=0.81,
    yuyv=True,
)
"""Its edge is off that of the photographs by 1.1 % of the contrast (root mean square). Its noise is
2.05 and 1.84 grey levels on black and white, where the photographs have 2.05 and 1.74."""

SOURCES: Mapping[str, str] = {
    "blur_sigma_px": "811 straight edges of the board on 14 of the photographs, fitted together with the sharpening",
    "sharpen, sharpen_sigma_px": "the same: a halo of 4 % of the contrast on white, 2.5 % on black",
    "read_sigma, shot_gain": "the noise beside those edges, on black (level 40) and on white (162)",
    "gamma": "none that edges show: fitted beside blur and sharpening it is 1.00",
    "mosaic": "a colour sensor has one; interpolated along edges, as OpenCV does (assumed)",
    "yuyv": "the D415's format on USB; that its brightness alone is sharpened is assumed",
}

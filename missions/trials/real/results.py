"""The results of one set of photographs, and of its rendered twin, as the page and ``summary.json``
give them.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from missions.trials.real.response import CameraResponse
from missions.trials.real.shutter import RowMotion
from missions.trials.shared.statistics import Interval
from path.arrays import Image
from path.camera.thinning import Thinning
from path.values import frozen


@frozen
class Figure95:
    """A figure with its 95 % interval; views are drawn together."""

    value: float
    interval: Interval

    def summary(self, name: str) -> dict[str, Any]:
        return {name: self.value, f"{name}_interval": list(self.interval)}

    def text(self, digits: int, scale: float = 1.0) -> str:
        low, high = (scale * end for end in self.interval)
        return f"{scale * self.value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


@frozen
class CornerScore:
    """One method's corners: px per axis, with the print as the views show it, and with all markers
    printed alike.

    ``across_px``: the robust figure in the one direction in the image in which paper that is not
    flat moves no corner. ``doubt_px``: how well the board itself knows where corners are;
    ``chi2_with_doubt``: over that and what is stated.
    """

    found: int
    robust_px: Figure95
    across_px: Figure95
    nominal_px: float
    rms_px: float
    stated_px: float | None = None
    chi2: Figure95 | None = None
    doubt_px: float | None = None
    chi2_with_doubt: Figure95 | None = None

    def summary(self) -> dict[str, Any]:
        named: dict[str, Any] = {
            "found": self.found,
            "nominal_px": self.nominal_px,
            "rms_px": self.rms_px,
        }
        if self.chi2_with_doubt is not None:
            named |= {"doubt_px": self.doubt_px, **self.chi2_with_doubt.summary("chi2_with_doubt")}
        return {
            **self.robust_px.summary("robust_px"),
            **self.across_px.summary("across_px"),
            **named,
        }


@frozen
class PoseScore:
    """Errors of D2's place in the marker's frame, of the rotation, and what was refused."""

    poses: int
    d2_mean_m: Figure95
    d2_median_m: Figure95
    d2_p95_m: Figure95
    rotation_median_deg: Figure95
    flips: int
    refused: dict[str, int]
    chi2: Figure95

    def summary(self) -> dict[str, Any]:
        return {
            "poses": self.poses,
            **self.d2_mean_m.summary("d2_mean_m"),
            **self.d2_median_m.summary("d2_median_m"),
            **self.d2_p95_m.summary("d2_p95_m"),
            **self.rotation_median_deg.summary("rotation_median_deg"),
            "flips": self.flips,
            "refused": self.refused,
            **self.chi2.summary("chi2_pose"),
        }


@frozen
class SetScore:
    """A set.

    Attributes:
        images, views: photographs, and those that show the board. ``markers``: seen in all of them.
        board_px: residual of the board's own corners to pose and bend, median over views of the rms
            per axis.
        print_m: rms by which the printed corners are off, as all views show it; None when that
            cannot be told.
        height_m: by which the paper leaves its smooth surface, as the photometric corners tell it;
            None without any.
        poses: by what they rest on; empty on a chessboard. ``named``: what the fits called wrong,
            and how often.
        example: the photograph in the middle, for the page.
        thinning: how the camera leaves out pixels, as these photographs tell it; None where it does
            not.
        row_motion: while rows were read, as the board's corners tell it; None without markers or of
            a sheet.
        twin: the same of the set's rendered twin; None without one. ``untwinned``: why there is
            none, if it was tried.
    """

    name: str
    images: int
    views: int
    markers: int
    side_px: float
    board_px: float
    print_m: float | None
    height_m: float | None
    camera: tuple[float, float, float, float]
    camera_sigmas: tuple[float, float, float, float] | None
    thinning: Thinning | None
    corners: dict[str, CornerScore]
    poses: dict[str, PoseScore]
    named: dict[str, int]
    example: Image
    row_motion: RowMotion | None = None
    twin: TwinScore | None = None
    untwinned: str = ""

    def summary(self) -> dict[str, Any]:
        """The figures of single markers at the top, as ``docs/real.md`` names them."""
        own = self.corners.get("photometric")
        single = self.poses["single"].summary() if "single" in self.poses else {}
        chi2 = own.chi2.summary("chi2_corners") if own is not None and own.chi2 is not None else {}
        return {
            "images": self.images,
            "views": self.views,
            "markers": self.markers,
            "side_px": self.side_px,
            "board_px": self.board_px,
            "print_m": self.print_m,
            "height_m": self.height_m,
            "camera": dict(zip(("fx", "fy", "cx", "cy"), self.camera, strict=True)),
            "camera_sigmas": self.camera_sigmas,
            "thinning": None if self.thinning is None else asdict(self.thinning),
            **single,
            **chi2,
            "stated_px": None if own is None else own.stated_px,
            "corners": {name: score.summary() for name, score in self.corners.items()},
            "named_wrong": self.named,
            "row_motion": None if self.row_motion is None else asdict(self.row_motion),
            **{name: score.summary() for name, score in self.poses.items() if name != "single"},
            **({} if self.twin is None else {"twin": self.twin.summary(self)}),
        }

    def compared(self) -> dict[str, Figure95]:
        """The figures in which a twin should be like its photographs."""
        own = self.corners.get("photometric")
        single = self.poses.get("single")
        corners = {} if own is None else {
            "corners_px": own.robust_px, "across_px": own.across_px, "chi2_corners": own.chi2,
        }  # fmt: skip
        poses = {} if single is None else {"d2_mean_m": single.d2_mean_m, "chi2_pose": single.chi2}
        return {name: figure for name, figure in {**corners, **poses}.items() if figure is not None}


@frozen(eq=False)
class TwinScore:
    """A set's rendered twin: the camera's response that it was drawn with, and what comes out of
    it.
    """

    response: CameraResponse
    score: SetScore

    def ratios(self, real: SetScore) -> dict[str, float]:
        """The twin's figures over the photographs'."""
        there = real.compared()
        return {
            name: figure.value / there[name].value
            for name, figure in self.score.compared().items()
            if name in there
        }

    def summary(self, real: SetScore) -> dict[str, Any]:
        camera = {
            "imaging": asdict(self.response.imaging),
            "edge_misfit": self.response.misfit,
        }
        return {**self.score.summary(), **camera, "ratios": self.ratios(real)}

"""The accuracy of D2's place and the target's from one frame: seven configurations, sixty
measurements each.

Sixty sessions: in each a drone pair is printed, calibrated, mounted and flown anew, with errors of
its own, and measures once in all seven configurations. So 420 measurements rest on sixty draws of
every systematic error, not on one; the session is the unit of all intervals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from flight.harness.errors import TrialErrors
from flight.harness.measured import MEASURED
from flight.harness.renderer import REALISTIC, REALISTIC_VIDEO, Imaging
from missions.ground.work import call
from missions.trials.pose.static.methods import (
    ALL,
    METHODS,
    Error,
    Method,
    Results,
    errors_of,
    estimated,
    measure,
    sent_point,
    session_seed,
)
from missions.trials.pose.static.pictures import (
    draw_configurations,
    draw_errors,
    draw_view,
    incidence,
)
from missions.trials.pose.static.report import (
    DEFAULT,
    HEADLINE,
    PIPELINES,
    SEVEN,
    Figures,
    breakdown_table,
    configurations_summary,
    configurations_table,
    figures_of,
    findings,
    mean,
    methods_table,
    noise_table,
    p95,
    plain_number,
)
from missions.trials.pose.static.shots import (
    LAYOUT,
    REFINES,
    StaticMeasurement,
    StaticSeries,
    renderer_of,
    shoot,
    shot_seed,
    stage_in,
)
from missions.trials.pose.static.stage import (
    CAMERA,
    CONFIGURATIONS,
    STANDS,
    Mounts,
    mounts_of,
    nominal,
    with_camera,
)
from missions.trials.shared.trial import TrialRequest, TrialResult, TrialTable
from path.camera.kernels import lens_of
from path.config import MethodConfig
from path.cycle.prior import Prior, predict
from path.geometry.rigid import rigid
from path.messages import Role

TITLE = "Static accuracy: where D2 and the target are, from one frame, by method"
PAPER = "Receiver-View Projection Consistency"
NEEDS = ("renderer", "errors")

SESSIONS = {
    "measured": 60,
    "ideal": 60,
    "realistic": 60,
    "realistic_h264": 30,
}  # H.264 encodes a short stream for every image
QUICK_SESSIONS = {"measured": 2, "ideal": 1, "realistic": 1, "realistic_h264": 1}
BLOCK = 10  # sessions of one piece of work
IMAGING: dict[str, dict[Role, Imaging]] = {
    HEADLINE: {Role.SENDER: MEASURED, Role.RECEIVER: MEASURED},
    "ideal": {Role.SENDER: Imaging(), Role.RECEIVER: Imaging()},
    "realistic": {Role.SENDER: REALISTIC, Role.RECEIVER: REALISTIC},
    # D1's depth camera is on board
    "realistic_h264": {Role.SENDER: REALISTIC, Role.RECEIVER: REALISTIC_VIDEO},
}
ByPipeline = Mapping[str, Mapping[Method, Figures]]
SHOWN = 4  # the configuration in the picture of D2's view

BREAKDOWN: tuple[tuple[str, str, tuple[Error, ...]], ...] = (
    ("all", "all of the noise table", ALL),
    ("none", "none but image and depth noise", ()),
    ("side", "printed side alone", ("side",)),
    ("optics", "focal lengths, principal points and distortion alone", ("optics",)),
    ("mounting", "mounts alone", ("mount",)),
    ("attitude_bias", "attitude bias alone", ("bias",)),
    ("attitude_noise", "attitude noise alone", ("noise",)),
    ("depth", "scale and bias of depth alone", ("depth",)),
    ("depth_narrow", "all, and depth from the middle 8 % of the box, per side", (*ALL, "narrow")),
)
ALONE = ("none", "side", "optics", "mounting", "attitude_bias", "attitude_noise", "depth")


def run(request: TrialRequest) -> TrialResult:
    mounts = mounts_of(request.rig)
    sightings = {name: _shoot(request, mounts, name) for name in IMAGING}
    results, rows = _judge(request, mounts, sightings)
    figures: ByPipeline = {
        name: {method: figures_of(result, request.seed) for method, result in by_method.items()}
        for name, by_method in results.items()
    }
    configurations = configurations_summary(
        results[HEADLINE], *_geometry(mounts, sightings[HEADLINE])
    )
    square = results[HEADLINE][DEFAULT].d2_m[:, len(CONFIGURATIONS)]
    pictures = _draw(request, mounts, results)
    return TrialResult(
        summary=_summary(figures, configurations, rows, square, sightings),
        findings=findings(
            figures, p95(square), [(title, r) for key, title, r in rows if key in ALONE]
        ),
        noise=noise_table(_table(request)),
        tables=_tables(figures, configurations, rows),
        pictures=pictures,
        notes=_notes(figures, square, sightings),
    )


def _shoot(request: TrialRequest, mounts: Mounts, pipeline: str) -> list[StaticMeasurement]:
    """All measurements with one camera pipeline; the view beside the seven only with the
    headline's.
    """
    sessions = (QUICK_SESSIONS if request.quick else SESSIONS)[pipeline]
    stands = STANDS if pipeline == HEADLINE else CONFIGURATIONS
    renderer = request.part("renderer")
    items = [
        StaticSeries(
            renderer,
            mounts,
            IMAGING[pipeline],
            request.seed,
            k,
            tuple(range(s, min(s + BLOCK, sessions))),
        )
        for k in range(len(stands))
        for s in range(0, sessions, BLOCK)
    ]
    return [
        sighting
        for block in request.work.map(f"images, {pipeline}", shoot, items)
        for sighting in block
    ]


def _table(request: TrialRequest) -> TrialErrors:
    """Return who draws the sessions' errors, with the trial's camera and marker."""
    table: TrialErrors = request.part("errors")(with_camera(request.rig, LAYOUT))
    return table


def _judge(
    request: TrialRequest, mounts: Mounts, sightings: dict[str, list[StaticMeasurement]]
) -> tuple[dict[str, dict[Method, Results]], list[tuple[str, str, Results]]]:
    """Every method on every pipeline's sightings, and the default method under each error alone."""
    names: list[tuple[str, Method]] = [(name, method) for name in sightings for method in METHODS]
    count = 1 + max(each.session for shots in sightings.values() for each in shots)
    table = _table(request)
    drawn = [table.session(session_seed(request.seed, session)) for session in range(count)]
    pieces = [
        partial(measure, sightings[name], mounts, drawn, request.seed, method)
        for name, method in names
    ]
    pieces += [
        partial(measure, sightings[HEADLINE], mounts, drawn, request.seed, DEFAULT, on)
        for _, _, on in BREAKDOWN
    ]
    done = request.work.map("methods", call, pieces)
    results: dict[str, dict[Method, Results]] = {name: {} for name in sightings}
    for (name, method), result in zip(names, done, strict=False):
        results[name][method] = result
    rows = [
        (key, title, r) for (key, title, _), r in zip(BREAKDOWN, done[len(names) :], strict=True)
    ]
    return results, rows


def _geometry(
    mounts: Mounts, sightings: Sequence[StaticMeasurement]
) -> tuple[list[float], list[float], list[float]]:
    """Return each configuration's geometry: D2's heading relative to D1's, mean incidence in rad,
    mean side in px.
    """
    headings = [nominal(c, mounts)[2] for c in CONFIGURATIONS]
    angles: list[list[float]] = [[] for _ in STANDS]
    sides: list[list[float]] = [[] for _ in STANDS]
    for sighting in sightings:
        corners = CAMERA.project(sighting.T_c2_v.apply(LAYOUT.markers[0].corners_v))
        angles[sighting.configuration].append(incidence(sighting.T_c2_v))
        sides[sighting.configuration].append(
            float(np.hypot(*(corners - np.roll(corners, 1, axis=0)).T).mean())
        )
    return headings, [float(np.mean(a)) for a in angles], [float(np.mean(s)) for s in sides]


def _summary(
    figures: ByPipeline,
    configurations: list[dict[str, Any]],
    rows: Sequence[tuple[str, str, Results]],
    square: np.ndarray,
    sightings: dict[str, list[StaticMeasurement]],
) -> dict[str, Any]:
    tables = {
        name: {"methods": {m: f.summary() for m, f in by.items()}} for name, by in figures.items()
    }
    seen = {
        name: {
            "markers_missed": {r: sum(s.markers[r] is None for s in shots) for r in REFINES},
            "targets_missed": sum(s.target is None for s in shots),
        }
        for name, shots in sightings.items()
    }
    return {
        "configurations": configurations,
        "methods": tables[HEADLINE]["methods"],
        "ideal": tables["ideal"],
        "realistic": tables["realistic"],
        "realistic_h264": tables["realistic_h264"],
        "pipelines": PIPELINES,
        "seen": seen,
        "sessions": figures[HEADLINE][DEFAULT].summary()["measurements"] // len(CONFIGURATIONS),
        "sent_mean_m": plain_number(mean(rows[0][2].sent_m[:, SEVEN].ravel())),
        "breakdown": {
            key: {
                "d2_mean_m": plain_number(mean(r.d2_m[:, SEVEN].ravel())),
                "d2_p95_m": plain_number(p95(r.d2_m[:, SEVEN].ravel())),
                "target_mean_m": plain_number(mean(r.target_m[:, SEVEN].ravel())),
                "target_p95_m": plain_number(p95(r.target_m[:, SEVEN].ravel())),
                "sent_mean_m": plain_number(mean(r.sent_m[:, SEVEN].ravel())),
            }
            for key, _, r in rows
        },
        "along_the_normal": {
            "d2_mean_m": plain_number(mean(square)),
            "d2_p95_m": plain_number(p95(square)),
        },
    }


def _tables(
    figures: ByPipeline,
    configurations: list[dict[str, Any]],
    rows: Sequence[tuple[str, str, Results]],
) -> tuple[TrialTable, ...]:
    return (
        *(methods_table(f"Camera: {title}", figures[name]) for name, title in PIPELINES.items()),
        configurations_table(configurations),
        breakdown_table("Each error alone", [(title, r) for _, title, r in rows]),
    )


def _notes(
    figures: ByPipeline, square: np.ndarray, sightings: dict[str, list[StaticMeasurement]]
) -> tuple[str, ...]:
    missed = sum(s.target is None for shots in sightings.values() for s in shots)
    counted = sum(len(shots) for shots in sightings.values())
    return (
        "Sixty sessions: in each, print, calibration, mounting and attitude biases are drawn anew, and all seven "
        "configurations are measured once, from single frames (thirty sessions with H.264). Intervals resample "
        "sessions. The paper measured sixty times in one set-up per configuration.",
        "All methods see the same frames. The first two start from OpenCV's SUBPIX corners, taken in an enlarged "
        "region around the marker. The methods without gravity never refuse a pose; those with gravity refuse as in "
        "flight.",
        "D2's error is that of its camera in the marker's frame. The target's error is that of the transferred point "
        "in D2's camera, against the point of the surface that the centre of D1's box truly shows; how far that is "
        "from the middle of the object is not in it. "
        f"D1 did not see its target in {missed} of {counted} measurements.",
        "Along the marker's normal its tilt hardly shows, and what attitude is wrong by moves D2's place: from 1.5 m "
        f"{1e3 * float(mean(square)):.1f} mm on average, 95th percentile {1e3 * float(p95(square)):.1f} mm. None of "
        "the seven looks so from that far; a stand-off is better planned 15° or more beside the normal.",
        "Depth noise averages out over the middle of the box; scale and bias of a stereo camera's depth do not.",
        "Not simulated: curled paper, rolling shutter, vibration.",
        "Squared error of the default pose in units of its covariance (6 when that is right): "
        + ", ".join(f"{figures[name][DEFAULT].nees:.1f} {name}" for name in PIPELINES)
        + ".",
    )


def _draw(
    request: TrialRequest, mounts: Mounts, results: dict[str, dict[Method, Results]]
) -> dict[str, str]:
    draw_configurations(mounts, request.out / "configurations.png")
    draw_errors(results, request.out / "errors.png")
    pictures = {
        "configurations.png": "The seven configurations and the three places of the target.",
        "errors.png": "Share of the measurements below an error, by method, on a logarithmic scale.",
    }
    if _draw_view(request, mounts):
        caption = (
            f"What D2 sees in configuration {STANDS[SHOWN].name}: the marker as fitted (and enlarged), the prior with "
            "its 3σ ellipse and search region (yellow), and the point of the target that D1 truly saw (red)."
        )
        pictures["view.png"] = caption
    return pictures


def _draw_view(request: TrialRequest, mounts: Mounts) -> bool:
    """The first session of one configuration; False when there is nothing to show."""
    shooting = StaticSeries(
        request.part("renderer"), mounts, IMAGING[HEADLINE], request.seed, SHOWN, (0,)
    )
    (sighting,) = shoot(shooting)
    drawn = _table(request).session(session_seed(request.seed, 0))
    errors = errors_of(drawn, mounts, (request.seed, SHOWN, 0), ALL)
    found = sighting.markers["photometric"]
    point_v = sent_point(sighting, errors)
    if found is None or point_v is None or sighting.target is None:
        return False
    pose = estimated(sighting, DEFAULT, errors, found)
    if pose is None:
        return False
    x, y, z = point_v.tolist()
    prior = predict(
        lens_of(CAMERA),
        rigid(pose.T_c_v),
        pose.covariance,
        (x, y, z),
        sighting.target.depth.sigma_m,
        0,
        MethodConfig(),
    )
    if not isinstance(prior, Prior):
        return False
    shot = renderer_of(shooting, Role.RECEIVER).shoot(
        stage_in(shooting, 0), Role.RECEIVER, shot_seed(shooting, 0)
    )
    true_c2 = sighting.T_c2_v.apply(mounts.T_v_c1.apply(sighting.target.point_c1_m))
    target_px = CAMERA.project(true_c2[None, :])[0]
    if not math.isfinite(float(target_px.sum())):
        return False
    draw_view(shot.color, found.corners_px, prior, target_px.tolist(), request.out / "view.png")
    return True

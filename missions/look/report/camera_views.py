"""A camera's view when the views agreed: its image, or the scene drawn as lines, with the boxes on
it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle

from drivers.log.mcap_log import LogRecord, decode_image
from missions.look.report.palette import DIM, MAPPED_BOX, MARKER, OWN_BOX, PRIOR, ROLE
from missions.look.report.records import RunRecords, judged_pairs, last
from missions.look.report.truth import Truth
from path.arrays import Array
from path.camera.model import CameraModel
from path.messages import Role

FAR_NS = 150_000_000
LINE = 1.8


def draw_view(
    axes: Axes,
    run: RunRecords,
    role: Role,
    truth: Truth | None,
) -> None:
    """One camera at the commit, or at the last pair that was judged when there was none."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_edgecolor(ROLE[role])
    name = "D1, the sender" if role is Role.SENDER else "D2, the receiver"
    instant_ns = _instant(run, role)
    image = _nearest(run.role(role).get("/image", ()), instant_ns, before=True)
    stamp_ns = instant_ns if image is None else image.stamp_ns
    axes.set_title(
        f"{name}, {_when(run, role, stamp_ns)}",
        loc="left",
        fontsize=10,
        color=ROLE[role],
    )
    if stamp_ns is None or (image is None and truth is None):
        axes.text(
            0.5,
            0.5,
            "nothing to show",
            transform=axes.transAxes,
            ha="center",
            va="center",
            color=DIM,
        )
        return
    if image is not None:
        pixels = decode_image(image.record)[:, :, ::-1]
        axes.imshow(pixels, interpolation="antialiased")
        size = pixels.shape[1], pixels.shape[0]
    else:
        assert truth is not None
        size = truth.scene.cameras[role].width, truth.scene.cameras[role].height
        axes.set_facecolor("#3b423b")
        _draw_objects(axes, truth, role, stamp_ns)
    axes.set_xlim(-0.5, size[0] - 0.5)
    axes.set_ylim(size[1] - 0.5, -0.5)
    axes.set_aspect("equal")
    draw = _draw_sender if role is Role.SENDER else _draw_receiver
    draw(axes, run, stamp_ns)
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        axes.legend(
            handles, labels, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=len(handles),
            facecolor="#555555", labelcolor="white", framealpha=1.0, handlelength=1.4,
        )  # fmt: skip


def _instant(run: RunRecords, role: Role) -> int | None:
    """Return an instant of the role's clock: the commit for the sender, its last agreed candidate
    for the receiver.
    """
    agreed = [r for r in judged_pairs(run) if r.record["agreed"]]
    if role is Role.SENDER:
        commit = last(run.sender, "/commit")
        return commit.stamp_ns if commit else (agreed[-1].stamp_ns if agreed else None)
    sequence = agreed[-1].record["sequence"] if agreed else None
    stamps = [
        r.stamp_ns for r in run.receiver.get("/candidate", ()) if r.record["sequence"] == sequence
    ]
    newest = last(run.receiver, "/candidate") or last(run.receiver, "/marker")
    return stamps[-1] if stamps else (newest.stamp_ns if newest else None)


def _when(
    run: RunRecords,
    role: Role,
    stamp_ns: int | None,
) -> str:
    instant_ns = _instant(run, role)
    if stamp_ns is None or instant_ns is None:
        return "never in the handshake"
    what = "the commit" if last(run.sender, "/commit") else "the last pair that agreed"
    before_s = (instant_ns - stamp_ns) * 1e-9
    return f"at {what}" if before_s < 0.05 else f"{before_s:.2f} s before {what}"


def _nearest(
    records: Sequence[LogRecord],
    stamp_ns: int | None,
    before: bool = False,
) -> LogRecord | None:
    """The record nearest to an instant (the newest not after it); None when there is none."""
    if stamp_ns is None:
        return None
    candidates = [r for r in records if r.stamp_ns <= stamp_ns] if before else list(records)
    return min(candidates, key=lambda r: abs(r.stamp_ns - stamp_ns), default=None)


def _near(records: Sequence[LogRecord], stamp_ns: int) -> Mapping[str, Any]:
    """The record of a frame's instant; empty when none is near."""
    found = _nearest(records, stamp_ns)
    return found.record if found and abs(found.stamp_ns - stamp_ns) < FAR_NS else {}


def _draw_sender(
    axes: Axes,
    run: RunRecords,
    stamp_ns: int,
) -> None:
    target = _near(run.sender.get("/target", ()), stamp_ns)
    # pairs are logged when they are judged, and belong to the instant of D2's frame
    judged = [LogRecord(r.topic, r.record["capture_ns"], r.record) for r in judged_pairs(run)]
    pair = _near([r for r in judged if r.record["mapped_box"]], stamp_ns)
    _draw_box(axes, target.get("box"), OWN_BOX, "D1's box")
    _draw_box(axes, pair.get("mapped_box"), MAPPED_BOX, "D2's box, mapped", style="--")
    if pair.get("iou") is not None:
        count = f"{min(pair['count'], pair['needed'])}/{pair['needed']}"
        axes.text(
            0.015, 0.975, f"IoU {pair['iou']:.2f}   {count}", transform=axes.transAxes, va="top",
            fontsize=10, color="white", bbox={"facecolor": "#222222", "edgecolor": "none", "alpha": 0.7},
        )  # fmt: skip


def _draw_receiver(
    axes: Axes,
    run: RunRecords,
    stamp_ns: int,
) -> None:
    marker = _near([r for r in run.receiver.get("/marker", ()) if r.record["corners_px"]], stamp_ns)
    answer = _near(run.receiver.get("/candidate", ()), stamp_ns)
    if marker:
        corners = np.reshape(marker["corners_px"], (-1, 2))
        axes.add_patch(
            Polygon(corners, closed=True, fill=False, ec=MARKER, lw=LINE, label="marker")
        )
        axes.plot(*corners[0], "o", ms=3, color=MARKER)
    if region := answer.get("region"):
        x0, y0, x1, y1 = region
        _draw_box(axes, (x0, y0, x1 - x0, y1 - y0), PRIOR, "search region", style=":")
    if prior := answer.get("prior_px"):
        axes.plot(*prior, "+", ms=13, mew=2, color=PRIOR, label="prior")
    _draw_box(axes, answer.get("box"), OWN_BOX, "D2's box")


def _draw_box(
    axes: Axes,
    box: Sequence[float] | None,
    color: str,
    label: str,
    style: str = "-",
) -> None:
    if box is not None:
        x, y, w, h = box
        axes.add_patch(
            Rectangle((x, y), w, h, fill=False, ec=color, lw=LINE, ls=style, label=label)
        )


def _draw_objects(
    axes: Axes,
    truth: Truth,
    role: Role,
    stamp_ns: int,
) -> None:
    """The true edges of every object, through the lens."""
    T_c_w = truth.T_w_c(role, stamp_ns).inverse()
    camera = truth.scene.cameras[role]
    edges = [edge for box in truth.scene.boxes for edge in _edges(box)]
    for object_id in truth.object_ids:
        T_c_o = T_c_w @ truth.T_w_o(object_id, role, stamp_ns)
        color = "#f5a03c" if object_id == truth.scene.target_id else "#9a7a4a"
        _draw_edges(axes, camera, [T_c_o.apply(edge) for edge in edges], color)


def _edges(box: Array) -> list[Array]:
    """The 12 edges of a box (centre, size), each as (n, 3) points along it: a lens bends them."""
    corners = [
        box[:3] + box[3:] / 2 * signs for signs in np.array(list(product((-1.0, 1.0), repeat=3)))
    ]
    shares = np.linspace(0.0, 1.0, 7)[:, None]
    pairs = [(a, b) for a, b in combinations(corners, 2) if np.count_nonzero(a != b) == 1]
    return [a + shares * (b - a) for a, b in pairs]


def _draw_edges(
    axes: Axes,
    camera: CameraModel,
    edges: Sequence[Array],
    color: str,
) -> None:
    """The edges in front of the camera, all in one line with gaps, which is drawn much faster than
    a line for each.
    """
    gap = np.full((1, 2), np.nan)
    seen = [
        np.vstack([camera.project(edge_c), gap]) for edge_c in edges if edge_c[:, 2].min() > 0.05
    ]
    if seen:
        axes.plot(*np.vstack(seen).T, color=color, lw=1.0)

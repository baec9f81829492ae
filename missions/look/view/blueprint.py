"""The places of Rerun's window: scene, both images, plots, words."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from missions.look.view.drawing import RUN
from missions.look.view.eye import SceneEye

PLOTS = (
    ("overlap", "IoU against what it needs (τ)"),
    ("evidence", "evidence, nats"),
    ("count", "agreeing pairs in a row"),
    ("separation", "separation, m"),
    ("link", "link, B/s"),
    ("age", "age of a frame, ms"),
    ("processor", "processor, % of a core"),
)


def blueprint(
    names: Sequence[str],
    drones: Sequence[str],
    plots: Sequence[str],
    eye: SceneEye | None = None,
) -> rrb.Blueprint:
    """The window for logs by name, those ``drones`` among them that have images.

    ``plots``: those above with something to show. Without an ``eye`` all of the scene is seen, the
    fence's box with it.
    """
    scene = rrb.Spatial3DView(
        origin="/",
        name="scene",
        contents=[
            "/tf/**",
            *(f"/{name}/{each}" for name in names for each in ("3d/**", "pinhole", "image")),
        ],
        spatial_information=rrb.SpatialInformation(target_frame="world", show_axes=False),
        background=[24, 26, 30],
        eye_controls=None
        if eye is None
        else rrb.EyeControls3D(position=eye.position, look_target=eye.target),
    )
    images = [
        rrb.Spatial2DView(
            origin=f"/{drone}/image",
            name=drone,
            contents=[f"/{drone}/image", f"/{drone}/boxes", f"/{drone}/verdict"],
        )
        for drone in drones
    ]
    words = rrb.TextLogView(
        origin="/",
        name="phases and reasons",
        contents=[f"/{name}/log" for name in names],
    )
    series = [
        rrb.TimeSeriesView(
            origin=f"/plots/{plot}",
            name=title,
            plot_legend=rrb.PlotLegend(visible=True),
        )
        for plot, title in PLOTS
        if plot in plots
    ]
    above = rrb.Horizontal(scene, rrb.Vertical(*images), column_shares=[5, 3]) if images else scene
    below = (
        rrb.Horizontal(rrb.Grid(*series, grid_columns=4), words, column_shares=[3, 1])
        if series
        else words
    )
    return rrb.Blueprint(
        rrb.Vertical(above, below, row_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=RUN),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )

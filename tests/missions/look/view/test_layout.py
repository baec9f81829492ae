"""The layout for Foxglove and Lichtblick names what is in a log."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from drivers.log.topics import TOPICS
from missions.ground.options.runs import MergeOptions, ViewOptions
from missions.look.logs.merge import run as run_merge
from missions.look.view.command import run as run_view


@pytest.fixture(scope="module")
def topics(run_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Those of a merged log."""
    merged = tmp_path_factory.mktemp("merged") / "merged.mcap"
    run_merge(MergeOptions((run_folder,), merged))
    with merged.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return {channel.topic for channel in summary.channels.values()}


@pytest.fixture
def layout(tmp_path: Path) -> dict[str, Any]:
    assert run_view(ViewOptions(layout=tmp_path / "layout.json")) == 0
    return json.loads((tmp_path / "layout.json").read_text())


def strings(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield key
            yield from strings(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from strings(inner)
    elif isinstance(value, str):
        yield value


def test_every_topic_of_the_layout_is_in_a_log(layout: dict[str, Any], topics: set[str]) -> None:
    named = {
        re.split(r"[.\[]", text)[0]
        for text in strings(layout["configById"])
        if text.startswith("/")
    }
    assert named - topics == set()
    assert {"/sender/3d", "/receiver/3d", "/sender/annotations", "/sender/log"} <= named


def test_every_plot_is_of_a_field_that_the_schemas_have(layout: dict[str, Any]) -> None:
    paths = [
        path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())
    ]
    assert len(paths) > 10
    for path in paths:
        topic, field = re.fullmatch(r"/\w+(/\w+)\.(\w+).*", path).groups()  # type: ignore[union-attr]
        assert field in TOPICS[topic].fields, path


def test_every_panel_has_its_place(layout: dict[str, Any]) -> None:
    placed = {text for text in strings(layout["layout"]) if "!" in text}
    assert placed == layout["configById"].keys()

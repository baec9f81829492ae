"""A run as Rerun has it: read back by Rerun's own program."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import util
from importlib.machinery import ModuleSpec
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.records import Schema

from drivers.interfaces import PartError
from drivers.log.index import MAGIC
from drivers.log.scan import LoggedMessage, messages
from missions.ground.options.runs import ViewOptions
from missions.look.view import command
from missions.look.view.command import run as run_view
from missions.look.view.figures import PlottedValues

DRAWN = {
    "/sender/3d/body/boxes",
    "/sender/3d/frustum/lines",
    "/sender/3d/marker/lines",
    "/sender/3d/target/ellipsoids",
    "/sender/3d/fence/lines",
    "/receiver/3d/separation/lines",
    "/receiver/3d/target/ellipsoids",
    "/world/3d/truth/boxes",
    "/tf/sender/camera",
    "/tf/receiver/marker_seen",
    "/sender/image",
    "/sender/boxes",
    "/receiver/boxes",
    "/receiver/verdict",
    "/receiver/pinhole",
    "/sender/log",
    "/plots/overlap/sender/iou",
    "/plots/overlap/sender/tau",
    "/plots/separation/receiver/marker_m",
    "/plots/separation/world/true_m",
    "/plots/link/sender/bytes_sent_per_s",
    "/plots/age/receiver/frame_ms",
    "/plots/processor/sender/thread",
}


def test_everything_that_is_drawn_is_in_reruns_file(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rrd = tmp_path / "run.rrd"
    assert run_view(ViewOptions((run_folder,), save=rrd)) == 0
    assert capsys.readouterr().out == f"{rrd}\n"
    stats = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "stats", str(rrd)],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    entities = set(re.findall(r"^(/\S+):", stats.stdout, re.MULTILINE))
    assert DRAWN - entities == set()
    assert any(entity.startswith("/view/") for entity in entities)  # the blueprint


def test_schemas_of_a_live_stream_have_no_ids_of_their_own(run_folder: Path) -> None:
    """Each message is read by its own schema, although all are number 0."""
    import rerun as rr  # noqa: PLC0415 (here: each worker would import it)

    from missions.look.view.drawing import Drawing  # noqa: PLC0415

    recording = rr.RecordingStream("test")
    drawing = Drawing(recording)
    names: set[str] = set()
    with (run_folder / "sender.mcap").open("rb") as file:
        file.seek(len(MAGIC))
        for each in messages(file):
            if isinstance(each, LoggedMessage):
                schema = each.channel.schema
                names.add(schema.name)
                live = Schema(0, schema.data, schema.encoding, schema.name)
                drawing.message(f"/sender{each.channel.topic}", live, each.utc_ns, each.data)
    recording.disconnect()
    assert {"foxglove.FrameTransforms", "foxglove.SceneUpdate", "foxglove.Log"} < names


def test_a_single_log_can_be_looked_at(run_folder: Path, tmp_path: Path) -> None:
    assert run_view(ViewOptions((run_folder / "receiver.mcap",), save=tmp_path / "one.rrd")) == 0
    assert (tmp_path / "one.rrd").stat().st_size > 10_000


def test_without_rerun_the_fix_is_said(run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def find_spec(name: str) -> ModuleSpec | None:
        return None if name == "rerun" else util.find_spec(name)

    monkeypatch.setattr(command, "find_spec", find_spec)
    with pytest.raises(PartError, match="looking at runs needs rerun") as refused:
        run_view(ViewOptions((run_folder,)))
    assert "-e '.[view]'" in refused.value.remedy


def test_nothing_named_is_refused() -> None:
    with pytest.raises(PartError, match="nothing is named"):
        run_view(ViewOptions())


def test_rates_are_of_the_seconds_between() -> None:
    figures = PlottedValues()
    first = {"bytes_sent": 1000, "bytes_received": 0}
    assert list(figures.of("/link", 0, first)) == []
    second = {"bytes_sent": 2000, "bytes_received": 500}
    assert dict(figures.of("/link", 500_000_000, second)) == {
        "link/bytes_sent_per_s": 2000.0,
        "link/bytes_received_per_s": 1000.0,
    }
    assert list(figures.of("/cpu", 0, {"spent_ns": {"thread": 0}})) == []
    shares = figures.of("/cpu", 1_000_000_000, {"spent_ns": {"thread": 250_000_000}})
    assert dict(shares) == {"processor/thread": 25.0}


class Lines:
    """Stands in for a recording: what is logged to each path and when, in ns of UTC; None where a
    line is ended.
    """

    def __init__(self) -> None:
        self.points: dict[str, list[tuple[int, float | None]]] = {}
        self._now_ns = 0

    def set_time(
        self, timeline: str, *, timestamp: np.datetime64 | None = None, duration: object = None
    ) -> None:
        del timeline, duration
        if timestamp is not None:
            self._now_ns = int(timestamp.astype(np.int64))

    def log(self, path: str, *parts: object, static: bool = False) -> None:
        import rerun as rr  # noqa: PLC0415

        for part in parts:
            if not static:
                ended = isinstance(part, rr.Clear)
                value = None if ended else float(part.scalars.as_arrow_array()[0].as_py())  # type: ignore[attr-defined]
                self.points.setdefault(path, []).append((self._now_ns, value))


MS = 1_000_000


def drawn(*said: tuple[int, str, dict[str, object]]) -> list[tuple[int, float | None]]:
    """The line of the sender's evidence, in ms, of records at ms."""
    lines = Lines()
    from missions.look.view.drawing import Drawing  # noqa: PLC0415

    drawing = Drawing(lines)  # type: ignore[arg-type]
    for at_ms, topic, record in said:
        schema = Schema(id=1, data=b"", encoding="jsonschema", name=f"path.{topic}")
        drawing.message(f"/sender/{topic}", schema, at_ms * MS, msgspec.json.encode(record))
    return [(at_ns // MS, value) for at_ns, value in lines.points["plots/evidence/sender/evidence"]]


def pair(evidence: float) -> dict[str, object]:
    return {"evidence": evidence}


def test_no_line_is_drawn_from_the_evidence_of_a_commit_to_the_gate_that_begins_again() -> None:
    line = drawn(
        (0, "agreement", pair(2.0)),
        (20, "agreement", pair(3.3)),
        (20, "commit", {"epoch": 1}),
        (200, "agreement", pair(0.0)),
    )
    assert line == [(0, 2.0), (20, 3.3), (20, None), (200, 0.0)]


def test_no_line_joins_two_attempts() -> None:
    line = drawn(
        (0, "agreement", pair(2.0)), (20, "agreement", pair(2.4)), (1500, "agreement", pair(0.0))
    )
    assert line == [(0, 2.0), (20, 2.4), (20, None), (1500, 0.0)]


def test_evidence_that_falls_within_an_attempt_is_drawn_as_it_falls() -> None:
    assert drawn(*((20 * k, "agreement", pair(3.0 - k)) for k in range(4))) == [
        (20 * k, 3.0 - k) for k in range(4)
    ]

"""``path-handoff view``: a run, or logs, in Rerun; or the layout for Foxglove and Lichtblick.

A run's logs are put onto one clock first (``missions.look.logs.merge``). What is shown is what any
reader of the log sees: Foxglove's messages, and figures of PATH's own records. Rerun's program is
started by path, for this computer alone.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from datetime import timedelta
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from drivers.interfaces import PartError
from drivers.log.index import MAGIC
from drivers.log.scan import LoggedMessage, messages
from missions.ground.options.runs import ViewOptions
from missions.ground.run_folder import claim_result
from missions.look.logs.merge import merge, named_logs
from missions.look.report.records import MERGED
from missions.look.view.eye import eye_of
from missions.look.view.viewer import page, serve, viewer, window

if TYPE_CHECKING:
    from rerun import ChunkBatcherConfig

LAYOUT = "foxglove.json"
# in every earlier result
LAYOUT_SIGN = '"configById"'
RERUN_SIGN = "RRF2"
REMEDY = (
    "install it with `.venv/bin/uv pip install --python .venv/bin/python -c constraints.txt -e '.[view]'` in your copy "
    "of PATH; or open the log in Foxglove or Lichtblick, with the layout that `path-handoff view --layout FILE` writes"
)


def run(options: ViewOptions) -> int:
    """``path-handoff view``. Raises PartError."""
    if options.layout is not None:
        claim_result(options.layout, LAYOUT_SIGN)
        options.layout.write_bytes(layout())
        sys.stdout.write(f"{options.layout}\n")
        return 0
    if not options.logs and not options.live:
        raise PartError(
            "nothing is named to look at",
            "name the folder of a run, or logs; or ask for --live, or for --layout FILE",
        )
    have_rerun()
    if options.save is not None:
        claim_result(options.save, RERUN_SIGN)
    if options.live:
        return _watch(options)
    with TemporaryDirectory(prefix="path-view-") as folder:
        rrd = options.save or Path(folder) / "run.rrd"
        write_rrd(options.logs, rrd, Path(folder))
        if options.save is not None:
            sys.stdout.write(f"{rrd}\n")
            return 0
        return serve(rrd, options.port) if options.web else window(rrd)


def layout() -> bytes:
    """The layout for Foxglove and Lichtblick, of topics as ``path-handoff merge`` names them."""
    return files("missions.look.view").joinpath(LAYOUT).read_bytes()


def have_rerun() -> None:
    """Raise PartError when Rerun, or what reads the log for it, is not installed."""
    missing = [name for name in ("rerun", "mcap_protobuf", "websockets") if find_spec(name) is None]
    if missing:
        raise PartError(
            f"looking at runs needs {' and '.join(missing)}, which is not installed", REMEDY
        )


def write_rrd(
    logs: Sequence[Path],
    rrd: Path,
    folder: Path,
) -> None:
    """Rerun's file of some logs; ``folder``: for what is needed meanwhile. Raises PartError,
    OSError.
    """
    import rerun as rr  # noqa: PLC0415 (an extra)

    from missions.look.view.blueprint import blueprint  # noqa: PLC0415
    from missions.look.view.drawing import Drawing  # noqa: PLC0415

    merged = _merged(logs, folder)
    recording = rr.RecordingStream(
        "path-handoff",
        recording_id=logs[0].resolve().name,
        batcher_config=_large_batches(),
    )
    topics: set[str] = set()
    recording.save(rrd)
    drawing = Drawing(recording)
    with merged.open("rb") as file:
        file.seek(len(MAGIC))
        for each in messages(file):
            if isinstance(each, LoggedMessage):
                topics.add(each.channel.topic)
                drawing.message(each.channel.topic, each.channel.schema, each.utc_ns, each.data)
    names = sorted({topic.split("/")[1] for topic in topics}, reverse=True)
    drones = [name for name in names if f"/{name}/image" in topics]
    recording.send_blueprint(
        blueprint(names, drones, drawing.plots, eye_of(drawing.paths.values()))
    )
    recording.flush()
    recording.disconnect()


def _large_batches() -> ChunkBatcherConfig:
    """A viewer reads a few large pieces far sooner than thousands of small ones."""
    import rerun as rr  # noqa: PLC0415 (an extra)

    batches = rr.ChunkBatcherConfig.DEFAULT()
    batches.flush_tick = timedelta(seconds=60.0)
    batches.flush_num_bytes = 8 << 20
    batches.flush_num_rows = 1 << 20
    return batches


def _merged(logs: Sequence[Path], folder: Path) -> Path:
    """One log on one clock, of whatever was named."""
    if len(logs) == 1 and logs[0].is_file() and logs[0].name == MERGED:
        return logs[0]
    merge(named_logs(logs), folder / MERGED)
    return folder / MERGED


def _watch(options: ViewOptions) -> int:
    """Flights as they go, until Ctrl-C, or until the window is closed. Raises PartError."""
    import rerun as rr  # noqa: PLC0415 (an extra)

    from missions.look.view.blueprint import PLOTS, blueprint  # noqa: PLC0415
    from missions.look.view.drawing import Drawing  # noqa: PLC0415
    from missions.look.view.watch import Watcher  # noqa: PLC0415

    recording = rr.RecordingStream("path-handoff")
    if options.save is not None:
        recording.save(options.save)
    shown = (
        nullcontext((None, "")) if options.save else page(options.port) if options.web else viewer()
    )
    with suppress(KeyboardInterrupt), shown as (server, at):
        if server is not None:
            recording.connect_grpc(at)
        drawing = Drawing(recording)
        watcher = Watcher(*options.live)
        names = set[str]()
        flying = 0
        with suppress(KeyboardInterrupt):
            while server is None or server.poll() is None:
                heard = watcher.next(0.5)
                if heard is None:
                    continue
                drawing.message(heard.topic, heard.schema, heard.utc_ns, heard.data)
                name = heard.topic.split("/")[1]
                if name not in names or len(drawing.paths) > flying:
                    names.add(name)
                    flying = len(drawing.paths)
                    known = sorted(names, reverse=True)
                    drones = [
                        name
                        for name in known
                        if name not in ("world", "attack") and "guard" not in name
                    ]
                    recording.send_blueprint(
                        blueprint(
                            known,
                            drones,
                            [kind for kind, _ in PLOTS],
                            eye_of(drawing.paths.values()),
                        )
                    )
        recording.flush()
        recording.disconnect()
    return 0

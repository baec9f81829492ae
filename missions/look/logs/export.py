"""``path-handoff export``: what a log holds, in forms that other programs read.

--tum   trajectories for evo and its like: seconds (UTC), x y z in m, quaternion x y z w; one file a body. DRONE.tum
        is the vehicle's own place, north-east-down; D2's camera in D1's marker's frame is
        marker.tum, and the target there, of a flight or a film, target.tum; and at levels with a
        world what was true of both: truth-DRONE.tum, the body in the world, and truth-marker.tum.
--csv   one table a topic and log: utc_ns, stamp_ns, then every field; lists have a column for each number.
--ros2  a bag of ROS 2 with standard messages (``missions.look.logs.ros2``); with --publish topics, while
        the logs are written (``missions.look.logs.ros2_live``).

A RealSense recording or a bag of ROS becomes images (``missions.look.logs.recording``).
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord, parts
from drivers.recordings.recording import REALSENSE_SUFFIXES
from drivers.recordings.ros_bag import METADATA, ros_bag_at
from drivers.recordings.ros_images import INSTALL
from missions.ground.options.runs import ExportOptions
from missions.ground.run_folder import unless_refused
from missions.ground.trajectory import Row, write_tum
from missions.look.logs.merge import utc_minus_stamp
from missions.look.logs.recording import export_recording
from missions.look.report.records import WORLD_LOG, RunRecords, drone_logs, load_run, read_parts
from missions.look.report.truth import Truth, truth_of
from path.geometry.rotation import quat_from_R
from path.messages import Role

ROS_PARTS = ("rosbags", "mcap_protobuf")
NOT_TURNED = (1.0, 0.0, 0.0, 0.0)


def run(options: ExportOptions) -> int:
    """``path-handoff export``. Raises PartError."""
    if options.folder.suffix.lower() in REALSENSE_SUFFIXES:
        return export_recording(options)
    if options.folder.exists() and ros_bag_at(options.folder) is not None:
        return export_recording(options)
    if options.calibration is not None:
        raise PartError(
            "--calibration is of a RealSense recording",
            f"leave it out for the run {options.folder}",
        )
    if not options.folder.is_dir():
        raise PartError(
            f"{options.folder} is no folder",
            "name the folder of a run, a RealSense recording (.db3), or a bag of ROS that is whole",
        )
    if any(options.folder.glob("*.db3")) or (options.folder / METADATA).is_file():
        raise PartError(
            f"{options.folder} is a bag of ROS 2 that is not whole: {METADATA} or its .db3 or .mcap is missing",
            f"name the file itself, or have {METADATA} written by `ros2 bag reindex`",
        )
    if not (options.tum or options.csv or options.ros2):
        raise PartError("nothing is asked for", "say --tum, --csv or --ros2, or several")
    if options.publish is not None:
        return _publish(options.folder, options.publish, ros2=options.ros2)
    out = options.out or options.folder / "export"
    with unless_refused(out):
        written = _write_all(options, out)
        if not written:
            raise PartError(
                f"{options.folder}: its logs hold nothing to be written",
                "was anything flown and logged? name the folder of another run",
            )
        for path in written:
            sys.stdout.write(f"{path}\n")
    return 0


def _write_all(options: ExportOptions, out: Path) -> list[Path]:
    written: list[Path] = []
    if options.tum:
        written += [
            write_tum(out / f"{name}.tum", rows)
            for name, rows in trajectories(options.folder).items()
            if rows
        ]
    if options.csv:
        written += [
            path
            for name, records in _logs(options.folder)
            for path in _write_csv(out, name, *records)
        ]
    if options.ros2:
        written.append(_write_ros2(options.folder, out))
    return written


def _publish(folder: Path, router: str, *, ros2: bool) -> int:
    if not ros2:
        raise PartError("--publish is of --ros2", "say --ros2 as well")
    _need(
        "zenoh",
        *ROS_PARTS,
        install=INSTALL.replace("`ros`: docs/films.md", "`ros-live`: docs/logs.md"),
    )
    from missions.look.logs.ros2_live import Topics, publish  # noqa: PLC0415 (an extra)

    with Topics(router) as topics:
        sys.stdout.write(f"publishing what is written into {folder} by {router}; Ctrl-C ends\n")
        sys.stdout.flush()
        publish(folder, topics, lambda: True)
    return 0


def _need(*names: str, install: str = INSTALL) -> None:
    missing = [name for name in names if find_spec(name) is None]
    if missing:
        raise PartError(f"--ros2 needs {' and '.join(missing)}, which is not installed", install)


def _write_ros2(folder: Path, out: Path) -> Path:
    _need(*ROS_PARTS)
    from missions.look.logs.ros2 import write_ros2  # noqa: PLC0415 (an extra)

    return write_ros2(folder, out)


def trajectories(folder: Path) -> dict[str, list[Row]]:
    """Every body's path by name, of what the drones logged and of what was true."""
    found: dict[str, list[Row]] = {}
    for name, records in drone_logs(folder).items():
        offset_ns = utc_minus_stamp(parts(folder, name))
        states = [r for r in records if r.topic == "/state"]
        found[name] = [
            (r.stamp_ns + offset_ns, r.record["position_n_m"], r.record["q_n_b"]) for r in states
        ]
        targets = [r for r in records if r.topic == "/target" and r.record["point_v_m"]]
        if targets:
            found["target"] = [
                (r.stamp_ns + offset_ns, r.record["point_v_m"], NOT_TURNED) for r in targets
            ]
        seen = [r for r in records if r.topic == "/candidate" and r.record["region"] is not None]
        if seen:
            found["marker"] = [
                (r.stamp_ns + offset_ns, r.record["position_v_m"], r.record["rotation_v_c2"])
                for r in seen
            ]
    if (folder / WORLD_LOG).is_file() and set(found) & {role.value for role in Role}:
        found |= _true(load_run(folder), folder)
    return found


def _true(run: RunRecords, folder: Path) -> dict[str, list[Row]]:
    offset_ns = utc_minus_stamp([folder / WORLD_LOG])
    records = run.world.get("/truth", ())
    found: dict[str, list[Row]] = {
        f"truth-{role.value}": [
            (r.stamp_ns + offset_ns, r.record[role.value]["t"], r.record[role.value]["q"])
            for r in records
        ]
        for role in Role
    }
    truth = truth_of(run.world)
    if truth is not None:
        found["truth-marker"] = list(_true_marker(run, truth, folder))
    return found


def _true_marker(
    run: RunRecords,
    truth: Truth,
    folder: Path,
) -> Iterator[Row]:
    """D2's camera in the marker's frame, at the very instants of ``marker.tum``."""
    offset_ns = utc_minus_stamp(parts(folder, Role.RECEIVER.value))
    for r in run.receiver.get("/candidate", ()):
        if r.record["region"] is not None:
            pose = truth.T_v_c2(r.stamp_ns)
            yield r.stamp_ns + offset_ns, pose.t.tolist(), quat_from_R(pose.R)


# --- tables


def _logs(folder: Path) -> Iterator[tuple[str, tuple[Sequence[LogRecord], int]]]:
    names = [
        *drone_logs(folder),
        *([Path(WORLD_LOG).stem] if (folder / WORLD_LOG).is_file() else []),
    ]
    for name in names:
        files = parts(folder, name)
        yield name, (read_parts(*files), utc_minus_stamp(files))


def _write_csv(
    out: Path,
    name: str,
    records: Sequence[LogRecord],
    offset_ns: int,
) -> Iterator[Path]:
    for topic in sorted({record.topic for record in records} - {"/image"}):
        rows = [
            {"utc_ns": r.stamp_ns + offset_ns, "stamp_ns": r.stamp_ns, **dict(_flat("", r.record))}
            for r in records
            if r.topic == topic
        ]
        columns = list(dict.fromkeys(column for row in rows for column in row))
        path = out / f"{name}.{topic.strip('/')}.csv"
        with path.open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, columns)
            table.writeheader()
            table.writerows(rows)
        yield path


def _flat(name: str, value: Any) -> Iterable[tuple[str, Any]]:
    """``[1, 2]`` of ``x`` as ``x.0`` and ``x.1``; names within names likewise."""
    if isinstance(value, Mapping):
        inner: Iterable[tuple[Any, Any]] = value.items()
    elif isinstance(value, list):
        inner = enumerate(value)
    else:
        return [(name, value)]
    return [
        each for key, part in inner for each in _flat(f"{name}.{key}" if name else str(key), part)
    ]

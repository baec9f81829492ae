"""``path-handoff export --ros2``: a run as a bag of ROS 2, written without ROS.

All logs on one clock (``missions.look.logs.merge``), as standard messages
(``missions.look.logs.ros2_messages``): ``rosbags`` has their definitions, encodes them as CDR and
writes the bag.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drivers.interfaces import PartError
from drivers.log.index import MAGIC
from drivers.log.scan import LoggedMessage, messages
from missions.look.logs.merge import merge, named_logs
from missions.look.logs.ros2_messages import Fields, Standards
from missions.look.report.records import MERGED

BAG = "ros2"
BAG_VERSION = 9
EMPTY = {"string": "", "bool": False}
STORE = Stores.ROS2_JAZZY
# of vision_msgs 4.1, which is no part of a distribution's core
VISION = {
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "Detection2D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox2D bbox\nstring id",
    "Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections",
}


def write_ros2(folder: Path, out: Path) -> Path:
    """Write a run's logs as a bag of ROS 2 into a folder of its own. Raises PartError, OSError."""
    bag = out / BAG
    if bag.exists():
        shutil.rmtree(bag)  # of an earlier export: the folder is held, and is an export's
    store = ros2_types()
    said = Standards()
    with TemporaryDirectory(prefix="path-ros2-") as there:
        merged = Path(there) / MERGED
        merge(named_logs([folder]), merged)
        with (
            Writer(bag, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as writer,
            merged.open("rb") as file,
        ):
            file.seek(len(MAGIC))
            connections: dict[str, Any] = {}
            for each in messages(file):
                if not isinstance(each, LoggedMessage):
                    continue
                for topic, kind, fields in said.of(each):
                    if topic not in connections:
                        connections[topic] = writer.add_connection(topic, kind, typestore=store)
                    data = store.serialize_cdr(made(store, kind, fields), kind)
                    writer.write(connections[topic], each.utc_ns, data)
    if not connections:
        raise PartError(f"{folder}: its logs hold nothing that ROS knows", "name another run")
    return bag


def ros2_types() -> Any:
    """Return the definitions of all types that are written."""
    store = get_typestore(STORE)
    for name, text in VISION.items():
        store.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
    return store


def made(
    store: Any,
    kind: str,
    fields: Fields,
) -> Any:
    """Return a message of a type. Raises ValueError for a field that it does not have."""
    known = store.get_msgdef(kind).fields
    strange = set(fields) - {name for name, _ in known}
    if strange:
        raise ValueError(f"{kind} has no {', '.join(sorted(strange))}")
    return store.types[kind](*(_field(store, of, fields.get(name)) for name, of in known))


def _field(
    store: Any,
    of: Any,
    given: Any,
) -> Any:
    node, detail = of
    if node is Nodetype.NAME:
        return made(store, detail, given or {})
    if node is Nodetype.BASE:
        return EMPTY.get(detail[0], 0) if given is None else given
    (inner, name), length = detail
    values = given if given is not None else ()
    if inner is Nodetype.NAME:
        return [made(store, name, each) for each in values]
    if name[0] == "string":
        return list(values)
    if isinstance(values, bytes):
        return np.frombuffer(values, np.uint8)
    numbers = np.asarray(values, name[0])
    return numbers if len(numbers) or node is Nodetype.SEQUENCE else np.zeros(length, name[0])

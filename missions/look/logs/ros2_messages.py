"""What a log holds, as messages of ROS 2: topic, type and fields. Imports nothing of ROS.

What viewers are told (``drivers.log.foxglove``) and PATH's own records become standard messages. Of
the drone NAME:

    /tf                             tf2_msgs/TFMessage: world (ENU), n (NED), NAME/body (FRD), NAME/camera
    /NAME/camera/image/compressed   sensor_msgs/CompressedImage
    /NAME/camera/camera_info        sensor_msgs/CameraInfo
    /NAME/fix                       sensor_msgs/NavSatFix
    /NAME/pose                      geometry_msgs/PoseStamped, in n
    /NAME/target, /NAME/marker      geometry_msgs/PoseWithCovarianceStamped, in sender/marker
    /NAME/detections                vision_msgs/Detection2DArray, in the image
    /NAME/markers                   visualization_msgs/MarkerArray
    /diagnostics                    diagnostic_msgs/DiagnosticArray
    /rosout                         rcl_interfaces/Log

Of the world: /world/truth/BODY as PoseStamped. Stamps are UTC, of the capture where there is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from mcap_protobuf.decoder import DecoderFactory

from drivers.log.scan import LoggedMessage
from drivers.log.topics import blank

Fields = Mapping[str, Any]
"""A message by its fields; those that are left out are zero, empty or false."""
Said = Iterable[tuple[str, str, Fields]]
"""Topic, type and fields of each message."""

CUBE, SPHERE, LINE_STRIP, LINE_LIST, TEXT = 1, 2, 4, 5, 9  # of visualization_msgs/Marker
LINE_LOOP = 1  # of foxglove.LinePrimitive, which has LINE_LIST as 2
LINES = 2
ROS_LEVEL = {0: 10, 1: 10, 2: 20, 3: 30, 4: 40, 5: 50}  # of rcl_interfaces/Log, by foxglove.Log's
WARN = 1  # of diagnostic_msgs/DiagnosticStatus
ERROR = 2
DIAGNOSED = {
    "phase": 0, "outcome": 0, "link": 0, "cpu": 0, "recording": 0, "late": WARN, "shed": WARN, "fault": WARN,
    "guard": WARN, "guard_alarm": WARN, "violation": ERROR,
}  # fmt: skip
"""PATH's topics that say how it goes, with the level of what they say."""


class Standards:
    """Messages of ROS for each message of a merged log. Imports nothing of ROS."""

    def __init__(self) -> None:
        self._decode: dict[str, Callable[[bytes], Any]] = {}
        self._of_viewers: dict[str, Callable[[str, int, Any], Said]] = {
            "foxglove.FrameTransforms": transforms,
            "foxglove.CameraCalibration": camera_info,
            "foxglove.CompressedImage": image,
            "foxglove.LocationFix": fix,
            "foxglove.SceneUpdate": markers,
            "foxglove.Log": line,
        }
        self._of_records: dict[str, Callable[[str, int, Any], Said]] = {
            "state": pose,
            "target": target,
            "marker": marker,
            "candidate": candidate,
            "track": track,
            "truth": truth,
        }

    def of(self, message: LoggedMessage) -> Said:
        name, _, own = message.channel.topic.lstrip("/").partition("/")
        schema = message.channel.schema
        make = self._of_viewers.get(schema.name)
        if make is not None:
            if schema.name not in self._decode:
                # a factory of its own for each: it remembers schemas by their id
                decoder = DecoderFactory().decoder_for("protobuf", schema)
                assert decoder is not None
                self._decode[schema.name] = decoder
            return make(name, message.utc_ns, self._decode[schema.name](message.data))
        if own not in self._of_records and own not in DIAGNOSED:
            return ()
        record = {**blank(f"/{own}"), **msgspec.json.decode(message.data)}
        if own in DIAGNOSED:
            return diagnostics(name, own, message.utc_ns, record)
        return self._of_records[own](name, message.utc_ns, record)


# --- what viewers are told


def transforms(
    name: str,
    utc_ns: int,
    message: Any,
) -> Said:
    moved = [
        {
            "header": _header(utc_ns, each.parent_frame_id),
            "child_frame_id": each.child_frame_id,
            "transform": {"translation": _vec(each.translation), "rotation": _turn(each.rotation)},
        }
        for each in message.transforms
    ]
    yield "/tf", "tf2_msgs/msg/TFMessage", {"transforms": moved}


def camera_info(
    name: str,
    utc_ns: int,
    message: Any,
) -> Said:
    yield (
        f"/{name}/camera/camera_info",
        "sensor_msgs/msg/CameraInfo",
        {
            "header": _header(utc_ns, message.frame_id),
            "width": message.width,
            "height": message.height,
            "distortion_model": message.distortion_model,
            "d": list(message.D),
            "k": list(message.K),
            "r": list(message.R),
            "p": list(message.P),
        },
    )


def image(
    name: str,
    utc_ns: int,
    message: Any,
) -> Said:
    picture = {
        "header": _header(utc_ns, message.frame_id), "format": message.format, "data": message.data
    }  # fmt: skip
    yield f"/{name}/camera/image/compressed", "sensor_msgs/msg/CompressedImage", picture


def fix(
    name: str,
    utc_ns: int,
    message: Any,
) -> Said:
    place = {
        "header": _header(utc_ns, f"{name}/body"),
        "latitude": message.latitude,
        "longitude": message.longitude,
        "altitude": message.altitude,
    }
    yield f"/{name}/fix", "sensor_msgs/msg/NavSatFix", place


def markers(
    name: str,
    utc_ns: int,
    message: Any,
) -> Said:
    """What is drawn in the scene; each entity is a namespace."""
    drawn: list[Fields] = []
    for entity in message.entities:
        shapes: list[Fields] = []
        for cube in entity.cubes:
            shapes.append(_shape(CUBE, cube.pose, _vec(cube.size), cube.color))
        for sphere in entity.spheres:
            shapes.append(_shape(SPHERE, sphere.pose, _vec(sphere.size), sphere.color))
        for text in entity.texts:
            size = {"z": 0.05 if text.scale_invariant else text.font_size}
            shapes.append({**_shape(TEXT, text.pose, size, text.color), "text": text.text})
        for drawing in entity.lines:
            shapes.append(_lines(drawing))
        lasts = {"sec": entity.lifetime.seconds, "nanosec": entity.lifetime.nanos}
        drawn += [
            {
                **shape,
                "header": _header(utc_ns, entity.frame_id),
                "ns": entity.id,
                "id": number,
                "lifetime": lasts,
                "frame_locked": True,
            }
            for number, shape in enumerate(shapes)
        ]
    yield f"/{name}/markers", "visualization_msgs/msg/MarkerArray", {"markers": drawn}


def line(
    name: str,
    utc_ns: int,
    message: Any,
) -> Said:
    said = {
        "stamp": _time(utc_ns), "level": ROS_LEVEL[message.level], "name": name, "msg": message.message
    }  # fmt: skip
    yield "/rosout", "rcl_interfaces/msg/Log", said


# --- PATH's records


def pose(
    name: str,
    utc_ns: int,
    record: Any,
) -> Said:
    yield _pose(f"/{name}/pose", utc_ns, "n", record["position_n_m"], record["q_n_b"])


def target(
    name: str,
    utc_ns: int,
    record: Any,
) -> Said:
    """D1's frame: where the target is, as it is sent to D2, and what was seen."""
    if record["point_v_m"] is not None:
        yield _sure(f"/{name}/target", utc_ns, record["point_v_m"], _NO_TURN, record["sigma_m"])
    if record["box"] is not None:
        beside = np.reshape(record["beside"] or (), (-1, 6))[:, :4].tolist()
        yield _boxes(name, utc_ns, [("target", record["box"], 1.0)], beside)


def marker(
    name: str,
    utc_ns: int,
    record: Any,
) -> Said:
    """D2's camera, as it measures it in the frame of D1's marker."""
    if record["position_v_m"] is not None:
        place = record["position_v_m"], record["rotation_v_c2"]
        yield _sure(f"/{name}/marker", utc_ns, *place, record["sigma_m"])


def candidate(
    name: str,
    utc_ns: int,
    record: Any,
) -> Said:
    found = [("detection", each["box"], each["score"]) for each in record["found"] or ()]
    own = [] if record["box"] is None else [("target", record["box"], 1.0)]
    yield _boxes(name, utc_ns, [*own, *found])


def track(
    name: str,
    utc_ns: int,
    record: Any,
) -> Said:
    if record["box"] is not None:
        yield _boxes(name, utc_ns, [("target", record["box"], 1.0)])


def truth(
    name: str,
    utc_ns: int,
    record: Any,
) -> Said:
    for role in ("sender", "receiver"):
        if record[role] is not None:
            yield _pose(
                f"/{name}/truth/{role}",
                utc_ns,
                "world",
                record[role]["t"],
                record[role]["q"],
            )
    for each in record["objects"] or ():
        half = 0.5 * each["yaw"]
        turn = (math.cos(half), 0.0, 0.0, math.sin(half))
        yield _pose(f"/{name}/truth/object_{each['id']}", utc_ns, "world", each["t"], turn)


def diagnostics(
    name: str,
    own: str,
    utc_ns: int,
    record: Any,
) -> Said:
    values = [{"key": key, "value": str(value)} for key, value in _flat("", record)]
    told = record.get("phase") or record.get("outcome") or record.get("detail") or ""
    status = {
        "level": DIAGNOSED[own], "name": f"{name}: {own}", "message": str(told), "hardware_id": name,
        "values": values,
    }  # fmt: skip
    array = {"header": _header(utc_ns, ""), "status": [status]}
    yield "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", array


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if not isinstance(value, Mapping):
        yield name, value
        return
    for key, inner in value.items():
        yield from _flat(f"{name}.{key}" if name else str(key), inner)


# --- parts of messages

_NO_TURN = (1.0, 0.0, 0.0, 0.0)


def _time(utc_ns: int) -> Fields:
    seconds, nanos = divmod(utc_ns, 1_000_000_000)
    return {"sec": seconds, "nanosec": nanos}


def _header(utc_ns: int, frame: str) -> Fields:
    return {"stamp": _time(utc_ns), "frame_id": frame}


def _vec(of: Any) -> Fields:
    return {"x": of.x, "y": of.y, "z": of.z}


def _turn(of: Any) -> Fields:
    return {"x": of.x, "y": of.y, "z": of.z, "w": of.w}


def _placed(t: Sequence[float], q: Sequence[float]) -> Fields:
    """A geometry_msgs/Pose. ``q``: wxyz."""
    position = dict(zip("xyz", t, strict=True))
    return {"position": position, "orientation": dict(zip("wxyz", q, strict=True))}


def _pose(
    topic: str,
    utc_ns: int,
    frame: str,
    t: Sequence[float],
    q: Sequence[float],
) -> tuple[str, str, Fields]:
    stamped = {"header": _header(utc_ns, frame), "pose": _placed(t, q)}
    return topic, "geometry_msgs/msg/PoseStamped", stamped


def _sure(
    topic: str,
    utc_ns: int,
    t: Sequence[float],
    q: Sequence[float],
    sigma_m: float | None,
) -> tuple[str, str, Fields]:
    """A place with its covariance; that of the rotation is not told, and is zero."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.eye(3) * (sigma_m or 0.0) ** 2
    sure = {"pose": _placed(t, q), "covariance": covariance.ravel()}
    stamped = {"header": _header(utc_ns, "sender/marker"), "pose": sure}
    return topic, "geometry_msgs/msg/PoseWithCovarianceStamped", stamped


def _boxes(
    name: str,
    utc_ns: int,
    found: Sequence[tuple[str, Sequence[float], float]],
    beside: Sequence[Sequence[float]] = (),
) -> tuple[str, str, Fields]:
    header = _header(utc_ns, f"{name}/camera")
    every = [*found, *(("beside", box, 1.0) for box in beside)]
    detections = [
        {
            "header": header,
            "results": [{"hypothesis": {"class_id": kind, "score": score}}],
            "bbox": {
                "center": {"position": {"x": x + 0.5 * w, "y": y + 0.5 * h}},
                "size_x": w,
                "size_y": h,
            },
            "id": kind,
        }
        for kind, (x, y, w, h), score in every
    ]
    array = {"header": header, "detections": detections}
    return f"/{name}/detections", "vision_msgs/msg/Detection2DArray", array


def _shape(
    kind: int,
    at: Any,
    size: Fields,
    color: Any,
) -> Fields:
    place = {"position": _vec(at.position), "orientation": _turn(at.orientation)}
    return {"type": kind, "pose": place, "scale": size, "color": _color(color)}


def _lines(of: Any) -> Fields:
    points = [_vec(point) for point in of.points]
    if of.type == LINE_LOOP:
        points += points[:1]
    kind = LINE_LIST if of.type == LINES else LINE_STRIP
    thick = 0.01 if of.scale_invariant else of.thickness
    return {**_shape(kind, of.pose, {"x": thick}, of.color), "points": points}


def _color(of: Any) -> Fields:
    return {"r": of.r, "g": of.g, "b": of.b, "a": of.a}

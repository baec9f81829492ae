"""The log's records in Foxglove's schemas, which any viewer knows, made from PATH's own.

    /calibration   CameraCalibration, of NAME/camera
    /tf            FrameTransforms: world (ENU) - n (NED) - NAME/body (FRD) - NAME/camera, NAME/marker, and on D2
                   NAME/camera - NAME/marker_seen, D1's marker as D2 measures it
    /annotations   ImageAnnotations: boxes, marker, prior and search region of a frame, and the verdict on it
    /3d            SceneUpdate: frustum, body, marker, target with its standard deviation, distance to the marker,
                   fence; of the world's log: the true bodies and objects
    /position      LocationFix, where the vehicle believes to be
    /log           Log: phases, notes, decisions

Nothing here is read back by PATH. What changes with every frame is told ten times a second, and for
every logged image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from foxglove.messages import (
    CameraCalibration,
    CubePrimitive,
    FrameTransform,
    FrameTransforms,
    ImageAnnotations,
    LinePrimitive,
    LinePrimitiveLineType,
    LogLevel,
    Point3,
    PointsAnnotation,
    PointsAnnotationType,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    TextAnnotation,
    TextPrimitive,
    Vector3,
)
from foxglove.messages import Log as Line

from drivers.log import foxglove_primitives as draw
from drivers.log.foxglove_primitives import Message, Record
from drivers.log.topics import blank
from path.geometry.rotation import rotate
from path.messages import Vec3

Standard = tuple[str, Message]

PERIOD_NS = 90_000_000  # ten times a second, whatever the frames' rate
AGAIN_NS = 1_000_000_000  # what does not change, for viewers that come late
BODY_M = (0.35, 0.35, 0.1)

ENU_OF_NED = Quaternion(w=0.0, x=math.sqrt(0.5), y=math.sqrt(0.5))
OF_A_FRAME: Mapping[str, tuple[str, ...]] = {
    "/target": ("/3d", "/annotations"),
    "/track": ("/3d target", "/annotations"),
    "/candidate": ("/3d target", "/annotations"),
    "/marker": ("/3d", "/annotations"),
    "/agreement": (),
}
"""Topics that come with every frame, and what they are told in, when it is due."""
LEVELS = {
    "/violation": LogLevel.Error,
    "/fault": LogLevel.Warning,
    "/guard": LogLevel.Warning,
    "/guard_alarm": LogLevel.Warning,
}


class Standards:
    """Foxglove's messages of one log. Stamps are UTC."""

    def __init__(self, name: str) -> None:
        prefix = f"{name}/" if name else ""
        self.camera = f"{prefix}camera"
        self._body = f"{prefix}body"
        self._marker = f"{prefix}marker"
        self._seen = f"{prefix}marker_seen"
        self._name = name
        self._setup: Record | None = None
        self._scene: Record | None = None
        self._parts: list[tuple[Vec3, Vector3]] = []  # middle and size of each box of an object
        self._said_ns: dict[str, int] = {}
        self._newest: dict[str, tuple[int, Record]] = {}
        self._of: dict[str, Callable[[int, Record], Iterable[Standard]]] = {
            "/setup": self._on_setup,
            "/link": self._again,
            "/state": self._on_state,
            "/target": self._on_target,
            "/track": self._on_frame,
            "/marker": self._on_marker,
            "/candidate": self._on_frame,
            "/scene": self._on_scene,
            "/truth": self._on_truth,
        }

    def of(self, topic: str, stamp_ns: int, record: Record) -> Iterable[Standard]:
        """Return a viewer's messages for a record."""
        told_in = OF_A_FRAME.get(topic)
        if told_in is not None:
            self._newest[topic] = stamp_ns, record
            for each in told_in:
                if self._is_due(each, stamp_ns):
                    break
            else:
                return ()
        if topic in LINES:
            return (self._line(topic, stamp_ns, {**blank(topic), **record}),)
        make = self._of.get(topic)
        return () if make is None else make(stamp_ns, {**blank(topic), **record})

    def of_image(self, stamp_ns: int) -> Iterable[Standard]:
        """Return what is drawn over an image; nothing when it was just told."""
        return (
            () if self._said_ns.get("/annotations") == stamp_ns else (self._annotations(stamp_ns),)
        )

    def _due(self, topic: str, stamp_ns: int, period_ns: int = PERIOD_NS) -> bool:
        if not self._is_due(topic, stamp_ns, period_ns):
            return False
        self._said_ns[topic] = stamp_ns
        return True

    def _is_due(self, topic: str, stamp_ns: int, period_ns: int = PERIOD_NS) -> bool:
        return stamp_ns - self._said_ns.get(topic, -AGAIN_NS) >= period_ns

    def _line(self, topic: str, stamp_ns: int, record: Record) -> Standard:
        level = LEVELS.get(topic, LogLevel.Info)
        return "/log", Line(
            timestamp=draw.time_of(stamp_ns),
            level=level,
            name=self._name,
            message=LINES[topic](record),
        )

    # --- what does not change

    def _on_setup(self, stamp_ns: int, record: Record) -> Iterator[Standard]:
        self._setup = record
        yield from self._again(stamp_ns, record)

    def _again(self, stamp_ns: int, _: Record) -> Iterator[Standard]:
        if self._setup is None or not self._due("/calibration", stamp_ns, AGAIN_NS // 2):
            return
        yield "/calibration", self._calibration(stamp_ns, self._setup["camera"])
        mounts = [draw.transform(stamp_ns, self._body, self.camera, self._setup["T_b_c"])]
        if self._setup["role"] == "sender":
            mounts.append(draw.transform(stamp_ns, self._body, self._marker, self._setup["T_b_v"]))
        north = FrameTransform(
            timestamp=draw.time_of(stamp_ns), parent_frame_id="world", child_frame_id="n", translation=Vector3(),
            rotation=ENU_OF_NED,
        )  # fmt: skip
        yield "/tf", FrameTransforms(transforms=[north, *mounts])
        entities = self._bodies(stamp_ns, self._setup)
        if self._setup["fence_m"] is not None:
            entities.append(
                self._entity(stamp_ns, "n", "fence", lines=draw.fence(*self._setup["fence_m"]))
            )
        yield "/3d", SceneUpdate(entities=entities)

    def _calibration(self, stamp_ns: int, camera: Record) -> Message:
        fx, fy, cx, cy = (camera[name] for name in ("fx", "fy", "cx", "cy"))
        return CameraCalibration(
            timestamp=draw.time_of(stamp_ns),
            frame_id=self.camera,
            width=camera["width"],
            height=camera["height"],
            distortion_model="plumb_bob",
            D=list(camera["distortion"]),
            K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        )

    def _bodies(self, stamp_ns: int, setup: Record) -> list[SceneEntity]:
        color = draw.BLUE if setup["role"] == "sender" else draw.ORANGE
        body = CubePrimitive(
            pose=draw.pose((0.0, 0.0, 0.0), draw.AS_IT_IS), size=draw.vector(BODY_M), color=color
        )
        entities = [
            self._entity(stamp_ns, self._body, "body", cubes=[body]),
            self._entity(
                stamp_ns, self.camera, "frustum", lines=[draw.frustum(setup["camera"], color)]
            ),
        ]
        if setup["role"] == "sender":
            squares = [
                LinePrimitive(
                    type=LinePrimitiveLineType.LineLoop,
                    points=[draw.point(c) for c in corners],
                    color=draw.PINK,
                    thickness=0.004,
                )
                for corners in np.reshape(setup["markers_v_m"], (-1, 4, 3)).tolist()
            ]
            entities.append(self._entity(stamp_ns, self._marker, "marker", lines=squares))
        return entities

    def _entity(self, stamp_ns: int, frame: str, name: str, **parts: Any) -> SceneEntity:
        entity_id = f"{self._name}/{name}"
        return SceneEntity(
            timestamp=draw.time_of(stamp_ns),
            frame_id=frame,
            id=entity_id,
            frame_locked=True,
            **parts,
        )

    # --- what a drone knows

    def _on_state(self, stamp_ns: int, record: Record) -> Iterator[Standard]:
        position = record["position_n_m"]
        if not all(map(math.isfinite, position)):
            return
        yield (
            "/tf",
            FrameTransforms(
                transforms=[draw.moved(stamp_ns, "n", self._body, position, record["q_n_b"])]
            ),
        )
        if self._setup is not None:
            yield "/position", draw.fix(stamp_ns, self._setup["origin"], position)

    def _on_target(self, stamp_ns: int, record: Record) -> Iterator[Standard]:
        point = record["point_v_m"]
        if point is not None and self._due("/3d", stamp_ns):
            target = self._entity(
                stamp_ns,
                self._marker,
                "target",
                spheres=[draw.sphere(point, record["sigma_m"], draw.PALE_BLUE)],
            )
            yield "/3d", SceneUpdate(entities=[target])
        yield from self._draw(stamp_ns)

    def _on_frame(self, stamp_ns: int, record: Record) -> Iterator[Standard]:
        """``/track`` or ``/candidate``: the last word on a frame."""
        point = record.get("point_v_m")
        if point is not None and self._due("/3d target", stamp_ns):
            sphere = draw.sphere(point, record["sigma_m"], draw.PALE_ORANGE)
            target = self._entity(stamp_ns, self._seen, "target", spheres=[sphere])
            yield "/3d", SceneUpdate(entities=[target])
        yield from self._draw(stamp_ns)

    def _on_marker(self, stamp_ns: int, record: Record) -> Iterator[Standard]:
        position = record["position_v_m"]
        if position is not None and self._due("/3d", stamp_ns):
            w, x, y, z = record["rotation_v_c2"]
            back = (w, -x, -y, -z)
            marker_c = [-along for along in rotate(back, position)]
            yield (
                "/tf",
                FrameTransforms(
                    transforms=[draw.moved(stamp_ns, self.camera, self._seen, marker_c, back)]
                ),
            )
            yield "/3d", SceneUpdate(entities=[self._distance(stamp_ns, marker_c)])
        candidate = self._newest.get("/candidate")
        if candidate is None or stamp_ns - candidate[0] > 3 * PERIOD_NS:
            yield from self._draw(stamp_ns)

    def _distance(self, stamp_ns: int, marker_c: Sequence[float]) -> SceneEntity:
        line = LinePrimitive(
            type=LinePrimitiveLineType.LineStrip,
            points=[Point3(), draw.point(marker_c)],
            color=draw.PINK,
            thickness=0.005,
        )
        middle = draw.pose([c / 2 for c in marker_c], draw.AS_IT_IS)
        text = TextPrimitive(
            pose=middle,
            billboard=True,
            font_size=0.08,
            color=draw.PINK,
            text=f"{math.hypot(*marker_c):.2f} m",
        )
        return self._entity(stamp_ns, self.camera, "separation", lines=[line], texts=[text])

    # --- over the images

    def _draw(self, stamp_ns: int) -> Iterator[Standard]:
        if self._due("/annotations", stamp_ns):
            yield self._annotations(stamp_ns)

    def _annotations(self, stamp_ns: int) -> Standard:
        self._said_ns["/annotations"] = stamp_ns
        points: list[PointsAnnotation] = []
        texts: list[TextAnnotation] = []
        for topic, color in (
            ("/target", draw.BLUE),
            ("/track", draw.BLUE),
            ("/candidate", draw.ORANGE),
        ):
            record = self._lately(topic, stamp_ns)
            points += draw.box(stamp_ns, record.get("box"), color)
        pair = self._lately("/agreement", stamp_ns)
        points += draw.box(stamp_ns, pair.get("mapped_box"), draw.ORANGE)
        if pair:
            texts.append(
                draw.text(stamp_ns, _verdict(pair), draw.GREEN if pair["agreed"] else draw.RED)
            )
        answer = self._lately("/candidate", stamp_ns)
        if region := answer.get("region"):
            x0, y0, x1, y1 = region
            points += draw.box(stamp_ns, (x0, y0, x1 - x0, y1 - y0), draw.GREY)
        if prior := answer.get("prior_px"):
            u, v = prior
            cross = [(u - 6, v), (u + 6, v), (u, v - 6), (u, v + 6)]
            points.append(draw.lines(stamp_ns, PointsAnnotationType.LineList, cross, draw.GREY))
        marker = self._lately("/marker", stamp_ns)
        if marker.get("corners_px") is not None:
            corners = np.reshape(marker["corners_px"], (-1, 2)).tolist()
            points.append(draw.lines(stamp_ns, PointsAnnotationType.LineLoop, corners, draw.PINK))
        for topic in ("/target", "/candidate", "/marker"):
            if reason := self._lately(topic, stamp_ns).get("reason"):
                texts.append(draw.text(stamp_ns, reason, draw.RED, line=1))
                break
        return "/annotations", ImageAnnotations(
            timestamp=draw.time_of(stamp_ns), points=points, texts=texts
        )

    def _lately(self, topic: str, stamp_ns: int) -> Record:
        """The newest record of a topic, when it is of about this instant."""
        newest = self._newest.get(topic)
        return (
            {**blank(topic), **newest[1]}
            if newest is not None and abs(stamp_ns - newest[0]) < 3 * PERIOD_NS
            else {}
        )

    # --- the world

    def _on_scene(self, stamp_ns: int, record: Record) -> Iterable[Standard]:
        del stamp_ns
        self._scene = record
        self._parts = [(part["c"], draw.vector(part["s"])) for part in record["boxes"]]
        return ()

    def _on_truth(self, stamp_ns: int, record: Record) -> Iterator[Standard]:
        if self._scene is None or not self._due("/3d", stamp_ns):
            return
        bodies = [body for body in record.values() if isinstance(body, Mapping) and "q" in body]
        cubes = [
            CubePrimitive(
                pose=draw.pose(body["t"], body["q"]), size=draw.vector(BODY_M), color=draw.GHOST
            )
            for body in bodies
        ]
        for each in record["objects"]:
            color = draw.GREEN if each["id"] == self._scene["target_id"] else draw.GREY
            half = each["yaw"] / 2.0
            turn = (math.cos(half), 0.0, 0.0, math.sin(half))
            (x, y, z), orientation = each["t"], draw.quaternion(turn)
            for center, size in self._parts:
                dx, dy, dz = rotate(turn, center)
                pose = Pose(position=Vector3(x=x + dx, y=y + dy, z=z + dz), orientation=orientation)
                cubes.append(CubePrimitive(pose=pose, size=size, color=color))
        yield "/3d", SceneUpdate(entities=[self._entity(stamp_ns, "world", "truth", cubes=cubes)])


LINES: dict[str, Callable[[Record], str]] = {
    "/phase": lambda r: f"phase {r['phase']}" + (f": {r['note']}" if r["note"] else ""),
    "/note": lambda r: str(r["note"]),
    "/outcome": lambda r: f"outcome {r['outcome']}" + (f": {r['detail']}" if r["detail"] else ""),
    "/responsibility": lambda r: (
        f"responsible: {r['responsible']}" + ("" if r["until_ns"] is None else ", in a lease")
    ),
    "/commit": lambda r: f"commit of target {r['target_id']} in epoch {r['epoch']}",
    "/decision": lambda r: f"decision {r['outcome']}" + (f": {r['reason']}" if r["reason"] else ""),
    "/refused": lambda r: f"refused: {r['why']}",
    "/guard": lambda r: f"guard {r['stage']}: {r['act']} {r['reason']}",
    "/guard_alarm": lambda r: f"guard ignores {r['ignored']}",
    "/violation": lambda r: str(r["detail"]),
    "/fault": lambda r: f"fault {r['fault']}",
    "/operator": lambda r: f"{r['act']}, {'done' if r['done'] else 'refused'}: {r['why']}",
}


def _verdict(pair: Record) -> str:
    count = f"{min(pair['count'], pair['needed'])}/{pair['needed']}"
    if pair["iou"] is None:
        return f"{pair['reason']}  {count}"
    tau = "" if pair["tau"] is None else f" (needs {pair['tau']:.2f})"
    return f"IoU {pair['iou']:.2f}{tau}  {count}"

"""Films of a recorded run as somebody without PATH would have them: a video, a folder of images,
and a text file.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from drivers.interfaces import Frame
from drivers.log.mcap_log import LogRecord
from drivers.log.video import recorded_frames
from drivers.rig.calibration_file import CameraCalibration, CameraTable, Quality, write_calibration
from drivers.rig.parts import Mount
from missions.ground import rig_library
from missions.look.replay.logged import pose_of
from missions.look.report.records import drone_logs
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_quat, quat_from_R
from path.messages import Role

FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def make_films(run: Path, folder: Path, seconds: tuple[float, float]) -> Path:
    """Both drones' films of a part of a run, by seconds from when the views are compared, and the
    file that names them.

    D1's is a video with depth images and a table of stamps, D2's a folder of images with stamps of
    its own clock.
    """
    logs = drone_logs(run)
    targets = [
        each
        for each in logs["sender"]
        if each.topic == "/target" and each.record["box"] is not None
    ]
    verify_ns = next(
        each.stamp_ns
        for each in logs["sender"]
        if each.topic == "/phase" and each.record["phase"] == "verify"
    )
    begin_ns, end_ns = (verify_ns + round(each * 1e9) for each in seconds)
    ahead_ns = next(  # D2's clock is of D1's, as they have measured it
        each.record["capture_ns"] - each.record["peer_capture_ns"]
        for each in reversed(logs["receiver"])
        if each.topic == "/heard_target"
    )
    first = next(each for each in targets if each.stamp_ns >= begin_ns)
    sent = list(_part(run / "sender.frames.mcap", begin_ns, end_ns))
    write_video(folder / "d1.mkv", sent)
    (folder / "d1.csv").write_text(
        "stamp_ns\n" + "".join(f"{each.stamp_ns}\n" for each in sent), "utf-8"
    )
    (folder / "short.csv").write_text("stamp_ns\n1\n2\n3\n", "utf-8")
    (folder / "d1-depth").mkdir()
    for number, each in enumerate(sent):
        assert each.depth_mm is not None
        cv2.imwrite(str(folder / "d1-depth" / f"{number}.png"), each.depth_mm, FAST)
    (folder / "d2").mkdir()
    lines = ["file,stamp_s\n"]
    for number, each in enumerate(
        _part(run / "receiver.frames.mcap", begin_ns + ahead_ns, end_ns + ahead_ns)
    ):
        cv2.imwrite(str(folder / "d2" / f"{number}.png"), each.color, FAST)
        lines.append(f"{number}.png,{each.stamp_ns * 1e-9:.9f}\n")
    (folder / "d2" / "stamps.csv").write_text("".join(lines), "utf-8")
    rig = rig_library.load_unchecked(str(run / "recorded.toml"))
    for role in Role:
        own = rig.role(role)
        write_calibration(folder / f"{role.value}.camera.toml", calibrated(own.camera))
        write_tum(folder / f"{role.value}.tum", logs[role.value], own.mount)
    write_calibration(
        folder / "small.toml", calibrated(CameraModel(320, 240, 300.0, 300.0, 160.0, 120.0))
    )
    x, y, w, h = first.record["box"]
    file = folder / "films.toml"
    file.write_text(
        f"""rig = "{run}/recorded.toml"

[target]
pixel = [{x + 0.5 * w:.1f}, {y + 0.5 * h:.1f}]

[sender]
film = "d1.mkv"
stamps = "d1.csv"
depth = "d1-depth"
calibration = "sender.camera.toml"
trajectory = "sender.tum"

[receiver]
film = "d2"
calibration = "receiver.camera.toml"
trajectory = "receiver.tum"
offset_s = {-ahead_ns * 1e-9:.9f}
""",
        "utf-8",
    )
    return file


def _part(file: Path, begin_ns: int, end_ns: int) -> Iterator[Frame]:
    return (each for each in recorded_frames(file) if begin_ns <= each.stamp_ns <= end_ns)


def write_video(file: Path, frames: Sequence[Frame]) -> None:
    """H.264 as a camera would store it."""
    av: Any = importlib.import_module("av")
    with av.open(str(file), "w") as container:
        stream = container.add_stream(
            "libx264", rate=20, options={"crf": "12", "preset": "ultrafast"}
        )
        stream.height, stream.width = frames[0].color.shape[:2]
        stream.pix_fmt = "yuv420p"
        for each in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(each.color, format="bgr24")))
        container.mux(stream.encode())


def write_tum(file: Path, records: Sequence[LogRecord], mount: Mount) -> None:
    """Where a drone believed to be, at each of its frames."""
    states = [each for each in records if each.topic == "/state"]
    stamps = [each.stamp_ns for each in states]
    places = np.array([each.record["position_n_m"] for each in states])
    lines: list[str] = []
    for each in records:
        R_n_c = None
        if each.topic == "/frame" and each.record["T_n_c"] is not None:
            R_n_c = pose_of(each.record["T_n_c"]).R
        elif each.topic == "/motion":
            R_n_c = R_from_quat(tuple(each.record["q_n_c"]))
        if R_n_c is not None:
            x, y, z = (np.interp(each.stamp_ns, stamps, places[:, k]) for k in range(3))
            qw, qx, qy, qz = quat_from_R(R_n_c @ mount.T_b_c.R.T)
            lines.append(f"{each.stamp_ns * 1e-9:.9f} {x} {y} {z} {qx} {qy} {qz} {qw}\n")
    file.write_text("# seconds x y z qx qy qz qw\n" + "".join(lines), "utf-8")


def calibrated(camera: CameraModel) -> CameraCalibration:
    table = CameraTable.of(camera)
    return CameraCalibration(
        "camera", 1, "2026-11-23", "", "", "", table, {}, Quality(0.1, 0.1, 30, 1000, 0.9)
    )

"""Bags of ROS, told by what they hold: their names end as those of RealSense recordings and of
PATH's own logs do.

librealsense writes bags too (``.bag`` of ROS 1 in older versions, ``.db3`` of ROS 2 today), with
topics of its own: those are recordings of a camera. Any other bag is one of ROS: ``path-handoff
export`` writes its images out (``drivers.recordings.ros_images``), everything else refuses it as
that.
"""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from drivers.log.index import MAGIC as MCAP_MAGIC
from drivers.recordings.stamps import RecordingError
from path.values import frozen

ROS1_MAGIC = b"#ROSBAG V"
SQLITE_MAGIC = b"SQLite format 3\x00"
METADATA = "metadata.yaml"  # of a ROS 2 bag's folder
OF_REALSENSE = ("/file_version", "/FILE_VERSION", "/device_0")
SEARCHED = 1 << 20  # bytes in which connections or a profile are looked for
SHOWN = 6


@frozen
class RosBag:
    """A bag of ROS. ``kind``: in words; ``topics``: as far as they are known."""

    kind: str
    topics: tuple[str, ...]

    @property
    def text(self) -> str:
        images = [topic for topic in self.topics if "image" in topic]
        shown = (images or list(self.topics))[:SHOWN]
        return f"a {self.kind}" + (f" with {', '.join(shown)}" if shown else "")


def refuse_ros(path: Path) -> None:
    """Raise RecordingError when a file or folder is a bag of ROS, or a database that holds no
    recording at all.
    """
    if (bag := ros_bag_at(path)) is not None:
        raise RecordingError(
            f"{path} is {bag.text}, not a recording of librealsense or of PATH",
            f"write its images out with `path-handoff export {path}`, and name the folder that it makes",
        )


def ros_bag_at(path: Path) -> RosBag | None:
    """Return what bag of ROS a file or a folder is; None when it is none."""
    if path.is_dir():
        return _ros2_folder(path)
    if path.suffix.lower() in (".zstd", ".zst") and Path(path.stem).suffix in (".db3", ".mcap"):
        return RosBag("ROS 2 bag that is compressed as a whole (zstd -d unpacks it)", ())
    try:
        with path.open("rb") as file:
            begins = file.read(16)
        kinds = {ROS1_MAGIC: _ros1, SQLITE_MAGIC: _ros2, MCAP_MAGIC: _ros2_mcap}
        read = next((read for magic, read in kinds.items() if begins.startswith(magic)), None)
        return None if read is None else read(path)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}", "name a file that can be read") from error


def _ros2_folder(path: Path) -> RosBag | None:
    parts = sorted(file for ending in ("*.db3*", "*.mcap*") for file in path.glob(ending))
    if not parts or not (path / METADATA).is_file():
        return None
    inside = [bag for file in parts if (bag := ros_bag_at(file)) is not None]
    return inside[0] if inside else RosBag("ROS 2 bag", ())


def _ros1(path: Path) -> RosBag | None:
    """A bag's connections stand at its end, where its header says; they are not compressed."""
    with path.open("rb") as file:
        content = file.read(4096)
        place = re.search(rb"index_pos=(.{8})", content, re.DOTALL)
        index = struct.unpack("<Q", place[1])[0] if place else 0
        if index:
            file.seek(min(index, path.stat().st_size))
            content = file.read(SEARCHED)
    topics = tuple(dict.fromkeys(_ros1_topics(content)))
    if topics and any(topic.startswith(OF_REALSENSE) for topic in topics):
        return None
    if not index:
        return RosBag("ROS 1 bag that was not closed (rosbag reindex mends it)", topics)
    return RosBag("ROS 1 bag", topics)


def _ros1_topics(content: bytes) -> Iterator[str]:
    """Yield the topics of connections: fields with their length before them."""
    for found in re.finditer(rb"(.{4})topic=", content, re.DOTALL):
        (length,) = struct.unpack("<I", found[1])
        topic = content[found.end() : found.end() + length - len("topic=")]
        if topic.startswith(b"/"):
            yield topic[:200].decode("ascii", errors="replace")


def _ros2(path: Path) -> RosBag | None:
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
            rows = database.execute("select name from topics").fetchall()
    except sqlite3.Error as error:
        raise RecordingError(
            f"{path} is a database (SQLite) that holds no recording: {error}",
            "is the file whole, and was it closed? name a RealSense recording",
        ) from error
    topics = tuple(str(name) for (name,) in rows)
    if any(topic.startswith(OF_REALSENSE) for topic in topics):
        return None
    return RosBag("ROS 2 bag", topics)


def _ros2_mcap(path: Path) -> RosBag | None:
    """An MCAP file begins with its profile."""
    with path.open("rb") as file:
        content = file.read(SEARCHED)
    size = struct.unpack_from("<I", content, len(MCAP_MAGIC) + 9)[0] if len(content) > 24 else 0
    profile = content[len(MCAP_MAGIC) + 13 :][: min(size, 16)]
    if profile not in (b"ros1", b"ros2"):
        return None
    topics = re.findall(rb"/[a-z][a-z0-9_/]*image[a-z0-9_/]*", content)
    return RosBag(
        f"ROS {profile[3:].decode()} bag (MCAP)", tuple(dict.fromkeys(t.decode() for t in topics))
    )

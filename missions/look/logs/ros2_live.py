"""``path-handoff export FOLDER --ros2 --publish ROUTER``: a flight as topics of ROS 2 while it goes.

What its logs say, as they are written, becomes the messages of ``missions.look.logs.ros2_messages``
and is published through zenoh as rmw_zenoh names and marks topics (its page of design; attachments as
of Jazzy), so that a ROS 2 whose RMW is rmw_zenoh_cpp lists and reads them. It is a program beside the
flight, which waits for nothing of it; topics of ROS are not read.
"""

from __future__ import annotations

import hashlib
import json
import struct
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zenoh

from drivers.interfaces import PartError
from drivers.log.scan import LoggedChannel, LoggedMessage
from drivers.log.topics import blank
from missions.look.live.follow import FolderFollower, Said
from missions.look.logs.ros2 import made, ros2_types
from missions.look.logs.ros2_messages import Fields, Standards

NODE = "path"
DOMAIN = 0  # of ROS
PAUSE_S = 0.02
RELIABLE_LAST_10 = "::,10:,:,:,,"  # its quality of service, where it is not rmw_zenoh's default
_ZENOH: Any = zenoh


def publish(folder: Path, topics: Topics, go_on: Callable[[], bool]) -> None:
    """Publish what is written into a folder, for as long as wanted."""
    said = Standards()
    with closing(FolderFollower(folder)) as follower:
        while go_on():
            for each in follower.new():
                message = _logged(each)
                for topic, kind, fields in said.of(message):
                    topics.publish(topic, kind, fields, message.utc_ns)
            time.sleep(PAUSE_S)


def _logged(said: Said) -> LoggedMessage:
    channel = LoggedChannel(said.topic, said.encoding, said.schema, blank(said.topic))
    return LoggedMessage(channel, said.message.log_time, said.message.data)


class Topics:
    """A node of ROS 2 with a publisher for each topic that was ever published.

    Args:
        router: where zenoh's router listens, such as ``tcp/127.0.0.1:7447``; it may come later.

    Raises:
        PartError: it is no address.
    """

    def __init__(self, router: str) -> None:
        config = _ZENOH.Config()
        config.insert_json5("scouting/multicast/enabled", "false")
        try:
            config.insert_json5("connect/endpoints", json.dumps([router]))
            self._session = _ZENOH.open(config)
        except _ZENOH.ZError:
            raise PartError(
                f"--publish {router}: no address of a router",
                "write it as tcp/HOST:PORT, such as tcp/127.0.0.1:7447",
            ) from None
        self._types = ros2_types()
        self._id = self._session.info.zid()
        self._publishers: dict[str, tuple[Any, bytes]] = {}
        self._tokens = [self._token("0/NN/%/%", NODE)]
        self._number = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._session.close()

    def publish(self, topic: str, kind: str, fields: Fields, utc_ns: int) -> None:
        """Publish one message."""
        if topic not in self._publishers:
            self._publishers[topic] = self._publisher(topic, kind)
        publisher, source = self._publishers[topic]
        self._number += 1
        data = self._types.serialize_cdr(made(self._types, kind, fields), kind)
        publisher.put(bytes(data), attachment=_attachment(self._number, utc_ns, source))

    def _publisher(self, topic: str, kind: str) -> tuple[Any, bytes]:
        package, _, name = kind.split("/")
        of = f"{package}::msg::dds_::{name}_/{self._types.hash_rihs01(kind)}"
        entity = f"{len(self._publishers) + 1}/MP/%/%"
        marked = f"{topic.replace('/', '%')}/{of}/{RELIABLE_LAST_10}"
        self._tokens.append(self._token(entity, f"{NODE}/{marked}"))
        source = hashlib.blake2b(f"{self._id}/{topic}".encode(), digest_size=16).digest()
        return self._session.declare_publisher(f"{DOMAIN}{topic}/{of}"), source

    def _token(self, entity: str, rest: str) -> Any:
        key = f"@ros2_lv/{DOMAIN}/{self._id}/0/{entity}/{rest}"
        return self._session.liveliness().declare_token(key)


def _attachment(number: int, utc_ns: int, source: bytes) -> bytes:
    """Return what rmw_zenoh sends beside a message: named values, as zenoh serialises them."""

    def text(data: bytes) -> bytes:
        return bytes([len(data)]) + data

    return b"".join(
        (
            text(b"sequence_number"),
            struct.pack("<q", number),
            text(b"source_timestamp"),
            struct.pack("<q", utc_ns),
            text(b"source_gid"),
            text(source),
        )
    )

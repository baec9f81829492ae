"""Flights as they go, from the streams that ``--live`` serves: what Foxglove's WebSocket says,
message by message.
"""

from __future__ import annotations

import base64
import json
import queue
import re
import struct
import threading
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress

from mcap.records import Schema
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from path.values import frozen

PROTOCOL = Subprotocol("foxglove.sdk.v1")
WAITING = 4096
MESSAGE_BYTES = 1 << 24
AGAIN_S = 1.0
_HEAD = struct.Struct("<BIQ")
_IS_MESSAGE = 1
UNKNOWN = re.compile(r"Unknown channel ID: (\d+)")
ASK_AGAIN = 20
ASK_AGAIN_S = 0.05


@frozen
class StreamMessage:
    topic: str
    schema: Schema
    utc_ns: int
    data: bytes


class Watcher:
    """Several streams at once, each in a thread that ends with the program.

    A stream that is not there yet, or is lost, is asked for again every second. When messages come
    faster than they are drawn the oldest are dropped.
    """

    def __init__(self, *addresses: str) -> None:
        self._heard: queue.Queue[StreamMessage] = queue.Queue(WAITING)
        for address in addresses:
            threading.Thread(target=self._watch, args=(address,), daemon=True).start()

    def next(self, timeout_s: float) -> StreamMessage | None:
        with suppress(queue.Empty):
            return self._heard.get(timeout=timeout_s)
        return None

    def _watch(self, address: str) -> None:
        while True:
            with (
                suppress(OSError, WebSocketException, ValueError, KeyError),
                _dialled(address) as stream,
            ):
                self._listen(stream)
            time.sleep(AGAIN_S)

    def _listen(self, stream: ClientConnection) -> None:
        """Take all that is said, until the stream ends."""
        topics: dict[int, tuple[str, Schema]] = {}
        refused: Counter[int] = Counter()
        for word in stream:
            if not isinstance(word, str):
                if len(word) >= _HEAD.size and word[0] == _IS_MESSAGE:
                    _, number, utc_ns = _HEAD.unpack_from(word)
                    self._put(StreamMessage(*topics[number], utc_ns, word[_HEAD.size :]))
                continue
            told = json.loads(word)
            if told.get("op") == "advertise":
                new = {each["id"]: (each["topic"], _schema(each)) for each in told["channels"]}
                topics |= new
                _subscribe(stream, new)
            elif told.get("op") == "status" and (unknown := UNKNOWN.search(told["message"])):
                # a busy server advertises a channel a moment before it takes subscriptions to it
                number = int(unknown[1])
                refused[number] += 1
                if number in topics and refused[number] <= ASK_AGAIN:
                    time.sleep(ASK_AGAIN_S)
                    _subscribe(stream, [number])

    def _put(self, heard: StreamMessage) -> None:
        while True:
            try:
                self._heard.put_nowait(heard)
                return
            except queue.Full:
                with suppress(queue.Empty):
                    self._heard.get_nowait()


def _subscribe(stream: ClientConnection, channels: Iterable[int]) -> None:
    wanted = [{"id": number, "channelId": number} for number in channels]
    stream.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


def _dialled(address: str) -> ClientConnection:
    return connect(f"ws://{address}", subprotocols=[PROTOCOL], max_size=MESSAGE_BYTES, proxy=None)


def _schema(channel: dict[str, str]) -> Schema:
    """Binary ones are in base64."""
    encoding = channel.get("schemaEncoding", "")
    text = channel["schema"]
    data = base64.b64decode(text) if encoding == "protobuf" else text.encode()
    return Schema(0, data, encoding, channel["schemaName"])

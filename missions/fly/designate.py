"""``path-handoff designate``: tell a D1 in the air which object is meant, or answer what it asks,
from a terminal.

Says what a tablet would say, to the port that the rig's ``[sender.operator]`` listens at
(``drivers.operator.words``).
"""

from __future__ import annotations

import base64
import json
import os
import select
import socket
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TextIO

from drivers.interfaces import PartError
from drivers.operator.words import MOST_BYTES
from missions.ground import rig_library
from missions.ground.heard_by import operator_of
from missions.ground.options.field import DesignateOptions

HELLO_S = 2.0
ANSWERED_S = 3.0  # D1's program says something to everybody who comes in


def run(options: DesignateOptions) -> int:
    """``path-handoff designate``; 0 once it was said. Raises PartError."""
    address = operator_of(rig_library.load(options.rig, world=False))
    words = statement(options)
    with socket.socket(
        socket.AF_INET6 if ":" in address[0] else socket.AF_INET, socket.SOCK_DGRAM
    ) as line:
        line.connect(address)
        if words is None:
            return answer_questions(line, sys.stdin, sys.stdout, options.picture)
        send(line, words)
        if heard(line, ANSWERED_S) is None:
            raise PartError(
                f"nobody answers at {address[0]}:{address[1]}",
                "is D1's program running, with this rig?",
            )
    sys.stdout.write(f"said: {json.dumps(words)}\n")
    return 0


def statement(options: DesignateOptions) -> dict[str, Any] | None:
    """Return what the options say; None when they say nothing: then questions are answered. Raises
    PartError.
    """
    if options.place is not None and options.bearing_deg is not None:
        raise PartError("--place and --bearing-deg are two statements", "say one after the other")
    if options.place is not None:
        height = {} if options.down_m is None else {"down_m": options.down_m}
        return {
            "place": list(options.place),
            "error_m": options.error_m,
            "age_s": options.age_s,
            **height,
        }
    if options.bearing_deg is not None:
        seen = {
            "bearing_deg": options.bearing_deg,
            "from": list(options.seen_from),
            "error_deg": options.error_deg,
        }
        return {**seen, "age_s": options.age_s}
    return None


def answer_questions(
    line: socket.socket,
    keys: TextIO,
    shown: TextIO,
    picture: Path | None,
) -> int:
    """Show what D1 asks, and send the numbers that are typed, until there are no more keys."""
    asked: int | None = None
    shown.write("waits for questions; a number answers, 0 is none of them, Ctrl-D ends\n")
    hello_s = 0.0
    rest = ""
    while True:
        if time.monotonic() >= hello_s:
            hello_s = time.monotonic() + HELLO_S
            send(line, {"hello": True})
        ready, _, _ = select.select([line, keys], [], [], 0.2)
        if line in ready:
            question = heard(line, 0.0)
            if question is not None and question["asks"] != asked:
                asked = question["asks"]
                show(question, shown, picture)
        if keys in ready:
            # not by lines: what a buffer holds nobody waits for
            typed = os.read(keys.fileno(), 1024)
            if not typed:
                return 0
            *lines, rest = (rest + typed.decode(errors="replace")).split("\n")
            for each in lines:
                if not each.strip().isdigit() or asked is None:
                    shown.write("no number, or nothing is asked\n")
                else:
                    send(line, {"question": asked, "number": int(each)})
        shown.flush()


def show(
    question: Mapping[str, Any],
    shown: TextIO,
    picture: Path | None,
) -> None:
    """Write a question for a person, and its picture into a file."""
    if question["asks"] is None:
        shown.write("nothing is asked any more\n")
        return
    shown.write(f"question {question['asks']}: which one is it?\n")
    for each in question["objects"]:
        place = f"{each['north_m']:+6.1f} m north {each['east_m']:+6.1f} m east"
        shown.write(
            f"  {each['number']:3}: {place}, {each['speed_mps']:.1f} m/s, {100.0 * each['share']:.0f} %\n"
        )
    if picture is not None and "jpeg" in question:
        picture.write_bytes(base64.b64decode(question["jpeg"]))
        shown.write(f"  {picture} shows them\n")


def send(line: socket.socket, words: Mapping[str, Any]) -> None:
    """Say something; nobody need listen yet."""
    try:
        line.send(json.dumps(words).encode())
    except ConnectionError:
        return


def heard(line: socket.socket, within_s: float) -> dict[str, Any] | None:
    """Return what D1's program says; None when it says nothing in time."""
    ready, _, _ = select.select([line], [], [], within_s)
    if not ready:
        return None
    try:
        return json.loads(line.recv(MOST_BYTES + 1024))
    except (ConnectionError, ValueError):
        return None

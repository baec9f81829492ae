"""What an operator asks for on the live page, and the two ways on which it goes.

Which object is meant goes to D1's program as from any tablet (``drivers.operator``). To call a
flight off is the flight's own Ctrl-C: its drones end the hand-over and land, and a pilot, the guard
and the fence stand above that as ever. There is no third way.

Nothing is done without the token, and nothing at the first tap: it is answered with a number, which
the second one has to bring within some seconds. All that is asked for is told on the page and
logged (``/operator`` in ``operator.mcap``), what is refused as well.
"""

from __future__ import annotations

import base64
import json
import math
import secrets
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivers.log.mcap_log import McapLog, new_part
from drivers.operator.words import MOST_BYTES, WordsError, decode
from missions.look.live.flight_state import FlightState
from missions.look.live.gate import is_token

AGAIN_S = 5.0  # for the second tap
LEAST_S = 0.2  # after the first: two touches of one tap are not two taps
HELLO_S = 2.0
ASKED_S = 6.0  # D1 repeats nothing: a question is forgotten when nothing is heard any more
TAKEN_UP_S = 3.0
PENDING = 16
LOG = "operator"


class Refused(Exception):
    """What was asked for is not done; the text says why."""


class DroneLine:
    """The way to whoever hears which object is meant: one line of JSON a datagram."""

    def __init__(self, address: tuple[str, int]) -> None:
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._address = address
        self._hello_s = 0.0
        self.question: dict[str, Any] | None = None
        self.heard_s = -math.inf

    def say(self, words: Mapping[str, Any]) -> None:
        with suppress(OSError):  # D1's program does not listen yet, or any more
            self._socket.sendto(json.dumps(words).encode(), self._address)

    def pump(self, now_s: float) -> None:
        """Stay known to D1's program, and take up what it asks."""
        if now_s - self._hello_s >= HELLO_S:
            self._hello_s = now_s
            self.say({"hello": True})
        while True:
            try:
                line = self._socket.recv(MOST_BYTES + 1024)
            except OSError:
                return
            with suppress(ValueError, TypeError, KeyError):
                asked = json.loads(line)
                self.question = None if asked["asks"] is None else asked
                self.heard_s = now_s

    def close(self) -> None:
        self._socket.close()


class Operator:
    """Carries out what is asked for on the page of one flight.

    Args:
        token: whoever acts has to know it.
        line: to D1's program; None where this rig's hears nobody by UDP.
        stop: calls the flight off; None where the page only watches.
        stops: what that does, for the button.
    """

    def __init__(
        self,
        state: FlightState,
        folder: Path,
        token: str,
        line: DroneLine | None,
        stop: Callable[[], None] | None,
        stops: str,
    ) -> None:
        self._state = state
        self._folder = folder
        self._token = token
        self._line = line
        self._stop = stop
        self._stops = stops
        self._log: McapLog | None = None
        self._pending: dict[str, tuple[float, dict[str, Any], str]] = {}
        self._sent: list[tuple[float, int]] = []
        self._refused_s = -math.inf

    def can(self) -> dict[str, Any]:
        """Return what the page may offer, and what D1 asks."""
        question = None if self._line is None else self._line.question
        asked = None
        if question is not None:
            pictured = f"question-{question['asks']}" if "jpeg" in question else None
            asked = {"asks": question["asks"], "objects": question["objects"], "image": pictured}
        return {"designate": self._line is not None, "stop": self._stops, "question": asked}

    def image_of(self, name: str) -> tuple[int, bytes] | None:
        """Return the picture that D1 asks with; of any other name the drone's newest image."""
        if not name.startswith("question-"):
            return self._state.image_of(name)
        question = None if self._line is None else self._line.question
        if question is None or "jpeg" not in question:
            return None
        return 0, base64.b64decode(question["jpeg"])

    def turn(self, now_s: float, *, watched: bool) -> None:
        """Do what comes round: hear what D1 asks while somebody looks, and miss its answer."""
        if self._line is not None and watched:
            self._line.pump(now_s)
            if now_s - self._line.heard_s > ASKED_S:
                self._line.question = None
        for sent_s, told in list(self._sent):
            if self._state.told > told:
                self._sent.remove((sent_s, told))
            elif now_s - sent_s > TAKEN_UP_S:
                self._sent.remove((sent_s, told))
                self._tell("designate", done=False, why="D1 took nothing up", who="")

    def close(self) -> None:
        if self._line is not None:
            self._line.close()
        if self._log is not None:
            self._log.close()

    async def act(self, wanted: Mapping[str, Any], who: str) -> dict[str, Any]:
        """Return ``again`` and ``text`` for a first tap, ``done`` for a second one, ``refused`` for
        what is not done.
        """
        try:
            if not is_token(str(wanted.get("token", "")), self._token):
                raise Refused("without the token: use the whole link that the terminal shows")
            if "again" in wanted:
                return {"done": self._second(str(wanted["again"]), who)}
            order = self._order(wanted)
        except (Refused, WordsError) as why:
            self._refuse(str(wanted.get("act", "act"))[:20], str(why), who)
            return {"refused": str(why)}
        while len(self._pending) >= PENDING:
            self._pending.pop(next(iter(self._pending)))
        number = secrets.token_hex(4)
        self._pending[number] = (time.monotonic(), order, who)
        return {"again": number, "within_s": AGAIN_S, "text": order["text"]}

    def _second(self, number: str, who: str) -> str:
        """Carry out what a first tap asked for. Raises Refused."""
        begun_s, order, first = self._pending.pop(number, (-math.inf, {}, ""))
        waited_s = time.monotonic() - begun_s
        if waited_s > AGAIN_S or first != who:
            raise Refused("there was no first tap, or too long ago")
        if waited_s < LEAST_S:
            raise Refused("both taps at once: tap, read, tap again")
        if order["act"] == "stop":
            self._tell("stop", done=True, why=order["text"], who=who)
            assert self._stop is not None
            self._stop()
            return "called off"
        assert self._line is not None
        words = order["words"]
        if "at_ns" in order:
            words = {**words, "age_s": max(0.0, (time.time_ns() - order["at_ns"]) * 1e-9)}
            decode(json.dumps(words).encode(), 0)
        self._line.say(words)
        self._sent.append((time.monotonic(), self._state.told))
        self._tell(order["act"], done=True, why=order["text"], who=who)
        return order["text"]

    def _order(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is to be done at the second tap, with words for the button. Raises Refused,
        WordsError.
        """
        act = wanted.get("act")
        if act == "stop":
            if self._stop is None:
                raise Refused("this page only watches")
            return {"act": act, "text": self._stops}
        if act not in ("place", "sight", "choose"):
            raise Refused("nothing that can be done here")
        if self._line is None:
            raise Refused("nobody is heard by UDP: the rig has no [sender.operator] for it")
        if act == "choose":
            words = {"question": wanted.get("question"), "number": wanted.get("number")}
            decode(json.dumps(words).encode(), 0)
            which = f"object {words['number']}" if words["number"] else "none of these"
            return {"act": act, "words": words, "text": f"it is {which}"}
        words, at_ns = self._pointed(wanted) if act == "place" else self._seen(wanted)
        decode(json.dumps({**words, "age_s": 0.0}).encode(), 0)
        where = words.get("place")
        text = f"the target is in that direction: {words.get('bearing_deg', 0.0):.0f} degrees"
        if where is not None:
            text = f"the target is at {where[0]:.1f} m north, {where[1]:.1f} m east"
        return {"act": act, "words": words, "at_ns": at_ns, "text": text}

    def _pointed(self, wanted: Mapping[str, Any]) -> tuple[dict[str, Any], int]:
        """A tap on the map: the place is where the object is now."""
        return {"place": wanted.get("place"), "error_m": wanted.get("error_m")}, time.time_ns()

    def _seen(self, wanted: Mapping[str, Any]) -> tuple[dict[str, Any], int]:
        """A tap in an image: the place on the ground where that line of sight meets the target's
        height, and of what flies the direction. Raises Refused.
        """
        drone = self._state.drones.get(str(wanted.get("of")))
        try:
            u, v = (float(each) for each in wanted["pixel"])
            finger_px = float(wanted["error_px"])
            image_ns = int(wanted["image_ns"])
        except (KeyError, TypeError, ValueError):
            raise Refused("no pixel of an image") from None
        if drone is None or drone.camera is None or drone.setup is None:
            raise Refused("nothing is known of that drone's camera")
        if not (drone.camera.contains(u, v) and 0.0 < finger_px < drone.camera.width):
            raise Refused("outside of the image")
        sight = drone.sight_at(image_ns, (u, v))
        if sight is None:
            raise Refused("where the drone was then is not known")
        tilt_rad = math.radians(drone.setup["mission"]["attitude_sigma_deg"])
        error_rad = math.hypot(finger_px / drone.camera.fx, tilt_rad)
        down_m = drone.target_down_m()
        range_m = None if down_m is None else sight.range_to(down_m)
        if range_m is not None:
            error_m = range_m * error_rad / sight.direction_n[2]
            return {
                "place": drone.in_crews_frame(sight.at(range_m)),
                "error_m": round(max(error_m, 0.01), 3),
            }, image_ns
        if down_m is not None:
            raise Refused("above the horizon: the target is on the ground")
        return {
            "bearing_deg": round(math.degrees(sight.bearing_rad), 2),
            "from": drone.in_crews_frame(sight.from_n_m),
            "error_deg": round(max(math.degrees(error_rad), 0.01), 3),
        }, image_ns

    def _refuse(
        self,
        act: str,
        why: str,
        who: str,
    ) -> None:
        """Tell of it, at most ten times a second: nobody fills a disk so."""
        now_s = time.monotonic()
        if now_s - self._refused_s > 0.1:
            self._refused_s = now_s
            self._tell(act, done=False, why=why, who=who)

    def _tell(
        self,
        act: str,
        *,
        done: bool,
        why: str,
        who: str,
    ) -> None:
        """Log what was asked for; the page hears of it as of all that is logged."""
        if self._log is None:
            self._log = McapLog(new_part(self._folder, LOG), LOG)
        record = {"act": act, "done": done, "why": why, "who": who}
        self._log.write("/operator", time.monotonic_ns(), record)

"""The line between the base of a relay and a drone's program in a process of its own: what each
says to the other.

The base's answers come as news, whenever they change: who asks one need not wait. A program's words
are lines of JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import msgspec

from flight.guidance import Vec3
from flight.harness.relay import Pointed
from flight.outcome import MissionEnd, Outcome
from missions.fly.relay.ground import Ground, Leg, SentTo, TakeOffOrder, TurnedBack

Say = Callable[[Mapping[str, Any]], None]


def news_of(base: Ground, name: str) -> dict[str, Any]:
    """Return what a drone's program has to know at present: of a team also its target, and where a
    person points at it while it is to be found.
    """
    leg = base.leg_of(name)
    order = base.order_of(name)
    sent = base.sent_to(name)
    pointed = base.pointed_at(name) if order is TakeOffOrder.FIND else None
    return {
        "order": order.value,
        "leg": leg and asdict(leg),
        "over": base.called_home(name),
        "sent": sent and asdict(sent),
        "pointed": pointed and asdict(pointed),
        "turned_back": base.turned_back(name),
    }


def hear(
    base: Ground,
    name: str,
    word: Mapping[str, Any],
) -> None:
    """Pass on to the base what a drone's program said; what is no word of it is passed over."""
    match word:
        case {"event": "ask", "battery": float(battery), "wait_s": float(wait_s)}:
            base.ask(name, battery, wait_s)
        case {"event": "holds"}:
            base.holds(name)
        case {"event": "leg_failed", "outcome": str(label), "detail": str(detail)}:
            base.leg_failed(name, MissionEnd(Outcome.from_label(label), detail))
        case {"event": "follows", "place_n_m": [float(north), float(east), float(down)]}:
            base.follows(name, (north, east, down))
        case {"event": "gave_up", "why": str(why)}:
            base.gave_up(name, why)
        case {"event": "may_find", "wait_s": float(wait_s)}:
            base.may_find(name, wait_s)
        case _:
            pass


class FarBase:
    """The base, as a drone's program in another process knows it
    (``missions.fly.relay.ground.Ground``).

    A leg that is over for this drone stays over, whatever older news is still on the line.
    """

    def __init__(self, name: str, say: Say) -> None:
        self._name = name
        self._say = say
        self._order: TakeOffOrder | None = None
        self._leg: Leg | None = None
        self._ended = 0  # number of the newest leg that is over
        self._sent: SentTo | None = None
        self._pointed: Pointed | None = None
        self._turned_back: TurnedBack = "no"
        self._over = False

    @property
    def told(self) -> bool:
        """Return whether there was any news yet."""
        return self._order is not None

    def on_news(self, news: Mapping[str, Any]) -> None:
        self._order = TakeOffOrder(news["order"])
        self._over = bool(news["over"])
        self._leg = None if news["leg"] is None else Leg(**news["leg"])
        self._sent = msgspec.convert(news["sent"], SentTo | None)
        if news["pointed"] is not None:
            self._pointed = msgspec.convert(news["pointed"], Pointed)
        self._turned_back = news["turned_back"]

    def called_home(self, name: str) -> bool:
        assert name == self._name
        return self._over

    def order_of(self, name: str) -> TakeOffOrder:
        assert name == self._name and self._order is not None, "asked before there was any news"
        return self._order

    def leg_of(self, name: str) -> Leg | None:
        assert name == self._name
        return self._leg if self._leg is not None and self._leg.number > self._ended else None

    def ask(
        self,
        name: str,
        battery: float,
        wait_s: float,
    ) -> None:
        assert name == self._name
        self._say({"event": "ask", "battery": battery, "wait_s": wait_s})

    def holds(self, name: str) -> None:
        self._end_leg(name)
        self._say({"event": "holds"})

    def leg_failed(self, name: str, end: MissionEnd) -> None:
        self._end_leg(name)
        self._say({"event": "leg_failed", "outcome": end.outcome.label, "detail": end.detail})

    # --- of a team ---

    def sent_to(self, name: str) -> SentTo | None:
        assert name == self._name
        return self._sent

    def pointed_at(self, name: str) -> Pointed:
        assert name == self._name and self._pointed is not None, (
            "asked of a drone that was not sent to find"
        )
        return self._pointed

    def follows(self, name: str, place_n_m: Vec3) -> None:
        assert name == self._name
        self._say({"event": "follows", "place_n_m": place_n_m})

    def gave_up(self, name: str, why: str) -> None:
        self._end_leg(name)
        self._say({"event": "gave_up", "why": why})

    def may_find(self, name: str, wait_s: float) -> None:
        assert name == self._name
        self._say({"event": "may_find", "wait_s": wait_s})

    def turned_back(self, name: str) -> TurnedBack:
        assert name == self._name
        return self._turned_back

    def _end_leg(self, name: str) -> None:
        leg = self.leg_of(name)
        if leg is not None:
            self._ended = leg.number

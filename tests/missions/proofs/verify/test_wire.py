"""The fuzzing of the link finds nothing in the link, and finds each fault that was put in."""

from __future__ import annotations

import io
from collections.abc import Callable

import pytest

from drivers.link.fields import TO_WIRE
from drivers.link.wire import Codec, Drop
from missions.ground.work import open_work
from missions.proofs.verify.wire import fuzz, hardened, play, sound, summary
from path.messages import Message, Ping, Role, Status


def test_nothing_forged_is_taken_and_nothing_genuine_lost() -> None:
    with open_work(1, io.StringIO()) as work:
        figures = summary(fuzz(8_000, 3, work))
    assert sound(figures), figures["failures"]
    assert figures["packets"] >= 8_000
    assert figures["genuine"] > 200
    assert len(figures["by_way"]) == 15
    assert {"bad_signature", "replayed", "unproven", "bad_crc", "unsigned", "wrong_system"} <= set(
        figures["by_reason"]
    )


def test_every_type_of_message_is_tried_about_as_often_as_any_other() -> None:
    figures = summary([play(3, number, 12_000, hardened) for number in range(2)])
    every = {kind.__name__ for kind in TO_WIRE}
    for name, of in (
        ("genuine", every),
        ("early", every),
        ("nearly valid", every - {"Ping", "Pong", "Target"}),
    ):
        # of a ping every number means something, of a target nearly every one
        counts = figures["by_message"][name]
        assert of <= set(counts) <= every
        assert min(counts[kind] for kind in of) > 0.3 * sum(counts.values()) / len(every), (
            name,
            counts,
        )


def test_a_seed_is_a_run() -> None:
    first, again = (play(5, 1, 400, hardened) for _ in range(2))
    assert (first.forged, first.dropped) == (again.forged, again.dropped)
    assert play(6, 1, 400, hardened).dropped != first.dropped


class Believing(Codec):
    """Asks for a signature, and does not look at it."""

    def _forged_or_old(self, data: bytes) -> Drop | None:
        return None


class StampFirst(Codec):
    """Keeps a stamp before the hash is compared, as pymavlink does."""

    def _forged_or_old(self, data: bytes) -> Drop | None:
        fault = super()._forged_or_old(data)
        self._streams[data[-13]] = max(
            self._streams.get(data[-13], 0), int.from_bytes(data[-12:-6], "little")
        )
        return fault


class Forgetful(Codec):
    """Does not know what it has taken before."""

    def _forged_or_old(self, data: bytes) -> Drop | None:
        self._streams.clear()
        return super()._forged_or_old(data)


class Trusting(Codec):
    """Believes a stream that it has not heard before."""

    def _introduced(self, data: bytes, message: Message) -> Message | Drop:
        self._streams[data[-13]] = int.from_bytes(data[-12:-6], "little")
        return message


class Fragile(Codec):
    """Raises at what it does not expect."""

    def decode(self, data: bytes) -> Message | Drop:
        result = super().decode(data)
        if result is Drop.UNKNOWN_ID:
            raise KeyError(data[7:10])
        return result


class Gullible(Codec):
    """Takes a Status of a stream that has not proven itself."""

    def _introduced(self, data: bytes, message: Message) -> Message | Drop:
        taken = super()._introduced(data, message)
        return message if isinstance(message, Status) else taken


class Careless(Codec):
    """Takes a Status with any role in it for one of the peer's."""

    def decode(self, data: bytes) -> Message | Drop:
        result = super().decode(data)
        return Ping(0, 0) if result is Drop.OUT_OF_RANGE else result


@pytest.mark.parametrize(
    ("codec", "failing"),
    [
        (Gullible, "early_taken"),
        (Careless, "nearly_valid_taken"),
        (Believing, "accepted_or_raised"),
        (StampFirst, "genuine_lost"),
        (Forgetful, "accepted_or_raised"),
        (Trusting, "accepted_or_raised"),
        (Fragile, "accepted_or_raised"),
    ],
)
def test_a_fault_of_the_link_is_found(codec: type[Codec], failing: str) -> None:
    def make(role: Role, key: bytes, stamp: Callable[[], int]) -> Codec:
        return codec(role, key, stamp=stamp)

    figures = summary([play(1, number, 1_500, make) for number in range(2)])
    assert not sound(figures)
    assert figures[failing] > 0

"""A link's own end: what a flood costs, and that it ends with the flood."""

from __future__ import annotations

from drivers.link.end import MOST_AT_ONCE, MOST_HZ, LinkEnd
from drivers.link.wire import Codec
from path.messages import Role
from tests.drivers.link.link_ends import STATUS

SECOND_NS = 10**9


def ends() -> tuple[Codec, LinkEnd]:
    return Codec(Role.SENDER, None), LinkEnd(Codec(Role.RECEIVER, None))


def test_a_flood_is_judged_no_faster_than_the_limit_and_a_peers_own_packets_are_far_below_it() -> None:
    peer, end = ends()
    packet = peer.encode(STATUS)
    for k in range(2 * MOST_HZ):
        end.arrived(packet, k * SECOND_NS // (2 * MOST_HZ))
    flooded = end.counters.dropped["flooded"]
    assert MOST_HZ - MOST_AT_ONCE - 1 <= flooded <= MOST_HZ
    end.arrived(packet, 2 * SECOND_NS)
    assert end.counters.dropped["flooded"] == flooded

    _, calm = ends()
    for k in range(1000):
        calm.arrived(packet, k * SECOND_NS // 500)
    assert "flooded" not in calm.counters.dropped


def test_strangers_use_nothing_up() -> None:
    peer, end = ends()
    packet = peer.encode(STATUS)
    for _ in range(10 * MOST_AT_ONCE):
        end.arrived(packet, 0, stranger=True)
    end.arrived(packet, 0)
    assert end.counters.dropped == {"stranger": 10 * MOST_AT_ONCE}
    assert end.counters.packets_received == 10 * MOST_AT_ONCE + 1

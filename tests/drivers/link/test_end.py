"""A link's own end: what a flood costs, and that it ends with the flood."""

from __future__ import annotations

from drivers.link.end import MOST_AT_ONCE, MOST_HZ, LinkEnd
from drivers.link.wire import Codec, introduce
from path.messages import Role
from tests.drivers.link.link_ends import STATUS

SECOND_NS = 10**9
FLOOD_HZ = 50_000
GENUINE_HZ = 120
KEY, OTHER_KEY = bytes(range(32)), bytes(32)


def ends() -> tuple[Codec, LinkEnd]:
    return Codec(Role.SENDER, None), LinkEnd(Codec(Role.RECEIVER, None))


def test_a_flood_is_judged_no_faster_than_the_limit_and_a_peers_own_packets_are_far_below_it() -> (
    None
):
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


def signed_ends() -> tuple[Codec, LinkEnd]:
    """The peer and this end, proven to each other."""
    peer, own = Codec(Role.SENDER, KEY), Codec(Role.RECEIVER, KEY)
    introduce(peer, own)
    return peer, LinkEnd(own)


def taken_in_a_flood(peer: Codec, end: LinkEnd, false: list[bytes]) -> int:
    """Returns how many of a second's genuine packets are taken between ``FLOOD_HZ`` others.

    Each takes the former's place.
    """
    before, gap = end.counters.dropped.get("superseded", 0), FLOOD_HZ // GENUINE_HZ
    for k in range(FLOOD_HZ):
        end.arrived(
            peer.encode(STATUS) if k % gap == gap // 2 else false[k % len(false)],
            k * SECOND_NS // FLOOD_HZ,
        )
    return end.counters.dropped["superseded"] - before + 1


def test_a_flood_that_is_not_signed_by_the_pair_costs_no_genuine_packet() -> None:
    peer, end = signed_ends()
    forger = Codec(Role.SENDER, OTHER_KEY, stamp=lambda: 2**48 - 9)
    good = bytearray(peer.encode(STATUS))
    good[20] ^= 1
    false = [
        forger.encode(STATUS),
        bytes(good),
        b"noise",
        Codec(Role.SENDER, None).encode(STATUS),
        b"\xfd" * 50,
    ]
    assert taken_in_a_flood(peer, end, false) >= GENUINE_HZ
    assert end.counters.dropped["flooded"] > 0.9 * (FLOOD_HZ - GENUINE_HZ - MOST_HZ)
    assert {"bad_signature", "bad_crc", "not_mavlink", "unsigned"} <= set(end.counters.dropped)


def test_a_flood_of_what_the_peer_once_sent_costs_none_either() -> None:
    peer, end = signed_ends()
    recorded = [peer.encode(STATUS) for _ in range(200)]
    for packet in recorded:
        end.arrived(packet, 0)
    assert taken_in_a_flood(peer, end, recorded) >= GENUINE_HZ
    assert end.counters.dropped["replayed"] > 0

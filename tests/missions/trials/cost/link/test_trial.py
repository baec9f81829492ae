from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import UDP_IP_OVERHEAD, Codec
from flight.config import MissionConfig
from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.cost.link import trial as link
from missions.trials.cost.link.traffic import Packet, extremes, verification
from missions.trials.shared.trial import TrialRequest, TrialResult
from path.messages import Role, Status

SECONDS = 1
HEADER = 10


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> TrialResult:
    with open_work(1) as work:
        return link.run(
            TrialRequest(rig_library.load("sim"), tmp_path_factory.mktemp("trial"), 5, True, work)
        )


def test_the_goals_of_the_link_are_met(result: TrialResult) -> None:
    assert result.summary["largest_packet_b"] <= 128
    assert result.summary["rates"]["60"]["untrimmed_bytes_per_s"] <= 12_000
    assert set(result.summary["messages"]) == set(link.KINDS)


def test_sizes_add_up(result: TrialResult) -> None:
    for size in result.summary["messages"].values():
        assert size["mavlink_b"] == 12 + size["payload_b"] + 13
        assert size["wire_b"] == size["mavlink_b"] + 28


def test_every_frame_has_its_messages_and_the_mission_its_own_rates() -> None:
    rates = MissionConfig()
    packets = verification(60, SECONDS, rates, seed=4)
    kinds = [packet.kind for packet in packets]
    assert kinds.count("target") == kinds.count("candidate") == 60 * SECONDS
    assert kinds.count("status") == round(rates.status_hz + rates.receiver_status_hz) * SECONDS
    assert kinds.count("ping") == kinds.count("pong") == 2 * SECONDS
    assert {kind: kinds.count(kind) for kind in ("commit", "accept", "confirm", "abort")} == {
        "commit": 1, "accept": 1, "confirm": 1, "abort": 0,
    }  # fmt: skip
    assert {packet.sender for packet in packets if packet.kind == "target"} == {Role.SENDER}
    assert {packet.sender for packet in packets if packet.kind == "candidate"} == {Role.RECEIVER}


@pytest.mark.parametrize("role", Role)
def test_extremes_are_as_long_as_their_message_can_be(role: Role) -> None:
    """Nothing that a link can send is longer, and no zero byte at the end was cut off."""
    codec = Codec(role, bytes(32))
    for message in extremes(role):
        data = codec.encode(message)
        payload = data[HEADER : HEADER + data[1]]
        assert payload[-1] != 0
        assert (
            len(payload)
            == dialect.mavlink_map[int.from_bytes(data[7:HEADER], "little")].unpacker.size
        )


@pytest.mark.parametrize("role", Role)
def test_a_status_while_both_verify_is_as_long_as_one_without_digests_and_end_can_be(
    role: Role,
) -> None:
    codec = Codec(role, bytes(32))
    longest = next(message for message in extremes(role) if isinstance(message, Status))
    sizes = {"target": {"wire_b": 81}, "status": {"wire_b": len(codec.encode(longest))}}
    verifying = link.while_verifying(sizes)
    assert verifying["status"]["wire_b"] == len(codec.encode(replace(longest, alike=None, ended=0)))
    assert verifying["target"] == sizes["target"]


def test_rates_count_the_headers_that_the_kernel_adds() -> None:
    packet = Packet("target", Role.SENDER, 28, 53)
    packets = [packet, replace(packet, sender=Role.RECEIVER)]
    rates = link.rates_of(packets, 2, {"target": {"wire_b": 100}})
    assert rates["bytes_per_s"] == 53 + UDP_IP_OVERHEAD
    assert (
        rates["sender_bytes_per_s"] == rates["receiver_bytes_per_s"] == (53 + UDP_IP_OVERHEAD) / 2
    )
    assert rates["untrimmed_bytes_per_s"] == 100


def test_a_hand_over_is_no_part_of_a_rate() -> None:
    target = Packet("target", Role.SENDER, 28, 53)
    commit = Packet("commit", Role.SENDER, 25, 50)
    sizes = {"target": {"wire_b": 81}, "commit": {"wire_b": 78}}
    both = link.rates_of([target, commit], 1, sizes)
    assert both == link.rates_of([target], 1, sizes)

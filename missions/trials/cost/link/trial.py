"""Bytes on the link between the drones: every packet as it is encoded and signed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import KEY_LENGTH, UDP_IP_OVERHEAD
from missions.ground import rig_library
from missions.trials.cost.link.traffic import Packet, extremes, packets_of, verification
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.alike import Alike
from path.messages import Role

TITLE = "Link: bytes of every packet at 30, 50 and 60 Hz, signed"
PAPER = "Hardware Performance"

RATES_HZ = (30, 50, 60)
SECONDS = 10
QUICK_SECONDS = 1
LIMIT_PACKET_B = 128
GOAL_BYTES_PER_S = 12_000
FRAME_B = dialect.HEADER_LEN_V2 + 2
SIGNATURE_B = dialect.MAVLINK_SIGNATURE_BLOCK_LEN
KINDS = ("target", "candidate", "status", "ping", "pong", "commit", "confirm", "accept", "abort")
WHO = {
    "target": "D1, every frame", "candidate": "D2, every frame", "status": "both", "ping": "both", "pong": "both",
    "commit": "D1, once", "confirm": "D1, for each accept", "accept": "D2, until confirmed", "abort": "either, once",
}  # fmt: skip
ONCE = ("commit", "accept", "confirm", "abort")
# the last fields of a Status: digests of 16 bits, and an exit code
ALIKE_B = 2 * len(fields(Alike))
ENDED_B = 1


def run(request: TrialRequest) -> TrialResult:
    mission = rig_library.mission_of(request.rig)
    seconds = QUICK_SECONDS if request.quick else SECONDS
    traffic = {hz: verification(hz, seconds, mission, request.seed) for hz in RATES_HZ}
    longest = [
        packet
        for role in Role
        for packet in packets_of(role, bytes(KEY_LENGTH), iter(extremes(role)))
    ]
    every = [*longest, *(packet for packets in traffic.values() for packet in packets)]
    sizes = {kind: _sizes(kind, every) for kind in KINDS}
    verifying = while_verifying(sizes)
    rates = {str(hz): rates_of(packets, seconds, verifying) for hz, packets in traffic.items()}
    largest = max(size["wire_b"] for size in sizes.values())
    summary: dict[str, Any] = {
        "messages": sizes,
        "rates": rates,
        "handover_b": sum(sizes[kind]["wire_b"] for kind in ("commit", "accept", "confirm")),
        "largest_packet_b": largest,
    }
    return TrialResult(
        summary=summary,
        findings=_findings(rates, largest),
        noise=_conditions(mission.status_hz, mission.receiver_status_hz, mission.ping_hz, seconds),
        tables=(_size_table(sizes), _rate_table(rates)),
        notes=(
            f"Each packet as the link encodes and signs it, one a datagram, and {UDP_IP_OVERHEAD} B for UDP and IPv4 "
            "headers. Ethernet, Wi-Fi or radio framing comes on top and is the channel's.",
            "MAVLink cuts off zero bytes at a payload's end: a candidate with a box is one byte shorter than one "
            "without. Sizes are of the largest that can be sent; the rates are of what was sent.",
            "No field is a floating point number; what rounding costs is in docs/decisions/0222.",
            "The paper counts bare payloads of 32 bit fields and does not say whether they are signed.",
        ),
    )


def _sizes(kind: str, packets: Iterable[Packet]) -> dict[str, int]:
    """Return the largest packet of a kind."""
    own = (packet for packet in packets if packet.kind == kind)
    packet = max(own, key=lambda each: each.wire_b)
    return {"payload_b": packet.payload_b, "mavlink_b": packet.mavlink_b, "wire_b": packet.wire_b}


def while_verifying(sizes: dict[str, dict[str, int]]) -> dict[str, dict[str, int]]:
    """Return the largest packets of each kind while both verify.

    A Status leaves its digests out then, and neither flight has ended: those bytes are zero, and
    MAVLink cuts them off.
    """
    status = {name: size_b - ALIKE_B - ENDED_B for name, size_b in sizes["status"].items()}
    return {**sizes, "status": status}


def rates_of(
    packets: Sequence[Packet], seconds: int, sizes: dict[str, dict[str, int]]
) -> dict[str, float]:
    """Return bytes a second: as sent, by direction, and if no byte had been cut off. What is sent
    once in a hand-over is not in them.
    """
    stream = [packet for packet in packets if packet.kind not in ONCE]
    sender_b, receiver_b = (
        sum(packet.wire_b for packet in stream if packet.sender is role) for role in Role
    )
    untrimmed_b = sum(sizes[packet.kind]["wire_b"] for packet in stream)
    return {
        "bytes_per_s": (sender_b + receiver_b) / seconds,
        "sender_bytes_per_s": sender_b / seconds,
        "receiver_bytes_per_s": receiver_b / seconds,
        "untrimmed_bytes_per_s": untrimmed_b / seconds,
        "packets_per_s": len(stream) / seconds,
    }


def _findings(rates: dict[str, dict[str, float]], largest: int) -> Sequence[TrialFinding]:
    findings = [
        TrialFinding("largest packet with UDP/IP, B", str(largest), "every kind of message, no byte cut off",
                "≤ 128", "≤ 128", verdict(largest <= LIMIT_PACKET_B)),
    ]  # fmt: skip
    for hz, rate in rates.items():
        goal = f"≤ {GOAL_BYTES_PER_S / 1000:.0f}" if hz == "60" else ""
        findings.append(
            TrialFinding(
                f"both ways at {hz} Hz, signed, all fields, kB/s",
                f"{rate['bytes_per_s'] / 1000:.2f}",
                f"{rate['untrimmed_bytes_per_s'] / 1000:.2f} with no byte cut off",
                "≈ 12 (9–15), < 16 at 60 Hz" if hz == "60" else "≈ 12 (9–15)",
                goal,
                verdict(rate["untrimmed_bytes_per_s"] <= GOAL_BYTES_PER_S) if goal else "measured",
            )
        )
    return findings


def _conditions(
    sender_hz: float,
    receiver_hz: float,
    ping_hz: float,
    seconds: int,
) -> TrialTable:
    return TrialTable(
        "What is on the link",
        ("message", "how often"),
        (
            ("target: point, gravity, sigma, capture, ids", "30, 50 or 60 Hz, D1"),
            ("candidate: box, T_v_c2, sigma, capture, ids", "30, 50 or 60 Hz, D2"),
            (
                "status: position, velocity, yaw, phase, flags, battery",
                f"{sender_hz:g} Hz D1, {receiver_hz:g} Hz D2",
            ),
            ("ping, and its pong: clock exchange", f"{ping_hz:g} Hz each way"),
            ("commit, accept, confirm: one hand-over", "once; not in the rates"),
            ("faults", "none: nothing is lost, every packet is signed with the pair's key"),
        ),
        f"For {seconds} s. Rates are the mission's own; the numbers are random, within what a verification has.",
    )


def _size_table(sizes: dict[str, dict[str, int]]) -> TrialTable:
    rows = tuple(
        (kind, WHO[kind], str(size["payload_b"]), str(size["mavlink_b"]), str(size["wire_b"]))
        for kind, size in sizes.items()
    )
    handover = sum(sizes[kind]["wire_b"] for kind in ("commit", "accept", "confirm"))
    return TrialTable(
        "Largest packet of each message, B",
        ("message", "who", "payload", f"MAVLink 2 (+ {FRAME_B} frame, {SIGNATURE_B} signature)",
         f"wire (+ {UDP_IP_OVERHEAD} UDP/IP)"),
        rows,
        f"A hand-over without a loss is one commit, one accept and one confirm: {handover} B.",
    )  # fmt: skip


def _rate_table(rates: dict[str, dict[str, float]]) -> TrialTable:
    rows = tuple(
        (f"{hz} Hz", f"{r['sender_bytes_per_s']:.0f}", f"{r['receiver_bytes_per_s']:.0f}", f"{r['bytes_per_s']:.0f}",
         f"{r['untrimmed_bytes_per_s']:.0f}", f"{r['packets_per_s']:.0f}")
        for hz, r in rates.items()
    )  # fmt: skip
    return TrialTable(
        "Bytes a second",
        ("frames", "D1 to D2", "D2 to D1", "both", "no byte cut off", "packets a second"),
        rows,
    )

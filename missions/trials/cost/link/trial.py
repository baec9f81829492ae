"""Bytes on the link between the drones, counted at the socket, and what signing and checking a
packet costs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from drivers.link.dialect import path_dialect as dialect
from drivers.link.wire import UDP_IP_OVERHEAD
from missions.ground import rig_library
from missions.look.report.palette import COUNT, DIM, FAULT, NEEDED, ROLE, tidy
from missions.trials.cost.link.cost import PACKETS, Times, measure_costs
from missions.trials.cost.link.traffic import LinkTraffic, TappedPacket, flow
from missions.trials.shared.drawing import save, sheet
from missions.trials.shared.statistics import bootstrap, median, medians
from missions.trials.shared.trial import (
    TrialFinding,
    TrialPicture,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.alike import Alike
from path.messages import Role

TITLE = "Link: bytes on the socket at 30, 50 and 60 Hz, signed, and the cost of signing"
PAPER = "Hardware Performance"

RATES_HZ = (30, 50, 60)
SECONDS = 10
QUICK_SECONDS = 1
LIMIT_PACKET_B = 128
GOAL_BYTES_PER_S = 12_000
PAPER_LIMIT = 16_000
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
PICTURE = "link.png"


def run(request: TrialRequest) -> TrialResult:
    mission = rig_library.mission_of(request.rig)
    seconds = QUICK_SECONDS if request.quick else SECONDS
    traffic = flow(request.work, RATES_HZ, seconds, mission, request.seed)
    costs = measure_costs(request)
    rng = np.random.default_rng([request.seed, 9])
    sizes = {kind: _sizes(kind, traffic) for kind in KINDS}
    verifying = while_verifying(sizes)
    rates = {str(one.hz): _rates(one, verifying) for one in traffic}
    largest = max(size["wire_b"] for size in sizes.values())
    medians = {name: float(np.median(times)) for name, times in costs.items()}
    summary: dict[str, Any] = {
        "messages": sizes,
        "rates": rates,
        "handover_b": sum(sizes[kind]["wire_b"] for kind in ("commit", "accept", "confirm")),
        "largest_packet_b": largest,
        "sign_us": medians["encode_signed"],
        "verify_us": medians["decode_signed"],
        "costs_us": medians,
    }
    _draw(traffic, sizes, request.out / PICTURE)
    return TrialResult(
        summary=summary,
        findings=(*_size_findings(rates, largest, traffic), *_cost_findings(costs, rng)),
        noise=_conditions(mission.status_hz, mission.receiver_status_hz, mission.ping_hz, seconds),
        tables=(_size_table(sizes), _rate_table(rates), _cost_table(costs, rng)),
        pictures=(
            TrialPicture(PICTURE, "Bytes a second by message, and what a packet consists of."),
        ),
        notes=(
            f"Counted by a tap between two real UDP links on loopback: each datagram's length and {UDP_IP_OVERHEAD} B "
            "for its UDP and IPv4 headers. Ethernet, Wi-Fi or radio framing comes on top and is the channel's.",
            "MAVLink cuts off zero bytes at a payload's end: a candidate with a box is one byte shorter than one "
            "without. Sizes are of the largest that can be sent; the rates are of what was sent.",
            "No field is a floating point number; what rounding costs is in docs/decisions/0222.",
            "The paper counts bare payloads of 32 bit fields and does not say whether they are signed.",
        ),
    )


def _sizes(kind: str, traffic: Sequence[LinkTraffic]) -> dict[str, int]:
    """The largest packet of a kind that was seen."""
    seen = [
        packet for one in traffic for packet in (*one.packets, *one.extremes) if packet.kind == kind
    ]
    packet = max(seen, key=lambda p: p.wire_b)
    return {"payload_b": packet.payload_b, "mavlink_b": packet.mavlink_b, "wire_b": packet.wire_b}


def while_verifying(sizes: dict[str, dict[str, int]]) -> dict[str, dict[str, int]]:
    """Return the largest packets of each kind while both verify.

    A Status leaves its digests out then, and neither flight has ended: those bytes are zero, and
    MAVLink cuts them off.
    """
    status = {name: size_b - ALIKE_B - ENDED_B for name, size_b in sizes["status"].items()}
    return {**sizes, "status": status}


def _rates(one: LinkTraffic, sizes: dict[str, dict[str, int]]) -> dict[str, float]:
    """Bytes a second of one link: as sent, by direction, over its seconds, and if no byte had been
    cut off.
    """
    stream = [packet for packet in one.packets if packet.kind not in ONCE]
    by_role = {
        role: sum(p.wire_b for p in stream if p.direction is role) / one.seconds for role in Role
    }
    each = _each_second(stream, one.seconds)
    return {
        "bytes_per_s": sum(by_role.values()),
        "sender_bytes_per_s": by_role[Role.SENDER],
        "receiver_bytes_per_s": by_role[Role.RECEIVER],
        "least_second_b": float(min(each)),
        "most_second_b": float(max(each)),
        "untrimmed_bytes_per_s": sum(sizes[packet.kind]["wire_b"] for packet in stream)
        / one.seconds,
        "packets_per_s": len(stream) / one.seconds,
    }


def _each_second(stream: Sequence[TappedPacket], seconds: int) -> list[int]:
    """Bytes that came within each second from the first packet on."""
    bins = [0] * seconds
    for packet in stream:
        second = int(packet.at_s - stream[0].at_s)
        if second < seconds:
            bins[second] += packet.wire_b
    return bins


def _size_findings(
    rates: dict[str, dict[str, float]], largest: int, traffic: Sequence[LinkTraffic]
) -> tuple[TrialFinding, ...]:
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
                f"{rate['least_second_b'] / 1000:.2f} to {rate['most_second_b'] / 1000:.2f} over its seconds; "
                f"{rate['untrimmed_bytes_per_s'] / 1000:.2f} with no byte cut off",
                "≈ 12 (9–15), < 16 at 60 Hz" if hz == "60" else "≈ 12 (9–15)",
                goal,
                verdict(rate["untrimmed_bytes_per_s"] <= GOAL_BYTES_PER_S) if goal else "measured",
            )
        )
    lost = sum(one.sent - one.received for one in traffic)
    dropped = sum(sum(one.dropped.values()) for one in traffic)
    findings.append(
        TrialFinding(
            "packets lost, and dropped by a codec", f"{lost}, {dropped}", "of all that were sent"
        )
    )
    return tuple(findings)


def _cost_findings(costs: dict[str, Times], rng: np.random.Generator) -> tuple[TrialFinding, ...]:
    def found(quantity: str, name: str) -> TrialFinding:
        low, high = bootstrap(costs[name], medians, rng)
        return TrialFinding(quantity, f"{median(costs[name]):.1f}", f"{low:.1f} to {high:.1f}")

    added = _both(costs, "signed") / _both(costs, "unsigned")
    low, high = bootstrap(added, medians, rng)
    share = 100.0 * 60.0 * median(_both(costs, "signed")) * 1e-6
    return (
        found("encode and sign a packet, µs median", "encode_signed"),
        found("verify and decode a packet, µs median", "decode_signed"),
        TrialFinding(
            "signed against unsigned, both ends, ratio",
            f"{median(added):.2f}",
            f"{low:.2f} to {high:.2f}",
        ),
        TrialFinding("one core at 60 Hz, a packet out and one in, per role", f"{share:.2f} %"),
    )


def _both(costs: dict[str, Times], how: str) -> Times:
    return costs[f"encode_{how}"] + costs[f"decode_{how}"]


def _conditions(sender_hz: float, receiver_hz: float, ping_hz: float, seconds: int) -> TrialTable:
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
            ("faults", "none: loopback, every packet signed with the pair's key"),
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


def _cost_table(costs: dict[str, Times], rng: np.random.Generator) -> TrialTable:
    rows: list[tuple[str, ...]] = []
    for name, values in costs.items():
        low, high = bootstrap(values, medians, rng)
        ends = f"{low:.1f} to {high:.1f}"
        rows.append(
            (
                name.replace("_", ", "),
                f"{median(values):.1f}",
                ends,
                f"{np.percentile(values, 99):.1f}",
            )
        )
    return TrialTable(
        f"Time per packet, µs (targets and candidates alike, mean of {PACKETS} each)",
        ("", "median", "95 % interval", "p99 of the means"),
        tuple(rows),
        "Python, in this process, on one core of a machine that is shared: take it as ± 20 %.",
    )


def _draw(traffic: Sequence[LinkTraffic], sizes: dict[str, dict[str, int]], path: Path) -> None:
    figure = sheet(10.5, 4.2)
    _draw_rates(figure.add_subplot(1, 2, 1), traffic)
    _draw_sizes(figure.add_subplot(1, 2, 2), sizes)
    save(figure, path)


def _draw_rates(axes: Axes, traffic: Sequence[LinkTraffic]) -> None:
    def rate(one: LinkTraffic, chosen: Callable[[TappedPacket], bool]) -> float:
        return (
            sum(
                packet.wire_b
                for packet in one.packets
                if chosen(packet) and packet.kind not in ONCE
            )
            / one.seconds
            / 1000.0
        )

    parts: tuple[tuple[str, str, Callable[[TappedPacket], bool]], ...] = (
        ("target", ROLE[Role.SENDER], lambda p: p.kind == "target"),
        ("candidate", ROLE[Role.RECEIVER], lambda p: p.kind == "candidate"),
        ("status", COUNT, lambda p: p.kind == "status"),
        ("clocks", DIM, lambda p: p.kind not in ("target", "candidate", "status")),
    )
    base = np.zeros(len(traffic))
    for label, colour, chosen in parts:
        heights = np.array([rate(one, chosen) for one in traffic])
        axes.bar(
            [f"{one.hz} Hz" for one in traffic],
            heights,
            0.55,
            bottom=base,
            color=colour,
            label=label,
        )
        base += heights
    axes.axhline(GOAL_BYTES_PER_S / 1000.0, color=NEEDED, lw=1.0, ls="--")
    axes.axhline(PAPER_LIMIT / 1000.0, color=FAULT, lw=1.0, ls=":")
    axes.text(-0.35, GOAL_BYTES_PER_S / 1000.0 + 0.15, "goal at 60 Hz", fontsize=8)
    axes.text(-0.35, PAPER_LIMIT / 1000.0 + 0.15, "paper's limit at 60 Hz", fontsize=8, color=FAULT)
    axes.set_ylim(0.0, 18.0)
    axes.set_ylabel("kB/s, both ways, with UDP/IP", fontsize=9)
    axes.legend(fontsize=8, loc="center left")
    tidy(axes)


def _draw_sizes(axes: Axes, sizes: dict[str, dict[str, int]]) -> None:
    kinds = list(reversed(sizes))
    base = np.zeros(len(kinds))
    parts = (
        ("UDP/IP", DIM, [float(UDP_IP_OVERHEAD)] * len(kinds)),
        ("MAVLink frame", COUNT, [float(FRAME_B)] * len(kinds)),
        ("signature", FAULT, [float(SIGNATURE_B)] * len(kinds)),
        ("payload", ROLE[Role.SENDER], [float(sizes[kind]["payload_b"]) for kind in kinds]),
    )
    for label, colour, widths in parts:
        axes.barh(kinds, widths, 0.6, left=base, color=colour, label=label)
        base += np.array(widths)
    axes.axvline(LIMIT_PACKET_B, color=NEEDED, lw=1.0, ls="--")
    axes.set_xlabel("B on the wire    (dashed: 128 B)", fontsize=9)
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    tidy(axes)

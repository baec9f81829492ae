"""The cost of making a signed packet of a message, and of checking one and reading it."""

from __future__ import annotations

from itertools import starmap

import numpy as np
from numpy.typing import NDArray

from drivers.clock import stopwatch_ns
from drivers.link.wire import KEY_LENGTH, Codec, introduce
from missions.trials.cost.link.traffic import a_candidate, a_target
from missions.trials.shared.trial import TrialRequest
from path.messages import Candidate, Role, Target

BATCHES = 120
QUICK_BATCHES = 12
BATCH = 50
PACKETS = 2 * BATCH  # in a batch: targets and candidates

Times = NDArray[np.float64]
Pair = tuple[Codec, Codec]


def measure_costs(request: TrialRequest) -> dict[str, Times]:
    """Mean time per packet in us of each batch, by what was done; signed and unsigned take
    turns.
    """
    rng = np.random.default_rng([request.seed, 5])
    pairs = {
        how: _pair(key) for how, key in (("signed", rng.bytes(KEY_LENGTH)), ("unsigned", None))
    }
    times: dict[str, list[float]] = {
        f"{what}_{how}": [] for how in pairs for what in ("encode", "decode")
    }
    for batch in request.work.steps(
        "batches of packets", range(QUICK_BATCHES if request.quick else BATCHES)
    ):
        messages = [
            (a_target(rng, k, stopwatch_ns()), a_candidate(rng, k, stopwatch_ns()))
            for k in range(1, BATCH + 1)
        ]
        for how in sorted(pairs, reverse=batch % 2 == 1):
            encode_us, decode_us = _time(pairs[how], messages)
            times[f"encode_{how}"].append(encode_us)
            times[f"decode_{how}"].append(decode_us)
    return {name: np.array(values) for name, values in times.items()}


def _pair(key: bytes | None) -> Pair:
    pair = Codec(Role.SENDER, key), Codec(Role.RECEIVER, key)
    introduce(*pair)
    return pair


def _time(pair: Pair, messages: list[tuple[Target, Candidate]]) -> tuple[float, float]:
    sender, receiver = pair

    def encode(target: Target, candidate: Candidate) -> tuple[bytes, bytes]:
        return sender.encode(target), receiver.encode(candidate)

    def decode(target: bytes, candidate: bytes) -> bool:
        return isinstance(receiver.decode(target), Target) and isinstance(
            sender.decode(candidate), Candidate
        )

    begin_ns = stopwatch_ns()
    packets = list(starmap(encode, messages))
    packed_ns = stopwatch_ns()
    understood = all(starmap(decode, packets))
    read_ns = stopwatch_ns()
    if not understood:
        raise AssertionError("a packet that was just made was dropped")
    return (packed_ns - begin_ns) / 1e3 / PACKETS, (read_ns - packed_ns) / 1e3 / PACKETS

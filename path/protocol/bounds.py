"""The longest times that a hand-over takes where programs keep time: L1 and L2, of whatever
settings.
"""

from __future__ import annotations

from path.protocol.values import ProtocolConfig

# how late a program may notice the time: its longest sleep, a record written meanwhile, its wake-up
LATE_S = 0.2


def commit_bound_s(config: ProtocolConfig) -> float:
    """From a COMMIT to the sender's decision (L1)."""
    return config.lease_s + config.max_uncertainty_s + LATE_S


def decision_bound_s(config: ProtocolConfig) -> float:
    """From the offer to each side's decision (L1)."""
    return config.handoff_s + commit_bound_s(config)


def gap_bound_s(config: ProtocolConfig) -> float:
    """With nobody responsible (L2)."""
    return commit_bound_s(config) + config.guard_s

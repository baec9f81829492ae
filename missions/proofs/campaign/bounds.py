"""The bounds on how long a decision and a gap may take, derived from the protocol's deadlines (L1,
L2).
"""

from __future__ import annotations

from missions.proofs.campaign.judge import COMMIT_BOUND_S, DECISION_BOUND_S, GAP_BOUND_S

BOUNDS: dict[tuple[str, str], float] = {
    ("machines", "decided_s"): DECISION_BOUND_S,
    ("machines", "commit_s"): COMMIT_BOUND_S,
    ("machines", "gap_s"): GAP_BOUND_S,
    ("roles", "commit_s"): COMMIT_BOUND_S,
    ("roles", "gap_s"): GAP_BOUND_S,
    ("team", "gap_s"): GAP_BOUND_S,
}

"""The size that a rig states of its target is the size of what the harness draws for it."""

from __future__ import annotations

import numpy as np
import pytest

from hil.geometric.scene import parts_of
from hil.world.snapshot import TargetKind
from missions.ground import rig_library
from path.config import EvidenceConfig
from path.gate.evidence import evidence_needed, evidence_of
from tests.every_rig import every_name


@pytest.mark.parametrize(
    ("name", "kind"),
    [("sim", "car"), ("sitl-px4", "car"), ("sim-person", "person"), ("sim-drone", "drone")],
)
def test_what_a_rig_says_is_wide_and_high_enough_and_hardly_more(
    name: str, kind: TargetKind
) -> None:
    rig = rig_library.load_unchecked(name)
    assert rig.world["target"].get("kind", "car") == kind
    parts = parts_of(kind)
    signs = np.array(np.meshgrid(*((-1.0, 1.0),) * 3)).reshape(3, -1).T
    corners = (parts[:, None, :3] + signs * parts[:, None, 3:6]).reshape(-1, 3)
    span_m = np.max(np.linalg.norm(corners[:, None, :2] - corners[None, :, :2], axis=2))
    stated = rig.method.evidence
    # of a drone only the hull is in a box as a rule; the arms may be
    assert span_m <= stated.span_m <= (0.33 if kind == "drone" else 1.02 * span_m)
    assert np.ptp(corners[:, 2]) <= stated.height_m + 0.001 <= 1.5 * np.ptp(corners[:, 2])


@pytest.mark.parametrize("name", every_name())
def test_a_rig_that_decides_by_evidence_states_the_size_of_its_target(name: str) -> None:
    method = rig_library.load_unchecked(name).method
    assert method.gate == "count" or (
        method.evidence.span_m > 0.0 and method.evidence.height_m > 0.0
    )


@pytest.mark.parametrize("name", every_name())
def test_a_rig_that_takes_weaker_blocks_says_that_they_agree_by_accident_more_often(
    name: str,
) -> None:
    stated, usual = rig_library.load_unchecked(name).method.evidence, EvidenceConfig()
    weaker = stated.strength < usual.strength
    assert weaker == (stated.first_rate > usual.first_rate) == (stated.next_rate > usual.next_rate)
    blocks = next(n for n in range(1, 100) if evidence_of(n, stated) >= evidence_needed(1, stated))
    assert blocks > 4 if weaker else blocks == 4

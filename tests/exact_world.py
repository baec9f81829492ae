"""A calm world in which nothing errs, and an autopilot that is quick about everything."""

from dataclasses import fields
from typing import Any

from hil.autopilot.autopilot import AutopilotConfig
from hil.world.config import WorldConfig
from hil.world.errors import ErrorsConfig
from hil.world.estimator import EstimatorConfig, WindConfig
from hil.world.world import World

QUICK = AutopilotConfig(
    settle_s=0.2, spool_s=0.1, climb_mps=1.5, land_mps=1.0, touchdown_mps=0.8, land_disarm_s=0.2
)

NAMES = [each.name for each in fields(EstimatorConfig)]


def exact_world(autopilot: AutopilotConfig = QUICK, **others: Any) -> World:
    """``others``: of the ``WorldConfig``."""
    config = WorldConfig(
        errors=ErrorsConfig("exact"),
        wind=WindConfig(0.0, gust_mps=0.0),
        estimator=EstimatorConfig(**dict.fromkeys(NAMES, 0.0)),
        autopilot=autopilot,
        **others,
    )
    return World(config, seed=1)

"""The table of errors for trials that judge single frames: what is true is the rig, and the drones
believe another.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from flight.harness.errors import DrawnErrors
from hil.world.errors import as_built, doubted, level_of, sizes_of
from hil.world.estimator import EstimatorConfig
from path.messages import Role

STREAM = 0x74696C74


class WorldErrors:
    """Draws sessions from the world's table (TrialErrors)."""

    def __init__(self, rig: Rig) -> None:
        config = decode_table(
            rig.world.get("estimator", {}),
            EstimatorConfig,
            rig.where("[world.estimator]"),
        )
        self._rig, self._sizes = rig, sizes_of(level_of(rig))
        self._estimator = config.times(self._sizes)

    def session(self, seed: int) -> DrawnErrors:
        """Return what the drones believe: as far from the rig, and by the same draws, as a
        flight's world is.

        Their cameras state how well they are known, as a calibration does.
        """
        built = as_built(self._rig, seed)
        random = np.random.default_rng([seed, STREAM])
        tilts = math.radians(self._estimator.tilt_bias_deg) * random.standard_normal((len(Role), 2))
        return DrawnErrors(
            cameras={role: doubted(built.rig.role(role).camera, self._sizes) for role in Role},
            T_b_c={role: built.rig.role(role).mount.T_b_c for role in Role},
            T_b_v=built.rig.sender.mount.T_b_v,
            layout=built.rig.layout,
            depth={role: built.sensors[role].depth_error for role in Role},
            tilt_bias_rad={
                role: (roll, pitch)
                for role, (roll, pitch) in zip(Role, tilts.tolist(), strict=True)
            },
            tilt_noise_rad=math.radians(self._estimator.tilt_noise_deg),
        )

    def rows(self) -> tuple[tuple[str, str, str], ...]:
        sizes = self._sizes
        estimator = self._estimator
        return (
            (
                "focal lengths of each camera",
                f"{100 * sizes.focal:g} %, fx and fy together",
                "session",
            ),
            ("principal point of each camera", f"{sizes.centre_px:g} px per axis", "session"),
            (
                "distortion of each camera",
                f"{sizes.distortion_px:g} px per axis in the image's corner",
                "session",
            ),
            ("printed side", f"{100 * sizes.side:g} %", "session"),
            (
                "mounts of both cameras and of the marker",
                f"{1e3 * sizes.mount_m:g} mm and {sizes.mount_deg:g}° per axis",
                "session",
            ),
            (
                "depth of each camera",
                f"scale {100 * sizes.depth:g} %, bias {1e3 * sizes.depth_bias_m:g} mm",
                "session",
            ),
            (
                "attitude bias, each drone",
                f"{estimator.tilt_bias_deg:g}° in roll and in pitch",
                "session",
            ),
            (
                "attitude noise, each drone",
                f"{estimator.tilt_noise_deg:g}° in roll and in pitch",
                "frame",
            ),
        )

"""Made-up beacons: as noisy, slow, late and elsewhere as they say they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.beacons.log import BeaconTruth, Mounted
from drivers.beacons.record import BeaconRecorder
from drivers.beacons.stream import MarvelmindStream
from drivers.interfaces import BeaconFix
from drivers.log.mcap_log import McapLog
from hil.beacons.noise import BeaconConfig
from hil.beacons.system import listen
from path.geometry.rotation import R_from_rpy, quat_from_R

CONFIG = BeaconConfig()
SECONDS = 120.0
MOUNTED = {
    "sender": Mounted(5, (0.0, 0.0, -0.05)),
    "receiver": Mounted(6, (0.1, 0.0, 0.0)),
    "target": Mounted(7, (0.0, 0.2, 0.1)),
}
LEANING = R_from_rpy(0.2, 0.1, 0.5)


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[BeaconFix], BeaconTruth]:
    """D1 flies east at 0.5 m/s, D2 stands, the target is parked with its nose to the west."""
    folder = tmp_path_factory.mktemp("beacons")
    with McapLog(folder / "world.mcap") as log:
        log.write("/scene", 0, {"target_id": 0})
        for k in range(round(SECONDS / 0.04)):
            q = list(quat_from_R(LEANING))
            record = {
                "sender": {"t": [0.5 * 0.04 * k, 0.0, 1.5], "q": [1.0, 0.0, 0.0, 0.0]},
                "receiver": {"t": [1.0, 2.0, 1.0], "q": q},
                "objects": [
                    {"id": 3, "t": [9.0, 9.0, 0.0], "yaw": 0.0},
                    {"id": 0, "t": [4.0, 5.0, 0.0], "yaw": np.pi},
                ],
            }
            log.write("/truth", k * 40_000_000, record)
    stream, fixes = MarvelmindStream(), list[BeaconFix]()

    def hear(port: str, arrival_ns: int, data: bytes) -> None:
        fixes.extend(stream.feed(port, arrival_ns, data))

    truth = listen(folder / "world.mcap", hear, 3, MOUNTED)
    return fixes, truth


def of(
    heard: tuple[list[BeaconFix], BeaconTruth], address: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Instants of the world, places in the world, quality."""
    fixes, truth = [fix for fix in heard[0] if fix.address == address], heard[1]
    p = (np.array([fix.position_m for fix in fixes]) - truth.origin_m) @ R_from_rpy(
        0.0, 0.0, truth.yaw_rad
    )
    return (
        np.array([fix.host_ns for fix in fixes]) * 1e-9 + truth.offset_s,
        p,
        np.array([f.quality for f in fixes]),
    )


def test_rate_and_gaps_are_as_stated(heard: tuple[list[BeaconFix], BeaconTruth]) -> None:
    for address in (5, 6, 7):
        t, _, _ = of(heard, address)
        expected = (
            SECONDS
            * CONFIG.rate_hz
            * (1.0 - CONFIG.drop_rate)
            * (1.0 - CONFIG.gap_rate * CONFIG.gap_s)
        )
        assert len(t) == pytest.approx(expected, rel=0.06)
        assert np.median(np.diff(t)) == pytest.approx(1.0 / CONFIG.rate_hz, rel=0.05)


def test_a_beacon_is_where_it_is_mounted_but_for_its_noise(
    heard: tuple[list[BeaconFix], BeaconTruth],
) -> None:
    for address, place in (
        (6, LEANING @ (0.1, 0.0, 0.0) + (1.0, 2.0, 1.0)),
        (7, np.array([4.0, 4.8, 0.1])),
    ):
        _, p, quality = of(heard, address)
        good = p[(quality > 75.0) & (np.linalg.norm(p - place, axis=1) < 0.2)]
        assert np.std(good, axis=0) == pytest.approx(CONFIG.noise_m, rel=0.15)
        assert np.all(np.abs(good.mean(axis=0) - place) < 3.0 * CONFIG.warp_m)
        assert np.any(np.abs(good.mean(axis=0) - place) > 0.002)  # the warp


def test_reflections_are_far_off_and_most_are_rated_so(
    heard: tuple[list[BeaconFix], BeaconTruth],
) -> None:
    far, rated, count = 0, 0, 0
    for address, place in (
        (6, LEANING @ (0.1, 0.0, 0.0) + (1.0, 2.0, 1.0)),
        (7, np.array([4.0, 4.8, 0.1])),
    ):
        _, p, quality = of(heard, address)
        wrong = np.linalg.norm(p - place, axis=1) > 0.2
        far, rated, count = (
            far + int(wrong.sum()),
            rated + int((wrong & (quality < 75.0)).sum()),
            count + len(p),
        )
    assert 0.008 < far / count < 0.04
    assert 0 < rated < far


def test_the_stated_offset_is_that_of_the_stamps(
    heard: tuple[list[BeaconFix], BeaconTruth],
) -> None:
    """D1's speed turns an error of the clock into a place: 5 ms are 2.5 mm, averaged over 900
    positions.
    """
    t, p, quality = of(heard, 5)
    fine = (quality > 75.0) & (np.abs(p[:, 0] - 0.5 * t) < 0.2)
    assert np.mean(p[fine, 0] - 0.5 * t[fine]) == pytest.approx(0.0, abs=2.0 * CONFIG.warp_m)
    assert np.std(p[fine, 0] - 0.5 * t[fine]) < 2.0 * CONFIG.noise_m


def test_the_same_seed_gives_the_same_log(tmp_path: Path) -> None:
    with McapLog(tmp_path / "world.mcap") as log:
        for k in range(100):
            still = {"t": [0.0, 0.0, 1.0], "q": [1.0, 0.0, 0.0, 0.0]}
            log.write(
                "/truth",
                k * 40_000_000,
                {
                    "sender": still,
                    "receiver": still,
                    "objects": [{"id": 0, "t": [1.0, 1.0, 0.0], "yaw": 0.0}],
                },
            )
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        recorder = BeaconRecorder(tmp_path / name, 0.0, virtual=True)
        listen(tmp_path / "world.mcap", recorder.write, seed, MOUNTED)
        recorder.close()
    assert (
        (tmp_path / "a").read_bytes()
        == (tmp_path / "b").read_bytes()
        != (tmp_path / "c").read_bytes()
    )


def test_a_log_without_truth_is_refused(tmp_path: Path) -> None:
    with McapLog(tmp_path / "world.mcap") as log:
        log.write("/scene", 0, {"target_id": 0})
    with pytest.raises(ValueError, match="no truth"):
        listen(tmp_path / "world.mcap", MarvelmindStream().feed, 1, MOUNTED)

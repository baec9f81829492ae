"""A campaign on a real Dask scheduler and workers; skipped where Dask, an extra, is not
installed.
"""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import pytest

from missions.ground.options.proofs import CampaignOptions
from missions.proofs.campaign.cluster import open_cluster
from missions.proofs.campaign.run import run


def square(number: int) -> int:
    return number * number


@pytest.mark.filterwarnings("default")
def test_a_cluster_does_what_the_cores_do(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        with open_cluster(cluster.scheduler_address, io.StringIO()) as work:
            assert sorted(work.stream("squares", square, range(20))) == [
                number * number for number in range(20)
            ]
        here, there = tmp_path / "here", tmp_path / "there"
        told = CampaignOptions(runs=2, faults=("none",), jobs=1)
        assert run(replace(told, out=here)) == 0
        assert run(replace(told, out=there, cluster=cluster.scheduler_address)) == 0
    assert (here / "runs.jsonl").read_text() == (there / "runs.jsonl").read_text()

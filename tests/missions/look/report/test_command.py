"""The report: figures from records alone, with the errors that were put into them."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.log.mcap_log import LogRecord
from missions.look.report.command import make_report, series_table, show, summarize_many
from missions.look.report.records import RunFacts, RunFolderError, load_run, write_facts
from missions.look.report.summary import shed_s, summarize
from missions.look.report.truth import first_hit, truth_of
from path.messages import Role

MakeRun = Callable[..., Path]
BOX = np.array([[0.0, 0.0, 0.5, 2.0, 1.0, 1.0]])


def test_errors_are_those_that_were_put_in(make_run: MakeRun) -> None:
    summary = summarize(load_run(make_run(d2_error_m=0.012, target_error_m=0.02)))
    assert summary["d2_error_m"] == pytest.approx(0.012, abs=2e-4)
    assert summary["target_error_m"] == pytest.approx(0.02, abs=5e-4)
    assert summary["target_error_p95_m"] >= summary["target_error_m"]


def test_perfect_estimates_have_no_error(make_run: MakeRun) -> None:
    summary = summarize(load_run(make_run(d2_error_m=0.0, target_error_m=0.0)))
    assert summary["d2_error_m"] < 2e-4
    assert summary["target_error_m"] < 5e-4


def test_clocks_that_are_mixed_up_would_show(make_run: MakeRun) -> None:
    run = load_run(make_run())
    truth = truth_of(run.world)
    assert truth is not None
    stamp_ns = run.receiver["/candidate"][100].record["capture_ns"]
    assert truth.to_world_ns(Role.RECEIVER, stamp_ns) == pytest.approx(22e9, abs=2)
    assert (
        np.linalg.norm(
            truth.T_w_c(Role.RECEIVER, stamp_ns).t - truth.T_w_c(Role.RECEIVER, stamp_ns + 10**9).t
        )
        > 0.2
    )


def test_times_counts_and_rates(make_run: MakeRun) -> None:
    summary = summarize(load_run(make_run()))
    expected = {
        "outcome": "committed",
        "exit_code": 0,
        "t_commit_s": 27.05,
        "agreement_s": 7.05,
        "iou_median": 0.7,
        "tau_median": 0.3,
        "misses": {"low_iou": 2},
        "pairs_judged": 352,
        "pairs_agreed": 350,
        "gate": "count",
        "count_max": 350,
        "evidence_max": None,
        "in_a_row": None,  # of a run whose log does not say what its gate was set to
        "separation_limit_m": 0.7,
        "link_bytes_per_s": 8000.0,
        "realtime_factor": 80.0,
        "wrong_handover": False,
        "object_handed_over": 0,
        "monitors": {},
        "setpoint_gap_s": {"sender": 0.04},
        "estimator_steps": {"sender": 0, "receiver": 0},
    }
    assert {key: summary[key] for key in expected} == expected
    assert summary["min_separation_m"] == pytest.approx(np.linalg.norm([0.5, 0.9, 0.5]), abs=1e-3)
    assert summary["frames"]["receiver"] == {"hz": 50.0, "missed": 0}
    assert summary["frames"]["sender"]["missed"] == 1
    json.dumps(summary, allow_nan=False)


def test_what_was_given_up_is_told_with_its_time() -> None:
    def shed(at_s: float, what: str, gone: bool) -> LogRecord:
        return LogRecord("/shed", round(at_s * 1e9), {"what": what, "gone": gone, "busy": 0.9})

    changes = [
        shed(1.0, "picture log", True),
        shed(2.0, "redetection", True),
        shed(4.5, "redetection", False),
    ]
    changes += [shed(8.0, "redetection", True)]
    records = {"/shed": changes, "/phase": [LogRecord("/phase", round(10e9), {"phase": "done"})]}
    assert shed_s(records) == {"picture log": 9.0, "redetection": 4.5}
    assert shed_s({}) == {}


def test_phases_have_starts_and_durations(make_run: MakeRun) -> None:
    phases = summarize(load_run(make_run()))["phases"]
    assert phases["sender"][1] == {"phase": "take-off", "start_s": 5.0, "duration_s": 5.0}
    assert [p["phase"] for p in phases["receiver"]][-2:] == ["follow", "land"]
    assert phases["sender"][-1]["duration_s"] > 0.0


def test_a_hand_over_of_the_wrong_object_is_seen(make_run: MakeRun) -> None:
    summary = summarize(load_run(make_run(followed_id=1)))
    assert summary["wrong_handover"] is True
    assert summary["object_handed_over"] == 1


def test_without_a_commit_nothing_was_handed_over(make_run: MakeRun) -> None:
    summary = summarize(load_run(make_run(committed=False, followed_id=1)))
    assert summary["outcome"] == "no_agreement"
    assert summary["wrong_handover"] is False
    assert summary["t_commit_s"] is None
    assert summary["agreement_s"] is None
    assert summary["iou_median"] == 0.7


def test_without_a_world_what_needs_truth_is_null(make_run: MakeRun) -> None:
    summary = summarize(load_run(make_run(world=False)))
    assert summary["d2_error_m"] is None
    assert summary["wrong_handover"] is None
    assert summary["min_separation_m"] > 0.5  # by D2's own measurement of the marker


def test_a_run_that_was_cut_off_still_has_a_summary(make_run: MakeRun) -> None:
    folder = make_run()
    (folder / "run.json").unlink()
    (folder / "receiver.mcap").unlink()
    sender = folder / "sender.mcap"
    sender.write_bytes(sender.read_bytes()[:2000])
    summary = summarize(load_run(folder))
    assert summary["outcome"] == "unfinished"
    assert summary["iou_median"] is None


def test_what_is_no_run_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="not the folder of a run"):
        load_run(tmp_path)


def test_a_ray_meets_the_near_face_of_the_nearest_box() -> None:
    two = np.vstack([BOX, BOX + np.array([5.0, 0, 0, 0, 0, 0])])
    hit = first_hit(np.array([-10.0, 0.2, 0.5]), np.array([2.0, 0.0, 0.0]), two)
    assert hit is not None
    np.testing.assert_allclose(hit, [-1.0, 0.2, 0.5])


@pytest.mark.parametrize(
    ("origin", "direction"), [((-10, 0.6, 0.5), (1, 0, 0)), ((-10, 0, 0.5), (-1, 0, 0))]
)
def test_a_ray_that_misses_meets_nothing(
    origin: tuple[float, ...], direction: tuple[float, ...]
) -> None:
    assert first_hit(np.array(origin, float), np.array(direction, float), BOX) is None


# --- what is shown and written


def test_a_report_is_made_again_from_the_logs(make_run: MakeRun) -> None:
    folder, shown = make_run(), io.StringIO()
    summary = make_report(folder, picture=False, stream=shown)
    assert json.loads((folder / "summary.json").read_text()) == summary
    text = shown.getvalue()
    for part in (
        "committed",
        "take-off",
        "350 of 352, 49.9 Hz",
        "low_iou 2",
        "5.0 mm median",
        "(limit 0.70 m)",
        "8000 B/s",
    ):
        assert part in text
    assert "\x1b" not in text


def test_a_report_of_almost_nothing_has_dashes(make_run: MakeRun) -> None:
    folder, shown = make_run(world=False, committed=False), io.StringIO()
    (folder / "run.json").unlink()
    (folder / "receiver.mcap").unlink()
    make_report(folder, picture=False, stream=shown)
    assert "unfinished" in shown.getvalue()
    assert "error of D2                -" in shown.getvalue()


def test_many_runs_are_summed_up(make_run: MakeRun) -> None:
    good = summarize(load_run(make_run()))
    bad = {
        **good,
        "seed": 8,
        "outcome": "monitor_violated",
        "monitors": {"S9": 2},
        "wrong_handover": True,
        "agreement_s": None,
    }
    series = summarize_many([good, bad], "path-handoff handoff --seed 7 --seeds 2")
    assert series["command"].endswith("--seeds 2")
    # Wilson's, of 1 in 2
    assert series["commit_rate_interval"] == pytest.approx([0.0945, 0.9055], abs=1e-4)
    assert series["outcomes"] == {"committed": 1, "monitor_violated": 1}
    assert series["commit_rate"] == 0.5
    assert series["wrong_handovers"] == 1
    assert series["monitors"] == {"S9": 2}
    assert series["misses"] == {"low_iou": 4}
    assert series["failed_seeds"] == {"8": "monitor_violated"}
    assert series["agreement_s"] == {"min": 7.05, "median": 7.05, "p95": 7.05, "max": 7.05}
    shown = io.StringIO()
    show(series_table(series), shown)
    assert "8 monitor_violated" in shown.getvalue()
    assert "50.0 % (9.4 to 90.5" in shown.getvalue()


def test_a_run_that_ended_before_any_log_is_shown_with_its_own_outcome(tmp_path: Path) -> None:
    """As on a computer that is too slow to begin; a folder of anything else is still none of a
    run.
    """
    detail = "the start of the world: not ready within 180 s"
    write_facts(
        tmp_path,
        RunFacts("sitl", "sitl", 0, "overloaded", 43, detail, simulated_s=0.0, wall_s=180.0),
    )
    stream = io.StringIO()
    assert make_report(tmp_path, True, stream)["outcome"] == "overloaded"
    assert "overloaded" in stream.getvalue() and "not ready within 180 s" in stream.getvalue()
    (tmp_path / "run.json").unlink()
    with pytest.raises(RunFolderError):
        make_report(tmp_path, True, stream)

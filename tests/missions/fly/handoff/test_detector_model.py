"""Rigs that look with YOLOX: the model is named when they are flown, and without one nothing
moves.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.detectors.yolox import MODEL_VARIABLE
from missions import cli
from missions.ground import rig_library
from tests.every_rig import every_name

LOOKING = sorted(name for name in every_name() if "yolox:YoloxDetector" in rig_library.whole(name))


def test_people_are_looked_for_with_yolox_wherever_frames_are_drawn() -> None:
    assert LOOKING == [
        "sim-rendered-person",
        "sim-rendered-person-indoor",
        "sitl-ardupilot-person",
        "sitl-mixed-person",
        "sitl-person",
        "sitl-px4-person",
    ]


@pytest.mark.parametrize("name", LOOKING)
def test_without_a_model_nothing_moves_and_the_way_to_name_one_is_said(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(MODEL_VARIABLE, raising=False)
    rig_library.load(name)  # the rig itself is whole
    for model, expected in (
        ([], "none was named"),
        (["--model", str(tmp_path / "gone.onnx")], "gone.onnx: no such file"),
    ):
        with pytest.raises(SystemExit) as end:
            cli.main(["handoff", "--rig", name, "--out", str(tmp_path / "run"), *model])
        assert end.value.code == 3
        error = capsys.readouterr().err
        assert expected in error
        assert "fix:" in error
        assert not (tmp_path / "run").exists()

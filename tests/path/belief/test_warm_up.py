"""Nothing that the belief calls is compiled in flight."""

from __future__ import annotations

import pytest

from path.belief import boxes, motion, warm_up


def test_everything_that_the_belief_calls_is_compiled_before_a_flight() -> None:
    warm_up.warm_up_belief()
    named = {**vars(motion), **vars(boxes)}
    compiled = {name: each for name, each in named.items() if hasattr(each, "signatures")}
    for name in ("mahalanobis2", "density", "renewal", "along_ray", "_grown", "_fused"):
        assert compiled[name].signatures, name
    for name in ("_beyond", "_likelier", "_inside"):
        assert compiled[name].signatures, name


def test_an_installation_that_computes_nonsense_is_told_before_the_flight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing(*_: object) -> float:
        return 0.0

    monkeypatch.setattr("path.belief.frame.density", nothing)
    with pytest.raises(RuntimeError, match="is not followed"):
        warm_up.warm_up_belief()

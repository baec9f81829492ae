"""A network in ONNX through onnxruntime, on the CPU: its inputs and outputs are checked before it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from drivers.interfaces import PartError

Floats = NDArray[np.float32]
Shape = tuple[int | str, ...]


class ModelError(PartError):
    """A model file is missing, is no network, or is one of other inputs and outputs."""


def open_session(file: Path, threads: int, remedy: str) -> onnxruntime.InferenceSession:
    """A network on the CPU. Raises ModelError when there is none."""
    if not file.is_file():
        raise ModelError(f"{file}: there is no such file; expected a network in ONNX", remedy)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions share no base of their own
        found = str(error).splitlines()[0]
        raise ModelError(
            f"{file}: expected a network in ONNX, found a file that cannot be read: {found}", remedy
        ) from error


class OnnxModel:
    """One float32 input, one float32 output."""

    def __init__(self, file: Path, threads: int, remedy: str) -> None:
        """Raises ModelError: expected and found."""
        self._session = open_session(file, threads, remedy)
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        kinds = [node.type for node in (*inputs, *outputs)]
        if (len(inputs), len(outputs)) != (1, 1) or set(kinds) != {"tensor(float)"}:
            found = f"{len(inputs)} and {len(outputs)}, {', '.join(kinds)}"
            raise ModelError(f"{file}: expected one input and one output of float32, found {found}", remedy)
        self._name = inputs[0].name
        self.input, self.output = _shape(inputs[0]), _shape(outputs[0])

    def run(self, tensor: Floats) -> Floats:
        outputs: list[Any] = list(self._session.run(None, {self._name: tensor}))
        return np.asarray(outputs[0], np.float32)


def _shape(node: Any) -> Shape:
    return tuple(side if isinstance(side, int) else str(side) for side in node.shape)


def shown(shape: Shape) -> str:
    """Returns a shape as messages have it: 1x3x416x416."""
    return "x".join(str(side) for side in shape)

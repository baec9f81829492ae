"""A network in ONNX through onnxruntime, on the CPU: its inputs and outputs are checked before it
is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from drivers.interfaces import PartError
from path.arrays import Singles
from path.values import frozen

Shape = tuple[int | str, ...]
FLOAT = "tensor(float)"
HALF = "tensor(float16)"


def open_session(
    file: Path,
    threads: int,
    remedy: str,
) -> onnxruntime.InferenceSession:
    """A network on the CPU. Raises PartError when there is none."""
    if not file.is_file():
        raise PartError(f"{file}: there is no such file; expected a network in ONNX", remedy)
    if (other := _other_weights(file)) is not None:
        raise PartError(
            f"{file}: expected a network in ONNX, found {other}", f"export it to ONNX: {remedy}"
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions share no base of their own
        found = str(error).splitlines()[0]
        raise PartError(
            f"{file}: expected a network in ONNX, found a file that cannot be read: {found}", remedy
        ) from error


def _other_weights(file: Path) -> str | None:
    """Return what a model file of another program is; None when it may be ONNX."""
    with file.open("rb") as opened:
        begins = opened.read(8)
    if begins[:4] == b"PK\x03\x04" or file.suffix.lower() in (".pt", ".pth"):
        return "PyTorch's own weights"
    if begins[4:8] == b"TFL3":
        return "a network of TensorFlow Lite"
    if begins[:4] == b"ftrt" or file.suffix.lower() in (".engine", ".trt"):
        return "an engine of TensorRT, which is for one graphics card"
    return None


@frozen
class Tensor:
    """An input or an output of a network. ``kind``: as onnxruntime says it, ``tensor(float)``."""

    name: str
    kind: str
    shape: Shape

    @property
    def text(self) -> str:
        kind = self.kind.removeprefix("tensor(").removesuffix(")")
        return f"{self.name} {shown(self.shape)} {kind}"


class OnnxModel:
    """A network with one input. What it computes with is float32 or float16; here it is float32.

    ``metadata``: what whoever exported it wrote beside it.
    """

    def __init__(
        self,
        file: Path,
        threads: int,
        remedy: str,
    ) -> None:
        """Raise PartError when the file is no network."""
        self._session = open_session(file, threads, remedy)
        self.inputs = tuple(_tensor(node) for node in self._session.get_inputs())
        self.outputs = tuple(_tensor(node) for node in self._session.get_outputs())
        self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map

    def run(self, tensor: Singles) -> Singles:
        """Return the first output for one input, as float32."""
        only = self.inputs[0]
        given = tensor.astype(np.float16) if only.kind == HALF else tensor
        outputs: list[Any] = list(self._session.run(None, {only.name: given}))
        return np.asarray(outputs[0], np.float32)


def _tensor(node: Any) -> Tensor:
    shape = tuple(side if isinstance(side, int) else str(side) for side in node.shape)
    return Tensor(str(node.name), str(node.type), shape)


def shown(shape: Shape) -> str:
    """Return a shape as messages have it: 1x3x416x416."""
    return "x".join(str(side) for side in shape)

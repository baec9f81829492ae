"""Small ONNX graphs, written as protobuf by hand: networks whose answers are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FLOAT, UINT8, INT64, HALF = 1, 2, 7, 10
INT_KIND, INTS_KIND = 2, 7


def varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


def field(number: int, content: bytes | int | str) -> bytes:
    """One field of a protobuf message."""
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    raw = content.encode() if isinstance(content, str) else content
    return varint(number << 3 | 2) + varint(len(raw)) + raw


def _value(name: str, shape: Sequence[int | str], kind: int = FLOAT) -> bytes:
    """``shape``: a side that may be of any size is given by its name."""
    sides = b"".join(field(1, field(1 if isinstance(side, int) else 2, side)) for side in shape)
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, sides)))


def _node(
    kind: str, inputs: Sequence[str], output: str, **attributes: int | Sequence[int]
) -> bytes:
    node = b"".join(field(1, name) for name in inputs) + field(2, output) + field(4, kind)
    for name, value in attributes.items():
        if isinstance(value, int):
            node += field(5, field(1, name) + field(3, value) + field(20, INT_KIND))
        else:
            node += field(
                5,
                field(1, name) + b"".join(field(8, each) for each in value) + field(20, INTS_KIND),
            )
    return node


def _constant(name: str, values: NDArray[np.float32] | NDArray[np.int64]) -> bytes:
    kind = FLOAT if values.dtype == np.float32 else INT64
    return (
        b"".join(field(1, side) for side in values.shape)
        + field(2, kind)
        + field(8, name)
        + field(9, values.tobytes())
    )


def _model(
    nodes: Sequence[bytes],
    constants: Sequence[bytes],
    inputs: Sequence[bytes],
    outputs: Sequence[bytes],
) -> bytes:
    graph = b"".join(field(1, node) for node in nodes) + field(2, "g")
    graph += b"".join(field(5, constant) for constant in constants)
    graph += b"".join(field(11, each) for each in inputs) + b"".join(
        field(12, each) for each in outputs
    )
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13))


def identity_network(shape: Sequence[int]) -> bytes:
    """A model with one input and one output of a shape."""
    return _model([_node("Identity", ["x"], "y")], [], [_value("x", shape)], [_value("y", shape)])


def bright_cells_network(file: Path, side: int, classes: int) -> Path:
    """Of the form of YOLOX: each 8 px cell is an object of its own size and of the last class, as
    sure as it is red.

    Its coarser levels find nothing.
    """
    fine, coarse, numbers = (side // 8) ** 2, (side // 16) ** 2 + (side // 32) ** 2, 5 + classes
    weights, bias = np.zeros((numbers, 3, 8, 8), np.float32), np.zeros(numbers, np.float32)
    weights[[4, -1], 2] = 1.0 / (64.0 * 255.0)
    bias[:2] = 0.5
    nodes = [
        _node("Conv", ["x", "w", "b"], "conv", kernel_shape=(8, 8), strides=(8, 8)),
        _node("Reshape", ["conv", "flat"], "cells"),
        _node("Transpose", ["cells"], "rows", perm=(0, 2, 1)),
        _node("Concat", ["rows", "rest"], "y", axis=1),
    ]
    constants = [
        _constant("w", weights),
        _constant("b", bias),
        _constant("flat", np.array([1, numbers, fine], np.int64)),
        _constant("rest", np.zeros((1, coarse, numbers), np.float32)),
    ]
    shapes = [_value("x", (1, 3, side, side))], [_value("y", (1, fine + coarse, numbers))]
    file.write_bytes(_model(nodes, constants, *shapes))
    return file


def fixed_network(
    file: Path,
    output: NDArray[np.float32],
    *,
    shape: Sequence[int | str] = (1, 3, 256, 256),
    kind: int = FLOAT,
    names: Sequence[str] = ("y",),
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """A network that answers the same to every image: ``output``, by each of its names.

    ``kind``: of input and output. ``metadata``: what stands beside the graph.
    """
    nodes = [_node("Identity" if kind == FLOAT else "Cast", ["c"], name, **({} if kind == FLOAT else {"to": kind}))
             for name in names]  # fmt: skip
    outputs = [_value(name, output.shape, kind) for name in names]
    model = _model(nodes, [_constant("c", output)], [_value("x", shape, kind)], outputs)
    for key, value in (metadata or {}).items():
        model += field(14, field(1, key) + field(2, value))
    file.write_bytes(model)
    return file


def lit_network(file: Path, boxes: NDArray[np.float32], scores: NDArray[np.float32]) -> Path:
    """A network whose scores are ``scores`` times the mean of its input: boxes (1, 4, n), scores (1,
    classes, n).
    """
    nodes = [
        _node("ReduceMean", ["x"], "light", keepdims=0),
        _node("Mul", ["s", "light"], "lit"),
        _node("Concat", ["b", "lit"], "y", axis=1),
    ]
    shape = (1, boxes.shape[1] + scores.shape[1], boxes.shape[2])
    constants = [_constant("b", boxes), _constant("s", scores)]
    image = _value("x", (1, 3, 256, 256))
    file.write_bytes(_model(nodes, constants, [image], [_value("y", shape)]))
    return file

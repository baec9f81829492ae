"""XFeat (Potje et al., CVPR 2024) through onnxruntime: the learned baseline of the paper.

The network is a file that the caller names; PATH comes without it. The graph ends at dense maps;
what the authors' own code does with them (keypoints, their suppression, scores, sampled
descriptors) is done here, the same way.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime

from drivers.detectors.onnx_model import open_session
from drivers.interfaces import PartError
from path.arrays import Singles
from path.baselines.features import Distance, Image, Keypoints

SIDE_PX = 640
CELL_PX = 8  # one cell of the maps
MAP = SIDE_PX // CELL_PX
INPUT = (1, 3, SIDE_PX, SIDE_PX)
# descriptors, keypoint logits, reliability
OUTPUTS = ((1, 64, MAP, MAP), (1, 65, MAP, MAP), (1, 1, MAP, MAP))
THRESHOLD = 0.05  # of a keypoint's probability
NMS_SIDE_PX = 5
BICUBIC = -0.75  # the free parameter of torch's bicubic sampling
REMEDY = (
    "name the authors' sparse export for 640 x 640, "
    "weights/xfeat.onnx of github.com/verlab/accelerated_features (commit c58e74f)"
)


class XFeat:
    """Implements ``path.baselines.features.Features``."""

    distance: Distance = "cosine"
    side_px: int | None = SIDE_PX

    def __init__(
        self,
        weights: Path,
        top_k: int = 4096,
        threads: int = 1,
    ) -> None:
        """Load the network.

        Args:
            top_k: at most this many keypoints in one image, the best.
            threads: of onnxruntime.

        Raises:
            PartError: the file is missing, is no network, or one of other inputs and outputs.
        """
        self._session = _session(weights, threads)
        self._input = self._session.get_inputs()[0].name
        self._top_k = top_k

    def extract(self, image: Image) -> Keypoints:
        """Features of a uint8 BGR image (h, w, 3); one larger than 640 px is made smaller, a
        smaller one gets a border.

        The border is of the image's mean, which the network subtracts anyway; nothing is found in
        it.
        """
        height, width = image.shape[:2]
        scale = min(1.0, SIDE_PX / max(height, width))
        w = max(1, round(width * scale))
        h = max(1, round(height * scale))
        fitted = image if scale == 1.0 else cv2.resize(image, (w, h), interpolation=cv2.INTER_AREA)
        tensor = np.empty(INPUT, np.float32)
        if (w, h) != (SIDE_PX, SIDE_PX):
            tensor[0] = (np.asarray(cv2.mean(fitted)[2::-1]) / 255.0)[:, None, None]
        tensor[0, :, :h, :w] = fitted[:, :, ::-1].transpose(2, 0, 1)
        tensor[0, :, :h, :w] *= 1.0 / 255.0
        outputs: list[Any] = list(self._session.run(None, {self._input: tensor}))
        descriptors, logits, reliability = (np.asarray(output, np.float32)[0] for output in outputs)
        points, scores = _keypoints(_heatmap(logits), reliability[0], w, h)
        best = np.argsort(-scores, kind="stable")[: self._top_k]
        points = points[best]
        stretch = np.array([width / w, height / h], np.float32)
        placed = (points + np.float32(0.5)) * stretch - np.float32(0.5)
        return Keypoints(placed, _sample(descriptors, points), scores[best])


def _session(weights: Path, threads: int) -> onnxruntime.InferenceSession:
    """The network, checked. Raises PartError."""
    session = open_session(weights, threads, REMEDY)
    found = (
        tuple(_shape(each) for each in session.get_inputs()),
        tuple(_shape(each) for each in session.get_outputs()),
    )
    if found != ((INPUT,), OUTPUTS):
        raise PartError(
            f"{weights}: not XFeat's network: expected {_told((INPUT,))} -> {_told(OUTPUTS)}, "
            f"found {_told(found[0])} -> {_told(found[1])}",
            REMEDY,
        )
    return session


def _shape(node: Any) -> tuple[Any, ...]:
    """Shape of an input or output; its type instead when that is not float32."""
    return tuple(node.shape) if node.type == "tensor(float)" else (node.type, *node.shape)


def _told(shapes: tuple[tuple[Any, ...], ...]) -> str:
    return ", ".join("x".join(str(side) for side in shape) for shape in shapes)


def _heatmap(logits: Singles) -> Singles:
    """Probability of a keypoint at each pixel, (640, 640), from (65, 80, 80): 64 pixels of a cell,
    and "none".
    """
    grown = np.exp(logits - logits.max(axis=0))
    share = grown[:64] / grown.sum(axis=0)
    cells = share.transpose(1, 2, 0).reshape(MAP, MAP, CELL_PX, CELL_PX)
    return np.ascontiguousarray(cells.transpose(0, 2, 1, 3).reshape(SIDE_PX, SIDE_PX))


def _keypoints(
    heatmap: Singles,
    reliability: Singles,
    width: int,
    height: int,
) -> tuple[Singles, Singles]:
    """Local maxima (n, 2) of the heatmap within ``width`` x ``height``, and their scores (n,)."""
    highest = cv2.dilate(heatmap, np.ones((NMS_SIDE_PX, NMS_SIDE_PX), np.uint8))
    peaks = (heatmap == highest) & (heatmap > THRESHOLD)
    peaks[height:] = False
    peaks[:, width:] = False
    v, u = np.nonzero(peaks)
    points = np.column_stack((u, v)).astype(np.float32)
    at = _on_map(points)
    reliable = cv2.remap(
        reliability, at[:, :1].copy(), at[:, 1:].copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
    ).ravel() if len(points) else np.zeros(0, np.float32)  # fmt: skip
    return points, (heatmap[v, u] * reliable).astype(np.float32)


def _on_map(points: Singles) -> Singles:
    """Pixels to coordinates on the maps, as the authors' sampling has them."""
    return points * np.float32(MAP / (SIDE_PX - 1.0)) - np.float32(0.5)


def _sample(descriptors: Singles, points: Singles) -> Singles:
    """Descriptors (n, 64) at pixels: normalised map (64, 80, 80), bicubic with zeros around it,
    normalised again.
    """
    norm = np.sqrt((descriptors * descriptors).sum(axis=0))
    padded = np.zeros((MAP + 4, MAP + 4, 64), np.float32)
    padded[2:-2, 2:-2] = (descriptors / np.maximum(norm, 1e-12)).transpose(1, 2, 0)
    at = _on_map(points)
    cell = np.floor(at).astype(np.int64)
    x, y = (at - cell).T
    across = _cubic(x)
    down = _cubic(y)
    sampled = np.zeros((len(points), 64), np.float32)
    for j in range(4):
        for i in range(4):
            taps = padded[cell[:, 1] + j + 1, cell[:, 0] + i + 1]
            sampled += (down[j] * across[i])[:, None] * taps
    length = np.sqrt((sampled * sampled).sum(axis=1, keepdims=True))
    return sampled / np.maximum(length, 1e-12)


def _cubic(t: Singles) -> tuple[Singles, ...]:
    """Weights of the taps at -1, 0, 1, 2 for a fraction 0..1."""
    a = np.float32(BICUBIC)

    def near(d: Singles) -> Singles:
        return ((a + 2.0) * d - (a + 3.0)) * d * d + 1.0

    def far(d: Singles) -> Singles:
        return ((a * d - 5.0 * a) * d + 8.0 * a) * d - 4.0 * a

    return far(t + 1.0), near(t), near(1.0 - t), far(2.0 - t)

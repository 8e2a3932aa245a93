"""XFeat: keypoints and descriptors by a small convolutional network, in NumPy.

Potje, Cadar, Araujo, Martins and Nascimento, "XFeat: accelerated features for lightweight image matching",
2024.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.registration.structure.learned.checkpoint import Weights

Floats = NDArray[np.float32]

# Sides of the input are multiples of this number of pixels, and of the cells that share a descriptor.
_MULTIPLE, _CELL = 32, 8
_MIN_SCORE = 0.05
# OpenCV looks up at most 32,766 positions at a time.
_MAX_CANDIDATES = 30_000
# Side of the neighbourhood in which a keypoint has the highest score.
_SUPPRESSION_SIDE = 5
_BATCH_EPSILON = 1e-5
# Blocks of the network: stride of each layer.
_BLOCKS = {
    "block1": (1, 2, 1, 2),
    "block2": (1, 1),
    "block3": (2, 1, 1),
    "block4": (2, 1, 1),
    "block5": (2, 1, 1, 1),
}


@dataclass(frozen=True, eq=False)
class LearnedKeypoints:
    """Keypoints of an image.

    Attributes
    ----------
    pixels : (n, 2) float32, column and row; pixel centres at integers.
    descriptors : (n, 64) float32 unit vectors, the highest score first.
    size : width and height of the image.
    """

    pixels: Floats
    descriptors: Floats
    size: tuple[int, int]

    def select(self, kept: NDArray[np.bool_] | slice) -> LearnedKeypoints:
        """Return the chosen keypoints."""
        return LearnedKeypoints(self.pixels[kept], self.descriptors[kept], self.size)


def detect_learned_keypoints(grey: NDArray[np.uint8], weights: Weights) -> LearnedKeypoints:
    """Detect the keypoints of a grey image (h, w); none if it has less than 32 rows or columns."""
    import cv2

    if min(grey.shape) < _MULTIPLE:
        size = (grey.shape[1], grey.shape[0])
        return LearnedKeypoints(np.zeros((0, 2), np.float32), np.zeros((0, 64), np.float32), size)
    height, width = (side // _MULTIPLE * _MULTIPLE for side in grey.shape)
    image = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
    image = (image - image.mean()) / np.sqrt(image.var() + np.float32(_BATCH_EPSILON))
    features, scores, reliability = _run_network(image, weights)
    highest = np.asarray(cv2.dilate(scores, np.ones((_SUPPRESSION_SIDE, _SUPPRESSION_SIDE), np.uint8)))
    rows, columns = np.nonzero((scores == highest) & (scores > _MIN_SCORE))
    strongest = np.argsort(-scores[rows, columns], kind="stable")[:_MAX_CANDIDATES]
    rows, columns = rows[strongest], columns[strongest]
    x, y = columns.astype(np.float32), rows.astype(np.float32)
    rows_of, columns_of = height // _CELL, width // _CELL
    # The network's reliability is defined at the corners of the map, its features at the centres of cells.
    own = cv2.remap(
        reliability,
        (x / (width - 1) * (columns_of - 1))[None],
        (y / (height - 1) * (rows_of - 1))[None],
        cv2.INTER_LINEAR,
    )[0]
    order = np.argsort(-scores[rows, columns] * own, kind="stable")
    x, y = x[order], y[order]
    across = (x / (width - 1) * columns_of - 0.5)[None], (y / (height - 1) * rows_of - 0.5)[None]
    descriptors = np.stack(
        [cv2.remap(one, *across, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)[0] for one in features],
        axis=1,
    )
    scale = np.array((grey.shape[1] / width, grey.shape[0] / height), np.float32)
    pixels = (np.stack((x, y), axis=1) + np.float32(0.5)) * scale - np.float32(0.5)
    return LearnedKeypoints(pixels, _normalize(descriptors, axis=1), (grey.shape[1], grey.shape[0]))


def _run_network(image: Floats, weights: Weights) -> tuple[Floats, Floats, Floats]:
    """Return descriptors (64, h / 8, w / 8), scores of pixels (h, w), and reliability (h / 8, w / 8)."""
    height, width = image.shape
    pooled = image.reshape(height // 4, 4, width // 4, 4).mean(axis=(1, 3))[None]
    first = _run_block(image[None], "block1", weights) + _convolve(pooled, weights, "skip1.1")
    eighth = _run_block(_run_block(first, "block2", weights), "block3", weights)
    sixteenth = _run_block(eighth, "block4", weights)
    coarse = _run_block(sixteenth, "block5", weights)
    fused = eighth + _enlarge(sixteenth, eighth.shape) + _enlarge(coarse, eighth.shape)
    fused = _run_layer(_run_layer(fused, "block_fusion.0", weights), "block_fusion.1", weights)
    features = _convolve(fused, weights, "block_fusion.2")
    heat = _run_layer(_run_layer(features, "heatmap_head.0", weights), "heatmap_head.1", weights)
    reliability = 1 / (1 + np.exp(-_convolve(heat, weights, "heatmap_head.2")[0]))
    cells = image.reshape(height // _CELL, _CELL, width // _CELL, _CELL).transpose(1, 3, 0, 2)
    points = cells.reshape(_CELL * _CELL, height // _CELL, width // _CELL)
    for layer in range(3):
        points = _run_layer(points, f"keypoint_head.{layer}", weights)
    logits = _convolve(points, weights, "keypoint_head.3")
    # The last channel is the probability that a cell has no keypoint.
    shares = np.exp(logits - logits.max(axis=0))
    shares = (shares / shares.sum(axis=0))[: _CELL * _CELL]
    scores = shares.reshape(_CELL, _CELL, height // _CELL, width // _CELL).transpose(2, 0, 3, 1)
    return _normalize(features, axis=0), np.ascontiguousarray(scores.reshape(height, width)), reliability


def _run_block(x: Floats, name: str, weights: Weights) -> Floats:
    for layer, stride in enumerate(_BLOCKS[name]):
        x = _run_layer(x, f"{name}.{layer}", weights, stride)
    return x


def _run_layer(x: Floats, name: str, weights: Weights, stride: int = 1) -> Floats:
    """Convolve, normalise by the statistics of training, and clip at zero."""
    kernel = weights[f"{name}.layer.0.weight"]
    scale = 1 / np.sqrt(weights[f"{name}.layer.1.running_var"] + np.float32(_BATCH_EPSILON))
    offset = -weights[f"{name}.layer.1.running_mean"] * scale
    found = convolve(x, kernel * scale[:, None, None, None], offset, stride)
    return np.maximum(found, 0, out=found)


def _convolve(x: Floats, weights: Weights, name: str) -> Floats:
    return convolve(x, weights[f"{name}.weight"], weights[f"{name}.bias"], 1)


def convolve(x: Floats, kernel: Floats, offset: Floats, stride: int) -> Floats:
    """Convolve (c, h, w) with a kernel (k, c, s, s) of odd side, and zeros around the image."""
    count, channels, side, _ = kernel.shape
    height, width = (-(-size // stride) for size in x.shape[1:])
    border = side // 2
    padded = np.pad(x, ((0, 0), (border, border), (border, border)))
    found = np.empty((count, height * width), np.float32)
    found[:] = offset[:, None]
    for row in range(side):
        for column in range(side):
            part = padded[:, row : row + stride * height : stride, column : column + stride * width : stride]
            found += kernel[:, :, row, column] @ part[:, :height, :width].reshape(channels, -1)
    return found.reshape(count, height, width)


def _enlarge(x: Floats, shape: tuple[int, ...]) -> Floats:
    import cv2

    return np.stack([cv2.resize(one, shape[:0:-1], interpolation=cv2.INTER_LINEAR) for one in x])


def _normalize(x: Floats, axis: int) -> Floats:
    return np.asarray(x / np.maximum(np.linalg.norm(x, axis=axis, keepdims=True), 1e-12), np.float32)

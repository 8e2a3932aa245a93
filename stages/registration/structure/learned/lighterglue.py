"""LighterGlue: matches between the keypoints of two images by a transformer, in NumPy.

Lindenberger, Sarlin and Pollefeys, "LightGlue: local feature matching at light speed", 2023, in the smaller
form that was trained for XFeat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.registration.structure.learned.checkpoint import Weights
from scanloom.stages.registration.structure.learned.xfeat import LearnedKeypoints

Floats = NDArray[np.float32]

_LAYERS = 6
_MIN_PROBABILITY = 0.1
_PREFIX = "matcher."


def match_learned_keypoints(
    first: LearnedKeypoints, second: LearnedKeypoints, weights: Weights
) -> NDArray[np.int64]:
    """Match keypoints; return indices (m, 2) in the first and second image, each at most once."""
    if not len(first.pixels) or not len(second.pixels):
        return np.zeros((0, 2), np.int64)
    positions = [_encode_positions(one, weights) for one in (first, second)]
    states = [_apply(one.descriptors, weights, "input_proj") for one in (first, second)]
    for layer in range(_LAYERS):
        name = f"transformers.{layer}.self_attn"
        states = [_attend_self(x, *turn, weights, name) for x, turn in zip(states, positions, strict=True)]
        states = _attend_cross(states[0], states[1], weights, f"transformers.{layer}.cross_attn")
    scores = _assign(states[0], states[1], weights, f"log_assignment.{_LAYERS - 1}")
    best, best_of_second = scores.argmax(axis=1), scores.argmax(axis=0)
    rows = np.arange(len(best))
    mutual = (best_of_second[best] == rows) & (scores[rows, best] > np.log(_MIN_PROBABILITY))
    return np.stack((rows[mutual], best[mutual]), axis=1)


def _encode_positions(keypoints: LearnedKeypoints, weights: Weights) -> tuple[Floats, Floats]:
    """Return the cosine and sine by which pairs of channels turn, from relative positions."""
    size = np.array(keypoints.size, np.float32)
    relative = (keypoints.pixels - size / 2) / (size.max() / 2)
    angles = relative @ weights[f"{_PREFIX}posenc.Wr.weight"].T
    return np.repeat(np.cos(angles), 2, axis=1), np.repeat(np.sin(angles), 2, axis=1)


def _attend_self(x: Floats, cosine: Floats, sine: Floats, weights: Weights, name: str) -> Floats:
    channels = x.shape[1]
    query, key, value = _apply(x, weights, f"{name}.Wqkv").reshape(len(x), channels, 3).transpose(2, 0, 1)
    query, key = (one * cosine + _turn(one) * sine for one in (query, key))
    weight = _softmax((query @ key.T) * np.float32(channels**-0.5), 1)
    return _feed_forward(x, _apply(weight @ value, weights, f"{name}.out_proj"), weights, name)


def _attend_cross(first: Floats, second: Floats, weights: Weights, name: str) -> list[Floats]:
    (key, key2), (value, value2) = (
        [_apply(x, weights, f"{name}.{kind}") for x in (first, second)] for kind in ("to_qk", "to_v")
    )
    similarity = (key @ key2.T) * np.float32(first.shape[1] ** -0.5)
    messages = _softmax(similarity, 1) @ value2, _softmax(similarity, 0).T @ value
    return [
        _feed_forward(x, _apply(message, weights, f"{name}.to_out"), weights, name)
        for x, message in zip((first, second), messages, strict=True)
    ]


def _assign(first: Floats, second: Floats, weights: Weights, name: str) -> Floats:
    """Return the logarithm of the probability of each match."""
    scale = np.float32(first.shape[1] ** 0.25)
    one, other = (_apply(x, weights, f"{name}.final_proj") / scale for x in (first, second))
    matchable = [
        -np.logaddexp(np.float32(0), -_apply(x, weights, f"{name}.matchability")) for x in (first, second)
    ]
    similarity = one @ other.T
    return np.asarray(
        _log_softmax(similarity, 1) + _log_softmax(similarity, 0) + matchable[0] + matchable[1].T, np.float32
    )


def _feed_forward(x: Floats, message: Floats, weights: Weights, name: str) -> Floats:
    """Add what a perceptron with layer normalisation and GELU makes of the state and a message."""
    from scipy.special import erf

    z = _apply(np.concatenate((x, message), axis=1), weights, f"{name}.ffn.0")
    z = (z - z.mean(axis=1, keepdims=True)) / np.sqrt(z.var(axis=1, keepdims=True) + np.float32(1e-5))
    z = z * weights[f"{_PREFIX}{name}.ffn.1.weight"] + weights[f"{_PREFIX}{name}.ffn.1.bias"]
    z = np.asarray(z * (np.float32(0.5) + np.float32(0.5) * erf(z * np.float32(0.5**0.5))), np.float32)
    return np.asarray(x + _apply(z, weights, f"{name}.ffn.3"), np.float32)


def _apply(x: Floats, weights: Weights, name: str) -> Floats:
    return np.asarray(x @ weights[f"{_PREFIX}{name}.weight"].T + weights[f"{_PREFIX}{name}.bias"], np.float32)


def _turn(x: Floats) -> Floats:
    """Turn pairs of channels by 90°."""
    turned = np.empty_like(x)
    turned[:, 0::2], turned[:, 1::2] = -x[:, 1::2], x[:, 0::2]
    return turned


def _softmax(x: Floats, axis: int) -> Floats:
    shares = x - x.max(axis=axis, keepdims=True)
    np.exp(shares, out=shares)
    shares /= shares.sum(axis=axis, keepdims=True)
    return np.asarray(shares)


def _log_softmax(x: Floats, axis: int) -> Floats:
    shifted = x - x.max(axis=axis, keepdims=True)
    return np.asarray(shifted - np.log(np.exp(shifted).sum(axis=axis, keepdims=True)), np.float32)

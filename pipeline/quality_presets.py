"""Quality presets: initial parameter values of a run, chosen by name.

Each preset lists only the values it changes, so that other stages keep their cached results. docs/quality.md
compares the presets.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

STANDARD = "standard"

QUALITIES: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    # A draft still adjusts poses and colour camera, because the texture would be misaligned otherwise.
    "draft": {
        "scan": {"max_frames": 50},
        "fuse": {"voxel_factor": 2.0},
        "simplify": {"noise_factor": 3.0},
        "texture": {"texels_per_pixel": 0.6, "alignment_iterations": 0},
        "compare": {"samples": 20_000},
        "report": {"pictures": False},
    },
    STANDARD: {},
    # More texels per pixel look sharper but do not improve the error on held-out photos.
    "best": {
        "depth": {"matcher": "hh4", "sgbm": {"left_right": "match"}},
        "fuse": {"voxel_factor": 0.7},
        "simplify": {"noise_factor": 1.0},
        "texture": {"max_texels": 256.0},
    },
}

"""Presets: what the parameters of a run begin with, by one word for how good the result shall be.

Each names only what it changes, so that stages it leaves alone keep their cached results. None says how far
to simplify: that decides what is proven, and is asked for by itself. docs/quality.md has what each comes to.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

STANDARD = "standard"

QUALITIES: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    # Poses and colour camera are adjusted in a draft, too: without, its texture is not in its place.
    "draft": {
        "scan": {"max_frames": 50},
        "fuse": {"voxel_factor": 2.0},
        "texture": {"texels_per_pixel": 0.6, "rounds": 0},
        "compare": {"samples": 20_000},
        "report": {"pictures": False},
    },
    STANDARD: {},
    # More texels a pixel look sharper, and are no nearer to photos that were left out.
    "best": {
        "depth": {"matcher": "hh4", "sgbm": {"left_right": "match"}},
        "fuse": {"voxel_factor": 0.7},
        "texture": {"max_texels": 256.0},
    },
}

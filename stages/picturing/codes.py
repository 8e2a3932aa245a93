"""Diagnostic codes of rendering, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

RENDER_NOTHING_TO_DRAW = Code(
    "render.nothing-to-draw",
    "Nothing to draw",
    """
The mesh has no triangles. `render` takes the meshes first and the picture last.
""",
    "the mesh has no triangles; there is nothing to draw.",
)
RENDER_ENCODER_MISSING = Code(
    "render.encoder-missing",
    "Encoders of videos that are missing",
    """
Not every build of OpenCV has every encoder: `--codec mpeg4` is in nearly all, and pictures always work.
""",
    "turn.mp4: OpenCV has no encoder for vp9 here; write pictures (.png).",
)

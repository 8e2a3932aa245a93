"""Diagnostic codes of rendering, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

RENDER_NOTHING_TO_DRAW = Code(
    "render.nothing-to-draw",
    "Nothing to draw",
    """
The mesh has no triangles. `render` expects the meshes first and the image last.
""",
    "the mesh has no triangles; there is nothing to draw.",
)
RENDER_ENCODER_MISSING = Code(
    "render.encoder-missing",
    "Missing video encoder",
    """
Builds of OpenCV differ in their video encoders. Almost all have `turntable.codec=mpeg4`, and images always
work.
""",
    "turn.mp4: this build of OpenCV has no encoder for vp9; choose another codec, or write images (.png).",
)

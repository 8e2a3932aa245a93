"""Diagnostic codes of refinement, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

REFINE_DATA_LEFT_OUT = Code(
    "refine.data-left-out",
    "Data that refinement leaves out",
    """
Refinement changes the triangles and returns positions, triangles and vertex colours. Texture, normals and
parts of the input are left out. Refine before `texture`, which follows in `scanloom run`.
""",
    "texture of the mesh is left out; refine the mesh before it gets a texture.",
)

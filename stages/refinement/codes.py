"""Diagnostic codes of refinement, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

REFINE_NOT_POSSIBLE = Code(
    "refine.not-possible",
    "Mesh that is not refined",
    """
A warning; the mesh stays as `clean` left it. Refinement needs the noise of the depth maps,
which is measured where neighbouring frames overlap: a single frame, or frames without overlap, do not show
it. A mesh that is processed in chunks is not refined either: increase `fuse.voxel_size`, or fuse a part of
the scan (`fuse.box`).
""",
    "the mesh is not refined: neighbouring frames do not overlap enough to measure the noise of their depth.",
)
REFINE_DATA_LEFT_OUT = Code(
    "refine.data-left-out",
    "Data that refinement leaves out",
    """
Refinement changes the triangles and returns positions, triangles and vertex colours. Texture, normals and
parts of the input are left out. Refine before `texture`, which follows in `scanloom run`.
""",
    "texture of the mesh is left out; refine the mesh before it gets a texture.",
)

"""Diagnostic codes of normal meshes, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

LEVELS_NORMAL_MESH_INEXACT = Code(
    "levels.normal-mesh-inexact",
    "Normal mesh less accurate than requested",
    """
Exit code 1; the file is written. More levels or more base triangles reduce the distance to the input.
""",
    (
        "the finest level is up to 0.0123 m from the input, more than max_error (0.005 m); increase levels "
        "or base_triangles."
    ),
)
LEVELS_BASE_LARGE = Code(
    "levels.base-large",
    "Base mesh larger than requested",
    """
A warning. Connected components, holes and handles of the input are preserved, and each needs base
triangles. Clean the input first.
""",
    (
        "the base mesh has 614 triangles, not 200: connected components, holes and handles are preserved, or "
        "the mesh cannot be refined well from fewer. The finest level has 157,184 triangles; lower levels to "
        "reduce that."
    ),
)
LEVELS_FOLDED = Code(
    "levels.folded",
    "Triangles flipped relative to the surface",
    """
A warning. Refinement can fold the mesh where the surface is rough relative to the size of a triangle. A
finer base (`base_triangles`, `base_error`) avoids most folds.
""",
    ("31 triangles in all levels (12 in the finest) are flipped relative to the surface or have no area."),
)
LEVELS_VERTICES_SPLIT = Code(
    "levels.vertices-split",
    "Pinched vertices that are split",
    """
A warning. If several fans of triangles share only a vertex, each fan gets a copy of it, because a normal
mesh is a manifold. `scanloom clean` splits such vertices as well.
""",
    ("1 pinched vertex was split: each fan of triangles around it has its own copy."),
)
LEVELS_TOO_FINE = Code(
    "levels.too-fine",
    "Edges too short for the size of the mesh",
    """
The file stores 32-bit floats. A stray vertex far away enlarges the bounding box so much that all edges are
below their precision. Remove that vertex. Coordinates are 64-bit floats: a mesh of millimetres that is a
million kilometres away from the origin has too few digits left.
""",
    (
        "mesh: most edges are shorter than 5e-05 m, the precision of the format for a mesh of this size; "
        "remove vertices far from the rest: vertex 8012 is 1e+03 m away."
    ),
)
LEVELS_LEVEL_MISSING = Code(
    "levels.level-missing",
    "Levels missing in a file",
    """
A truncated file is a coarser mesh: the levels before the damage are returned with a warning. A request for
a finer level is an error.
""",
    "clean.snm: has no level 4; only levels 0 to 2 are intact: the file ends there.",
)

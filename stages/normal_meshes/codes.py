"""Diagnostic codes of normal meshes, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

LEVELS_NORMAL_MESH_INEXACT = Code(
    "levels.normal-mesh-inexact",
    "A normal mesh that is farther off than asked",
    """
Exit code 1: the file is written. More levels or more base triangles come nearer.
""",
    (
        "the finest level is up to 0.0123 m from the input, more than max_error (0.005 m); give more levels "
        "or a finer base."
    ),
)
LEVELS_BASE_LARGE = Code(
    "levels.base-large",
    "A base mesh that is larger than asked",
    """
A warning. Components, holes and handles of the input keep the base large: clean it first.
""",
    (
        "the base mesh has 614 triangles, not 200: what is left stands for pieces, holes and handles, which "
        "all stay, or could not be refined well with fewer. The finest level has 157,184; fewer levels have "
        "fewer."
    ),
)
LEVELS_FOLDED = Code(
    "levels.folded",
    "Triangles that are turned against the surface",
    """
A warning. Where the surface is rough beside the size of a triangle, refinement may fold it. A finer base
(`base_triangles`, `base_error`) avoids most folds.
""",
    ("31 triangles of all levels, 12 of the finest, are turned against the surface or have no area."),
)
LEVELS_VERTICES_SPLIT = Code(
    "levels.vertices-split",
    "Vertices that are split",
    """
A warning. Fans of triangles that touch at one vertex get a vertex each, because a normal mesh is a
manifold. `scanloom clean` splits them, too.
""",
    ("1 pinched vertex was split, so that each fan of triangles that touched there has its own."),
)
LEVELS_TOO_FINE = Code(
    "levels.too-fine",
    "Edges that are too short beside the size of the mesh",
    """
The file has 32-bit floats. One stray vertex far away makes the box of the mesh so large that all edges
are below their precision: remove it.
""",
    (
        "mesh: most edges are shorter than 5e-05 m, which is all that can be told apart in a mesh of this "
        "size; remove what lies far from the rest: vertex 8012 is 1e+03 m away."
    ),
)
LEVELS_LEVEL_MISSING = Code(
    "levels.level-missing",
    "Levels that a file does not have",
    """
A file that ends early is a coarser mesh: levels before the damage are given out, with a warning, and a
finer one is an error.
""",
    "clean.snm: has no level 4, only levels 0 to 2 are whole: it was cut there.",
)

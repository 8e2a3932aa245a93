"""Codes of the diagnostics of normal meshes, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

LEVELS_NORMAL_MESH_INEXACT = Code(
    "levels.normal-mesh-inexact",
    "A normal mesh that is farther off, or larger, than asked",
    """
Exit code 1 for `max_error`; warnings else. More levels or more base triangles come nearer; pieces, holes
and handles of
the input keep the base large: clean it first.
""",
    (
        "most edges are shorter than … m, which is all that can be told apart in a "
        "mesh of this size; remove what lies far from the rest: vertex … is … m away."
    ),
)
LEVELS_LEVEL_MISSING = Code(
    "levels.level-missing",
    "Levels that a file does not have",
    """
A file that ends early is a coarser mesh: levels before the damage are given out, with a warning, and a
finer one is an
error.
""",
    "level is …; it must be at least 0.",
)

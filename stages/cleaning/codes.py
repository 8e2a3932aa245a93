"""Diagnostic codes of cleaning and checks, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

CLEAN_NOTHING_LEFT = Code(
    "clean.nothing-left",
    "Nothing left after cleaning",
    """
The mesh has triangles without area only. If a whole scan vanishes, `clean.min_island_area` is larger than
all its components.
""",
    "mesh: has no triangle with an area; nothing is left of it.",
)
CLEAN_CHECK_FAILED = Code(
    "clean.check-failed",
    "Requirements of `check` that a mesh does not meet",
    """
Exit code 1 if it was asked for by `--require`. Each sentence names the first place by a point;
[checking](../checking.md) explains each class. `scanloom clean` makes any mesh an oriented manifold,
`--fill-holes` closes borders, `--repair` repairs places where that does no harm.
""",
    "chair.ply: it has edges of one triangle: 96, the first at (0.12, -0.4, 1.01) m.",
)
CLEAN_NOT_REPAIRED = Code(
    "clean.not-repaired",
    "Places that repairs leave alone",
    """
Warnings: irregular places that are left, with the reason. `max_shape` of repairs bounds how far the
surface may move.
""",
    (
        "3 of 41 caps left: 3 where the distance is not proven to be within max_shape; the first at (0.12, "
        "-0.4, 1.01) m."
    ),
)

"""Diagnostic codes of cleaning and checks, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

CLEAN_NOTHING_LEFT = Code(
    "clean.nothing-left",
    "Nothing left after cleaning",
    """
The mesh contains only degenerate triangles and small islands. If a whole scan vanishes,
`clean.min_island_area` is larger than all its components. Give a smaller area.
""",
    "mesh: has only degenerate triangles and small islands, so nothing is left of it.",
)
CLEAN_CHECK_FAILED = Code(
    "clean.check-failed",
    "Unmet requirements of `check`",
    """
Exit code 1 for requirements given with `--require`. Each message contains the position of the first defect;
[checking](../checking.md) explains each class. `scanloom clean` makes any mesh an oriented manifold,
`--fill-holes` closes borders, and `--repair` repairs defects where this creates no others.
""",
    "chair.ply: it has edges with only one triangle: 96, the first at (0.12, -0.4, 1.01) m.",
)
CLEAN_NOT_REPAIRED = Code(
    "clean.not-repaired",
    "Defects that are not repaired",
    """
Warnings about defects that remain, with the reasons. `max_shape` limits how far repairs may move the surface;
a larger value allows more repairs.
""",
    (
        "3 of 41 caps not repaired: 3 where the distance is not proven to be within max_shape; the first at "
        "(0.12, -0.4, 1.01) m."
    ),
)
CLEAN_NOT_SOLID = Code(
    "clean.not-solid",
    "Surfaces that cannot become solid",
    """
`clean.solid` closes the surface of an object. A wall, a room or a single view encloses no volume, or is seen
from inside. Set `clean.wall` to make a wall of this thickness behind such a surface. If most of the mesh
encloses a volume, the message also states the area up to which `clean.min_island_area` must remove islands.
""",
    (
        "mesh: open sheets, which enclose no volume, are 100.0% of the surface, one at (0.12, -0.4, 1.01) m; "
        "set clean.wall to the thickness in metres of the wall behind them."
    ),
)
CLEAN_SOLID_INCOMPLETE = Code(
    "clean.solid-incomplete",
    "Solids that still intersect themselves",
    """
`clean.solid` refills or rebuilds surface that intersects itself. The message contains the location of a
triangle that still intersects or touches others after that, or the part of the surface that is missing.
""",
    (
        "the solid still intersects or touches itself at 2 triangles, the first at (0.12, -0.4, 1.01) m; set "
        "clean.max_shape to another distance."
    ),
)
CLEAN_SOLID_THIN = Code(
    "clean.solid-thin",
    "Solids with walls that stay thin",
    """
`clean.min_thickness` adds material around thin walls in rounds. The message states how many triangles still
have less of the solid behind them: single triangles after the last round, or all thin walls if they are too
large to be thickened at this scale (more than about 25,000 times the squared thickness). For a sheet, such
as a room, `clean.wall` sets the thickness directly; make it a tenth larger than `clean.min_thickness`.
""",
    (
        "the solid is thinner than 0.0004 m behind 12,406 triangles; the minimum is 0.00012 m; set "
        "clean.wall to a larger thickness if the object is a sheet, or clean.min_thickness to another one."
    ),
)

"""Codes of the diagnostics of cleaning and checks, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

CLEAN_NOTHING_LEFT = Code(
    "clean.nothing-left",
    "Nothing left after cleaning",
    """
The mesh has triangles without area only. If a whole scan vanishes, `clean.min_island_area` is larger than
all its
pieces.
""",
    "has no triangle with an area; nothing is left of it.",
)
CLEAN_CHECK_FAILED = Code(
    "clean.check-failed",
    "What `check` finds",
    """
Exit code 1 if it was asked for by `--require`. Each place is told with a point;
[checking](../checking.md) says what
each class means. `scanloom clean` makes any mesh an oriented manifold, `--fill-holes` closes borders,
`--repair` puts
right what can be put right without harm.
""",
    "it has no surface.",
)
CLEAN_NOT_REPAIRED = Code(
    "clean.not-repaired",
    "What repairs leave alone",
    """
Warnings: what is irregular and was left, with the reason. `max_shape` of repairs bounds how far the
surface may move.
""",
    "…: …; the first at (…, …, …) m.",
)

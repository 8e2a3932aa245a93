"""Diagnostic codes of pipeline stages, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

LEVELS_NOISE_UNKNOWN = Code(
    "levels.noise-unknown",
    "How exact the depth is cannot be told",
    """
A warning: no two frames show the same, or there are none. `lod.base_error` states it.
""",
    (
        "the noise of the frames' depth cannot be estimated; the finest level is the clean mesh "
        "itself; lod.base_error gives another."
    ),
)
LEVELS_MESH_LARGE = Code(
    "levels.mesh-large",
    "Levels of a large mesh",
    """
Warnings: the clean mesh has more than 5 million triangles. What is proven of levels and tiles is from the
clean mesh in the first case, from
the simplified one in the second; how far that is off as measured stands in report.json, under `mesh`,
`to_clean`.
""",
    (
        "the clean mesh is too large for levels of its own: they begin with the simplified mesh, "
        "proven to be within 0.002 m of it, which is part of the bound of each level."
    ),
)
USAGE_STAGE_SKIPPED = Code(
    "usage.stage-skipped",
    "A stage that this scan does not go through",
    """
`--until` and `--force` name a stage that the scan has no use for, or that is switched off. The sentence
says why, and
with which parameter it would run. [The stages](../stages.md) say when each is there.
""",
    "is not a stage of this scan: it is RGB-D, its depth is measured already",
)

"""Diagnostic codes of pipeline stages, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

LEVELS_NOISE_UNKNOWN = Code(
    "levels.noise-unknown",
    "Unknown depth noise",
    """
A warning: the noise is estimated from overlapping frames, but no frames overlap. Set `lod.base_error`
explicitly.
""",
    (
        "the depth noise cannot be estimated, so the finest level is the unsimplified clean mesh; set "
        "lod.base_error to simplify it."
    ),
)
LEVELS_MESH_LARGE = Code(
    "levels.mesh-large",
    "Levels of detail of a large mesh",
    """
Warnings: the clean mesh has more than 5 million triangles, so levels of detail are built from the
simplified mesh. With a proven simplification, the bounds of levels and tiles are relative to the clean
mesh, else to the simplified mesh. report.json has the measured distance between the two under `mesh`,
`to_refined`.
""",
    (
        "the clean mesh is too large: levels are built from the simplified mesh, which is proven to be "
        "within 0.002 m of the clean mesh. The bound of each level includes this distance."
    ),
)
USAGE_STAGE_SKIPPED = Code(
    "usage.stage-skipped",
    "Stage that does not apply to the scan",
    """
`--until` or `run.force` names a stage that does not apply to the scan, or is switched off. The message
gives the reason, and the parameter that enables the stage. [The stages](../stages.md) lists when each
stage runs.
""",
    "depth does not apply to this scan: it is RGB-D and has measured depth.",
)

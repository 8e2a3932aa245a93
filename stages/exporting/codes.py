"""Diagnostic codes of mesh export, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

EXPORT_LEFT_OUT = Code(
    "export.left-out",
    "Parts of a mesh that a format does not hold",
    """
A warning. STL and OFF store geometry only, without colours, parts and corner normals. USD is written as one
mesh, without parts.
""",
    ".stl stores geometry only: the colours are left out; write .ply or .glb",
)
EXPORT_UP_UNKNOWN = Code(
    "export.up-unknown",
    "Unknown up direction",
    """
A warning. `export.axes` rotates a mesh by its up direction, but neither its file nor `--up` states one. The
mesh is written without rotation. State the direction, for example with `--up +z`.
""",
    "the up direction is unknown: the mesh is written as if it were y-up already; set `up`",
)
EXPORT_IMAGE_AS_PNG = Code(
    "export.image-as-png",
    "Images written as PNG",
    """
The image is stored without loss, but the file is larger. JPEG does not support transparency, and viewers of
USD read only PNG and JPEG.
""",
    "the image glass.png is transparent: it is stored as PNG, because JPEG has no transparency",
)
EXPORT_USD_FAILED = Code(
    "export.usd-failed",
    "USD package that cannot be created",
    """
The library `usd-core` could not create the `.usdz` package. Write `.usda` instead, and report the mesh as a
bug.
""",
    "chair.usdz: usd-core could not create the package; write .usda.",
)
EXPORT_NOT_SOLID = Code(
    "export.not-solid",
    "Meshes that cannot be prepared for printing",
    """
`export.hollow`, `export.plate` and `export.bed` need a closed surface without self-intersections. Run
`scanloom clean IN OUT --solid` first.
""",
    (
        "chair.ply: it is not solid: it has edges with only one triangle: 96, the first at "
        "(0.12, -0.4, 1.01) m; run `scanloom clean --solid` first."
    ),
)

"""Codes of the diagnostics of exports, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

EXPORT_LEFT_OUT = Code(
    "export.left-out",
    "Parts of a mesh that a format does not hold",
    """
Warnings. STL and OFF hold the shape alone, without colours, parts and normals of corners; USD holds one
mesh.
""",
    ".stl holds the shape alone: the colours are left out; write .ply or .glb",
)
EXPORT_UP_UNKNOWN = Code(
    "export.up-unknown",
    "An up direction that is not known",
    """
A warning. `export.axes` turns a mesh by its up direction, which neither its file nor `--up` states. The mesh
is written as it is. `--up +z` states it.
""",
    "nothing tells what is up: the axes are taken to be y-up already; `up` says it",
)
EXPORT_IMAGE_AS_PNG = Code(
    "export.image-as-png",
    "Images that are written as PNG",
    """
Nothing is lost, but the file is larger. JPEG has no transparency, and USD shows PNG and JPEG alone.
""",
    "the image glass.png is transparent: it is kept as PNG",
)
EXPORT_USD_FAILED = Code(
    "export.usd-failed",
    "A USD package that cannot be made",
    """
The library that packs `.usdz` refused. Write `.usda`, and report the mesh.
""",
    "chair.usdz: usd-core could not make the package.",
)

"""Codes of the diagnostics of exports, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

EXPORT_LEFT_OUT = Code(
    "export.left-out",
    "What an export leaves out, or takes otherwise",
    """
Warnings. STL and OFF hold shape alone, without colours, parts and normals of corners; USD shows PNG and
JPEG and one mesh.
`--up` says what is up where nothing tells.
""",
    "… holds the shape alone: the … are left out; write .ply or .glb",
)

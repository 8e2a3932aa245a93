"""Diagnostic codes of the comparison stages."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

COMPARE_MESHES_APART = Code(
    "compare.meshes-apart",
    "Meshes that lie apart",
    """
Exit code 1. They are in different worlds or units: millimetres against metres, or a mesh that was centred
by another program. `--align icp` moves one onto the other if it lies roughly there; it never scales.
""",
    (
        "scan.ply: lies 812 m from truth.ply, which is more than their size; give meshes of one thing, in "
        "the same world and unit."
    ),
)
TEXTURE_PHOTOS_MISMATCH = Code(
    "texture.photos-mismatch",
    "Photos that do not fit the mesh",
    """
The mesh and the photos are not of one world: poses of another scan, a mesh that was moved or scaled
since, or a calibration of another size. A mesh for `scanloom texture` has to stand where the scan stands;
`scanloom compare FUSED MESH` shows by how much it is off.
""",
    "none of the 120 photos shows the mesh: do poses and mesh belong together?",
)

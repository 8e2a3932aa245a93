"""Diagnostic codes of the comparison stages."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

COMPARE_MESHES_APART = Code(
    "compare.meshes-apart",
    "Meshes too far apart",
    """
Exit code 1. The meshes are in different coordinate systems or units: millimetres and metres, or a mesh that
another program centred. `--align icp` aligns them if they overlap roughly; it never changes the scale.
""",
    (
        "scan.ply: is 812 m from truth.ply, which is more than their size; give meshes of the same object, "
        "in the same coordinates and unit."
    ),
)
TEXTURE_PHOTOS_MISMATCH = Code(
    "texture.photos-mismatch",
    "Photos that do not show the mesh",
    """
Mesh and photos are in different coordinate systems: the poses are from another scan, the mesh was moved or
scaled, or the calibration is for another image size. `scanloom texture` requires a mesh in the world
coordinates of the scan; `scanloom compare FUSED MESH` shows its deviation.
""",
    "none of the 120 photos shows the mesh: do poses and mesh belong together?",
)

"""Codes of the diagnostics of meshes and their files, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

FUSE_TOO_LARGE = Code(
    "fuse.too-large",
    "A mesh too large for one piece",
    """
More than 5 million triangles are cleaned, simplified, measured and drawn piece by piece, and what is
missing is told of them so, so
that a run goes to its end. `lod` begins with the simplified mesh, and says [how far that
is](levels.md#levels-of-a-large-mesh) from
the clean one; the page shows the result without the clean mesh and the colours of what is missing. Only
`bake` reads all of it: in
place of it, `texture` paints the simplified mesh from the photos. The table of pieces,
`fused.pieces.json` or `clean.pieces.json`,
stands beside the mesh in the cache, and goes with that one file alone.
""",
    (
        "… reads all of … at once, which has … triangles; it takes up to …. Give a "
        "larger fuse.voxel_size, or fuse a part (fuse.box)."
    ),
)
COMPARE_POINT_CLOUD = Code(
    "compare.point-cloud",
    "Clouds of points",
    """
`compare` takes clouds as PLY, LAS, LAZ and E57, the latter three with `pip install "scanloom[clouds]"`.
Files that are cut
short or damaged are refused; get a whole copy. What a scanner marked as invalid or withheld does not
count, and colours that
are black throughout are none. Changes and views need surfaces; a cloud has distances alone.
""",
    "… needs two surfaces, and … is a cloud of points; leave it out.",
)
MESH_COMPANION_MISSING = Code(
    "mesh.companion-missing",
    "A companion that is missing",
    """
glTF names its `.bin` and images, OBJ its `.mtl`, and that its images: copy them too, with their names and
folders.
Without an image the mesh is read with a warning, without its texture.
""",
    "refers to the file …, which is missing.",
)
MESH_COMPRESSION_UNKNOWN = Code(
    "mesh.compression-unknown",
    "Compressed in a way that is not read",
    """
Draco is not read; files packed by meshoptimizer are. In Blender, switch *Compression* off on export.
""",
    "is compressed; write it again without compression.",
)
MESH_COORDINATES_TOO_LARGE = Code(
    "mesh.coordinates-too-large",
    "Coordinates that are too large",
    """
So far out that areas and volumes are beyond floating point, or positions beyond single precision. Mostly
one stray
vertex: take it out, or move the mesh to the origin.
""",
    (
        "vertex … is at (…), beyond ±… m (… such): its coordinates are too large; "
        "take it out, or scale the mesh."
    ),
)
MESH_FILE_DAMAGED = Code(
    "mesh.file-damaged",
    "Damaged, cut short, or of another kind",
    """
The same check stands before every file that is written: a mesh whose positions, normals or texture
coordinates are
not finite is refused, and no file is left. Nothing is reserved for what a file only promises. Get a whole
copy of it. If another program opens it, it may repair in
silence what is named here: write it from there again.
""",
    "places more than … corners and vertices; it is damaged.",
)
MESH_NO_SURFACE = Code(
    "mesh.no-surface",
    "No surface, or none that a stage can work on",
    """
A point cloud, a file of lines, or triangles without area; or a surface that is no manifold, for a stage
that needs one.
`scanloom clean` makes an oriented manifold of whatever has surface.
""",
    "has … … (……); clean it first.",
)
MESH_LEFT_OUT = Code(
    "mesh.left-out",
    "What a mesh does not hold",
    """
Warnings: parts of a file that scanloom has no place for. The rest is read.
""",
    "… is left out: it is no rotation",
)
USAGE_EXTENSION_UNKNOWN = Code(
    "usage.extension-unknown",
    "An extension that stands for no format",
    """
The extension of the output decides the format. The sentence names what this command writes; `scanloom
export` writes
the most. USD needs an extra: `pip install "scanloom[usd]"`. STL and OFF hold the shape alone, and are
refused where
colours are the result.
""",
    "…: the extension … stands for no format; use ….",
)

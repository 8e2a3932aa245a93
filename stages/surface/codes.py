"""Codes of the diagnostics of meshes and their files, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

FUSE_TOO_LARGE = Code(
    "fuse.too-large",
    "A mesh too large for one piece",
    """
More than 5 million triangles are cleaned, simplified, measured and drawn piece by piece, and gaps are
reported of them so, so that a run goes to its end. `lod` begins with the simplified mesh, and says [how
far that is](levels.md#levels-of-a-large-mesh) from the clean one; the page shows the result without the
clean mesh and the colours of gaps. Only `bake` reads all of it: in place of it, `texture` paints the
simplified mesh from the photos. The table of pieces, `fused.pieces.json` or `clean.pieces.json`, stands
beside the mesh in the cache, and goes with that one file alone.
""",
    (
        "bake reads all of clean.ply at once, which has 7,412,306 triangles; it takes up to 5,000,000. "
        "Give a larger fuse.voxel_size, or fuse a part (fuse.box)."
    ),
)
MESH_CLOUD_DAMAGED = Code(
    "mesh.cloud-damaged",
    "Clouds of points that are damaged or hold no points",
    """
LAS, LAZ and E57 files that are cut short, damaged or empty are refused; get a whole copy. Clouds of more
than 100 million points are refused, too: thin them out first.
""",
    "hall.laz: promises 12,000,000 points, more than it holds; it is damaged or cut short.",
)
MACHINE_EXTRA_MISSING = Code(
    "machine.extra-missing",
    "An optional library that is not installed",
    """
Some formats and plots need libraries that are an extra: `pip install "scanloom[clouds]"` for LAS, LAZ and
E57, `"scanloom[usd]"` for USD, `"scanloom[plot]"` for plots.
""",
    "hall.laz: .laz is read by laspy and lazrs; install scanloom[clouds].",
)
COMPARE_POINT_CLOUD = Code(
    "compare.point-cloud",
    "Clouds of points where surfaces are needed",
    """
`compare` takes clouds as PLY, LAS, LAZ and E57, the latter three with `pip install "scanloom[clouds]"`.
Points that a scanner marked as invalid or withheld do not count, and colours that are black throughout
are none. Changes and views need surfaces; a cloud has distances alone.
""",
    "--change needs two surfaces, and hall.laz is a cloud of points; leave it out.",
)
MESH_COMPANION_MISSING = Code(
    "mesh.companion-missing",
    "A companion that is missing",
    """
glTF names its `.bin` and images, OBJ its `.mtl`, and that its images: copy them too, with their names and
folders. Without an image the mesh is read with a warning, without its texture.
""",
    "chair.gltf: refers to the file chair.bin, which is missing.",
)
MESH_TEXTURE_DAMAGED = Code(
    "mesh.texture-damaged",
    "Images or texture coordinates that are damaged",
    """
The mesh is read with a warning, and is grey where its image cannot be decoded or its texture coordinates
are missing. Write the image again as PNG or JPEG, or export the mesh anew.
""",
    "chair.obj: the texture image chair.png is of no known kind or damaged",
)
MESH_COMPRESSION_UNKNOWN = Code(
    "mesh.compression-unknown",
    "Compressed in a way that is not read",
    """
Draco is not read; files packed by meshoptimizer are. In Blender, switch *Compression* off on export.
""",
    "chair.glb: is compressed; write it again without compression.",
)
MESH_COORDINATES_TOO_LARGE = Code(
    "mesh.coordinates-too-large",
    "Coordinates that are too large",
    """
So far out that areas and volumes are beyond floating point, or positions beyond single precision. Mostly
one stray vertex: take it out, or move the mesh to the origin.
""",
    (
        "chair.ply: vertex 8012 is at (1e+200, 0, 0), beyond ±1e+100 m (1 such): its coordinates are too "
        "large; take it out, or scale the mesh."
    ),
)
MESH_NOT_FINITE = Code(
    "mesh.not-finite",
    "Values that are not finite",
    """
Positions, normals or texture coordinates are infinite or no number. The same check stands before every
file that is written: such a mesh is refused, and no file is left. Remove or repair the vertex or triangle
that is named.
""",
    (
        "chair.obj: vertex 8012 is [nan, 0.0, 1.0], not finite (1 such); remove or repair these before "
        "processing."
    ),
)
MESH_INDEX_OUT_OF_RANGE = Code(
    "mesh.index-out-of-range",
    "Triangles that use vertices that do not exist",
    """
The file is damaged or cut short, or arrays do not belong together. Get a whole copy of the file.
""",
    (
        "chair.ply: triangle 12 uses vertices [4, 5, 99999], but there are only 8012 (3 such triangles); the "
        "file is damaged or cut short."
    ),
)
MESH_FILE_TOO_LARGE = Code(
    "mesh.file-too-large",
    "A mesh that is too large for its format",
    """
A GLB file holds 4 GiB at most. Write PLY, or simplify the mesh first.
""",
    "city.glb: would take 5,120,331,008 bytes, more than a GLB file can hold; write PLY.",
)
MESH_FILE_DAMAGED = Code(
    "mesh.file-damaged",
    "Damaged, cut short, or of another kind",
    """
Nothing is reserved for sizes that a file only promises. Get a whole copy of it. If another program opens
it, that program may repair it in silence: write it from there again.
""",
    "chair.glb: places more than 536,870,912 corners and vertices; it is damaged.",
)
MESH_POINTS_OUTSIDE = Code(
    "mesh.points-outside",
    "Points outside of the box that their file states",
    """
A warning. Packed points have no check sum: points that lie far from all others are a sign of damage. Get
a whole copy.
""",
    "hall.laz: 312 points are not where its header says that all are: it may be damaged",
)
MESH_UNIT_NOT_METRES = Code(
    "mesh.unit-not-metres",
    "Coordinates in another unit than metres",
    """
A warning. The coordinates are used as they are: parameters that are lengths, and all lengths that are
printed, are in the unit of the file. Convert the cloud to metres first.
""",
    "hall.las: its coordinates are in feet, and are taken as metres: all lengths are in that unit",
)
MESH_NO_SURFACE = Code(
    "mesh.no-surface",
    "No surface, or none that a stage can work on",
    """
A point cloud, a file of lines, or triangles without area; or a surface that is no manifold, for a stage
that needs one. `scanloom clean` makes an oriented manifold of whatever has surface.
""",
    "points.ply: holds 81,204 vertices but no triangles; a mesh is expected.",
)
MESH_LEFT_OUT = Code(
    "mesh.left-out",
    "Parts of a file that a mesh does not hold",
    """
Warnings: parts of a file that scanloom has no place for. The rest is read.
""",
    "chair.glb: animations are left out",
)
MESH_CONFIDENCE_LEFT_OUT = Code(
    "mesh.confidence-left-out",
    "The confidence of vertices that is left out",
    """
A warning. `mesh remesh` carries the confidence of the vertices of a PLY file; other commands leave it out.
""",
    "chair.ply: the confidence of its vertices is left out: remesh carries it",
)
MESH_VALUES_REPLACED = Code(
    "mesh.values-replaced",
    "Colours that are replaced",
    """
A warning. Colours that are not finite become black. Where only some parts of a file have colours of
vertices, the others become white.
""",
    "chair.obj: colours that are not finite are taken as 0",
)
MESH_POLYGONS_SPLIT = Code(
    "mesh.polygons-split",
    "Polygons that were split into triangles",
    """
Nothing is lost: a mesh consists of triangles here, and each corner of a polygon stays one.
""",
    "chair.obj: 5,120 polygons were split into triangles",
)
MESH_POLYGONS_NOT_SIMPLE = Code(
    "mesh.polygons-not-simple",
    "Polygons that cross themselves or have no area",
    """
A warning. Such polygons have no unique triangles, and are split as if they were convex. Triangulate the
mesh in the program that made it.
""",
    "chair.obj: 2 polygons cross themselves or have no area, and were split as if convex",
)
MESH_CONVERSION_LOSS = Code(
    "mesh.conversion-loss",
    "Data that the mesh class of another library cannot hold",
    """
A warning of `to_open3d`, `to_open3d_legacy` and `to_trimesh`. Functions of `stages` take and return the
Mesh itself, and `write_mesh` writes all of it.
""",
    (
        "open3d.geometry.TriangleMesh cannot hold parts and the up direction of this mesh: left out. Pass "
        "the Mesh itself, or write it with write_mesh as GLB, OBJ or PLY."
    ),
)
SCALE_UP_CONTRADICTED = Code(
    "scale.up-contradicted",
    "An up direction that cameras and surface contradict",
    """
A warning. The up direction that is known, from the layout or from gravity, is used; results may lie on
their side if it is wrong. `--set upright.up=+z` states it (an axis, or three numbers).
""",
    (
        "what is up is taken from layout euroc, but cameras were held as if it were 88° off that; "
        "upright.up=AXIS states it"
    ),
)
USAGE_EXTENSION_UNKNOWN = Code(
    "usage.extension-unknown",
    "An extension that stands for no format",
    """
The extension of a file decides its format. The sentence names the formats that this command reads or
writes; `scanloom export` writes the most. STL and OFF hold the shape alone, and are refused where colours
are the result.
""",
    "chair.3ds: is of an unknown format '.3ds'; known are .ply, .obj, .off, .stl, .glb, .gltf.",
)

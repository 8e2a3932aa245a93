"""Diagnostic codes of meshes and mesh files, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

FUSE_TOO_LARGE = Code(
    "fuse.too-large",
    "Mesh too large to process at once",
    """
Meshes of more than 5 million triangles are cleaned, simplified, measured, drawn and searched for gaps in
chunks, so that a run completes. [`refine`](../stages/refine.md#large-meshes) needs the whole mesh in memory:
up to 21 million triangles by default, more with a larger `refine.memory`. Larger meshes keep their noise,
with a warning. `lod` starts from the simplified mesh and states [its
distance](levels.md#levels-of-detail-of-a-large-mesh) from the refined mesh. The report page shows coarse
copies of large meshes. `bake` accepts no chunks; use `texture` instead, which paints the simplified mesh from
the photos. The chunk table, for example `refined.pieces.json`, is stored next to the mesh in the cache and is
valid for that file only.
""",
    (
        "bake cannot process chunks, and refined.ply has 7,412,306 triangles, more than the in-memory limit "
        "of 5,000,000. Increase fuse.voxel_size, or fuse a part of the scan (fuse.box)."
    ),
)
MESH_CLOUD_DAMAGED = Code(
    "mesh.cloud-damaged",
    "Damaged or empty point clouds",
    """
LAS, LAZ and E57 files that are cut short, damaged or empty are refused; get a whole copy. Point clouds of
more than 100 million points are refused as well: subsample them first.
""",
    "hall.laz: declares 12,000,000 points, more than it holds; it is damaged or cut short.",
)
MACHINE_EXTRA_MISSING = Code(
    "machine.extra-missing",
    "Missing optional library",
    """
Some formats and plots need optional libraries: `pip install "scanloom[clouds]"` for LAS, LAZ and E57,
`"scanloom[usd]"` for USD, `"scanloom[sim]"` for simulation models, `"scanloom[solid]"` for solids,
`"scanloom[plot]"` for plots, `"scanloom[sfm]"` for photos without poses.
""",
    "hall.laz: reading .laz requires laspy and lazrs; install scanloom[clouds].",
)
COMPARE_POINT_CLOUD = Code(
    "compare.point-cloud",
    "Point clouds where surfaces are required",
    """
`compare` accepts point clouds as PLY, LAS, LAZ and E57, the latter three with `pip install
"scanloom[clouds]"`. Points that a scanner marked as invalid or withheld are ignored, and so are colours
that are black throughout. Changes and views require surfaces; point clouds only support distances.
""",
    "--change needs two surfaces, and hall.laz is a cloud of points; leave it out.",
)
MESH_COMPANION_MISSING = Code(
    "mesh.companion-missing",
    "Missing companion files",
    """
glTF files refer to a `.bin` file and images, OBJ files to an `.mtl` file, which refers to images. Copy
these files as well, with their names and folders. If an image is missing, the mesh is read without that
texture, with a warning.
""",
    "chair.gltf: refers to the file chair.bin, which is missing.",
)
MESH_TEXTURE_DAMAGED = Code(
    "mesh.texture-damaged",
    "Damaged images or texture coordinates",
    """
The mesh is read with a warning. It is grey where its image cannot be decoded or its texture coordinates are
missing. Save the image again as PNG or JPEG, or export the mesh again.
""",
    "chair.obj: the texture image chair.png has an unknown format or is damaged",
)
MESH_COMPRESSION_UNKNOWN = Code(
    "mesh.compression-unknown",
    "Unsupported compression",
    """
Draco and binary OFF are not supported; glTF files compressed by meshoptimizer are. In Blender, turn
*Compression* off on export.
""",
    "chair.glb: uses an unsupported compression; write it again without compression.",
)
MESH_COORDINATES_TOO_LARGE = Code(
    "mesh.coordinates-too-large",
    "Coordinates too large",
    """
Coordinates are so large that areas and volumes overflow, or that positions exceed single precision. The
cause is usually a stray vertex: remove it, or move the mesh to the origin.
""",
    (
        "chair.ply: vertex 8012 is at (1e+200, 0, 0), beyond ±1e+60 m (1 such): its coordinates are too "
        "large; remove it, or scale the mesh."
    ),
)
MESH_NOT_FINITE = Code(
    "mesh.not-finite",
    "Values that are not finite",
    """
Positions, normals or texture coordinates are infinite or NaN. The check also runs before a file is written:
such a mesh is refused, and no file is created. Remove or repair the vertex or triangle that the message
names.
""",
    (
        "chair.obj: vertex 8012 is [nan, 0.0, 1.0], not finite (1 such); remove or repair these before "
        "processing."
    ),
)
MESH_INDEX_OUT_OF_RANGE = Code(
    "mesh.index-out-of-range",
    "Vertex indices out of range",
    """
The file is damaged or cut short, or the given arrays do not belong together. Get a whole copy of the file.
""",
    (
        "chair.ply: triangle 12 uses vertices [4, 5, 99999], but there are only 8012 (3 such triangles); the "
        "file is damaged or cut short."
    ),
)
MESH_FILE_TOO_LARGE = Code(
    "mesh.file-too-large",
    "Mesh too large for its format",
    """
A GLB file is limited to 4 GiB. Write PLY, or simplify the mesh first.
""",
    "city.glb: needs 5,120,331,008 bytes, more than the 4 GiB limit of GLB; write PLY.",
)
MESH_FILE_DAMAGED = Code(
    "mesh.file-damaged",
    "Mesh files that are damaged, cut short or of another format",
    """
Sizes declared by a file are checked before memory is allocated. Get a whole copy of the file. If another
program opens the file, that program may repair it silently: save it again from there.
""",
    "chair.glb: its nodes have more than 536,870,912 corners and vertices; it is damaged.",
)
MESH_POINTS_OUTSIDE = Code(
    "mesh.points-outside",
    "Points outside the bounding box of the header",
    """
A warning. Compressed points have no checksum, so points outside the bounding box are a sign of damage. Get
a whole copy.
""",
    "hall.laz: 312 points are outside the bounding box of the header: the file may be damaged",
)
MESH_UNIT_NOT_METRES = Code(
    "mesh.unit-not-metres",
    "Coordinates not in metres",
    """
A warning. The coordinates are used unchanged: lengths in parameters and in the output are in the unit of
the file. Convert the point cloud to metres first.
""",
    "hall.las: its coordinates are in feet but used as metres: all lengths are in that unit",
)
MESH_NO_SURFACE = Code(
    "mesh.no-surface",
    "No usable surface",
    """
The file is a point cloud, has only lines, or has triangles without area; or the surface is not a manifold
and the stage requires one. `scanloom clean` turns any surface into an oriented manifold.
""",
    "points.ply: holds 81,204 vertices but no triangles; a mesh is expected.",
)
MESH_LEFT_OUT = Code(
    "mesh.left-out",
    "Unsupported data in mesh files",
    """
A warning. The file has data that scanloom does not support. The other data is read.
""",
    "chair.glb: animations are left out",
)
MESH_CONFIDENCE_LEFT_OUT = Code(
    "mesh.confidence-left-out",
    "Vertex confidence left out",
    """
A warning. Only `remesh` uses the confidence of the vertices of a PLY file.
""",
    "chair.ply: the vertex confidence is left out: only remesh uses it",
)
MESH_VALUES_REPLACED = Code(
    "mesh.values-replaced",
    "Replaced colours",
    """
A warning. Colours that are not finite become black. If only some parts of a file have vertex colours, the
other parts become white.
""",
    "chair.obj: colours that are not finite become black",
)
MESH_POLYGONS_SPLIT = Code(
    "mesh.polygons-split",
    "Polygons split into triangles",
    """
No data is lost: every corner of a polygon becomes a corner of a triangle.
""",
    "chair.obj: 5,120 polygons were split into triangles",
)
MESH_POLYGONS_NOT_SIMPLE = Code(
    "mesh.polygons-not-simple",
    "Self-intersecting or degenerate polygons",
    """
A warning. Such polygons have no unique triangulation and are split as if they were convex. Triangulate the
mesh in the program that made it.
""",
    "chair.obj: 2 polygons intersect themselves or have no area: they are split as if convex",
)
MESH_CONVERSION_LOSS = Code(
    "mesh.conversion-loss",
    "Data lost in conversion to another library",
    """
A warning of `to_open3d`, `to_open3d_legacy` and `to_trimesh`. Functions of `stages` accept and return
`Mesh`, and `write_mesh` stores all of it.
""",
    (
        "open3d.geometry.TriangleMesh cannot hold parts and the up direction of this mesh: left out. Pass "
        "the Mesh itself, or write it with write_mesh as GLB, OBJ or PLY."
    ),
)
SCALE_UP_CONTRADICTED = Code(
    "scale.up-contradicted",
    "Up direction contradicted by cameras and surface",
    """
A warning. The known up direction, from the layout or from gravity, is used. If it is wrong, results are not
upright. Override it with `--set upright.up=+z` (an axis, or three numbers).
""",
    (
        "the up direction from layout euroc differs by 88° from the cameras' up direction; set "
        "upright.up=AXIS if it is wrong"
    ),
)
USAGE_EXTENSION_UNKNOWN = Code(
    "usage.extension-unknown",
    "Unknown file extension",
    """
The extension of a file selects its format. The message names the formats that the command reads or writes;
`scanloom export` writes the largest number. STL and OFF store geometry only, and are refused where colours
are the result.
""",
    "chair.3ds: is of an unknown format '.3ds'; known are .ply, .obj, .off, .stl, .glb, .gltf.",
)

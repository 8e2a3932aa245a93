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
EXPORT_IMAGE_REDUCED = Code(
    "export.image-reduced",
    "Images downsampled for their encoder",
    """
A warning. The encoder of KTX2 images accepts at most 12,582,912 texels, for example 4096 × 3072. Textures of
larger models are better divided into several images, or written as WebP.
""",
    (
        "the image photos-1.jpg of 4096 × 4096 texels is downsampled, because the KTX2 encoder accepts at "
        "most 12,582,912; use `webp` or a smaller `image_size`."
    ),
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
EXPORT_DECOMPOSITION_FAILED = Code(
    "export.decomposition-failed",
    "Mesh that cannot be divided into convex parts",
    """
The library CoACD stopped, ran out of memory, or needed more than an hour. Simplify the mesh, or repair its
defects first: `scanloom check` lists them.
""",
    "CoACD could not divide the mesh into convex parts; simplify or repair the mesh first.",
)
EXPORT_COLLISION_LOOSE = Code(
    "export.collision-loose",
    "Collision geometry beyond its limit",
    """
The proven distance by which the collision parts exceed the object, or by which they fail to contain its
surface, is above the limit. `simulation.json` has the bound of each part. With `simulation.max_excess` given,
this is an unmet requirement. Small details need many parts: allow more excess, or smooth the mesh. With
`simulation.collision=inside`, the limit applies to the distance of the surface from the parts; surface of
parts thinner than the limit can be farther.
""",
    "model: the collision geometry reaches up to 3.2 mm outside the surface (limit 2 mm) in 4 of 61 parts.",
)
EXPORT_OPEN_BODY = Code(
    "export.open-body",
    "Open meshes in a simulation",
    """
An open mesh encloses no volume, so it becomes a static body: its collision parts are thin shells on both
sides of the surface, and its mass is that of the shells. Close the mesh, with `scanloom refine` or a scan
from all sides, to make it movable. Small holes are closed automatically.
""",
    "model: the surface is open, so the body is static, and its mass is that of its collision parts.",
)
EXPORT_HOLES_CLOSED = Code(
    "export.holes-closed",
    "Holes closed for a simulation",
    """
Holes of an object are closed by flat caps, which take part in mass and collision. The visual mesh stays
open. The surface below a cap was not scanned.
""",
    "model: holes are closed with 3.1 % of additional surface for mass and collision.",
)
EXPORT_NO_OBJECTS = Code(
    "export.no-objects",
    "Scans without separate objects",
    """
A warning. `--split objects` makes bodies of what stands on a level floor or table. A plane counts if it has
0.25 m² or 15 % of the area of the largest level plane. A component above a plane is an object if it encloses
a volume when it is closed by the plane, and if it touches nothing else. Walls, furniture that carries another
plane, and objects that lean on other surfaces stay in the static body. Without a known up direction, set
`--up`.
""",
    "the scan has no level floor or table, so it is one static body; crop the scan to a table or floor.",
)
EXPORT_NOT_SPLIT = Code(
    "export.not-split",
    "Components that are no bodies of their own",
    """
Components on a plane that are too small, enclose no volume, or are attached to other surfaces stay in the
static body. An object that stands on another object, and not on a floor or table, is part of that object.
""",
    "4 objects are bodies; other components on their planes stay static: 14 too small.",
)
EXPORT_OBJECT_CLOSED = Code(
    "export.object-closed",
    "Objects closed on the plane where they stood",
    """
A warning. The lower side of an object was not scanned. The object is cut slightly above the plane, continued
vertically to the plane, and closed. Unseen sides are continued in the same way. The material `added` marks
this surface if the mesh has a texture. The plane is flattened, so that objects rest on it without overlap.
""",
    (
        "objects are closed on the plane where they stood; 42% to 55% of their surface is added. The plane "
        "is flattened by up to 4.2 mm."
    ),
)
EXPORT_BODIES_OVERLAP = Code(
    "export.bodies-overlap",
    "Bodies that overlap at the start",
    """
A warning. Collision parts are larger than their object by up to `simulation.max_excess`, so that close bodies
can overlap. A simulator pushes them apart. `simulation.json` lists the bodies.
""",
    (
        "object_1 and object_3 overlap at the start, by at most 0.8 mm, in 2 pairs of collision parts; set "
        "`max_excess` lower."
    ),
)
EXPORT_COLLISION_LARGE = Code(
    "export.collision-large",
    "Collision geometry larger than the visual mesh",
    """
The files of the collision parts are larger than those of the visual mesh. A simulator may be slower than with
the mesh itself. Allow more excess with `simulation.max_excess`.
""",
    "model: the collision geometry (48,210 bytes) is larger than the visual mesh (21,004 bytes).",
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

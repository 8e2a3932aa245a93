"""Diagnostic codes of simplification, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

SIMPLIFY_NOT_MANIFOLD = Code(
    "simplify.not-manifold",
    "Non-manifold surface",
    """
A warning: the surface was split into manifold sheets, which are not simplified where they touch. Run
`scanloom clean` first to simplify these regions, too.
""",
    (
        "the surface is not a manifold: it was split into sheets, which stay unchanged at 214 vertices where "
        "they touch; run clean first to simplify there, too."
    ),
)
SIMPLIFY_BOUND_NOT_PROVEN = Code(
    "simplify.bound-not-proven",
    "Bounds that are not proven or not met",
    """
Exit code 1: the file is written, and the message contains the bounds that are proven instead. Where surfaces
of different colours touch, no small colour bound can be proven, not even for an unchanged mesh. Give a larger
bound, or omit the bound on colour.
""",
    "the requested bounds are not proven; 0.00213 m and 31.5 levels are proven instead.",
)
SIMPLIFY_COLORS_NOT_COMPARED = Code(
    "simplify.colors-not-compared",
    "Colours that cannot be compared",
    """
A warning of `simplify` with `max_color`. Where surfaces of different colours coincide, a point has several
colours, and a colour difference is not defined. `scanloom clean` removes double faces.
""",
    "colours are not compared at 1,204 triangles, where surfaces of different colours coincide in the input.",
)
SIMPLIFY_TRADEOFF = Code(
    "simplify.tradeoff",
    "Error against triangles",
    """
Messages of `tradeoff`. Exit code 1 if the error exceeds the bound at every triangle count: give larger counts
or a larger bound. A mesh flies apart if a vertex is far outside the bounding box of the input, or if a single
place is far more off than the rest of the surface, or than in meshes of fewer triangles: such counts are not
suggested. The other messages explain why a curve ends, and which meshes the distances refer to.
""",
    (
        "at none of these triangle counts is 95 % of the surface within 0.001 m; give larger counts with "
        "--counts."
    ),
)
SIMPLIFY_DEFAULT_COUNT = Code(
    "simplify.default-count",
    "Default bounds that leave too many triangles",
    """
A warning about a large mesh, if neither a triangle count nor a bound is given. A count or bound that is given
applies unchanged.
""",
    (
        "the default bounds would leave 6,120,331 triangles, more than later stages process at once; "
        "5,000,000 are kept. Give simplify.triangles, simplify.ratio or simplify.max_shape for another count."
    ),
)
SIMPLIFY_COUNT_NOT_REACHED = Code(
    "simplify.count-not-reached",
    "Triangle count not reached",
    """
Exit code 1: the file is written. The remaining edges cannot collapse because of locked vertices, borders,
bounds, or the topology: holes, handles and components are preserved. Before simplifying, run `scanloom clean`
with `--fill-holes 0.05` and a larger `--min-island-area` to remove small holes and islands.
""",
    (
        "2,418 triangles are left instead of 1,000: no other edge can collapse, mostly because of the rule "
        '"topology".'
    ),
)
SIMPLIFY_EDGES_BLOCKED = Code(
    "simplify.edges-blocked",
    "Few edges left to collapse",
    """
A warning: most of the remaining edges belong to holes, handles and small components, or are locked. Therefore
the other surfaces lose accuracy. Fill or remove small holes and components with `scanloom clean` first, or
keep more triangles.
""",
    (
        "62% of the remaining edges belong to holes, handles and small components, which are preserved, so "
        "the other surfaces lost more detail than necessary; fill or remove small ones first "
        "(clean.fill_holes and clean.min_island_area), or keep more triangles."
    ),
)
SIMPLIFY_DEGENERATE_REMOVED = Code(
    "simplify.degenerate-removed",
    "Isolated degenerate triangles",
    """
A warning. Triangles with two vertices at one position have no area and are removed by every method. If such a
triangle is isolated, bounds on shape do not cover its removal.
""",
    "isolated degenerate triangles were removed, and no bound covers them: 2 of 81,204.",
)
SIMPLIFY_RECORD_INVALID = Code(
    "simplify.record-invalid",
    "Invalid collapse records",
    """
A record is the `.npz` file that `--save-record` writes. If it is damaged, simplify again with
`--save-record`. `replay --fit` does not support records of method `seams`.
""",
    "a record of method seams cannot be fitted to the input; run simplify with that triangle count instead.",
)
SIMPLIFY_RECORD_TOO_SHORT = Code(
    "simplify.record-too-short",
    "Records that end too early",
    """
`replay` restores meshes between the input and the end of the record. Simplify to fewer triangles with
`--save-record`.
""",
    "triangles asks for 100 triangles, but the record ends at 2418.",
)
SIMPLIFY_COMPONENTS_REMOVED = Code(
    "simplify.components-removed",
    "Removed components and holes",
    """
`simplify.drop_below` was given. The warning reports the number and area of the removed components and
holes; check that they are as intended. Give a smaller length if something is missing. A length that would
remove every component is an error.
""",
    (
        "drop_below removed 37 connected components smaller than 0.05 m (4,410 triangles, 0.0213 m²) and "
        "filled 12 holes (0.00184 m²); no bound covers these."
    ),
)
SIMPLIFY_DROP_BELOW_UNUSED = Code(
    "simplify.drop-below-unused",
    "Mesh too large for the removal of small components",
    """
A warning. A mesh that is simplified in parts keeps its small components. Remove them before with
`clean.min_island_area`.
""",
    (
        "drop_below has no effect, because the mesh has 7,412,306 triangles and is simplified in parts; "
        "remove small components with clean.min_island_area."
    ),
)
SIMPLIFY_COORDINATES_UNUSABLE = Code(
    "simplify.coordinates-unusable",
    "Unusable texture coordinates",
    """
Coordinates far outside 0 to 1, or all at one position, come from broken exporters. Create a new texture
(`scanloom texture` from photos, `scanloom mesh bake` from the mesh's colours), or remove it.
""",
    (
        "mesh: texture coordinates are too small to be weighted against the shape; create a new texture, or "
        "remove it."
    ),
)
SIMPLIFY_SEAM_DRIFT = Code(
    "simplify.seam-drift",
    "Texture shifted next to seams",
    """
`simplify.seams.max_seam_drift` limits how far seams move in the image, in texels. A smaller limit keeps more
triangles next to seams. By default, seams move by at most 1.5 edges of the simplified mesh. A warning appears
above 16 texels.
""",
    (
        "texture seams moved by up to 23 texels in the image, so the texture may be visibly shifted next to "
        "seams; give a smaller max_seam_drift, or keep more triangles."
    ),
)
SIMPLIFY_ATTRIBUTES_LOST = Code(
    "simplify.attributes-lost",
    "Attributes that a method does not preserve",
    """
Warnings. New images are baked, unless `--no-bake` is given or the file format has no images. `--keep-uv`
keeps the old images. Method `seams` preserves normals and colours of corners.
""",
    "model.obj: simplify discards parts; method seams preserves them.",
)
SIMPLIFY_TEXTURE_LEFT_OUT = Code(
    "simplify.texture-left-out",
    "Discarded texture",
    """
A warning. The method simplifies the shape only, and no new image was requested. `--bake` bakes new images,
and `--keep-uv` keeps the images of the input with their texture coordinates.
""",
    "model.glb: simplify discards the texture; method seams preserves it, and bake creates a new image from "
    "the old one.",
)
SIMPLIFY_IMAGES_KEPT = Code(
    "simplify.images-kept",
    "Images kept with their seams",
    """
A warning. An atlas has as many texels as the images that it replaces. For a brick that repeats over a wall,
or a palette of colours, this is too few, and the images are kept. Their seams then restrict the
simplification. `--bake` bakes an atlas anyway.
""",
    (
        "the images repeat on the surface, and an atlas with as few texels would lose detail: texture "
        "coordinates and images are kept; bake=True bakes an atlas anyway."
    ),
)
SIMPLIFY_IMAGES_REBAKED = Code(
    "simplify.images-rebaked",
    "Images replaced by baked ones",
    """
A warning. With its own images, the model would exceed the triangle count along texture seams. With newly
baked images it is closer to the input and has fewer triangles. `--keep-uv` keeps the old images.
""",
    (
        "new images are baked: with its own images, the model would keep 5,120 triangles along texture seams "
        "and differ more from the input; keep_uv=True keeps the old images."
    ),
)
USAGE_METHOD_MISMATCH = Code(
    "usage.method-mismatch",
    "Parameters that do not fit the method of `simplify`",
    """
Each [method](../simplification.md) supports different parameters. `--method auto`, the default, selects the
first method that supports all given parameters. Omit the method, or omit parameters of another method.
""",
    "planar.patch_angle is not supported by method quadric; leave one of them out.",
)
USAGE_REGION_INVALID = Code(
    "usage.region-invalid",
    "Invalid regions, locks or importance",
    """
Coordinates are in metres, in the axes of the mesh file. Look up a position with *Measure* in the page of
`scanloom view`, or in any viewer that shows coordinates. `--region "sphere x y z radius 5"` multiplies
squared errors in the region by five; `lock` keeps all its vertices unchanged.
""",
    "sphere about (0.1, 0.2, 5) of radius 0.5 m contains no vertex of the mesh; coordinates are in metres.",
)

"""Codes of the diagnostics of simplification, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

SIMPLIFY_NOT_MANIFOLD = Code(
    "simplify.not-manifold",
    "A surface that is no manifold",
    """
A warning: sheets stay as they are where they touch. `scanloom clean` first lets these places move.
""",
    (
        "the surface is no manifold: it was split into sheets, which stay as they are at 214 vertices where "
        "they touch; run clean first to let these move."
    ),
)
SIMPLIFY_BOUND_NOT_PROVEN = Code(
    "simplify.bound-not-proven",
    "Bounds that are not proven, or not kept",
    """
Exit code 1: the file is written, and the bounds that are proven instead are named. Where sheets of
different colours touch, no small bound on colour is true even of the mesh and itself. Give a larger
bound, or leave the bound on colour out.
""",
    "the bounds that were asked for are not proven; proven are 0.00213 m and 31.5 levels.",
)
SIMPLIFY_COLORS_NOT_COMPARED = Code(
    "simplify.colors-not-compared",
    "Colours that are not compared",
    """
A warning of `simplify` with `max_color`. Where sheets of different colours lie on each other, a point has
several colours, and a difference of colour has no meaning. `scanloom clean` takes doubled faces away.
""",
    ("colours are not compared at 1,204 triangles, where the model itself has several colours in one place."),
)
SIMPLIFY_TRADEOFF = Code(
    "simplify.tradeoff",
    "Error against triangles",
    """
Of `mesh tradeoff`. Exit code 1 if the bound is below the error of all numbers of triangles: give larger
numbers, or a larger bound. The others are remarks: why a curve ends, and which meshes its distances
belong to.
""",
    "none of these numbers keeps 95 % of the surface within 0.001 m; give more triangles with --counts.",
)
SIMPLIFY_DEFAULT_COUNT = Code(
    "simplify.default-count",
    "Fewer triangles than the default bounds would leave",
    """
A warning about a large mesh for which neither a number nor a bound was given. A number or a bound that is
given is kept to.
""",
    (
        "within the default bounds 6,120,331 triangles would be left, more than what follows takes at once; "
        "5,000,000 are. Give simplify.triangles, ratio or max_shape for another number."
    ),
)
SIMPLIFY_COUNT_NOT_REACHED = Code(
    "simplify.count-not-reached",
    "Not as few triangles as asked",
    """
Exit code 1: the file is written. The remaining edges may not collapse: locked vertices, borders, a
topology of many holes and handles (which all stay), or a bound that was given too. `scanloom clean
--fill-holes 0.05` and a larger `clean.min_island_area` before simplifying take small holes and islands
away.
""",
    "2,418 triangles are left, not 1,000 as asked: no other edge may collapse, for topology most often.",
)
SIMPLIFY_CROWDED = Code(
    "simplify.crowded",
    "Little left to collapse",
    """
A warning: most of the remaining edges stand for holes, handles and small components, or are locked, so
that all accuracy is lost elsewhere. Fill or remove small ones with `scanloom clean` first, or keep more
triangles.
""",
    (
        "62% of the edges that are left stand for holes, handles and loose pieces, which all stay, so that "
        "the rest lost more than it had to; fill or remove small ones first (fill_holes and min_island_area "
        "of clean), or keep more triangles."
    ),
)
SIMPLIFY_LINES_LEFT_OUT = Code(
    "simplify.lines-left-out",
    "Triangles that are lines or points",
    """
A warning. A triangle with two corners in one place has no area, and no method keeps it. Where it lies
beside no other triangle, bounds on shape do not cover it.
""",
    (
        "triangles with two corners in one place that lie beside no other triangle were left out, and no "
        "bound is about them: 2 of 81,204."
    ),
)
SIMPLIFY_RECORD_INVALID = Code(
    "simplify.record-invalid",
    "Records of collapses",
    """
A record is the `.npz` file that `--save-record` writes. A damaged one cannot be used: simplify again with
`--save-record`. A record of method `seams` cannot be fitted.
""",
    "a record of method seams cannot be fitted; simplify to that number instead.",
)
SIMPLIFY_RECORD_TOO_SHORT = Code(
    "simplify.record-too-short",
    "Records that end before what is asked",
    """
`replay` goes from the whole mesh to where the record ends, not beyond. Simplify further with
`--save-record`.
""",
    "triangles asks for 100 triangles, but the record ends at 2418.",
)
SIMPLIFY_COMPONENTS_REMOVED = Code(
    "simplify.components-removed",
    "Small components and holes",
    """
`simplify.drop_below` was given. A warning names the counts; check that the number and the area are what you
meant. Give a smaller length if something is missing. A length that would remove every component is
refused.
""",
    (
        "drop_below removed 37 connected components smaller than 0.05 m (4,410 triangles, 0.0213 m²) and "
        "filled 12 holes (0.00184 m²); no bound covers these."
    ),
)
SIMPLIFY_DROP_BELOW_UNUSED = Code(
    "simplify.drop-below-unused",
    "A mesh that is too large for the removal of small components",
    """
A warning. A mesh that is simplified in parts keeps its small components. `clean.min_island_area` removes
them before.
""",
    (
        "drop_below has no effect on this mesh: it has 7,412,306 triangles, which are simplified in parts; "
        "remove small components with clean.min_island_area."
    ),
)
SIMPLIFY_COORDINATES_UNWEIGHABLE = Code(
    "simplify.coordinates-unweighable",
    "Texture coordinates that cannot be weighed",
    """
Coordinates far outside 0 to 1, or all in one place, come from broken exporters. Make a new texture
(`scanloom texture` from photos, `scanloom bake` from the mesh's colours), or leave it out.
""",
    (
        "mesh: its texture coordinates are too small to be weighed against its shape; make a new texture, or "
        "leave it out."
    ),
)
SIMPLIFY_SEAM_DRIFT = Code(
    "simplify.seam-drift",
    "Texture shifted beside seams",
    """
`simplify.seams.max_seam_drift` limits how far seams move in the image, in texels. A smaller limit keeps more
triangles beside seams. Without a limit given, seams move by at most 1.5 edges of the simplified mesh, and
a warning appears from 16 texels on.
""",
    (
        "texture seams moved by up to 23 texels in the image, so the texture may be shifted beside them; "
        "give a smaller max_seam_drift, or keep more triangles."
    ),
)
SIMPLIFY_ATTRIBUTES_LOST = Code(
    "simplify.attributes-lost",
    "Attributes that a method does not carry",
    """
Warnings. Images are baked anew, unless `--no-bake` is given or the format holds none. `--keep-uv` keeps
them. Normals and colours of corners are carried by `seams`.
""",
    "model.obj: simplify left out: parts; method seams carries them.",
)
SIMPLIFY_TEXTURE_LEFT_OUT = Code(
    "simplify.texture-left-out",
    "A texture that is left out",
    """
A warning. The method works on the shape alone, and no new image was asked for. `--bake` bakes the images of
the input anew, and `--keep-uv` keeps them with their texture coordinates.
""",
    "model.glb: simplify left out: texture; method seams carries it, and bake makes a new image.",
)
SIMPLIFY_IMAGES_KEPT = Code(
    "simplify.images-kept",
    "Images that are kept with their seams",
    """
A warning. An atlas has as many texels as the images that it replaces: one brick that repeats over a wall,
or a palette of colours, has too few. Seams then stay, and hold the shape in place; `--bake` bakes
regardless.
""",
    (
        "the images repeat on the surface: texture coordinates and images are kept, since an atlas of as few "
        "texels would lose detail; bake=True makes one all the same."
    ),
)
SIMPLIFY_IMAGES_REMADE = Code(
    "simplify.images-remade",
    "Images that are baked anew",
    """
A warning. The model's own images would hold more triangles along texture seams than were asked for, and
images that are baked anew are nearer to the input with fewer triangles. `--keep-uv` keeps the old ones.
""",
    (
        "with its own images the model keeps 5,120 triangles along texture seams and differs more from the "
        "input: new images are baked; keep_uv=True keeps the old."
    ),
)
USAGE_METHOD_MISMATCH = Code(
    "usage.method-mismatch",
    "A method of `simplify` that does not fit what was asked",
    """
Each [method](../simplification.md) has parameters of its own. `--method auto`, the default, takes the
first that knows all that were given; leave the method out, or leave out a parameter that belongs to
another.
""",
    "planar.patch_angle has no meaning for method quadric; leave one of them out.",
)
USAGE_REGION_INVALID = Code(
    "usage.region-invalid",
    "Regions, locks and importance",
    """
Places are in metres and in the axes of the mesh's own file: look one up with *Measure* in the page of
`scanloom view`, or in any viewer that shows coordinates. `--region "sphere x y z radius 5"` counts
squared errors there five times; `lock` leaves all vertices in it as they are.
""",
    "sphere at (0.1, 0.2, 5) holds no vertex of the mesh; places are in metres.",
)

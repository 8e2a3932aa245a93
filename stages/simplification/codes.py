"""Codes of the diagnostics of simplification, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

SIMPLIFY_NOT_MANIFOLD = Code(
    "simplify.not-manifold",
    "A surface that is no manifold",
    """
A warning: sheets stay as they are where they touch. `scanloom clean` first lets these places move.
""",
    (
        "the surface is no manifold: it was split into sheets, which stay as they "
        "are at … vertices where they touch; run clean first to let these move."
    ),
)
SIMPLIFY_BOUND_NOT_PROVEN = Code(
    "simplify.bound-not-proven",
    "Bounds that are not proven, or not kept",
    """
Exit code 1: the file is written, and what is proven instead is told. Where sheets of different colours
touch, no small
bound on colour is true even of the mesh and itself. Give a larger bound, or leave the bound on colour out.
""",
    "the bounds that were asked for are not proven; proven are ….",
)
SIMPLIFY_TRADEOFF = Code(
    "simplify.tradeoff",
    "Error against triangles",
    """
Of `tradeoff`. The first says that the bound is below what any of the numbers reaches: give larger ones,
or a larger bound.
The others are remarks: where the suggestion comes from, why a curve ends, and what its distances are of.
""",
    "none of these numbers keeps …; give more triangles with --counts.",
)
SIMPLIFY_DEFAULT_COUNT = Code(
    "simplify.default-count",
    "Fewer triangles than the default bounds would leave",
    """
A warning about a large mesh of which nothing was asked. A number or a bound that is given is kept to.
""",
    (
        "within the default bounds … triangles would be left, more than what follows "
        "takes at once; … are. Give simplify.triangles, ratio or max_shape for "
        "another number."
    ),
)
SIMPLIFY_COUNT_NOT_REACHED = Code(
    "simplify.count-not-reached",
    "Not as few triangles as asked",
    """
Exit code 1: the file is written. What is left may not collapse: locked vertices, borders, a topology of
many holes and
handles (which all stay), or a bound that was given too. `scanloom clean --fill-holes 0.05` and a larger
`clean.min_island_area` before simplifying take small holes and islands away.
""",
    "no other edge may collapse, for … most often",
)
SIMPLIFY_RECORD_INVALID = Code(
    "simplify.record-invalid",
    "Records of collapses",
    """
A record is the `.npz` file that `--save-record` writes. A damaged one cannot be used: simplify again with
`--save-record`. `replay` goes from the whole mesh to where the record ends, not beyond.
""",
    "cannot be read: ….",
)
SIMPLIFY_COMPONENTS_REMOVED = Code(
    "simplify.components-removed",
    "Small components and holes",
    """
`--drop-below` was given. The first is what it did; check that the number and the area are what you meant.
Give a smaller
length if something is missing.
""",
    (
        "drop_below removed … connected components smaller than … m (… triangles, … "
        "m²) and filled … holes (… m²); no bound covers these."
    ),
)
SIMPLIFY_COORDINATES_UNWEIGHABLE = Code(
    "simplify.coordinates-unweighable",
    "Texture coordinates that cannot be weighed",
    """
Coordinates far outside 0 to 1, or all in one place, come from broken exporters. Make a new texture
(`scanloom texture`
from photos, `scanloom bake` from the mesh's colours), or leave it out.
""",
    (
        "its texture coordinates are too small to be weighed against its shape; make "
        "a new texture, or leave it out."
    ),
)
SIMPLIFY_SEAM_DRIFT = Code(
    "simplify.seam-drift",
    "Texture shifted beside seams",
    """
`simplify.max_seam_drift` limits how far seams move in the image, in texels. A smaller limit keeps more
triangles beside
seams. Without a limit given, seams move by at most 1.5 edges of the simplified mesh, and a warning
appears from 16 texels
on.
""",
    (
        "texture seams moved by up to … texels in the image, so the texture may be "
        "shifted beside them; give a smaller max_seam_drift, or keep more triangles."
    ),
)
SIMPLIFY_ATTRIBUTES_LOST = Code(
    "simplify.attributes-lost",
    "What a method does not carry",
    """
Warnings. Images are baked anew, unless `--no-bake` is given or the format holds none. `--keep-uv` keeps
them. Normals and
colours of corners are carried by `seams`.
""",
    (
        "copies of vertices in one place differ in colour by up to … levels; their "
        "mean was taken, while method seams of simplify keeps both."
    ),
)
USAGE_METHOD_MISMATCH = Code(
    "usage.method-mismatch",
    "A method of `simplify` that does not fit what was asked",
    """
Each [method](../simplification.md) has parameters of its own. `--method auto`, the default, takes the
first that knows
all that were given; leave the method out, or leave out what belongs to another.
""",
    "method …, which goes as far as its bounds; leave out triangles and ratio.",
)
USAGE_REGION_INVALID = Code(
    "usage.region-invalid",
    "Regions, locks and importance",
    """
Places are in metres and in the axes of the mesh's own file: look one up with *Measure* in the page of
`scanloom view`,
or in any viewer that shows coordinates. `--region "sphere x y z radius 5"` counts squared errors there
five times;
`lock` leaves all vertices in it as they are.
""",
    "… at …: a place is three finite numbers, in metres.",
)

"""Parameters of method `seams` only."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param

# Vertices within this ratio of the bounding box's diagonal are joined: the precision of 32-bit floats.
SIMILAR_DISTANCE = 1e-6

# Default bound on seam drift, in mean edge lengths of the simplified mesh in the image, and as a ratio of the
# image's side. A third of it increases the shape error of meshes with small charts (a foot in 2,000 charts at
# 3 %: RMS 353e-5 against 216e-5); twice as much gains nothing.
SEAM_DRIFT_EDGES = 1.5
MAX_SEAM_DRIFT_RATIO = 0.1

# Image side in texels for meshes with texture coordinates but no image.
DEFAULT_IMAGE_SIDE = 1024


@dataclass(frozen=True, kw_only=True)
class SeamsParams:
    """Parameters of method `seams`."""

    similar_distance: float | None = param(
        None,
        "Join vertices closer than this, unless an edge would get more than two triangles. A larger "
        "distance closes cracks between parts. Default: "
        f"{SIMILAR_DISTANCE:g} of the bounding box's diagonal, at most a hundredth of the median edge "
        "length.",
        unit="m",
        low=0,
    )
    texture_weight: float = param(
        1.2,
        "Weight of a shift of the texture along the surface, relative to a shift of the surface itself.",
        low=0,
    )
    normal_weight: float = param(
        1.0,
        "Weight of normals, if the mesh has any. With 1, the normals along an edge of the "
        "simplified mesh weigh as much as the deviation of its shape.",
        low=0,
    )
    shape_weight: float = param(
        0.3,
        "Weight of the shape-only quadric near seams, relative to the quadric of shape and attributes.",
        low=0,
    )
    material_border_penalty: float = param(
        0.5, "Penalty for a collapse where several materials meet, as a fraction of its cost.", low=0
    )
    part_border_penalty: float = param(
        0.5, "Penalty for a collapse where several parts meet, as a fraction of its cost.", low=0
    )
    valence_penalty: float = param(
        0.1,
        "Penalty for each edge beyond eight at the new vertex, as a fraction of the cost of the collapse.",
        low=0,
    )
    duplicate_penalty: float = param(
        0.1,
        "Penalty for each duplicate of an edge's end points beyond two, as a fraction of the "
        "cost of the collapse.",
        low=0,
    )
    max_seam_drift: float | None = param(
        None,
        "Maximum distance in the image between a texture seam and its position in the input. Default: "
        f"{SEAM_DRIFT_EDGES:g} edges of the simplified mesh, at most {MAX_SEAM_DRIFT_RATIO:g} of the image's "
        "side.",
        unit="texels",
        low=0,
    )

    def __post_init__(self) -> None:
        check_parameters(self)

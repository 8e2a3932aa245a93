"""Parameters of method `seams` only."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check, param

# Vertices within this ratio of the bounding box's diagonal are joined: the precision of 32-bit floats.
SIMILAR_DISTANCE = 1e-6

# Default bound on seam drift, in mean edge lengths of the simplified mesh in the image, and as a ratio of the
# image's side. A third of it increases the shape error of meshes with small charts (a foot in 2,000 charts at
# 3 %: RMS 353e-5 against 216e-5); twice as much gains nothing.
SEAM_DRIFT_EDGES = 1.5
MAX_SEAM_DRIFT_RATIO = 0.1

# Image side in texels for meshes with texture coordinates but no image.
ASSUMED_SIDE = 1024


@dataclass(frozen=True, kw_only=True)
class SeamsParams:
    """Parameters of method `seams`."""

    similar_distance: float | None = param(
        None,
        "Vertices closer than this are one, unless an edge would get more than two triangles. A larger "
        "distance closes cracks between parts. Default: "
        f"{SIMILAR_DISTANCE:g} of the bounding box's diagonal, at most a hundredth of the median side of "
        "triangles.",
        unit="m",
        low=0,
    )
    texture_weight: float = param(
        1.2,
        "Weight of a shift of the texture along the surface against a shift of the surface itself.",
        low=0,
    )
    normal_weight: float = param(
        1.0,
        "Weight of normals, if the mesh has any, against 1 where an edge that is left turns as much by them "
        "as by its shape.",
        low=0,
    )
    shape_weight: float = param(
        0.3,
        "Weight of the quadric of shape alone against that of shape and attributes, where a seam is near.",
        low=0,
    )
    across_textures: float = param(
        0.5, "Penalty for a collapse where several materials meet, as a share of its cost.", low=0
    )
    across_parts: float = param(
        0.5, "Penalty for a collapse where several parts meet, as a share of its cost.", low=0
    )
    valence_penalty: float = param(
        0.1, "Penalty for each edge beyond eight that a vertex would have, as a share of its cost.", low=0
    )
    set_penalty: float = param(
        0.1, "Penalty for each copy of the ends of an edge beyond two, as a share of its cost.", low=0
    )
    max_seam_drift: float | None = param(
        None,
        "Largest distance in the image between a texture seam and its position in the input. Default: "
        f"{SEAM_DRIFT_EDGES:g} edges of the simplified mesh, at most {MAX_SEAM_DRIFT_RATIO:g} of the image's "
        "side.",
        unit="texels",
        low=0,
    )

    def __post_init__(self) -> None:
        check(self)

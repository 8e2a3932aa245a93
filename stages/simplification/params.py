"""How far `simplify` goes, and by which method."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stages.errors import UsageError
from stages.params import check, param
from stages.simplification.planar import params as planar_params
from stages.simplification.seams import defaults as seam_defaults

# Headings of the command's help.
_HOW_FAR = "How far: a number, bounds or both"
_HOW = "How"
_ONE_METHOD = "For one method only"
_SEAMS = "For textured meshes"

# Parameters that only some of the methods know.
_ONLY_FOR = {
    "max_shape": ("certified", "jia01", "planar"),
    "max_texture": ("certified", "jia01", "planar"),
    "close_bounds": ("certified",),
    "resolution": ("jia01",),
    "paper_rule": ("jia01",),
    "similar_distance": ("seams",),
    "texture_weight": ("seams",),
    "normal_weight": ("seams",),
    "shape_weight": ("seams",),
    "across_textures": ("seams",),
    "across_parts": ("seams",),
    "valence_penalty": ("seams",),
    "set_penalty": ("seams",),
    "max_seam_drift": ("seams",),
    "patch_angle": ("planar",),
    "crease_angle": ("planar",),
    "noise_angle": ("planar",),
}


@dataclass(frozen=True, kw_only=True)
class SimplifyParams:
    """How, and how far, `simplify` goes.

    Any bound that is given is kept, also with `triangles` or `ratio`: whichever comes first ends the work.
    For jia01 with one of these, a bound that is not given does not limit; its default then only helps to say
    which edges go first.
    """

    triangles: int | None = param(
        None, "Stop when at most this many triangles are left.", group=_HOW_FAR, low=1
    )
    ratio: float | None = param(
        None,
        "Stop when at most this share of the input's triangles is left.",
        group=_HOW_FAR,
        low=0,
        high=1,
        low_open=True,
    )
    max_shape: float | None = param(
        None,
        "certified: largest distance of any point of either surface from the other; default: 0.5 % of the "
        "bounding box's diagonal. jia01: largest shape change, summed over the collapses around an edge; "
        "default: 0.1 of the resolution, but at most 0.5 % of the diagonal. planar: as certified.",
        group=_HOW_FAR,
        unit="m",
        low=0,
        low_open=True,
    )
    max_texture: float | None = param(
        None,
        "certified: largest difference, Euclidean over the channels, between the colour at any point of "
        "either surface and that at any nearest point of the other; no bound if not given. jia01: the "
        "strongest contrast in the neighbourhood of a collapse, summed over the collapses around an edge, "
        "which far exceeds the colour error that results; default: 400. planar: largest difference "
        "between the colours of a point and of its counterpart on the other surface; default for coloured "
        f"meshes: {planar_params.MAX_TEXTURE:g}, and 1000 is no bound in effect.",
        group=_HOW_FAR,
        unit="8-bit levels",
        low=0,
    )
    method: str = param(
        "auto",
        "quadric: to a number of triangles, with the least squared error of shape and colour. certified: as "
        "far as bounds on the distance and on the difference of colour are proven for every point, or to a "
        "number of triangles within them. seams: to a number of triangles, with the texture coordinates, "
        "colours and normals of every corner, and no crack along texture seams. jia01: within bounds on the "
        "summed change of shape and texture. planar: near-planar patches with as few triangles as their "
        "borders need, within bounds; fast, for walls, floors and machined parts. auto: jia01 with "
        "resolution or paper_rule, else certified with max_shape or max_texture, else with triangles or "
        "ratio seams if the mesh has texture, materials, parts or normals of corners and quadric if not, "
        "else jia01.",
        group=_HOW,
        choices=("auto", "quadric", "certified", "jia01", "planar", "seams"),
    )
    attribute_scale: float | None = param(
        None,
        "Length that weighs as much as one level of colour. Default: quadric derives it from the mesh and "
        "the number of triangles, certified from the mesh; jia01 takes max_shape / max_texture.",
        group=_HOW,
        unit="m per level",
        low=0,
    )
    threads: int | None = param(
        None,
        "Parts of the mesh worked on at the same time, with the same result; one a core if not given.",
        group=_HOW,
        low=1,
        high=256,
        invalidates=False,
    )
    fit: bool = param(
        True,
        "quadric, seams: move vertices to fit the input by least squares at the end, with quadric their "
        "colours too; boundaries stay.",
        group=_ONE_METHOD,
    )
    close_bounds: bool = param(
        False,
        "certified: bound each triangle as closely as can be, in two to four times the time. Otherwise the "
        "bounds of a triangle may be as large as max_shape and max_texture though less is true.",
        group=_ONE_METHOD,
    )
    resolution: float | None = param(
        None,
        "jia01: wanted edge length: longer edges are split first, and do not collapse. Default: 36 times the "
        "mean edge length, more where splitting would add over 5 % of triangles.",
        group=_ONE_METHOD,
        unit="m",
        low=0,
        low_open=True,
    )
    paper_rule: bool = param(
        False,
        "jia01: follow the paper: check the bounds after each collapse, so that the last one may overshoot, "
        "and measure shape at vertices only. Default: check before, and between vertices too; bounds then "
        "hold.",
        group=_ONE_METHOD,
    )

    patch_angle: float | None = planar_params.patch_angle(None, _ONE_METHOD)
    crease_angle: float | None = planar_params.crease_angle(None, _ONE_METHOD)
    noise_angle: float | None = planar_params.noise_angle(None, _ONE_METHOD)
    similar_distance: float | None = param(
        None,
        "seams: vertices closer than this are one. A larger one joins parts that only touch. Default: "
        f"{seam_defaults.SIMILAR_DISTANCE:g} of the bounding box's diagonal.",
        group=_SEAMS,
        unit="m",
        low=0,
    )
    texture_weight: float | None = param(
        None,
        "seams: weight of a shift of the texture along the surface against a shift of the surface itself; "
        f"default: {seam_defaults.TEXTURE_WEIGHT:g}.",
        group=_SEAMS,
        low=0,
    )
    normal_weight: float | None = param(
        None,
        "seams: weight of normals, if the mesh has any, against 1 where an edge that is left turns as much "
        f"by them as by its shape; default: {seam_defaults.NORMAL_WEIGHT:g}.",
        group=_SEAMS,
        low=0,
    )
    shape_weight: float | None = param(
        None,
        "seams: weight of the quadric of shape alone against that of shape and attributes, where a seam is "
        f"near; default: {seam_defaults.SHAPE_WEIGHT:g}.",
        group=_SEAMS,
        low=0,
    )
    across_textures: float | None = param(
        None,
        "seams: penalty for a collapse where several materials meet, as a share of its cost; default: "
        f"{seam_defaults.ACROSS_TEXTURES:g}.",
        group=_SEAMS,
        low=0,
    )
    across_parts: float | None = param(
        None,
        f"seams: the same where several parts meet; default: {seam_defaults.ACROSS_PARTS:g}.",
        group=_SEAMS,
        low=0,
    )
    valence_penalty: float | None = param(
        None,
        "seams: penalty for each edge beyond eight that a vertex would have, as a share of its cost; "
        f"default: {seam_defaults.VALENCE_PENALTY:g}.",
        group=_SEAMS,
        low=0,
    )
    set_penalty: float | None = param(
        None,
        "seams: the same for each copy of the ends of an edge beyond two; default: "
        f"{seam_defaults.SET_PENALTY:g}.",
        group=_SEAMS,
        low=0,
    )
    max_seam_drift: float | None = param(
        None,
        "seams: largest distance in the image between a seam and what it was, as a share of the image's "
        "side; no bound if not given.",
        group=_SEAMS,
        low=0,
    )

    def __post_init__(self) -> None:
        check(self)
        for name in ("resolution", "max_shape", "max_texture", "attribute_scale"):
            if getattr(self, name) == math.inf:
                raise UsageError(f"{name} is infinite; leave it out, and give triangles or ratio instead.")
        if self.triangles is not None and self.ratio is not None:
            raise UsageError("triangles and ratio are both given; give one of them.")

    @property
    def has_count(self) -> bool:
        """Whether a number of triangles is wanted."""
        return self.triangles is not None or self.ratio is not None

    def target(self, triangles: int) -> int:
        """Return how many of so many triangles are wanted; 0 if there is no such wish."""
        return math.floor(self.ratio * triangles) if self.ratio is not None else self.triangles or 0

    def chosen(self, *, in_pieces: bool = False) -> str:
        """Return the method that `auto` stands for here, or the one that is given.

        Parameters
        ----------
        in_pieces : whether the mesh has texture, materials, parts or normals of corners.

        Raises
        ------
        UsageError
            If the parameters do not suit the method.
        """
        has_bound = self.max_shape is not None or self.max_texture is not None
        method = self.method
        if method == "auto":
            if self.resolution is not None or self.paper_rule:
                method = "jia01"
            elif not has_bound and self.has_count and (in_pieces or self._names_seams()):
                method = "seams"
            elif has_bound:
                method = "certified"
            else:
                method = "quadric" if self.has_count else "jia01"
        self._require_suited(method)
        if method in ("quadric", "seams") and not self.has_count:
            raise UsageError(f"method {method} needs a number of triangles; give triangles or ratio.")
        if method == "planar" and self.has_count:
            raise UsageError("method planar goes as far as its bounds; leave out triangles and ratio.")
        if method == "certified" and not has_bound:
            raise UsageError("method certified needs a bound; give max_shape, max_texture or both.")
        return method

    def _names_seams(self) -> bool:
        return any(m == ("seams",) and getattr(self, name) is not None for name, m in _ONLY_FOR.items())

    def for_patches(self) -> planar_params.PatchParams:
        """Return what limits the patches of method planar."""
        names = ("max_shape", "max_texture", "patch_angle", "crease_angle", "noise_angle", "threads")
        given = {name: getattr(self, name) for name in names}
        return planar_params.PatchParams(
            **{name: value for name, value in given.items() if value is not None}
        )

    def _require_suited(self, method: str) -> None:
        for name, methods in _ONLY_FOR.items():
            # By default none of these is set; a number that is 0 was given.
            if method in methods or getattr(self, name) is None or getattr(self, name) is False:
                continue
            if self.method == "auto":
                if methods == ("planar",):
                    raise UsageError(f"{name} is for method planar; give method too.")
                raise UsageError(f"{name} is for method {methods[0]}, which needs max_shape or max_texture.")
            raise UsageError(f"{name} has no meaning for method {method}; leave one of them out.")

"""Packing of models into a page of limited size.

Photos are dropped and models are simplified to fit.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.report.page.codes import REPORT_REDUCED
from scanloom.pipeline.report.page.single_file_page import (
    PageCamera,
    PageColoring,
    PageModel,
    PageScale,
    make_single_file_page,
)
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.exporting.image_conversion import convert_images
from scanloom.stages.exporting.presets import preset
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mean_normal import estimate_mean_normal
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.up_direction import rotate_to_z

# Maximum number of rounds of simplification.
_MAX_ROUNDS = 8
_MIN_TRIANGLES = 2_000
_MIN_IMAGE_SIZE = 512
# The first model is the most important: the others start with at most this many triangles, and the first is
# kept unchanged for this many rounds.
_MAX_OTHER_TRIANGLES = 100_000
_ROUNDS_KEEPING_FIRST = 2
# Minimum ratio of a model that one round keeps.
_MIN_KEPT_RATIO = 0.5
# Bytes per triangle, to estimate the initial triangle count: about 8 for a scan, 3 for a smooth surface.
# Encoding millions of triangles that cannot fit would dominate the memory use.
_BYTES_PER_TRIANGLE = 5
# Above this triangle count models are simplified one at a time, which takes about 500 bytes per triangle.
_MAX_PARALLEL_TRIANGLES = 1_000_000
# Safety factor on the bytes to save: bytes per triangle increase as a model is simplified.
_SAFETY_FACTOR = 1.4
# Photos may use one fourth of the page.
_PHOTOS_DIVISOR = 4
# Size factor of base64.
_BASE64_FACTOR = 4 / 3
# Maximum number of colormaps per model: the vertex attribute has four components.
MAX_COLORMAPS = 4


@dataclass(frozen=True, eq=False)
class VertexColormap:
    """Scalar values at the vertices of a model, with a colour scale.

    Attributes
    ----------
    values : (n,) values in the unit of the scale.
    scale : colour scale; values beyond it get its last colours.
    note : short description.
    """

    values: NDArray[np.float64]
    scale: PageScale
    note: str = ""


class PageModelSource(NamedTuple):
    """Source of a page model before packing; see `PageModel`.

    The alternative colourings are up to MAX_COLORMAPS `colormaps`, by name, and the vertex colours of a
    textured mesh. `full_triangle_count` is the triangle count before coarsening; 0 if not coarsened.
    """

    mesh: Mesh
    note: str = ""
    scale: PageScale | None = None
    colormaps: Mapping[str, VertexColormap] = {}
    full_triangle_count: int = 0


# Models by name, most important first.
Models = Mapping[str, PageModelSource]


def make_packed_page(
    title: str,
    models: Models,
    max_bytes: int,
    report_data: Mapping[str, Any] | None = None,
    cameras: Sequence[PageCamera] = (),
) -> bytes:
    """Make a page of at most `max_bytes`, if possible; warn about omitted photos.

    Parameters
    ----------
    title, report_data, cameras : see `make_single_file_page`; `rotation` is added.
    models : models in a common frame, with a common up direction.
    """
    cameras, photos = _limit_photos(cameras, max_bytes // _PHOTOS_DIVISOR)
    if photos:
        emit(
            REPORT_REDUCED.warning(
                "{photos} photos are omitted to keep the page below {most_bytes:,} bytes.",
                photos=photos,
                most_bytes=max_bytes,
            )
        )
    rotation = compute_page_rotation(next(iter(models.values())).mesh)
    report_data = {**(report_data or {}), "rotation": rotation.ravel().tolist()}
    first, *others = (_PackingPlan.from_source(name, shown) for name, shown in models.items())
    plans = [
        first.reduce(max_bytes / (_BYTES_PER_TRIANGLE * max(first.triangles, 1))),
        *(one.reduce(_MAX_OTHER_TRIANGLES / max(one.triangles, 1)) for one in others),
    ]
    done: dict[_PackingPlan, tuple[PageModelSource, PageModel]] = {}
    for attempt in range(_MAX_ROUNDS):
        changed = [plan for plan in plans if plan not in done]
        is_many = sum(len(plan.source.mesh.triangles) for plan in changed) > _MAX_PARALLEL_TRIANGLES
        made = map_ordered(
            _pack_model, changed, threads=1 if is_many else get_worker_count(), max_pending=len(changed)
        )
        done = {plan: done[plan] for plan in plans if plan in done} | dict(zip(changed, made, strict=True))
        packed = [done[plan][1] for plan in plans]
        page = make_single_file_page(title, packed, report_data, cameras)
        if len(page) <= max_bytes:
            return page
        # Models at their minimum size cannot contribute.
        sizes = [
            0.0 if plan.is_minimal(one.triangles) else _BASE64_FACTOR * len(one.glb)
            for plan, one in zip(plans, packed, strict=True)
        ]
        shares = _distribute_reduction(
            sizes, _SAFETY_FACTOR * (len(page) - max_bytes), keep_first=attempt < _ROUNDS_KEEPING_FIRST
        )
        # Simplify the simplified model further, which is faster than starting from the full model.
        plans = [
            plan if share == 1 else replace(plan, source=done[plan][0]).reduce(share)
            for plan, share in zip(plans, shares, strict=True)
        ]
    emit(
        REPORT_REDUCED.warning(
            "the page has {size:,} bytes, more than {most_bytes:,}, and cannot be reduced further.",
            size=len(page),
            most_bytes=max_bytes,
        )
    )
    return page


def compute_page_rotation(mesh: Mesh) -> NDArray[np.float64]:
    """Return the (3, 3) rotation of a mesh to z up.

    z up is the frame of the page. An unknown up direction is y up, as in glTF.
    """
    return rotate_to_z(np.array((0.0, 1.0, 0.0) if mesh.up is None else mesh.up))


def _distribute_reduction(sizes: Sequence[float], excess: float, *, keep_first: bool) -> list[float]:
    """Distribute the bytes to save over the models, as ratios to keep.

    Parameters
    ----------
    sizes : size of each model in bytes, first model first; 0 for a model that cannot be reduced.
    excess : bytes to save in total.
    keep_first : keep the first model unchanged if the others can be reduced.
    """
    other_bytes = sum(sizes[1:])
    other_ratio = min(max(1 - excess / other_bytes, _MIN_KEPT_RATIO), 1.0) if other_bytes else 1.0
    first_excess = excess - (1 - other_ratio) * other_bytes
    keep_first = keep_first and other_bytes > 0
    first_ratio = (
        1.0 if keep_first or not sizes[0] else min(max(1 - first_excess / sizes[0], _MIN_KEPT_RATIO), 1.0)
    )
    return [first_ratio, *[other_ratio] * (len(sizes) - 1)]


def _limit_photos(cameras: Sequence[PageCamera], max_bytes: int) -> tuple[list[PageCamera], int]:
    """Drop every other photo until the rest fits in `max_bytes` bytes.

    Returns the cameras and the number of dropped photos.
    """
    sizes = [0 if camera.photo is None else len(camera.photo) for camera in cameras]
    kept = [number for number, size in enumerate(sizes) if size]
    count = len(kept)
    while sum(sizes[number] for number in kept) > max_bytes:
        kept = kept[1::2]
    chosen = set(kept)
    thinned = [
        camera if number in chosen else replace(camera, photo=None) for number, camera in enumerate(cameras)
    ]
    return thinned, count - len(kept)


@dataclass(frozen=True, eq=False)
class _PackingPlan:
    """Target size of a model in a page.

    Attributes
    ----------
    name, source : model, possibly simplified already.
    full_triangle_count : triangle count of the original.
    triangles, image_size : maximum triangle count, and maximum image side in pixels.
    """

    name: str
    source: PageModelSource
    full_triangle_count: int
    triangles: int
    image_size: int

    @classmethod
    def from_source(cls, name: str, source: PageModelSource) -> _PackingPlan:
        count = len(source.mesh.triangles)
        return cls(name, source, source.full_triangle_count or count, count, preset("web").image_size)

    def is_minimal(self, triangle_count: int) -> bool:
        """Return True if a model with `triangle_count` triangles cannot be reduced further.

        `triangle_count` may exceed the target, because each hole and each component keeps a few triangles.
        """
        has_image = self.source.mesh.texture is not None and self.image_size > _MIN_IMAGE_SIZE
        return (self.triangles <= _MIN_TRIANGLES or triangle_count > self.triangles) and not has_image

    def reduce(self, ratio: float) -> _PackingPlan:
        """Scale the triangle and texel counts by a ratio below 1."""
        if ratio >= 1:
            return self
        triangles = max(round(ratio * self.triangles), min(_MIN_TRIANGLES, self.triangles))
        size = max(round(math.sqrt(ratio) * self.image_size), _MIN_IMAGE_SIZE)
        return replace(self, triangles=triangles, image_size=size)


def _simplify_model(source: PageModelSource, triangles: int) -> PageModelSource:
    mesh = source.mesh
    found = simplify(mesh, triangles=triangles, keep_uv=True)
    simplified = found.mesh.with_(up=mesh.up)
    if simplified.colors is None and mesh.colors is not None:
        simplified = simplified.with_(colors=found.map_vertex_values(mesh.colors))
    colormaps = {
        name: replace(one, values=found.map_vertex_values(one.values))
        for name, one in source.colormaps.items()
    }
    return source._replace(mesh=simplified, colormaps=colormaps)


def _pack_model(plan: _PackingPlan) -> tuple[PageModelSource, PageModel]:
    """Simplify a model to its target and encode it as GLB."""
    # Drop diagnostics about the reduced model: the full model is a separate file.
    with collecting(forward=False):
        return _encode_model(plan)


def _encode_model(plan: _PackingPlan) -> tuple[PageModelSource, PageModel]:
    source = plan.source
    if plan.triangles < len(source.mesh.triangles):
        source = _simplify_model(source, plan.triangles)
    mesh, note, scale, colormaps, _ = source
    count = len(mesh.triangles)
    words = (
        f"reduced from {plan.full_triangle_count:,} for this page" if count < plan.full_triangle_count else ""
    )
    colorings = [
        PageColoring(name, channel, ", ".join(filter(None, (paint.note, words))), paint.scale)
        for channel, (name, paint) in enumerate(colormaps.items())
    ]
    if mesh.texture is not None and mesh.colors is not None:
        colorings.append(PageColoring("vertex colours", None, words))
    # Higher quality than for the web: users zoom into the page, and its size limit is larger.
    web = replace(preset("web"), position_bits=16, texel_steps=0, quality=85)
    written = convert_images(mesh, web.images, web.quality, plan.image_size)
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        path = Path(folder) / "model.glb"
        write_gltf(
            path, written, compress=web.compress, shading=web.shading, values=_encode_values(colormaps)
        )
        glb = read_input_bytes(path)
    facing = estimate_mean_normal(mesh, compute_page_rotation(mesh))
    words = ", ".join(filter(None, (note, words)))
    return source, PageModel(plan.name, glb, count, words, facing, scale, tuple(colorings))


def _encode_values(colormaps: Mapping[str, VertexColormap]) -> NDArray[np.uint8] | None:
    """Encode colormap values as a GLB vertex attribute, (n, 4) uint8.

    Returns None without colormaps.
    """
    if not colormaps:
        return None
    columns = [_encode_ratios(paint) for paint in colormaps.values()]
    columns += [np.zeros_like(columns[0])] * (MAX_COLORMAPS - len(columns))
    return np.stack(columns, axis=1)


def _encode_ratios(colormap: VertexColormap) -> NDArray[np.uint8]:
    low, high = colormap.scale.low, colormap.scale.high
    shares = ((colormap.values - low) / (high - low)).clip(0, 1)
    return np.asarray(np.rint(255 * shares), np.uint8)

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
from scanloom.pipeline.report.page.one_file import PageCamera, PageLook, PageModel, PageScale, one_file
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.exporting.images import with_images
from scanloom.stages.exporting.presets import preset
from scanloom.stages.files.opening import content_of
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mean_normal import estimate_mean_normal
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.upright import turn_along_z

# Maximum number of rounds of simplification.
_ATTEMPTS = 8
_LEAST_TRIANGLES = 2_000
_LEAST_IMAGE = 512
# The first model is the most important: the others start with at most this many triangles, and the first is
# kept unchanged for this many rounds.
_MOST_BESIDE = 100_000
_LAST = 2
# Minimum ratio of a model that one round keeps.
_AT_ONCE = 0.5
# Bytes per triangle, to estimate the initial triangle count: about 8 for a scan, 3 for a smooth surface.
# Encoding millions of triangles that cannot fit would dominate the memory use.
_BYTES_EACH = 5
# Above this triangle count models are simplified one at a time, which takes about 500 bytes per triangle.
_MANY = 1_000_000
# Safety factor on the bytes to save: bytes per triangle increase as a model is simplified.
_SPARE = 1.4
# Photos may use one fourth of the page.
_PHOTOS_SHARE = 4
# Size factor of base64.
_GROWN = 4 / 3
# Maximum number of colormaps per model: the vertex attribute has four components.
MOST_PAINTS = 4


@dataclass(frozen=True, eq=False)
class Paint:
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


class Shown(NamedTuple):
    """Source of a page model before packing; see `PageModel`.

    The alternative colourings are up to MOST_PAINTS `paints`, by name, and the vertex colours of a textured
    mesh. `complete` is the triangle count before coarsening; 0 if not coarsened.
    """

    mesh: Mesh
    note: str = ""
    scale: PageScale | None = None
    paints: Mapping[str, Paint] = {}
    complete: int = 0


# Models by name, most important first.
Models = Mapping[str, Shown]


def packed_page(
    title: str,
    models: Models,
    most_bytes: int,
    told: Mapping[str, Any] | None = None,
    cameras: Sequence[PageCamera] = (),
) -> bytes:
    """Make a page of at most `most_bytes`, if possible; warn about omitted photos.

    Parameters
    ----------
    title, told, cameras : see `one_file`.
    models : models in a common frame, with a common up direction.
    """
    cameras, photos = _with_photos_within(cameras, most_bytes // _PHOTOS_SHARE)
    if photos:
        emit(
            REPORT_REDUCED.warning(
                "{photos} photos are omitted to keep the page below {most_bytes:,} bytes.",
                photos=photos,
                most_bytes=most_bytes,
            )
        )
    first, *others = (_Plan.of(name, shown) for name, shown in models.items())
    plans = [
        first.lighter(most_bytes / (_BYTES_EACH * max(first.triangles, 1))),
        *(one.lighter(_MOST_BESIDE / max(one.triangles, 1)) for one in others),
    ]
    done: dict[_Plan, tuple[Shown, PageModel]] = {}
    for attempt in range(_ATTEMPTS):
        changed = [plan for plan in plans if plan not in done]
        is_many = sum(len(plan.shown.mesh.triangles) for plan in changed) > _MANY
        made = read_ahead(_packed, changed, threads=1 if is_many else workers(), ahead=len(changed))
        done = {plan: done[plan] for plan in plans if plan in done} | dict(zip(changed, made, strict=True))
        packed = [done[plan][1] for plan in plans]
        page = one_file(title, packed, told, cameras)
        if len(page) <= most_bytes:
            return page
        # Models at their minimum size cannot contribute.
        sizes = [
            0.0 if plan.is_least(one.triangles) else _GROWN * len(one.glb)
            for plan, one in zip(plans, packed, strict=True)
        ]
        shares = _shares(sizes, _SPARE * (len(page) - most_bytes), is_first_kept=attempt < _LAST)
        # Simplify the simplified model further, which is faster than starting from the full model.
        plans = [
            plan if share == 1 else replace(plan, shown=done[plan][0]).lighter(share)
            for plan, share in zip(plans, shares, strict=True)
        ]
    emit(
        REPORT_REDUCED.warning(
            "the page has {size:,} bytes, more than {most_bytes:,}, and cannot be reduced further.",
            size=len(page),
            most_bytes=most_bytes,
        )
    )
    return page


def turn_of_page(mesh: Mesh) -> NDArray[np.float64]:
    """Return the (3, 3) rotation of a mesh to z up.

    z up is the frame of the page. An unknown up direction is y up, as in glTF.
    """
    return turn_along_z(np.array((0.0, 1.0, 0.0) if mesh.up is None else mesh.up))


def _shares(sizes: Sequence[float], excess: float, *, is_first_kept: bool) -> list[float]:
    """Distribute the bytes to save over the models, as ratios to keep.

    Parameters
    ----------
    sizes : size of each model in bytes, first model first; 0 for a model that cannot be reduced.
    excess : bytes to save in total.
    is_first_kept : keep the first model unchanged if the others can be reduced.
    """
    beside = sum(sizes[1:])
    share = min(max(1 - excess / beside, _AT_ONCE), 1.0) if beside else 1.0
    left = excess - (1 - share) * beside
    is_first_kept = is_first_kept and beside > 0
    of_first = 1.0 if is_first_kept or not sizes[0] else min(max(1 - left / sizes[0], _AT_ONCE), 1.0)
    return [of_first, *[share] * (len(sizes) - 1)]


def _with_photos_within(cameras: Sequence[PageCamera], most: int) -> tuple[list[PageCamera], int]:
    """Drop every other photo until the rest fits in `most` bytes.

    Returns the cameras and the number of dropped photos.
    """
    sizes = [0 if camera.photo is None else len(camera.photo) for camera in cameras]
    kept = [number for number, size in enumerate(sizes) if size]
    count = len(kept)
    while sum(sizes[number] for number in kept) > most:
        kept = kept[1::2]
    chosen = set(kept)
    thinned = [
        camera if number in chosen else replace(camera, photo=None) for number, camera in enumerate(cameras)
    ]
    return thinned, count - len(kept)


@dataclass(frozen=True, eq=False)
class _Plan:
    """Target size of a model in a page.

    Attributes
    ----------
    name, shown : model, possibly simplified already.
    complete : triangle count of the original.
    triangles, image_size : maximum triangle count, and maximum image side in pixels.
    """

    name: str
    shown: Shown
    complete: int
    triangles: int
    image_size: int

    @classmethod
    def of(cls, name: str, shown: Shown) -> _Plan:
        count = len(shown.mesh.triangles)
        return cls(name, shown, shown.complete or count, count, preset("web").image_size)

    def is_least(self, made: int) -> bool:
        """Return True if a model with `made` triangles cannot be reduced further.

        `made` may exceed the target, because each hole and each component keeps a few triangles.
        """
        has_image = self.shown.mesh.texture is not None and self.image_size > _LEAST_IMAGE
        return (self.triangles <= _LEAST_TRIANGLES or made > self.triangles) and not has_image

    def lighter(self, share: float) -> _Plan:
        """Scale the triangle and texel counts by a ratio below 1."""
        if share >= 1:
            return self
        triangles = max(round(share * self.triangles), min(_LEAST_TRIANGLES, self.triangles))
        size = max(round(math.sqrt(share) * self.image_size), _LEAST_IMAGE)
        return replace(self, triangles=triangles, image_size=size)


def _simplified(shown: Shown, triangles: int) -> Shown:
    mesh = shown.mesh
    found = simplify(mesh, triangles=triangles, keep_uv=True)
    light = found.mesh.with_(up=mesh.up)
    if light.colors is None and mesh.colors is not None:
        light = light.with_(colors=found.follow(mesh.colors))
    paints = {name: replace(one, values=found.follow(one.values)) for name, one in shown.paints.items()}
    return shown._replace(mesh=light, paints=paints)


def _packed(plan: _Plan) -> tuple[Shown, PageModel]:
    """Simplify a model to its target and encode it as GLB."""
    # Drop diagnostics about the reduced model: the full model is a separate file.
    with collecting(forward=False):
        return _as_file(plan)


def _as_file(plan: _Plan) -> tuple[Shown, PageModel]:
    shown = plan.shown
    if plan.triangles < len(shown.mesh.triangles):
        shown = _simplified(shown, plan.triangles)
    mesh, note, scale, paints, _ = shown
    count = len(mesh.triangles)
    words = f"reduced from {plan.complete:,} for this page" if count < plan.complete else ""
    looks = [
        PageLook(name, channel, ", ".join(filter(None, (paint.note, words))), paint.scale)
        for channel, (name, paint) in enumerate(paints.items())
    ]
    if mesh.texture is not None and mesh.colors is not None:
        looks.append(PageLook("vertex colours", None, words))
    # Higher quality than for the web: users zoom into the page, and its size limit is larger.
    web = replace(preset("web"), position_bits=16, texel_steps=0, quality=85)
    written = with_images(mesh, web.images, web.quality, plan.image_size)
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        path = Path(folder) / "model.glb"
        write_gltf(path, written, compress=web.compress, shading=web.shading, values=_values(paints))
        glb = content_of(path)
    look = estimate_mean_normal(mesh, turn_of_page(mesh))
    words = ", ".join(filter(None, (note, words)))
    return shown, PageModel(plan.name, glb, count, words, look, scale, tuple(looks))


def _values(paints: Mapping[str, Paint]) -> NDArray[np.uint8] | None:
    """Encode colormap values as a GLB vertex attribute, (n, 4) uint8.

    Returns None without colormaps.
    """
    if not paints:
        return None
    columns = [_as_share(paint) for paint in paints.values()]
    columns += [np.zeros_like(columns[0])] * (MOST_PAINTS - len(columns))
    return np.stack(columns, axis=1)


def _as_share(paint: Paint) -> NDArray[np.uint8]:
    low, high = paint.scale.low, paint.scale.high
    shares = ((paint.values - low) / (high - low)).clip(0, 1)
    return np.asarray(np.rint(255 * shares), np.uint8)

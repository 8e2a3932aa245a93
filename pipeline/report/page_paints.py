"""Looks of a run's result beside its own on the page: how far it is off, and how well it was seen."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from scanloom.pipeline.evaluation.deviations import Kept
from scanloom.pipeline.report.page.one_file import PageScale
from scanloom.pipeline.report.page.packing import Paint
from scanloom.stages.comparing.palette import colors_of
from scanloom.stages.files.images import read_stored
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats

# Of the scale of deviations.
_STEPS = 40
# Of the range of colours, what is well where no bound was asked for; and the share of the surface that is
# nearer than the last colour.
_WELL = 0.1
_IN_RANGE = "99"
# Of numbers of photos, from few to many: dark to light, told apart by all eyes; and of none.
_FEW_TO_MANY = np.array(((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37.0)))
_UNSEEN = (128, 128, 128)
# Of the scale of spreads, and the share of vertices whose spread is within it.
_SPREAD_STEPS, _SPREAD_IN_RANGE = 20, 0.98
# Numbers written beside their scale, about.
_MARKS = 4
_TINY = float(np.finfo(np.float64).tiny)
# In a triangle, near its corners.
_NEAR_CORNERS = np.full((3, 3), 1 / 6) + 0.5 * np.eye(3)


def deviation_paint(kept: Kept, bound: float | None, *, is_metric: bool) -> Paint:
    """Return deviations as a look.

    Parameters
    ----------
    bound : metres that were asked for; within it is well.
    is_metric : lengths are metres, else units of the scan.
    """
    most = max(float(kept.figures["absolute_percentiles_m"][_IN_RANGE]), 2 * (bound or 0.0), _TINY)
    within = bound if bound is not None else _WELL * most
    is_signed = bool(kept.figures["is_signed"])
    edges = np.linspace(-most if is_signed else 0.0, most, _STEPS + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    # What lies beyond the scale has its last colours.
    ends = [-np.inf, *edges[1:-1], np.inf]
    shares = [round(kept.share_within(*pair), 5) for pair in pairwise(ends)]
    unit, per = ("mm", 1000) if is_metric else ("units", 1)
    scale = PageScale(
        unit=unit,
        low=per * float(edges[0]),
        high=per * float(most),
        within=per * within,
        colors=_as_css(colors_of(middles, within, most)),
        shares=shares,
        safe=_as_css(colors_of(middles, within, most, "safe")),
    )
    return Paint(per * kept.at_vertices, scale, "of the result from the clean mesh")


def confidence_paint(mesh: Mesh, maps: Path) -> Paint | None:
    """Return as a look how many photos show each place; None where the maps of a texture do not tell it.

    Parameters
    ----------
    mesh : with the texture.
    maps : folder of its maps; see `scanloom.stages.texturing.maps`.
    """
    texture = mesh.texture
    if texture is None or not texture.has_uvs().all():
        return None
    files = [maps / f"count-{number}.png" for number in range(1, len(texture.materials) + 1)]
    if not files or not all(file.is_file() for file in files):
        return None
    counts = np.zeros((*texture.material_ids.shape, 3))
    for number, file in enumerate(files):
        image = read_stored(file)
        if image.ndim != 2:
            return None
        chosen = texture.material_ids == number
        height, width = image.shape
        at = np.einsum("kc,tcx->tkx", _NEAR_CORNERS, texture.uvs[chosen])
        columns = np.floor(at[..., 0] * width).clip(0, width - 1).astype(np.int64)
        rows = np.floor((1 - at[..., 1]) * height).clip(0, height - 1).astype(np.int64)
        counts[chosen] = image[rows, columns]
    most = max(int(counts.max(initial=0)), 1)
    note = f"photos that show a place, of which {most} count at most"
    return Paint(_at_vertices(mesh, counts), _photo_scale(mesh, counts, most), note)


def spread_paint(mesh: Mesh, spread: Floats, *, is_metric: bool) -> Paint:
    """Return as a look how much frames disagree about where each place is.

    Parameters
    ----------
    spread : (n,) of the vertices, metres; NaN for those that no frame measured.
    is_metric : lengths are metres, else units of the scan.
    """
    unit, per = ("mm", 1000) if is_metric else ("units", 1)
    known = np.isfinite(spread)
    most = per * float(np.quantile(spread[known], _SPREAD_IN_RANGE)) if known.any() else 0.0
    step = max(most, _TINY) / _SPREAD_STEPS
    # Before the scale begins stands what nobody measured.
    values = np.where(known, per * spread, -step / 2)
    a, b, c = (mesh.vertices[corner] for corner in mesh.triangles.T)
    area = np.repeat(np.linalg.norm(np.cross(b - a, c - a), axis=1), 3)
    steps = np.floor(values[mesh.triangles.reshape(-1)] / step).clip(-1, _SPREAD_STEPS - 1).astype(np.int64)
    shares = np.bincount(steps + 1, area, minlength=_SPREAD_STEPS + 1)
    places = np.linspace(0, len(_FEW_TO_MANY) - 1, _SPREAD_STEPS)
    colors = [np.interp(places, np.arange(len(_FEW_TO_MANY)), channel) for channel in _FEW_TO_MANY.T]
    scale = PageScale(
        unit=unit,
        low=-step,
        high=_SPREAD_STEPS * step,
        within=None,
        colors=_as_css(np.rint(np.vstack([_UNSEEN, np.stack(colors, axis=1)]))),
        shares=(shares / max(shares.sum(), _TINY)).round(5).tolist(),
        marks=[0.0, most / 2, most],
    )
    return Paint(values, scale, "how far off the surface frames measured it, RMS; grey where none did")


def _at_vertices(mesh: Mesh, counts: Floats) -> Floats:
    """Return the mean at each vertex of what there is at its corners (m, 3)."""
    corners, used = mesh.triangles.reshape(-1), len(mesh.vertices)
    total = np.bincount(corners, counts.reshape(-1), minlength=used)
    return np.asarray(total / np.maximum(np.bincount(corners, minlength=used), 1))


def _photo_scale(mesh: Mesh, counts: Floats, most: int) -> PageScale:
    a, b, c = (mesh.vertices[corner] for corner in mesh.triangles.T)
    area = np.repeat(np.linalg.norm(np.cross(b - a, c - a), axis=1), 3)
    shares = np.bincount(counts.reshape(-1).astype(np.int64), area, minlength=most + 1)
    places = np.linspace(0, len(_FEW_TO_MANY) - 1, most)
    colors = np.stack(
        [np.interp(places, np.arange(len(_FEW_TO_MANY)), channel) for channel in _FEW_TO_MANY.T], axis=1
    )
    step = max(round(most / _MARKS), 1)
    return PageScale(
        unit="photos",
        # Numbers stand in the middle of their step.
        low=-0.5,
        high=most + 0.5,
        within=None,
        colors=_as_css(np.rint(np.vstack([_UNSEEN, colors]))),
        shares=(shares / max(shares.sum(), _TINY)).round(5).tolist(),
        marks=[float(count) for count in range(0, most + 1, step)],
    )


def _as_css(colors: np.ndarray) -> list[str]:
    return [f"rgb({r}, {g}, {b})" for r, g, b in colors.astype(int).tolist()]

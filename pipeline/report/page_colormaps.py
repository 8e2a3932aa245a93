"""Colormaps of the result: deviation, photo count and depth spread."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from scanloom.pipeline.evaluation.stored_deviations import StoredDeviations
from scanloom.pipeline.report.page.packing import VertexColormap
from scanloom.pipeline.report.page.single_file_page import PageScale
from scanloom.stages.comparing.deviation_palette import colorize_distances
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats

# Steps of the deviation scale.
_STEPS = 40
# Default tolerance as a ratio of the colour range, and the percentile of deviations that the range covers.
_DEFAULT_TOLERANCE_RATIO = 0.1
_RANGE_PERCENTILE = "99"
# Colours from few to many photos (viridis, readable for the colour-blind), and the colour for none.
_SEQUENTIAL_COLORS = np.array(((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37.0)))
_UNOBSERVED_COLOR = (128, 128, 128)
# Steps of the spread scale, and the quantile of vertices that it covers.
_SPREAD_STEPS, _SPREAD_QUANTILE = 20, 0.98
# Approximate number of labels of the photo scale.
_LABEL_COUNT = 4
_TINY = float(np.finfo(np.float64).tiny)
# Barycentric coordinates of sample points near the three corners of a triangle.
_CORNER_WEIGHTS = np.full((3, 3), 1 / 6) + 0.5 * np.eye(3)


def make_deviation_colormap(
    deviations: StoredDeviations, bound: float | None, *, is_metric: bool
) -> VertexColormap:
    """Make the colormap of deviations.

    Parameters
    ----------
    bound : requested maximum deviation in metres; smaller deviations are shown as in tolerance.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    max_deviation = max(
        float(deviations.metrics["absolute_percentiles_m"][_RANGE_PERCENTILE]), 2 * (bound or 0.0), _TINY
    )
    within = bound if bound is not None else _DEFAULT_TOLERANCE_RATIO * max_deviation
    is_signed = bool(deviations.metrics["is_signed"])
    edges = np.linspace(-max_deviation if is_signed else 0.0, max_deviation, _STEPS + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    # Deviations beyond the scale count for its last steps.
    ends = [-np.inf, *edges[1:-1], np.inf]
    shares = [round(deviations.compute_ratio_within(*pair), 5) for pair in pairwise(ends)]
    unit, unit_factor = ("mm", 1000) if is_metric else ("units", 1)
    scale = PageScale(
        unit=unit,
        low=unit_factor * float(edges[0]),
        high=unit_factor * float(max_deviation),
        within=unit_factor * within,
        colors=_to_css(colorize_distances(middles, within, max_deviation)),
        shares=shares,
        safe=_to_css(colorize_distances(middles, within, max_deviation, "safe")),
    )
    return VertexColormap(
        unit_factor * deviations.at_vertices, scale, "deviation of the result from the refined mesh"
    )


def make_photo_count_colormap(mesh: Mesh, maps: Path) -> VertexColormap | None:
    """Make the colormap of the photo count per surface point.

    Returns None without valid maps.

    Parameters
    ----------
    mesh : textured mesh.
    maps : folder of the per-texel maps; see `scanloom.stages.texturing.provenance_maps`.
    """
    texture = mesh.texture
    if texture is None or not texture.has_uvs().all():
        return None
    files = [maps / f"count-{number}.png" for number in range(1, len(texture.materials) + 1)]
    if not files or not all(file.is_file() for file in files):
        return None
    counts = np.zeros((*texture.material_ids.shape, 3))
    for number, file in enumerate(files):
        image = read_stored_image(file)
        if image.ndim != 2:
            return None
        chosen = texture.material_ids == number
        height, width = image.shape
        at = np.einsum("kc,tcx->tkx", _CORNER_WEIGHTS, texture.uvs[chosen])
        columns = np.floor(at[..., 0] * width).clip(0, width - 1).astype(np.int64)
        rows = np.floor((1 - at[..., 1]) * height).clip(0, height - 1).astype(np.int64)
        counts[chosen] = image[rows, columns]
    max_count = max(int(counts.max(initial=0)), 1)
    note = f"number of photos per surface point, at most {max_count}"
    return VertexColormap(
        _average_at_vertices(mesh, counts), _make_photo_scale(mesh, counts, max_count), note
    )


def make_spread_colormap(mesh: Mesh, spread: Floats, *, is_metric: bool) -> VertexColormap:
    """Make the colormap of the disagreement of frames about the position of the surface.

    Parameters
    ----------
    spread : (n,) RMS distance of the measurements at each vertex, in metres; NaN if not measured.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    unit, unit_factor = ("mm", 1000) if is_metric else ("units", 1)
    known = np.isfinite(spread)
    max_spread = unit_factor * float(np.quantile(spread[known], _SPREAD_QUANTILE)) if known.any() else 0.0
    step = max(max_spread, _TINY) / _SPREAD_STEPS
    # Vertices that no frame measured get the grey step below zero.
    values = np.where(known, unit_factor * spread, -step / 2)
    a, b, c = (mesh.vertices[corner] for corner in mesh.triangles.T)
    area = np.repeat(np.linalg.norm(np.cross(b - a, c - a), axis=1), 3)
    steps = np.floor(values[mesh.triangles.reshape(-1)] / step).clip(-1, _SPREAD_STEPS - 1).astype(np.int64)
    shares = np.bincount(steps + 1, area, minlength=_SPREAD_STEPS + 1)
    places = np.linspace(0, len(_SEQUENTIAL_COLORS) - 1, _SPREAD_STEPS)
    colors = [
        np.interp(places, np.arange(len(_SEQUENTIAL_COLORS)), channel) for channel in _SEQUENTIAL_COLORS.T
    ]
    scale = PageScale(
        unit=unit,
        low=-step,
        high=_SPREAD_STEPS * step,
        within=None,
        colors=_to_css(np.rint(np.vstack([_UNOBSERVED_COLOR, np.stack(colors, axis=1)]))),
        shares=(shares / max(shares.sum(), _TINY)).round(5).tolist(),
        marks=[0.0, max_spread / 2, max_spread],
    )
    return VertexColormap(
        values, scale, "RMS distance of depth measurements from the surface; grey if not measured"
    )


def _average_at_vertices(mesh: Mesh, counts: Floats) -> Floats:
    """Average corner values (m, 3) at the vertices (n,)."""
    corners, used = mesh.triangles.reshape(-1), len(mesh.vertices)
    total = np.bincount(corners, counts.reshape(-1), minlength=used)
    return np.asarray(total / np.maximum(np.bincount(corners, minlength=used), 1))


def _make_photo_scale(mesh: Mesh, counts: Floats, max_count: int) -> PageScale:
    a, b, c = (mesh.vertices[corner] for corner in mesh.triangles.T)
    area = np.repeat(np.linalg.norm(np.cross(b - a, c - a), axis=1), 3)
    shares = np.bincount(counts.reshape(-1).astype(np.int64), area, minlength=max_count + 1)
    places = np.linspace(0, len(_SEQUENTIAL_COLORS) - 1, max_count)
    colors = np.stack(
        [np.interp(places, np.arange(len(_SEQUENTIAL_COLORS)), channel) for channel in _SEQUENTIAL_COLORS.T],
        axis=1,
    )
    step = max(round(max_count / _LABEL_COUNT), 1)
    return PageScale(
        unit="photos",
        # Centre each step on an integer.
        low=-0.5,
        high=max_count + 0.5,
        within=None,
        colors=_to_css(np.rint(np.vstack([_UNOBSERVED_COLOR, colors]))),
        shares=(shares / max(shares.sum(), _TINY)).round(5).tolist(),
        marks=[float(count) for count in range(0, max_count + 1, step)],
    )


def _to_css(colors: np.ndarray) -> list[str]:
    return [f"rgb({r}, {g}, {b})" for r, g, b in colors.astype(int).tolist()]

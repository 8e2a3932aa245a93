"""Runs xatlas, as a process of its own: `python -m stages.baking.atlas_worker GIVEN.npz FOUND.npz`.

xatlas is native code that ends its process on some meshes (a finely triangulated sphere is one); see
stages.baking.atlas, which starts this.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.baking.rasterize import overlaps
from stages.edges import components

Floats = NDArray[np.float64]

# Of charts: with the library's 2, a few charts come out so stretched that a hundredth of a fused room has a
# third of its texels; beyond 4 nothing changes.
_MAX_COST = 4.0
# Of the whole surface: without a limit the search for charts takes half as long again, for no fewer charts.
_MOST_OF_AREA = 1 / 8
# A triangle with less than this share of the texels it should have is laid out on its own.
_LEAST_SHARE = 1e-3
# Packing again, each time a little denser or sparser, to fill the image.
_PACKINGS = 8
# How often what still overlaps is taken out of its chart.
_REPAIRS = 3
# Aim a little below the full size: charts do not shrink quite in proportion, for padding and rounding.
_AIM = 0.985


def main(given: str, found: str) -> None:
    """Read what `stages.baking.atlas` gives, and write what it wants."""
    with np.load(given) as arrays:
        corners, charts = charted(arrays["vertices"], arrays["triangles"], arrays["groups"])
        placed, size = arrays["vertices"].astype(np.float64)[arrays["triangles"]], int(arrays["size"])
        padding = int(arrays["padding"])
        density = 0.8 * size / float(np.sqrt(np.abs(_signed_areas(corners)).sum()))
        for _ in range(1 + _REPAIRS):
            uvs, density = packed(corners, charts, size, padding, density)
            bad = overlaps(uvs, size).triangles
            if not len(bad):
                break
            corners, charts = _apart(corners, charts, placed, bad)
    np.savez(found, uvs=uvs, charts=charts)


def charted(
    vertices: NDArray[np.float32], triangles: NDArray[np.uint32], groups: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int64]]:
    """Cut a surface into charts and flatten each.

    Parameters
    ----------
    vertices, triangles : all triangles have an area; edges are some hundreds long.
    groups : (m,) triangles of different groups are in different charts.

    Returns
    -------
    (m, 3, 2) corners in units of the vertices, as on a plane for each chart, and (m,) the charts.
    """
    import xatlas

    atlas = xatlas.Atlas()
    members = [np.flatnonzero(groups == group) for group in np.unique(groups)]
    for rows in members:
        used, indices = np.unique(triangles[rows], return_inverse=True)
        atlas.add_mesh(vertices[used], indices.reshape(-1, 3).astype(np.uint32))
    areas = _areas(vertices.astype(np.float64)[triangles])
    options = xatlas.ChartOptions()
    options.max_cost = _MAX_COST
    options.max_chart_area = float(areas.sum()) * _MOST_OF_AREA
    packing = xatlas.PackOptions()
    packing.resolution = 1024
    atlas.generate(options, packing)
    corners = np.empty((len(triangles), 3, 2))
    charts = np.empty(len(triangles), np.int64)
    count = 0
    for number, rows in enumerate(members):
        _, indices, uvs = atlas.get_mesh(number)
        corners[rows] = uvs[indices]
        labels = _connected(indices, len(uvs))
        charts[rows] = count + labels
        count += int(labels.max()) + 1
    corners *= (atlas.width, atlas.height)
    corners *= np.sqrt(areas.sum() / np.abs(_signed_areas(corners)).sum())
    return _with_bad_ones_apart(corners, charts, vertices.astype(np.float64)[triangles], areas)


def packed(
    corners: Floats, charts: NDArray[np.int64], size: int, padding: int, density: float
) -> tuple[Floats, float]:
    """Arrange charts in a square image, as large as they fit.

    Parameters
    ----------
    density : texels in a unit of length, to start with.

    Returns
    -------
    Corners (m, 3, 2) in texels, and the density that fitted.

    Raises
    ------
    ValueError
        If they do not fit, for so many need more padding than there is room.
    """
    best, best_density, too_much = None, 0.0, np.inf
    for _ in range(_PACKINGS):
        uvs, extent = _packed(corners, charts, density, padding)
        if extent <= size and density > best_density:
            best, best_density = uvs, density
        if extent > size:
            too_much = min(too_much, density)
        if best_density > 0.96 * too_much or 0.95 * size < extent <= size:
            break
        density = density * _AIM * size / extent
        if density >= too_much:
            density = (best_density + too_much) / 2
    if best is None:
        raise ValueError("the charts do not fit")
    return best, best_density


def _packed(corners: Floats, charts: NDArray[np.int64], density: float, padding: int) -> tuple[Floats, int]:
    import xatlas

    wedges, indices = np.unique(
        np.column_stack([np.repeat(charts, 3), corners.reshape(-1, 2)]), axis=0, return_inverse=True
    )
    atlas = xatlas.Atlas()
    atlas.add_uv_mesh(
        wedges[:, 1:].astype(np.float32),
        indices.reshape(-1, 3).astype(np.uint32),
        charts.astype(np.uint32)[:, None],
    )
    options = xatlas.PackOptions()
    options.texels_per_unit = density
    options.padding = padding
    atlas.generate(xatlas.ChartOptions(), options)
    _, found, uvs = atlas.get_mesh(0)
    extent = (atlas.width, atlas.height)
    return uvs[found].astype(np.float64) * extent, max(extent)


def _with_bad_ones_apart(
    corners: Floats, charts: NDArray[np.int64], placed: Floats, areas: Floats
) -> tuple[Floats, NDArray[np.int64]]:
    """Lay out on its own what lies on others in its chart, or has hardly any area in it."""
    signed = _signed_areas(corners)
    orientation = np.sign(np.bincount(charts, signed))[charts]
    (bad,) = np.nonzero(signed * orientation < _LEAST_SHARE * areas)
    return _apart(corners, charts, placed, bad)


def _apart(
    corners: Floats, charts: NDArray[np.int64], placed: Floats, bad: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int64]]:
    """Make a chart of its own of each bad triangle, in its true shape."""
    corners, charts = corners.copy(), charts.copy()
    corners[bad] = _flat(placed[bad])
    charts[bad] = charts.max() + 1 + np.arange(len(bad))
    return corners, charts


def _flat(corners: Floats) -> Floats:
    """Return triangles (k, 3, 3) laid in a plane, (k, 3, 2), by their longest side."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    order = (lengths.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(corners, order[:, :, None], axis=1).swapaxes(0, 1)
    base = np.linalg.norm(b - a, axis=1)
    along = ((c - a) * (b - a)).sum(axis=1) / base
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / base
    zero = np.zeros_like(base)
    flat = np.stack([zero, zero, base, zero, along, height], axis=1).reshape(-1, 3, 2)
    return np.take_along_axis(flat, np.argsort(order, axis=1)[:, :, None], axis=1)


def _areas(corners: Floats) -> Floats:
    sides = corners[:, 1:] - corners[:, :1]
    return np.asarray(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2)


def _signed_areas(corners: Floats) -> Floats:
    (x1, y1), (x2, y2) = ((corners[:, i] - corners[:, 0]).T for i in (1, 2))
    return np.asarray((x1 * y2 - y1 * x2) / 2)


def _connected(indices: NDArray[Any], count: int) -> NDArray[np.int64]:
    triangles = indices.astype(np.int64)
    _, labels = components(count, triangles[:, :2].ravel(), triangles[:, 1:].ravel())
    # Vertices nobody uses have numbers too; charts are counted without gaps.
    return np.asarray(np.unique(labels[triangles[:, 0]], return_inverse=True)[1].reshape(-1), np.int64)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Page of a comparison: both models, the deviation between them, and the changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.report.page.one_file import PageScale
from scanloom.pipeline.report.page.packing import Shown, packed_page, turn_of_page
from scanloom.pipeline.report.page_told import deviation_tables
from scanloom.stages.comparing.change import Changes
from scanloom.stages.comparing.deviations import Deviations
from scanloom.stages.comparing.palette import colors_of
from scanloom.stages.picturing.spots import spots
from scanloom.stages.printing import place_in_words
from scanloom.stages.surface.cloud import is_cloud
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.vertex_normals import vertex_normals

# Maximum number of points shown of a point cloud.
_MOST_SPOTS = 40_000
# Camera distance after flying to a location, as a ratio of the model size.
_NEAR = 0.25
# Ambient light intensity, and direction of the light.
_AMBIENT, _LIGHT = 0.5, np.array((0.35, 0.55, 0.75)) / np.linalg.norm((0.35, 0.55, 0.75))
_WAYS = {"a_to_b": "A to B", "b_to_a": "B to A", "symmetric": "both ways"}
# Steps of the colour scale.
_STEPS = 40
# Colour names for positive, negative and near-zero deviations, by palette.
_COLORS = {"metrology": ("red", "blue", "green"), "safe": ("orange", "blue", "white")}


def page_of_comparison(
    names: tuple[str, str],
    meshes: tuple[Mesh, Mesh],
    found: Deviations,
    moved: Changes | None,
    figures: Mapping[str, Any],
    most_bytes: int,
    palette: str = "metrology",
) -> bytes:
    """Make the page of a comparison of two models A and B.

    Parameters
    ----------
    names : names of A and B.
    meshes : A and B; point clouds are shown as small triangles.
    found : deviation of B from A, coloured with `palette`.
    moved : parts added in B and missing from A, if requested.
    figures : metrics of the command `compare`.
    most_bytes : target size of the page; a warning is emitted if the page remains larger.
    palette : "metrology" or "safe".
    """
    up = meshes[0].up or meshes[1].up
    about = _range_in_words(found.is_signed, palette)
    models = {
        "deviation of B from A": _shown(found.painted, up, about)._replace(scale=_scale_of(found, palette))
    }
    for letter, name, mesh in zip("AB", names, meshes, strict=True):
        models[f"{letter}: {name}"] = _shown(mesh, up)
    if moved is not None:
        about = "green: added in B; red: missing from A"
        models["change"] = _shown(_shaded(moved.painted), up, about)
    turn = turn_of_page(next(iter(models.values())).mesh)
    away = _NEAR * float(np.linalg.norm(np.ptp(found.painted.vertices, axis=0)))
    told = {"tables": list(_tables(figures, turn, away))}
    return packed_page(f"{names[1]} compared with {names[0]}", models, most_bytes, told)


def _shown(mesh: Mesh, up: tuple[float, float, float] | None, note: str = "") -> Shown:
    if not is_cloud(mesh):
        return Shown(mesh.with_(up=up), note)
    drawn = spots(mesh, _MOST_SPOTS).with_(up=up)
    count = f"{len(drawn.triangles):,} of {len(mesh.vertices):,} points, each a triangle"
    return Shown(drawn, "; ".join(filter(None, (note, count))))


def _range_in_words(is_signed: bool, palette: str) -> str:
    """Describe the colours of a palette."""
    over, under, near = _COLORS[palette]
    return f"{over} outside, {under} inside; {near} is near" if is_signed else f"{over} far, {near} near"


def _scale_of(found: Deviations, palette: str) -> PageScale:
    """Make the colour scale of deviations in millimetres.

    The scale includes the surface ratio of each colour.
    """
    most = found.color_range
    low = -most if found.is_signed else 0.0
    edges = np.linspace(low, most, _STEPS + 1)
    colors = colors_of((edges[1:] + edges[:-1]) / 2, found.within, most, palette)
    # Deviations beyond the scale are drawn in its last colours.
    shares = np.histogram(found.samples.clip(low, most), edges)[0] / len(found.samples)
    css = [f"rgb({r}, {g}, {b})" for r, g, b in colors.tolist()]
    return PageScale("mm", 1000 * low, 1000 * most, 1000 * found.within, css, shares.round(5).tolist())


def _shaded(mesh: Mesh) -> Mesh:
    """Shade vertex colours with a directional light, because pages draw them unlit."""
    assert mesh.colors is not None
    light = _AMBIENT + (1 - _AMBIENT) * np.abs(vertex_normals(mesh) @ _LIGHT)
    return mesh.with_(colors=np.rint(mesh.colors * light[:, None]).astype(np.uint8))


def _tables(figures: Mapping[str, Any], turn: NDArray[np.float64], away: float) -> Sequence[dict[str, Any]]:
    def places(found: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        return [{"target": (turn @ np.array(one["point_m"])).tolist(), "away": away} for one in found]

    told = figures["deviation"]
    tables = [
        *deviation_tables(told, None, places(told["worst"]), "Deviation of B from A, sampled"),
        _distances(figures["distance"]),
    ]
    change = figures["change"]
    if change is not None and change["largest"]:
        tables.append({
            "title": f"Farther than {1000 * change['distance_m']:.4g} mm from the other model, largest first",
            "head": ["", "area", "centre in scan coordinates, m", ""],
            "rows": [
                [one["kind"], f"{one['area_m2']:.4g} m²", place_in_words(one["point_m"])]
                for one in change["largest"]
            ],
            "places": places(change["largest"]),
        })  # fmt: skip
    if figures["views"] is not None:
        tables.append(_views(figures["views"]))
    return tables


def _distances(told: Mapping[str, Any]) -> dict[str, Any]:
    measures = ("maximum", "mean", "rms")
    rows = [
        [way, *(f"{1000 * told[key][f'{one}_m']:.4g} mm" for one in measures)] for key, way in _WAYS.items()
    ]
    return {"title": "Distances", "head": ["", "maximum", "mean", "RMS"], "rows": rows}


def _views(told: Mapping[str, Any]) -> dict[str, Any]:
    rows = [
        [
            one["viewpoint"],
            "equal" if one["psnr_db"] is None else f"{one['psnr_db']:.1f} dB",
            "–" if one["ssim"] is None else f"{one['ssim']:.4f}",
            f"{100 * one['silhouette_iou']:.2f} %",
        ]
        for one in [*told["each"], {**told, "viewpoint": "all"}]
    ]
    compared = {"colors": "in colour", "shape": "shaded without colour"}[told["compared"]]
    title = f"Pictures from all around, {compared}"
    return {"title": title, "head": ["", "PSNR", "SSIM", "silhouette overlap (IoU)"], "rows": rows}

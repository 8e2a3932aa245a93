"""Page of a comparison: both models, the deviation between them, and the changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.report.page.packing import PageModelSource, compute_page_rotation, make_packed_page
from scanloom.pipeline.report.page.page_header import PageFact, make_page_header
from scanloom.pipeline.report.page.single_file_page import PageScale
from scanloom.pipeline.report.report_summary import make_deviation_tables
from scanloom.stages.comparing.change import Changes
from scanloom.stages.comparing.deviation_palette import colorize_distances
from scanloom.stages.comparing.deviations import Deviations
from scanloom.stages.printing import format_count, format_position
from scanloom.stages.rendering.point_splats import make_point_splats
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.point_cloud import is_cloud
from scanloom.stages.surface.vertex_normals import compute_vertex_normals

# Maximum number of points shown of a point cloud.
_MAX_SHOWN_POINTS = 40_000
# Camera distance after flying to a location, as a ratio of the model size.
_FLY_DISTANCE_RATIO = 0.25
# Ambient light intensity, and direction of the light.
_AMBIENT, _LIGHT = 0.5, np.array((0.35, 0.55, 0.75)) / np.linalg.norm((0.35, 0.55, 0.75))
_DIRECTIONS = {"a_to_b": "A to B", "b_to_a": "B to A", "symmetric": "both ways"}
# Steps of the colour scale.
_STEPS = 40
# Colour names for positive, negative and near-zero deviations, by palette.
_COLOR_NAMES = {"metrology": ("red", "blue", "green"), "safe": ("orange", "blue", "white")}


def make_comparison_page(
    names: tuple[str, str],
    meshes: tuple[Mesh, Mesh],
    deviations: Deviations,
    changes: Changes | None,
    metrics: Mapping[str, Any],
    max_bytes: int,
    palette: str = "metrology",
) -> bytes:
    """Make the page of a comparison of two models A and B.

    Parameters
    ----------
    names : names of A and B.
    meshes : A and B; point clouds are shown as small triangles.
    deviations : deviation of B from A, coloured with `palette`.
    changes : parts added in B and missing from A, if requested.
    metrics : metrics of the command `compare`.
    max_bytes : target size of the page; a warning is emitted if the page remains larger.
    palette : "metrology" or "safe".
    """
    up = meshes[0].up or meshes[1].up
    note = _describe_colors(deviations.is_signed, palette)
    models = {
        "deviation of B from A": _make_page_source(deviations.painted_mesh, up, note)._replace(
            scale=_make_color_scale(deviations, palette)
        )
    }
    for letter, name, mesh in zip("AB", names, meshes, strict=True):
        models[f"{letter}: {name}"] = _make_page_source(mesh, up)
    if changes is not None:
        note = "green: added in B; red: missing from A"
        models["change"] = _make_page_source(_shade_colors(changes.painted_mesh), up, note)
    turn = compute_page_rotation(next(iter(models.values())).mesh)
    away = _FLY_DISTANCE_RATIO * float(np.linalg.norm(np.ptp(deviations.painted_mesh.vertices, axis=0)))
    report_data = {
        "header": _make_header(names, meshes, metrics["deviation"]),
        "tables": list(_make_tables(metrics, turn, away)),
    }
    return make_packed_page(f"{names[1]} compared with {names[0]}", models, max_bytes, report_data)


def _make_header(
    names: tuple[str, str], meshes: tuple[Mesh, Mesh], deviation: Mapping[str, Any]
) -> dict[str, Any]:
    facts = []
    for letter, name, mesh in zip("AB", names, meshes, strict=True):
        count = (
            format_count(len(mesh.vertices), "point")
            if is_cloud(mesh)
            else format_count(len(mesh.triangles), "triangle")
        )
        facts.append(PageFact(letter, name, count))
    farthest = max((abs(one["distance_m"]) for one in deviation["worst"]), default=0.0)
    facts += [
        PageFact("RMS deviation", f"{1000 * deviation['rms_m']:.3g} mm", "distance of B from A"),
        PageFact("Largest deviation", f"{1000 * farthest:.3g} mm", "of samples and vertices"),
    ]
    return make_page_header(facts)


def _make_page_source(mesh: Mesh, up: tuple[float, float, float] | None, note: str = "") -> PageModelSource:
    if not is_cloud(mesh):
        return PageModelSource(mesh.with_(up=up), note)
    splats = make_point_splats(mesh, _MAX_SHOWN_POINTS).with_(up=up)
    count = f"{len(splats.triangles):,} of {len(mesh.vertices):,} points, each a triangle"
    return PageModelSource(splats, "; ".join(filter(None, (note, count))))


def _describe_colors(is_signed: bool, palette: str) -> str:
    """Describe the colours of a palette."""
    over, under, near = _COLOR_NAMES[palette]
    return f"{over} outside, {under} inside; {near} is near" if is_signed else f"{over} far, {near} near"


def _make_color_scale(deviations: Deviations, palette: str) -> PageScale:
    """Make the colour scale of deviations in millimetres.

    The scale includes the surface ratio of each colour.
    """
    max_value = deviations.color_range
    low = -max_value if deviations.is_signed else 0.0
    edges = np.linspace(low, max_value, _STEPS + 1)
    colors = colorize_distances(
        (edges[1:] + edges[:-1]) / 2, deviations.in_tolerance_limit, max_value, palette
    )
    # Deviations beyond the scale are drawn in its last colours.
    shares = np.histogram(deviations.sample_distances.clip(low, max_value), edges)[0] / len(
        deviations.sample_distances
    )
    css = [f"rgb({r}, {g}, {b})" for r, g, b in colors.tolist()]
    return PageScale(
        "mm",
        1000 * low,
        1000 * max_value,
        1000 * deviations.in_tolerance_limit,
        css,
        shares.round(5).tolist(),
    )


def _shade_colors(mesh: Mesh) -> Mesh:
    """Shade vertex colours with a directional light, because pages draw them unlit."""
    assert mesh.colors is not None
    light = _AMBIENT + (1 - _AMBIENT) * np.abs(compute_vertex_normals(mesh) @ _LIGHT)
    return mesh.with_(colors=np.rint(mesh.colors * light[:, None]).astype(np.uint8))


def _make_tables(
    metrics: Mapping[str, Any], turn: NDArray[np.float64], away: float
) -> Sequence[dict[str, Any]]:
    def make_targets(found: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        return [{"target": (turn @ np.array(one["point_m"])).tolist(), "away": away} for one in found]

    deviation = metrics["deviation"]
    tables = [
        *make_deviation_tables(
            deviation, None, make_targets(deviation["worst"]), "Deviation of B from A, sampled", ""
        ),
        _make_distance_table(metrics["distance"]),
    ]
    change = metrics["change"]
    if change is not None and change["largest"]:
        tables.append({
            "title": f"Farther than {1000 * change['distance_m']:.4g} mm from the other model, largest first",
            "head": ["", "area", "centre in scan coordinates, m", ""],
            "rows": [
                [one["kind"], f"{one['area_m2']:.4g} m²", format_position(one["point_m"])]
                for one in change["largest"]
            ],
            "places": make_targets(change["largest"]),
        })  # fmt: skip
    if metrics["views"] is not None:
        tables.append(_make_view_table(metrics["views"]))
    return tables


def _make_distance_table(distance: Mapping[str, Any]) -> dict[str, Any]:
    measures = ("maximum", "mean", "rms")
    rows = [
        [way, *(f"{1000 * distance[key][f'{one}_m']:.4g} mm" for one in measures)]
        for key, way in _DIRECTIONS.items()
    ]
    return {"title": "Distances", "head": ["", "maximum", "mean", "RMS"], "rows": rows}


def _make_view_table(views: Mapping[str, Any]) -> dict[str, Any]:
    rows = [
        [
            one["viewpoint"],
            "equal" if one["psnr_db"] is None else f"{one['psnr_db']:.1f} dB",
            "–" if one["ssim"] is None else f"{one['ssim']:.4f}",
            f"{100 * one['silhouette_iou']:.2f} %",
        ]
        for one in [*views["each"], {**views, "viewpoint": "all"}]
    ]
    compared = {"colors": "in colour", "shape": "shaded without colour"}[views["compared"]]
    title = f"Pictures from all around, {compared}"
    return {"title": title, "head": ["", "PSNR", "SSIM", "silhouette overlap (IoU)"], "rows": rows}

"""The report: what is measured on the meshes, pictures of them, and what a run adds to that.

Measures and pictures depend on the meshes alone and are cached as any stage's result. Seconds, and what was
cached, belong to one run; `compose` puts both together.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.engine import Outcome
from pipeline.photos import write_photos
from pipeline.schema import SCHEMA
from stages import __version__
from stages.comparing.compare import CompareParams, compare_surfaces
from stages.params import check, param, with_former_names
from stages.picturing.render import Model, Shading, Viewpoint, viewpoints, write_png
from stages.progress import Progress, silent
from stages.scans.prefetch import read_ahead
from stages.scans.scan import Frame, Scan
from stages.surface.mesh import Mesh
from stages.surface.raycasting import Surface, bounding_box
from stages.surface.topology import require_area, topology

RESULT_VERSION = 5


@with_former_names
@dataclass(frozen=True, kw_only=True)
class ReportParams:
    """What is measured on the result, and shown of it."""

    enabled: bool = param(
        True,
        "Measure the result against the meshes it came from, and draw them; without it there is no page.",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )
    pictures: bool = param(True, "Draw each stage's mesh, as PNG files.")

    viewpoints: int = param(
        3, "Number of viewpoints; every mesh is drawn from each.", low=1, high=100, was="views"
    )
    width: int = param(800, "Width of a picture.", unit="px", low=64, high=4096)
    photos: int = param(
        24,
        "How many small photos, spread evenly over the scan, the page can lay over the result.",
        low=0,
        high=1000,
    )
    page: bool = param(
        True, "Write report.html, a page that shows the result in any browser.", invalidates=False
    )
    page_size: float = param(
        5.0,
        "What the page may take; its models are made lighter for that.",
        unit="MB",
        low=1.2,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check(self)


def make(
    folder: Path,
    meshes: Mapping[str, Mesh],
    frames: Sequence[Frame],
    compared: CompareParams,
    params: ReportParams,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure the simplified mesh, write pictures of all into `folder`, and return the figures.

    Parameters
    ----------
    meshes : "fused", "clean" and "simplified".
    frames : of the scan, whose poses say where to look from.

    Raises
    ------
    MeshError
        If a mesh has no surface to measure and draw.
    """
    for name, mesh in meshes.items():
        require_area(mesh, f"{name}.ply")
    # Distances and pictures ask the same surfaces: to make one takes longer than to draw it.
    box = bounding_box(*meshes.values())
    surfaces = {name: Surface(mesh, box) for name, mesh in meshes.items()}
    with ThreadPoolExecutor(1) as beside:
        measured = beside.submit(measure, surfaces, compared)
        drawn = draw(folder, surfaces, frames, params) if params.pictures else []
        photos = write_photos(folder, frames, params.photos)
        progress(1, 2)
        return {"mesh": measured.result(), "pictures": drawn, "photos": photos}


def measure(surfaces: Mapping[str, Surface], params: CompareParams) -> dict[str, Any]:
    """Measure the simplified mesh: its counts, its edges, and how far it is from those it was made from.

    From the simplified mesh to the fused one (`to_fused`, `b_to_a`) is the error of what is there. The
    other way is mostly how far off the islands were that cleaning removed; `to_clean` is free of those, so
    both its ways together are the error of simplification alone.
    """
    final = surfaces["simplified"]
    fewer = replace(params, samples=math.ceil(params.samples / 4))
    found = topology(final.mesh)
    return {
        "vertices": len(final.mesh.vertices),
        "triangles": len(final.mesh.triangles),
        "manifold": found.is_manifold,
        "oriented": found.is_oriented,
        "boundary_loops": found.boundary_loops,
        "components": found.components,
        "edges": edge_figures(final.mesh),
        "to_fused": compare_surfaces(surfaces["fused"], final, params).figures(),
        "to_clean": compare_surfaces(surfaces["clean"], final, fewer).figures(),
    }


def edge_figures(mesh: Mesh) -> dict[str, Any]:
    """Return mean and spread of the edges' lengths; every edge counts once."""
    ends = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    count = len(mesh.vertices)
    # An edge as one number: sorting numbers is several times faster than sorting rows.
    edges = np.unique(ends[:, 0] * count + ends[:, 1])
    lengths = np.linalg.norm(mesh.vertices[edges // count] - mesh.vertices[edges % count], axis=1)
    if len(lengths) == 0:
        return {"count": 0}
    return {
        "count": len(edges),
        "length_mean_m": float(lengths.mean()),
        "length_deviation_m": float(lengths.std()),
        "length_minimum_m": float(lengths.min()),
        "length_maximum_m": float(lengths.max()),
    }


def draw(
    folder: Path, surfaces: Mapping[str, Surface], frames: Sequence[Frame], params: ReportParams
) -> list[str]:
    """Write a PNG of each mesh from each viewpoint, and one of the last with its triangles beside it.

    Parameters
    ----------
    surfaces : by the name of their stage; the viewpoints are those of the first.
    frames : of the scan, whose poses say where to look from.

    Returns
    -------
    The names of the files: `<mesh>-<viewpoint>.png` and `<mesh>-triangles.png`.
    """
    chosen = viewpoints_of(next(iter(surfaces.values())).mesh, frames, params)
    jobs: list[tuple[str, Model, Viewpoint, Shading]] = []
    for name, surface in surfaces.items():
        model = Model(surface)
        jobs += [(f"{name}-{viewpoint.name}.png", model, viewpoint, "color") for viewpoint in chosen]
    jobs.append((f"{name}-triangles.png", model, chosen[-1], "edges"))
    threads = os.cpu_count() or 1
    images = list(read_ahead(lambda job: job[1].draw(*job[2:]), jobs, threads=threads, ahead=len(jobs)))
    images[-1] = np.hstack(images[-2:])
    for (file, *_), image in zip(jobs, images, strict=True):
        write_png(folder / file, image)
    return [file for file, *_ in jobs]


def viewpoints_of(mesh: Mesh, frames: Sequence[Frame], params: ReportParams) -> tuple[Viewpoint, ...]:
    """Return where the meshes of a run are drawn from; `mesh` is the fused one."""
    # A viewpoint is named after its frame; numbers, because the names of files decide nothing here.
    numbered = [replace(frame, name=f"{i:06d}") for i, frame in enumerate(frames)]
    return viewpoints(mesh, params.viewpoints, frames=numbered, width=params.width)


def compose(scan: Scan, outcomes: Sequence[Outcome], final: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Put together the content of report.json.

    Parameters
    ----------
    outcomes : what became of each stage of this run.
    final : figures of the report stage; empty if the run ended before it.
    out : the output folder, which results are named from.
    """
    return {
        "schema": SCHEMA,
        "scanloom": __version__,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "scan": {
            "layout": scan.layout,
            "frames": len(scan.frames),
            "frames_skipped": [{"frame": one.name, "reason": one.reason} for one in scan.skipped],
            "warnings": list(scan.warnings),
            # Where it is false, metres in all figures are units of the scan's world.
            "metric": scan.is_metric,
            "scale": scan.scale and scan.scale.figures(),
        },
        "stages": {outcome.stage: _stage(outcome, out) for outcome in outcomes},
        "mesh": final.get("mesh"),
        # None unless remesh is enabled.
        "normal_mesh": final.get("normal_mesh"),
        # None unless frames were held out.
        "held_out": final.get("held_out"),
        "pictures": final.get("pictures", []),
    }


def _stage(outcome: Outcome, out: Path) -> dict[str, Any]:
    return {
        "cached": outcome.cached,
        "reason": outcome.reason,
        "seconds": round(outcome.seconds, 3),
        # Of the run that made the result, which is this one unless it was cached.
        "made_in_s": outcome.made["seconds"],
        "peak_memory_mb": round(outcome.made["peak_memory_bytes"] / 1e6, 1),
        "params": outcome.params,
        "figures": {} if outcome.stage == "report" else outcome.figures,
        "unmet": list(outcome.unmet),
        "results": [path.relative_to(out).as_posix() for path in outcome.results],
    }

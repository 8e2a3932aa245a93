"""Metrics of a run for the tables and the page of a batch."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from scanloom.pipeline.run.run import RunResult

# Main result files, best first.
_RESULT_FILES = ("textured.glb", "simplified.glb", "simplified.ply", "refined.ply", "clean.ply", "fused.ply")
# Mesh whose overview picture represents the run, best first.
_PICTURE_MESHES = ("textured", "simplified", "refined", "fused")


def metrics_of(result: RunResult) -> dict[str, Any]:
    """Return the table metrics of a run; None for unknown values."""
    report = result.report
    scan, mesh, held_out = report["scan"], report["mesh"], report["held_out"]
    stages: Mapping[str, Mapping[str, Any]] = report["stages"]
    of_fuse = stages.get("fuse", {}).get("metrics", {})
    placed = {path.relative_to(result.out).as_posix() for one in result.stages for path in one.results}
    return {
        "layout": scan["layout"],
        "frames": scan["frames"],
        "frames_skipped": len(scan["frames_skipped"]) + len(of_fuse.get("frames_skipped", ())),
        "metric": scan["metric"],
        "voxel_size_m": of_fuse.get("voxel_size_m"),
        "triangles": mesh["triangles"] if mesh else None,
        "manifold": mesh["manifold"] if mesh else None,
        "fused_distance_rms_m": mesh["to_fused"]["distance"]["b_to_a"]["rms_m"] if mesh else None,
        "held_out_psnr_db": held_out["psnr_affine_db"] if held_out and held_out["photos"] else None,
        "stages_cached": sum(one.cached for one in result.stages),
        "stages": len(result.stages),
        "compute_seconds": round(sum(float(one.compute_cost["seconds"]) for one in result.stages), 1),
        "peak_memory_mb": round(
            max(float(one.compute_cost["peak_memory_bytes"]) for one in result.stages) / 1e6
        ),
        "result": next((name for name in _RESULT_FILES if name in placed), None),
        "page": None if result.page is None else result.page.name,
        "picture": _choose_picture(report["pictures"]) or _choose_photo(placed),
    }


def _choose_picture(drawn: Sequence[str]) -> str | None:
    """Choose the picture that represents a run, relative to the output folder."""
    for mesh in _PICTURE_MESHES:
        of_mesh = [name for name in drawn if name.startswith(f"pictures/{mesh}-")]
        if of_mesh:
            return next((name for name in of_mesh if name.endswith("-overview.png")), of_mesh[0])
    return None


def _choose_photo(placed: Collection[str]) -> str | None:
    """Choose the middle photo of a scan, for a run without pictures."""
    photos = sorted(name for name in placed if name.startswith("pictures/photos/"))
    return photos[len(photos) // 2] if photos else None


def count_written_bytes(result: RunResult) -> int:
    """Return the bytes written by a run.

    New cache entries count twice, because they are copied to the output folder.
    """
    made = [one.folder for one in result.stages if not one.cached]
    return 2 * sum(path.stat().st_size for folder in made for path in folder.rglob("*") if path.is_file())

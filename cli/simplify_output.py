"""Text result of `simplify`: sizes before and after, deviation, texture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scanloom.cli.output import format_size
from scanloom.stages import CompareParams, Mesh, SimplificationResult
from scanloom.stages.printing import format_count, format_upper_bound

# Points sampled on each surface for a deviation that the method does not prove. 50,000 take 0.1 s, and every
# vertex is measured as well.
_SAMPLES = 50_000
# Explanations of `SimplificationResult.stopped_by`.
_STOPS = {
    "bounds": "bounds; no further edge can collapse",
    "triangles": "triangles; the mesh has the requested number",
    "request": "request; simplification was interrupted",
    "unproven": "unproven; the bounds cannot be proven",
}


def format_simplification(
    result: SimplificationResult[Any], metrics: Mapping[str, Any], original: Mesh
) -> str:
    """Return size, deviation and texture of a simplified mesh, line by line.

    Parameters
    ----------
    metrics : of the command, with `input_bytes` and `output_bytes`.
    original : mesh before simplification; the deviation is measured on it if the method proves none.
    """
    count = len(result.mesh.triangles)
    before, size = int(metrics["input_bytes"]), int(metrics["output_bytes"])
    full = result.triangles_before
    rows = {
        "output": str(metrics["output"]),
        "triangles": f"{full:,} → {count:,}{_format_ratio(count, full)}",
        "size": f"{format_size(before)} → {format_size(size)}{_format_ratio(size, before)}",
        # Methods that describe their bounds in a sentence need no row.
        **({} if result.details.describe() else {"deviation": _format_deviation(result, original)}),
        "texture": _format_texture(result),
        "stopped by": _STOPS.get(result.stopped_by, result.stopped_by),
    }
    width = max(map(len, rows))
    return "\n".join(f"{name:<{width}}  {text}" for name, text in rows.items())


def _format_ratio(part: int, whole: int) -> str:
    return f" ({part / whole:.1%})" if whole else ""


def _format_deviation(result: SimplificationResult[Any], original: Mesh) -> str:
    bound = getattr(result.details, "shape_bound_m", None)
    if bound is not None:
        levels = getattr(result.details, "color_bound_levels", None)
        colors = "" if levels is None else f"; colours at most {format_upper_bound(levels)} of 255 levels"
        return f"at most {format_upper_bound(bound)} m{colors} (proven at every point)"
    if not (len(result.mesh.triangles) and len(original.triangles)):
        return "not measured: a mesh has no triangles"
    # Comparison needs the ray caster, which takes long to import.
    from scanloom.stages.comparing.compare import compare

    found = compare(original, result.mesh, CompareParams(samples=_SAMPLES))
    off = found.symmetric
    return (
        f"up to {off.maximum:.3g} m, {off.maximum / found.diagonal:.2%} of the size; {off.rms:.3g} m RMS "
        f"(measured at {format_count(2 * _SAMPLES, 'point')} and all vertices)"
    )


def _format_texture(result: SimplificationResult[Any]) -> str:
    if result.baked is not None:
        return f"baked again, {_format_sizes(result.baked.sizes)}"
    if result.mesh.texture is None or not result.mesh.texture.images:
        return "none" if result.mesh.colors is None else "none; vertex colours"
    return f"images of the input, {_format_sizes([one.size for one in result.mesh.texture.images])}"


def _format_sizes(sizes: Sequence[tuple[int, int] | None]) -> str:
    return ", ".join("unknown size" if size is None else f"{size[0]} × {size[1]} px" for size in sizes)

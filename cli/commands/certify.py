"""Command `certify`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom import stages
from scanloom.cli.bounds_output import SaveBounds, write_bounds
from scanloom.cli.mesh_arguments import read_mesh_file
from scanloom.cli.output import Output, format_table
from scanloom.cli.paths import require_new_file
from scanloom.stages import CertifyParams
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.printing import format_lower_bound, format_upper_bound
from scanloom.stages.simplification.codes import SIMPLIFY_BOUND_NOT_PROVEN


def certify(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Mesh file to certify.", show_default=False)
    ],
    original: Annotated[
        Path,
        typer.Argument(metavar="ORIGINAL", help="Mesh file that RESULT was made from.", show_default=False),
    ],
    certify: CertifyParams,
    out: Output,
    save_bounds: SaveBounds = None,
) -> None:
    """Prove the maximum deviation of a mesh from another.

    The bounds on shape (both ways) and colour hold at every point. With --max-shape or --max-color, the exit
    code is 1 if these limits are not proven; --check-only stops as soon as that is clear, which is much
    faster.

    Example: scanloom mesh certify simplified.ply clean.ply --max-shape 0.005 --max-color 20
    """
    if save_bounds is not None:
        require_new_file(save_bounds, (".ply",))
    mesh, reference = read_mesh_file(result), read_mesh_file(original)
    with out.progress("certify", "pieces") as progress:
        found = stages.certify(mesh, reference, certify, progress=progress)
    if save_bounds is not None:
        write_bounds(save_bounds, mesh, found.shape_bound, found.color_bound, out)
    metrics = found.to_dict()
    if found.within_limits is False:
        emit(SIMPLIFY_BOUND_NOT_PROVEN.unmet("the limits are not proven.", result))
    out.result(metrics, None if out.as_json else _certificate_text(metrics))


def _certificate_text(metrics: Mapping[str, Any]) -> str:
    rows = [["", "attained", "proven maximum"]]
    measures = (("distance m", "shape", "m"), ("colour difference levels", "color", "levels"))
    for name, key, unit in measures:
        found, bound = (metrics[f"{key}_{which}_{unit}"] for which in ("attained", "bound"))
        if found is not None:
            rows.append(
                [name, format_lower_bound(found), "no bound" if bound is None else format_upper_bound(bound)]
            )
    text = format_table(rows)
    if metrics["within_limits"] is not None:
        text += f"\n\nThe limits are {'proven' if metrics['within_limits'] else 'not proven'}."
    return f"{text}\n\nThe bounds include {metrics['slack_m']:.3g} m for searches in single precision."

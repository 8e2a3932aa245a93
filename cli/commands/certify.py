"""The command `certify`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import read_file
from scanloom.cli.output import Output, table_of
from scanloom.cli.paths import require_new_file
from scanloom.cli.written_bounds import SaveBounds, write_bounds
from scanloom.stages import CertifyParams
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.printing import at_least, at_most
from scanloom.stages.simplification.codes import SIMPLIFY_BOUND_NOT_PROVEN


def certify(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Mesh file to prove something of.", show_default=False)
    ],
    original: Annotated[
        Path, typer.Argument(metavar="ORIGINAL", help="Mesh file it came from.", show_default=False)
    ],
    params: CertifyParams,
    out: Output,
    save_bounds: SaveBounds = None,
) -> None:
    """Prove how far a mesh is from its original at most, in shape (both ways) and in colour, at any point.

    With --max-shape or --max-color it is also found out whether they are kept; the exit code is 1 if that is
    not proven. --only-decide ends as soon as that is clear, far faster.

    Example: scanloom certify simplified.ply clean.ply --max-shape 0.005 --max-color 20
    """
    if save_bounds is not None:
        require_new_file(save_bounds, (".ply",))
    mesh, reference = read_file(result), read_file(original)
    with out.progress("certify", "pieces") as progress:
        found = stages.certify(mesh, reference, params, progress=progress)
    if save_bounds is not None:
        write_bounds(save_bounds, mesh, found.shape_bound, found.color_bound, out)
    figures = found.figures()
    if found.within_limits is False:
        emit(SIMPLIFY_BOUND_NOT_PROVEN.unmet("the limits are not proven to be kept.", result))
    out.result(figures, None if out.as_json else _certificate_text(figures))


def _certificate_text(figures: Mapping[str, Any]) -> str:
    rows = [["", "found", "proven to be at most"]]
    measures = (("distance m", "shape", "m"), ("colour difference levels", "color", "levels"))
    for name, key, unit in measures:
        found, bound = (figures[f"{key}_{which}_{unit}"] for which in ("attained", "bound"))
        if found is not None:
            rows.append([name, at_least(found), "no bound" if bound is None else at_most(bound)])
    text = table_of(rows)
    if figures["within_limits"] is not None:
        text += f"\n\nLimits {'are kept' if figures['within_limits'] else 'are not proven to be kept'}."
    return f"{text}\n\n{figures['slack_m']:.3g} m of that are for searches in single precision."

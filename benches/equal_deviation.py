"""Triangles that `simplify` needs to prove another simplifier's maximum deviation.

    python benches/equal_deviation.py DATA [--ratios 0.1 0.04] [--mesh horse.ply ...] [--only VTK]
                                      [--samples 1000000]

DATA holds `meshes/`. Prints one Markdown table. Peers and their settings are the same as in
`benches/simplify.py`.

Each peer simplifies to a ratio of the triangles. The search of `benches/bounds.py` then finds the
largest two-sided distance between the peer's result and the input. `simplify` gets this distance as
`max_shape`, without a triangle count. If the peer keeps colours, a second row adds the largest colour
difference found as `max_color`.

The search finds at most the peer's true maximum, while `simplify` has to prove its bound for every point. The
comparison therefore favours the peer. It compares maxima only: a single bad spot in a peer's result gives
`simplify` a loose bound.

"proven / requested" exceeds 1 if a bound cannot be proven. Results of `simplify` are attacked as well. A
deviation above the proven bound ends the bench with an error. A full run takes half an hour.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import meshes
from bounds import compute_diagonal, find_two_sided_maximum
from peers.tools import OURS, Tool
from simplify import find_installed, run_tools

from scanloom.stages.simplification.certified.details import CertifiedDetails
from scanloom.stages.simplification.simplify import SimplificationResult, simplify
from scanloom.stages.surface.mesh import Mesh

MESHES = ("horse.ply", "fandisk.obj", "stanford-bunny.obj", "redkitchen_fused_vertexcolor.ply")
HEAD = (
    "| mesh | ratio | peer | triangles | max distance / diagonal | colour levels | scanloom: triangles "
    "| scanloom / peer | proven / requested | measured / proven |\n"
    "|---|---:|---|---:|---:|---:|---:|---:|---:|---:|"
)


def compare_at_deviation(
    mesh: Mesh, name: str, share: float, tools: list[Tool], samples: int
) -> Iterator[tuple[str, float]]:
    """Yield table row and triangle ratio for each peer and bound.

    The ratio is our triangle count over the peer's.
    """
    for tool, setting, _, light in run_tools(mesh, share, tools):
        distance, levels = find_two_sided_maximum(mesh, light, samples)
        for asked in (None,) if light.colors is None else (None, levels):
            ours = simplify(mesh, method="certified", max_shape=distance, max_color=asked)
            proven = ours.details.shape_bound_m / distance
            if asked is not None:
                assert ours.details.color_bound_levels is not None
                proven = max(proven, ours.details.color_bound_levels / asked)
            ratio = len(ours.mesh.triangles) / len(light.triangles)
            cells = (
                name,
                f"{share:.0%}",
                f"{tool.name} {setting}".strip(),
                f"{len(light.triangles):,}",
                f"{distance / compute_diagonal(mesh):.3e}",
                "" if asked is None else f"{asked:.1f}",
                f"{len(ours.mesh.triangles):,}",
                f"{ratio:.2f}",
                f"{proven:.3f}",
                f"{compute_proof_ratio(mesh, ours, samples):.3f}",
            )
            yield "| " + " | ".join(cells) + " |", ratio


def compute_proof_ratio(mesh: Mesh, ours: SimplificationResult[CertifiedDetails], samples: int) -> float:
    """Compute the largest ratio of measured to proven deviation.

    The maximum is over shape and colour.

    Raises
    ------
    SystemExit
        If the ratio exceeds 1, which disproves the bound.
    """
    distance, levels = find_two_sided_maximum(mesh, ours.mesh, samples)
    proven = ours.details
    ratio = distance / proven.shape_bound_m
    if proven.color_bound_levels is not None:
        ratio = max(ratio, levels / proven.color_bound_levels)
    if ratio > 1:
        raise SystemExit(
            f"The proof is wrong: {distance:g} m and {levels:g} levels were measured, but the proven bounds "
            f"are {proven.shape_bound_m:g} m and {proven.color_bound_levels or 0:g} levels."
        )
    return ratio


def main() -> None:
    """Print the table, then the smallest and the largest triangle ratio."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--ratios", type=float, nargs="+", default=[0.1, 0.04])
    parser.add_argument("--mesh", nargs="+", default=MESHES, help="files in DATA/meshes")
    parser.add_argument("--only", nargs="+", metavar="TOOL", help="peers whose names start with TOOL")
    parser.add_argument("--samples", type=int, default=1_000_000)
    options = parser.parse_args()
    tools = [tool for tool in find_installed(options.only) if tool.name != OURS]
    print(f"\n{HEAD}", flush=True)
    ratios = []
    for name in options.mesh:
        mesh = meshes.read_colored_scan(options.data / "meshes" / name)
        for share in options.ratios:
            for row, ratio in compare_at_deviation(mesh, name, share, tools, options.samples):
                ratios.append(ratio)
                print(row, flush=True)
    if ratios:
        print(f"\nscanloom / peer: {min(ratios):.2f} to {max(ratios):.2f}")


if __name__ == "__main__":
    main()

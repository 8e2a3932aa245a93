"""Evenness of edge lengths after simplification by `jia01`, with and without a resolution that splits edges.

    python benches/jia_evenness.py MESH [MESH ...]

Variation is the standard deviation of edge lengths over their mean. RMS and maximum of the two-sided distance
are in 1e-5 of the diagonal, colours in 8-bit levels, sampled on the original.

Rows of each mesh:

- "input": the mesh before simplification.
- "none": edges are not split, and their length is not limited. The bounds are those that were the default
  then: T_max is 400.
- "default": the default of `jia01`.
- "none, same count": as "none", but stopped at the number of triangles of "default". If the bounds stop it
  before, they are left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from scanloom import Mesh, SimplificationResult, read_mesh, simplify
from scanloom.stages.comparing.compare import compare
from scanloom.stages.simplification.jia01.limits import MAX_SHAPE_PER_DIAGONAL, MAX_SHAPE_PER_MEAN_EDGE
from scanloom.stages.surface.edges import make_edge_keys

FORMER_RESOLUTION = 36.0  # mean edge lengths
FORMER_MAX_COLOR = 400.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", type=Path, nargs="+")
    print("| mesh | resolution | triangles | splits | variation | RMS | max | colour RMSE |")
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    for path in parser.parse_args().meshes:
        mesh = read_mesh(path).with_(texture=None, normals=None)
        print_row(path.stem, "input", len(mesh.triangles), "", compute_variation(mesh), "", "", "")
        lengths = measure_edges(mesh)
        diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        count_only: dict[str, Any] = {
            "method": "jia01",
            "jia01": {"resolution": FORMER_RESOLUTION * float(lengths.mean())},
        }
        max_shape = min(MAX_SHAPE_PER_MEAN_EDGE * float(lengths.mean()), MAX_SHAPE_PER_DIAGONAL * diagonal)
        bounds = count_only | {"max_shape": max_shape, "max_color": FORMER_MAX_COLOR}
        former = simplify(mesh, **bounds)
        print_result(path.stem, "none", mesh, former)
        default = simplify(mesh, method="jia01")
        print_result(path.stem, "default", mesh, default)
        count = len(default.mesh.triangles)
        limits = bounds if count >= len(former.mesh.triangles) else count_only
        again = simplify(mesh, triangles=count, **limits)
        print_result(path.stem, "none, same count", mesh, again)


def measure_edges(mesh: Mesh) -> np.ndarray:
    """Measure the length of every edge."""
    sides = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    keys = np.unique(make_edge_keys(sides[:, 0], sides[:, 1]))
    ends = mesh.vertices[np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1)]
    return np.asarray(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))


def compute_variation(mesh: Mesh) -> float:
    """Compute the standard deviation of edge lengths over their mean."""
    lengths = measure_edges(mesh)
    return float(lengths.std() / lengths.mean())


def print_result(name: str, rule: str, mesh: Mesh, result: SimplificationResult[Any]) -> None:
    """Print the row of a simplified mesh."""
    difference = compare(mesh, result.mesh, samples=200_000)
    scale = 1e5 / float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    color = difference.color_a_to_b
    print_row(
        name,
        rule,
        len(result.mesh.triangles),
        f"{result.details.splits:,}",
        compute_variation(result.mesh),
        f"{difference.symmetric.rms * scale:.2f}",
        f"{difference.symmetric.maximum * scale:.0f}",
        "" if color is None else f"{color.rmse:.2f}",
    )


def print_row(name: str, rule: str, triangles: int, splits: str, variation: float, *errors: str) -> None:
    """Print a row of the table."""
    cells = (name, rule, f"{triangles:,}", splits, f"{variation:.3f}", *errors)
    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()

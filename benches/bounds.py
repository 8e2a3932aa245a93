"""Whether `simplify` keeps its bound on shape: the largest distance measured from outside, over the bound.

Run `python benches/bounds.py DATA [--samples 1000000]`, DATA holding `meshes/`; it prints a Markdown table.
Distances are measured both ways, at so many random samples a side and at every vertex.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from stages.clean import clean
from stages.compare import compare
from stages.mesh import Mesh
from stages.mesh_files import read_mesh
from stages.raycasting import bounding_box
from stages.simplify import simplify

MESHES = (
    "camelhead.off",
    "colored_airplane.ply",
    "cow.obj",
    "face.obj",
    "fandisk.obj",
    "horse.ply",
    "igea.ply",
    "redkitchen_fused_vertexcolor.ply",
    "rocker-arm.obj",
    "sceaux_mvs_scene_mesh.ply",
    "spot/spot_triangulated.obj",
    "ycb_banana/textured_simple_reoriented.obj",
)
# Shares of the bounding box's diagonal, each with a bound on texture that leaves shape to decide.
BOUNDS = ((2e-4, 20.0), (1e-3, 60.0), (5e-3, 400.0), (2e-2, 2000.0))


def row(mesh: Mesh, relative: float, texture: float, samples: int) -> tuple[float, float]:
    """Return the share of triangles that went, and the largest distance over the bound."""
    low, high = bounding_box(mesh)
    diagonal = float(((high - low) ** 2).sum() ** 0.5)
    bound = relative * diagonal
    light = simplify(mesh, max_shape=bound, max_texture=texture, resolution=diagonal).mesh
    farthest = compare(mesh, light, samples=samples).symmetric.maximum
    return 1 - len(light.triangles) / len(mesh.triangles), farthest / bound


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--samples", type=int, default=1_000_000)
    options = parser.parse_args()
    print("| mesh | bound / diagonal | removed | measured / bound |\n|---|---:|---:|---:|")
    worst = 0.0
    for name in MESHES:
        mesh = clean(read_mesh(options.data / "meshes" / name)).mesh
        for relative, texture in BOUNDS:
            removed, ratio = row(mesh, relative, texture, options.samples)
            worst = max(worst, ratio)
            print(f"| {name} | {relative:g} | {removed:.1%} | {ratio:.4f} |", flush=True)
    print(f"\nLargest: {worst:.4f}")


if __name__ == "__main__":
    main()

"""Colour error of vertex colours and baked textures by triangle ratio.

    python benches/baking.py DATA [--ratios 0.1 0.05 0.02] [--mesh kitchen globe] [--scan FILE ...]

DATA holds `meshes/` and `images/`. Prints a Markdown table. PSNR is sampled on the original surface and
compares its colour with the colour at the nearest point of the simplified mesh.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import meshes
from markdown_tables import print_head, print_row

from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.texturing.bake import bake

COLUMNS = (
    "mesh",
    "ratio",
    "triangles",
    "vertex colours, dB",
    "baked, dB",
    "images",
    "charts",
    "coverage",
    "CPU s",
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--ratios", type=float, nargs="+", default=[0.1, 0.05, 0.02])
    parser.add_argument(
        "--mesh", nargs="*", choices=("kitchen", "globe", "painted"), default=["kitchen", "globe"]
    )
    parser.add_argument("--scan", type=Path, nargs="+", default=[], help="other coloured meshes")
    options = parser.parse_args()
    originals = {name: meshes.MESHES[name](options.data) for name in options.mesh}
    originals |= {path.stem: meshes.read_colored_scan(path) for path in options.scan}
    print_head(COLUMNS)
    for name, original in originals.items():
        for ratio in options.ratios:
            light = simplify(original, ratio=ratio).mesh
            start = time.process_time()
            baked = bake(light, original)
            seconds = time.process_time() - start
            assert baked.color is not None
            assert baked.vertex_color is not None
            cells = [name, f"{ratio:.0%}", f"{len(light.triangles):,}", f"{baked.vertex_color.psnr:.1f}"]
            cells += [
                f"{baked.color.psnr:.1f}",
                " + ".join(f"{w} × {h}" for w, h in baked.sizes),
                f"{baked.charts}",
                f"{baked.coverage:.2f}",
            ]
            print_row([*cells, f"{seconds:.1f}"])


if __name__ == "__main__":
    main()

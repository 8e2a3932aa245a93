"""File size against distance: normal meshes, Draco, and simplified meshes in Draco.

Part of normal_mesh.py. RMS is the larger of the two directions, over the diagonal of the original's bounding
box; dB is 20 log10 of its inverse.

- "with levels": files of several base sizes and tolerances, truncated after every level, each decoded and
  measured.
- "without levels": files of `remesh(levels=0, base_triangles=…)`, which hold just a simplified mesh. Tables
  name the smallest file of both kinds with at most the given RMS, and the smallest one with levels.
- "Draco": all vertices are kept.
- "simplify + Draco": each simplifier at several sizes, encoded by Draco with several bit depths. Its size at
  a given RMS is interpolated between the two nearest files of its Pareto front.
- "/ target": our size over the largest size that we allow. Above 1 the target is missed.

For comparison: published coders of normal meshes need 3,037 bytes at 62 dB and 18,111 bytes at 75 dB for a
dinosaur of 14,000 vertices.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from markdown_tables import print_head, print_row
from peers.draco import decode_draco, encode_draco
from peers.tools import OURS, TOOLS, PeerUnavailable, Tool, make_version_check
from rate_distortion import EncodedMesh, ReferenceMesh, find_smallest, interpolate_size, select_pareto_front

from scanloom.stages.normal_meshes.normal_mesh import decode
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.surface.mesh import Mesh


@dataclass(frozen=True)
class RemeshSettings:
    """Parameters for files of one base size.

    Attributes
    ----------
    base : triangles of the base mesh.
    levels : number of refinements.
    tolerances : one file each; passed to `remesh`.
    """

    base: int
    levels: int
    tolerances: tuple[float, ...]
    scheme: str = "butterfly"
    relaxations: int = 1


# Small bases need large tolerances: files of other pairs are larger at the same distance. Size and distance
# jump by a tenth from one tolerance to the next, hence several tolerances.
LEVEL_SETTINGS = {
    "horse": (
        RemeshSettings(200, 4, (2e-3,)),
        RemeshSettings(300, 4, (1.6e-3, 1.2e-3)),
        RemeshSettings(400, 4, (1.3e-3, 1.1e-3)),
        RemeshSettings(464, 4, (1.1e-3, 6e-4)),
        RemeshSettings(700, 4, (6e-4, 4e-4, 3e-4)),
        RemeshSettings(1000, 4, (6e-4, 4e-4, 3e-4, 2e-4, 1.85e-4)),
        RemeshSettings(1200, 4, (2.5e-4,)),
        RemeshSettings(1200, 4, (2e-4,), relaxations=0),
        RemeshSettings(1350, 4, (2e-4,)),
        RemeshSettings(1500, 4, (2e-4, 1.5e-4, 1e-4)),
        RemeshSettings(800, 5, (1.1e-4, 1e-4, 9e-5)),
        RemeshSettings(1000, 5, (1.2e-4, 1.1e-4)),
    ),
    # The cow's files without levels are smaller at every distance; these files show by how much.
    "cow": (
        RemeshSettings(426, 3, (4e-3, 1e-3)),
        RemeshSettings(1000, 2, (4e-3, 2e-3, 1e-3, 5e-4), "linear", 0),
        RemeshSettings(2000, 3, (1e-3, 5e-4)),
    ),
    "face": (
        RemeshSettings(150, 4, (1.2e-3, 5e-4)),
        RemeshSettings(300, 4, (1.2e-3, 5e-4, 2e-4)),
        RemeshSettings(600, 4, (5e-4, 2e-4)),
    ),
    # This scan is rough everywhere; one base size is enough to show it.
    "sceaux": (RemeshSettings(600, 4, (1.2e-3, 6e-4)),),
    "kitchen": (),
}
# Files without levels: triangle ratios and tolerances.
NO_LEVEL_RATIOS = {
    "horse": np.geomspace(0.005, 0.08, 5),
    "cow": np.geomspace(0.1, 0.95, 9),
    "face": np.geomspace(0.015, 0.16, 8),
    "sceaux": (0.1, 0.149, 0.2, 0.306, 0.4, 0.531),
    "kitchen": (0.0519, 0.09, 0.1522, 0.22, 0.3112),
}
NO_LEVEL_TOLERANCES = (2.5e-3, 1.6e-3, 1e-3, 6e-4, 4e-4, 2.5e-4, 1.6e-4)

# Draco's bit depths with all vertices kept, and the target for our size over Draco's at the same RMS.
TARGETS_ALL_VERTICES = {8: 1 / 12, 9: None, 10: 1 / 5, 11: 1 / 3, 12: 1 / 2, 14: None}
# Draco's bit depths after simplification, and triangle ratios.
BITS = range(9, 14)
SIMPLIFY_RATIOS = np.geomspace(0.01, 0.9, 14)
# Target for our size over simplify + Draco, at each of these RMS distances (over the diagonal).
TARGET_RATIO = 1 / 2
DISTANCES = (60e-5, 30e-5, 18.7e-5, 14e-5, 13.9e-5, 11.1e-5, 7e-5, 6.7e-5, 3.6e-5)
# Simplifiers that cannot win here: they are far behind, or use the same quadrics as another one.
SKIPPED_TOOLS = ("VTK", "meshoptimizer", "Open3D legacy", "fast-simplification", "CGAL Garland")


def print_rates(name: str, mesh: Mesh, samples: int) -> None:
    """Print the Pareto front of our files and sizes of peers' files."""
    original = ReferenceMesh(mesh, samples)
    refined = select_pareto_front(make_files_with_levels(name, original))
    ours = select_pareto_front([*refined, *make_files_without_levels(name, original)])
    for files, kind in ((refined, "with levels"), (ours, "with levels or without")):
        print(f"\n### {name}, {len(mesh.vertices):,} vertices: files {kind}\n")
        print_head(["parameters", "bytes", "bits per original vertex", "RMS ×1e-5", "dB"])
        for file in files:
            bits = 8 * file.size / len(mesh.vertices)
            rms = f"{1e5 * file.rms:.2f}"
            print_row([file.made, f"{file.size:,}", f"{bits:.3f}", rms, f"{file.decibels:.1f}"])
    try:
        make_version_check("DracoPy")()
    except PeerUnavailable as reason:
        print(f"\nDraco is skipped: {reason}")
        return
    print_all_vertices(original, ours, refined)
    print_simplified(original, ours, refined)


def make_files_with_levels(name: str, original: ReferenceMesh) -> Iterator[EncodedMesh]:
    """Yield files of several bases and tolerances, truncated after every level."""
    for setting in LEVEL_SETTINGS[name]:
        for tolerance in setting.tolerances:
            result = remesh(
                original.mesh,
                levels=setting.levels,
                base_triangles=setting.base,
                scheme=setting.scheme,
                relaxations=setting.relaxations,
                tolerance=tolerance,
            )
            how = f"{setting.scheme}, relaxations {setting.relaxations}, {tolerance:.2g}"
            for level, end in enumerate(result.level_ends):
                made = f"base {len(result.base.triangles)}, level {level} of {setting.levels}, {how}"
                yield original.file(end, decode(result.data[:end]).mesh, made)


def make_files_without_levels(name: str, original: ReferenceMesh) -> Iterator[EncodedMesh]:
    """Yield files without levels, of several sizes and tolerances."""
    for share in NO_LEVEL_RATIOS[name]:
        triangles = int(share * len(original.mesh.triangles))
        for tolerance in NO_LEVEL_TOLERANCES:
            data = remesh(original.mesh, levels=0, base_triangles=triangles, tolerance=tolerance).data
            made = f"without levels, {triangles:,} triangles, {tolerance:.2g}"
            yield original.file(len(data), decode(data).mesh, made)


def print_all_vertices(original: ReferenceMesh, ours: list[EncodedMesh], refined: list[EncodedMesh]) -> None:
    """Print a row for each of Draco's bit depths, all vertices kept."""
    print("\nDraco with all vertices, and our smallest file within its RMS:\n")
    mine = ["ours", "bytes", "RMS ×1e-5", "/ Draco", "target", "/ target"]
    print_head(["Draco, bits", "bytes", "RMS ×1e-5", "dB", *mine, "with levels: bytes", "/ target"])
    for bits, wanted in TARGETS_ALL_VERTICES.items():
        data = encode_draco(original.mesh, bits)
        peer = original.file(len(data), decode_draco(data), f"{bits}")
        file = find_smallest(ours, peer.rms)
        cells = [peer.made, f"{peer.size:,}", f"{1e5 * peer.rms:.2f}", f"{peer.decibels:.1f}"]
        if file is None:
            cells += ["no file", "", "", ""]
        else:
            cells += [file.made, f"{file.size:,}", f"{1e5 * file.rms:.2f}", f"{file.size / peer.size:.3f}"]
        target = None if wanted is None else wanted * peer.size
        cells += ["" if wanted is None else f"{wanted:.3f}", format_target_ratio(file, target)]
        file = find_smallest(refined, peer.rms)
        print_row(
            [*cells, "no file" if file is None else f"{file.size:,}", format_target_ratio(file, target)]
        )


def format_target_ratio(file: EncodedMesh | None, size: float | None) -> str:
    """Format a file's size over a target; empty if either is missing."""
    return "" if file is None or size is None else f"{file.size / size:.2f}"


def print_simplified(original: ReferenceMesh, ours: list[EncodedMesh], refined: list[EncodedMesh]) -> None:
    """Print the size of simplify + Draco by distance and simplifier."""
    rivals: dict[str, list[EncodedMesh]] = {}
    for tool in TOOLS:
        if tool.name.startswith(SKIPPED_TOOLS):
            continue
        try:
            tool.version()
            rivals[tool.name] = select_pareto_front(make_simplified_files(tool, original))
        except PeerUnavailable as reason:
            print(f"\n{tool.name} is skipped: {reason}")
    print(f"\nSimplify + Draco: bytes, and our size over the target of {TARGET_RATIO:g} times these bytes:\n")
    both = [[f"{name}: bytes", "/ target"] for name in rivals]
    print_head(["RMS ×1e-5", "dB", "ours", "bytes", "with levels: bytes", *itertools.chain(*both)])
    for rms in DISTANCES:
        file, levels = (find_smallest(files, rms) for files in (ours, refined))
        cells = [f"{1e5 * rms:.1f}", f"{-20 * math.log10(rms):.1f}"]
        cells += ["no file", ""] if file is None else [file.made, f"{file.size:,}"]
        cells.append("no file" if levels is None else f"{levels.size:,}")
        for files in rivals.values():
            size = interpolate_size(files, rms)
            cells += (
                ["", ""] if size is None else [f"{size:,.0f}", format_target_ratio(file, TARGET_RATIO * size)]
            )
        print_row(cells)
    print(f"\n{OURS}: our own `simplify`, encoded by Draco.")


def make_simplified_files(tool: Tool, original: ReferenceMesh) -> Iterator[EncodedMesh]:
    """Yield files of one simplifier at several sizes and bit depths.

    The simplifier runs with its first setting.
    """
    setting = next(iter(tool.settings.values()))
    for share in SIMPLIFY_RATIOS:
        triangles = int(share * len(original.mesh.triangles))
        call, unpacked = tool.prepare(original.mesh, triangles, **setting)
        light = unpacked(call())
        for bits in BITS:
            data = encode_draco(light, bits)
            yield original.file(len(data), decode_draco(data), f"{triangles:,} triangles, {bits} bits")

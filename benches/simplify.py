"""Comparison of simplifiers: shape, colour, manifoldness, time and memory.

    python benches/simplify.py DATA [--ratios 0.1 0.04] [--mesh globe] [--only VTK] [--scan FILE]
                                    [--paint FILE ...] [--picture FILE] [--summary] [--samples 200000]

DATA holds `meshes/` and `images/`. `pip install '.[bench]'` installs the peers that are Python packages.
meshoptimizer requires cargo; CGAL requires g++ and Debian's libcgal-dev and libeigen3-dev. A missing peer is
skipped with a line that gives the reason. All tools get the same cleaned mesh. A full run takes five minutes.

Prints Markdown: a table for each mesh and ratio, then comparisons. With --summary, one row per tool shows its
best setting for each mesh and ratio, the one with the smallest product of shape and colour error. Our
simplifier runs with its derived colour weight and with multiples of it. A peer is beaten if one of our
settings is better in both shape and colour.

Each call is a separate process on one core. "CPU s" is its CPU time, "MB" the growth of peak memory during
the call; a call on a small mesh precedes both. Lengths are relative to the bounding box's diagonal. Shape is
two-sided. "check" is the RMS by PyMeshLab's own sampling. Colour is sampled on the original and compared with
the nearest point of the result, in 8-bit levels. "non-manifold vertices" have more than one fan. "flipped"
triangles face more than 120° away from the nearest triangle of the original. "edge spread" is the standard
deviation of edge lengths over their mean.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import meshes
import numpy as np
from peers.results import SimplifierResult, compare_with_peers, make_summary_table
from peers.tools import OURS, TOOLS, PeerUnavailable, Tool

from scanloom.stages.comparing.compare import compare
from scanloom.stages.surface.edges import build_edges
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.topology import Topology, topology

# Seconds after which a call counts as failed.
TIMEOUT_S = 300
MAX_FLIPPED_COSINE = math.cos(math.radians(120))


def main() -> None:
    """Print the tables and comparisons."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--ratios", type=float, nargs="+", default=[0.1, 0.04])
    parser.add_argument("--mesh", nargs="*", choices=meshes.MESHES, default=list(meshes.MESHES))
    parser.add_argument("--only", nargs="+", metavar="TOOL", help="tools that start with TOOL, and ours")
    parser.add_argument("--scan", type=Path, help="another coloured mesh")
    parser.add_argument(
        "--paint", type=Path, nargs="+", metavar="FILE", help="further models, painted with the earth's map"
    )
    parser.add_argument("--picture", type=Path, help="draw shape error against colour error")
    parser.add_argument("--summary", action="store_true", help="print one row per tool, all else to stderr")
    parser.add_argument("--samples", type=int, default=200_000)
    options = parser.parse_args()

    with contextlib.redirect_stdout(sys.stderr if options.summary else sys.stdout):
        rows = run(options)
        print("\n" + "\n".join(compare_with_peers(rows)))
    if options.summary:
        print("\n".join(make_summary_table(rows)))
    if options.picture:
        from peers.picture import draw_errors

        draw_errors(rows, options.picture)


def run(options: argparse.Namespace) -> list[SimplifierResult]:
    """Measure all tools; print a table for each mesh and ratio."""
    tools = list(find_installed(options.only))
    inputs = {name: meshes.MESHES[name](options.data) for name in options.mesh}
    if options.scan:
        inputs[options.scan.stem] = meshes.read_colored_scan(options.scan)
    for path in options.paint or ():
        inputs[path.stem] = meshes.read_projected(path, meshes.read_earth_map(options.data))
    rows = []
    for name, mesh in inputs.items():
        for ratio in options.ratios:
            print(f"\n### {name}, {len(mesh.triangles):,} triangles to {ratio:.0%}\n\n{HEADER}")
            part: list[SimplifierResult] = []
            for row in measure_tools(name, mesh, ratio, tools, options.samples):
                part.append(row)
                print(format_row(row, part[0]), flush=True)
            rows += part
    return rows


def find_installed(prefixes: list[str] | None) -> Iterator[Tool]:
    """Yield the available tools; print their versions, and reasons for missing ones."""
    for tool in TOOLS:
        if (
            prefixes
            and tool.name != OURS
            and not tool.name.lower().startswith(tuple(o.lower() for o in prefixes))
        ):
            continue
        try:
            print(f"- {tool.name}: {tool.version()}", flush=True)
            yield tool
        except PeerUnavailable as reason:
            print(f"- {tool.name} is skipped: {reason}", flush=True)


def measure_tools(
    name: str, mesh: Mesh, ratio: float, tools: list[Tool], samples: int
) -> Iterator[SimplifierResult]:
    """Run each tool with each setting and measure its result."""
    before = topology(mesh)
    for tool, setting, cost, light in run_tools(mesh, ratio, tools):
        yield SimplifierResult(
            mesh=name,
            ratio=ratio,
            tool=tool.name,
            setting=setting,
            **cost,
            **measure_quality(mesh, before, light, samples),
        )


def run_tools(
    mesh: Mesh, ratio: float, tools: list[Tool]
) -> Iterator[tuple[Tool, str, dict[str, float], Mesh]]:
    """Run each tool with each setting; print failures.

    Meshes without colours run with the first setting only. Yields tool, setting, cost ("seconds" and
    "megabytes") and result.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, result = Path(folder, "given.npz"), Path(folder, "result.npz")
        save_mesh(mesh, given)
        for tool in tools:
            settings = list(tool.settings)
            for setting in settings if mesh.colors is not None else settings[:1]:
                try:
                    cost = call_in_subprocess(
                        tool, setting, given, math.floor(ratio * len(mesh.triangles)), result
                    )
                except (PeerUnavailable, subprocess.SubprocessError) as error:
                    print(f"| {tool.name} | {setting} | failed: {error} |")
                    continue
                yield tool, setting if mesh.colors is not None else "", cost, load_mesh(result)


def call_in_subprocess(
    tool: Tool, setting: str, given: Path, triangles: int, result: Path
) -> dict[str, float]:
    """Call a tool in a new process; return seconds and megabytes.

    Raises
    ------
    PeerUnavailable
        If the tool fails; the message is the last line it printed.
    """
    command = [
        sys.executable,
        __file__,
        "--call",
        tool.name,
        setting,
        str(given),
        str(triangles),
        str(result),
    ]
    # Some tools read the thread count from these variables and ignore the CPU affinity.
    environment = os.environ | {"OMP_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, env=environment)
    if done.returncode:
        raise PeerUnavailable((done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1])
    return dict(json.loads(done.stdout.splitlines()[-1]))


def call_tool(name: str, setting: str, given: str, triangles: str, result: str) -> None:
    """Call one tool in this process; print its cost as JSON."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    tool = next(tool for tool in TOOLS if tool.name == name)
    mesh = load_mesh(Path(given))
    small = meshes.make_globe(12, np.zeros((2, 2, 3), np.uint8)).with_(colors=None)
    if mesh.colors is not None:
        small = small.with_(colors=np.resize(mesh.colors, (len(small.vertices), 3)))
    # Warm up: load libraries before anything is measured.
    warm, _ = tool.prepare(small, 200, **tool.settings[setting])
    warm()
    work, unpacked = tool.prepare(mesh, int(triangles), **tool.settings[setting])
    # Linux resets the peak memory of a process on this write; the peak so far is from earlier steps.
    Path("/proc/self/clear_refs").write_text("5")
    before, start = read_peak_bytes(), time.process_time()
    raw = work()
    seconds, growth = time.process_time() - start, read_peak_bytes() - before
    save_mesh(unpacked(raw), Path(result))
    print("\n" + json.dumps({"seconds": seconds, "megabytes": growth / 1e6}))


def read_peak_bytes() -> int:
    """Return the peak resident memory of this process since its last reset."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def save_mesh(mesh: Mesh, path: Path) -> None:
    """Write a mesh to an NPZ file for `load_mesh`."""
    colors = {} if mesh.colors is None else {"colors": mesh.colors}
    np.savez(path, vertices=mesh.vertices, triangles=mesh.triangles, **colors)


def load_mesh(path: Path) -> Mesh:
    """Read a mesh written by `save_mesh`."""
    with np.load(path) as arrays:
        return Mesh(arrays["vertices"], arrays["triangles"], arrays.get("colors"))


def measure_quality(mesh: Mesh, before: Topology, result: Mesh, samples: int) -> dict[str, Any]:
    """Measure a result against its input."""
    difference = compare(mesh, result, samples=samples)
    after = topology(result)
    color = difference.color_a_to_b
    lengths = compute_edge_lengths(result)
    angles = compute_min_angles(result)
    diagonal = difference.diagonal
    return {
        "triangles": len(result.triangles),
        "rms": difference.symmetric.rms / diagonal,
        "maximum": difference.symmetric.maximum / diagonal,
        "check": measure_pymeshlab_rms(mesh, result, samples // 2, diagonal),
        "color": color and color.rmse,
        "color_note": "" if mesh.colors is None else "dropped",
        "psnr": color and color.psnr,
        "topology": after,
        "euler_change": after.euler - before.euler,
        "turned": count_flipped(mesh, result),
        "edge_mean": lengths.mean() / diagonal,
        "edge_spread": lengths.std() / lengths.mean(),
        "angle_low": float(np.percentile(angles, 5)),
        "angle_least": float(angles.min()),
    }


def measure_pymeshlab_rms(mesh: Mesh, result: Mesh, samples: int, diagonal: float) -> float | None:
    """Measure the two-sided RMS over the diagonal with PyMeshLab.

    Returns None if PyMeshLab is not installed.
    """
    try:
        import pymeshlab
    except ImportError:
        return None
    pair = pymeshlab.MeshSet()
    for one in (mesh, result):
        pair.add_mesh(pymeshlab.Mesh(one.vertices, one.triangles))
    squared = [
        pair.get_hausdorff_distance(
            sampledmesh=a, targetmesh=1 - a, samplevert=False, sampleface=True, samplenum=samples
        )["RMS"]
        ** 2
        for a in (0, 1)
    ]
    return math.sqrt(sum(squared) / 2) / diagonal


def compute_edge_lengths(mesh: Mesh) -> np.ndarray:
    """Compute the length of every edge (n,), metres."""
    ends = build_edges(mesh.triangles, len(mesh.vertices)).ends
    return np.linalg.norm(mesh.vertices[ends[:, 0]] - mesh.vertices[ends[:, 1]], axis=1)


def compute_min_angles(mesh: Mesh) -> np.ndarray:
    """Compute each triangle's smallest angle (m,), degrees; 0 if degenerate."""
    corners = mesh.vertices[mesh.triangles]
    one, other = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    sines = np.linalg.norm(np.cross(one, other), axis=2)
    return np.degrees(np.arctan2(sines, (one * other).sum(axis=2))).min(axis=1)


def count_flipped(mesh: Mesh, result: Mesh) -> int:
    """Count triangles that face more than 120° away from the original.

    Each is compared with the original's triangle nearest to its centroid.
    """
    middles = result.vertices[result.triangles].mean(axis=1)
    nearest = (
        RaycastingSurface(mesh, compute_bounding_box(mesh, result)).find_closest_points(middles).triangles
    )
    cosines = (compute_unit_normals(result) * compute_unit_normals(mesh)[nearest]).sum(axis=1)
    return int(np.count_nonzero(cosines < MAX_FLIPPED_COSINE))


def compute_unit_normals(mesh: Mesh) -> np.ndarray:
    """Compute each triangle's unit normal (m, 3); zero without area."""
    a, b, c = mesh.vertices[mesh.triangles].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


COLUMNS = {
    "tool": "---",
    "setting": "---",
    "triangles": "---:",
    "RMS ×1e-5": "---:",
    "check": "---:",
    "max ×1e-5": "---:",
    "colour RMSE": "---:",
    "PSNR dB": "---:",
    "non-manifold edges": "---:",
    "non-manifold vertices": "---:",
    "flipped": "---:",
    "degenerate": "---:",
    "border edges": "---:",
    "Euler ±": "---:",
    "edge ×1e-5": "---:",
    "edge spread": "---:",
    "5 % angle °": "---:",
    "min °": "---:",
    "CPU s": "---:",
    "× ours": "---:",
    "MB": "---:",
}
HEADER = "\n".join("| " + " | ".join(part) + " |" for part in (COLUMNS, COLUMNS.values()))


def format_row(row: SimplifierResult, first: SimplifierResult) -> str:
    """Format a row in Markdown.

    Times are also given relative to `first`, if that is ours.
    """
    shape = row.topology
    color = (row.color_note, "") if row.color is None else (f"{row.color:.2f}", f"{row.psnr:.2f}")
    cells = (
        row.tool,
        row.setting,
        f"{row.triangles:,}",
        f"{1e5 * row.rms:.2f}",
        "" if row.check is None else f"{1e5 * row.check:.2f}",
        f"{1e5 * row.maximum:.0f}",
        *color,
        f"{shape.nonmanifold_edges}",
        f"{shape.nonmanifold_vertices}",
        f"{row.turned}",
        f"{shape.degenerate}",
        f"{shape.boundary_edges}",
        f"{row.euler_change:+d}",
        f"{1e5 * row.edge_mean:.0f}",
        f"{row.edge_spread:.2f}",
        f"{row.angle_low:.1f}",
        f"{row.angle_least:.2f}",
        f"{row.seconds:.2f}",
        f"{row.seconds / first.seconds:.2f}" if first.tool == OURS else "",
        f"{row.megabytes:.0f}",
    )
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    if sys.argv[1:2] == ["--call"]:
        call_tool(*sys.argv[2:])
    else:
        main()

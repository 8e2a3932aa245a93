"""Levels of detail: build time, proven bounds, and sampled deviations.

    python benches/lod.py DATA [--mesh horse kitchen ...] [--threads 1] [--fronts 100] [--samples 20000]
    python benches/lod.py DATA --fields

DATA holds `meshes/`. Prints these Markdown tables:

Build: CPU seconds, million input triangles per second, cells of the finest level, nodes, stored triangles
over input triangles, and file size. "cut to 20,000" is the wall time of a cut to 20,000 triangles. "evaluate
+ adjust" is the wall time of evaluating the paper's measures for a view and cutting the mesh accordingly.
Both are the best of five runs.

Levels: for each level the proven bounds, its triangles, and the triangles of the whole mesh simplified by
method `certified` within the same distance. "ratio" of the two is the cost of borders between cells. "sampled
/ proven" is the sampled distance over the proven one, over all nodes of the level: the maximum, which must
not exceed 1, and the ratio of nodes at 0.8 or more. Each node is compared with its part of the input, in both
directions. The last two columns are the same for colours at nearest points.

clusterlod: cuts of the whole mesh within an error, by meshoptimizer's clusterlod and by ours: triangles,
sampled distance over the claimed one, and our triangle count over clusterlod's. The environment variable
MESHOPTIMIZER names a folder with meshoptimizer's sources; without it the table is skipped. clusterlod bounds
shape alone, while colours bound our levels, too.

Fronts: random sets of nodes with random splits that cover the surface. Counts the fronts with an edge of more
than two triangles, and the fronts whose borders differ from the input's.

Fields (`--fields`): the horse in the four fields of view of the paper's figure 4, by its own rule. The paper
gives the field's parameter and the triangle count, but neither viewpoint, pixels, near nor far distance.

- "full rule" applies all measures for six viewpoints along the axes: smallest and largest triangle count.
- "error" applies the rule's error threshold alone, the only part that depends on the field. The parameter is
  taken as the angle of the field in degrees, or as the distance. The missing scale, pixels per metre, is
  calibrated with the first row; the other rows follow.
- "global" is lambda_G with the last row's count as floor and a far distance calibrated with the first row.
- "proven" and "sampled" are the distances for "error, distance", over the diagonal.
"""

from __future__ import annotations

import argparse
import ctypes
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from markdown_tables import print_head, print_row
from numpy.typing import NDArray
from peers import native
from trimesh.triangles import points_to_barycentric

from scanloom.stages import lod
from scanloom.stages._open3d import import_open3d
from scanloom.stages.lod import Hierarchy, View
from scanloom.stages.lod.refinement_measures import compute_global_limit
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.topology import topology

MESHES = {
    "horse": "horse.ply",
    "igea": "igea.ply",
    "kitchen": "redkitchen_fused_vertexcolor.ply",
}
BUILD_COLUMNS = [
    *("mesh", "triangles", "build CPU s", "Mtri/s", "cells", "nodes", "stored / input", "MB"),
    *("cut to 20,000 ms", "evaluate + adjust ms"),
]
LEVEL_COLUMNS = [
    *("mesh", "level", "proven m", "proven colour levels", "triangles", "whole mesh", "ratio"),
    *("sampled / proven, max", "0.8 or more", "colour: max", "0.8 or more"),
]
CLUSTERLOD_COLUMNS = [
    *(
        "mesh",
        "error m",
        "clusterlod: triangles",
        "sampled / claimed",
        "scanloom: triangles",
        "sampled / proven",
        "ratio",
    ),
]
# Field parameters and triangle counts of figure 4.
FIELDS = ((10.6017, 8632), (22.4261, 6553), (37.1169, 4060), (78.9082, 762))
FIELD_COLUMNS = [
    *("parameter", "paper", "full rule, 6 views", "global", "error, angle", "difference"),
    *("error, distance", "difference", "proven / diagonal", "sampled / diagonal"),
]
FRONT_COLUMNS = ["mesh", "fronts", "with non-manifold edges", "with other borders"]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--mesh", nargs="+", choices=MESHES, default=list(MESHES))
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--fronts", type=int, default=100)
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--fields", action="store_true")
    given = parser.parse_args()
    if given.fields:
        print_fields(read_mesh(given.data / "meshes" / MESHES["horse"]), given.threads, given.samples)
        return
    meshes = {name: read_mesh(given.data / "meshes" / MESHES[name]) for name in given.mesh}
    hierarchies: dict[str, Hierarchy] = {}
    print_head(BUILD_COLUMNS)
    for name, mesh in meshes.items():
        before = time.process_time()
        hierarchies[name] = lod.build(mesh, threads=given.threads)
        print_build(name, mesh, hierarchies[name], time.process_time() - before)
    print()
    print_head(LEVEL_COLUMNS)
    for name, mesh in meshes.items():
        print_levels(name, mesh, hierarchies[name], given.samples)
    print()
    print_clusterlod(meshes, hierarchies, given.samples)
    print()
    print_head(FRONT_COLUMNS)
    for name, hierarchy in hierarchies.items():
        print_fronts(name, hierarchy, given.fronts)


def print_fields(mesh: Mesh, threads: int, samples: int) -> None:
    """Print the table of the paper's fields of view."""
    # Levels with a small ratio, because bounds are proven for whole levels only.
    hierarchy = lod.build(mesh, ratio=1.2, root_triangles=400, cell_triangles=4000, threads=threads)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    (first, max_triangles), (_, min_triangles) = FIELDS[0], FIELDS[-1]
    levels = hierarchy.to_dict()["levels"]
    counts = np.log([level["triangles"] for level in levels])
    bounds = np.log([level["shape_bound_m"] for level in levels])
    exact = np.interp(np.log(max_triangles), counts, bounds)
    share = (max_triangles - min_triangles) / (len(mesh.triangles) - min_triangles)
    far = first / (1 - share)
    print_head(FIELD_COLUMNS)
    for parameter, paper in FIELDS:
        full_rule_counts = [
            count_triangles_by_full_rule(hierarchy, parameter, axis) for axis in (*np.eye(3), *-np.eye(3))
        ]
        overall = compute_global_limit(len(mesh.triangles), min_triangles, parameter, near=0.0, far=far)
        half, first_half = (np.tan(np.radians(p / 2)) for p in (parameter, first))
        by_angle, count = (
            round(float(np.exp(np.interp(exact + np.log(more), bounds[::-1], counts[::-1]))))
            for more in (half / first_half, parameter / first)
        )
        cut = hierarchy.cut(triangles=count)
        there, back = (
            sample_max_deviation(cut.mesh, mesh, samples),
            sample_max_deviation(mesh, cut.mesh, samples),
        )
        found = max(there[0], back[0])
        print_row(
            [
                f"{parameter:.1f}",
                f"{paper:,}",
                f"{min(full_rule_counts):,} to {max(full_rule_counts):,}",
                f"{overall:,.0f}",
                f"{by_angle:,}",
                f"{by_angle / paper - 1:+.0%}",
                f"{count:,}",
                f"{count / paper - 1:+.0%}",
                f"{cut.shape_bound_m / diagonal:.2e}",
                f"{found / diagonal:.2e}",
            ]
        )


def count_triangles_by_full_rule(hierarchy: Hierarchy, field: float, axis: NDArray[np.float64]) -> int:
    """Count triangles by the paper's full rule.

    Parameters
    ----------
    field : field of view, degrees.
    axis : unit vector (3,) from the model to the eye.
    """
    middle, radius = hierarchy.spheres[0][0], hierarchy.spheres[1][0]
    # At this distance, the narrowest field still shows the whole model.
    eye = middle + axis * radius / np.sin(np.radians(0.5 * FIELDS[0][0]))
    view = View(tuple(eye), tuple(middle), tuple(np.roll(axis, 1)), field=field)
    weights = lod.evaluate(hierarchy, view, rule="paper")
    return lod.adjust(hierarchy.front(), weights, len(hierarchy.triangles)).triangles


def print_build(name: str, mesh: Mesh, hierarchy: Hierarchy, seconds: float) -> None:
    """Print a row of the table of builds."""
    with tempfile.TemporaryDirectory() as folder:
        lod.write_slod(Path(folder) / "m.slod", hierarchy)
        size = (Path(folder) / "m.slod").stat().st_size
    metrics = hierarchy.to_dict()
    middle, radius = hierarchy.spheres[0][0], hierarchy.spheres[1][0]
    eye = middle + np.array((0.0, 0.0, 3.0 * radius))
    view = View(tuple(eye), tuple(middle))
    hierarchy.cut(triangles=1)
    front = hierarchy.front()
    lod.evaluate(hierarchy, view)
    print_row(
        [
            name,
            f"{len(mesh.triangles):,}",
            f"{seconds:.1f}",
            f"{len(mesh.triangles) / seconds / 1e6:.4f}",
            str(metrics["leaves"]),
            str(metrics["nodes"]),
            f"{metrics['stored_per_input']:.2f}",
            f"{size / 1e6:.1f}",
            f"{measure_min_ms(lambda: hierarchy.cut(triangles=20_000)):.1f}",
            f"{measure_min_ms(lambda: lod.adjust(front, lod.evaluate(hierarchy, view), 20_000).cut()):.1f}",
        ]
    )


def measure_min_ms(call: Callable[[], object]) -> float:
    """Measure the smallest wall time of five calls, ms."""
    times = []
    for _ in range(5):
        before = time.perf_counter()
        call()
        times.append(time.perf_counter() - before)
    return 1e3 * min(times)


def print_levels(name: str, mesh: Mesh, hierarchy: Hierarchy, samples: int) -> None:
    """Print the rows of the table of levels, finest first."""
    for level in range(int(hierarchy.level.max()) + 1):
        nodes = np.flatnonzero(hierarchy.level == level)
        if not len(nodes):
            continue
        bound = float(hierarchy.shape_bound[nodes].max())
        triangles = int(hierarchy.coarse[nodes].sum())
        whole = len(simplify(mesh, method="certified", max_shape=bound).mesh.triangles)
        attacks = np.array([sample_node_deviation(hierarchy, int(node), samples) for node in nodes])
        shares = attacks[:, 0] / hierarchy.shape_bound[nodes]
        colors = ["", "", ""]
        if hierarchy.colors is not None:
            of_colors = attacks[:, 1] / hierarchy.color_bound[nodes]
            colors = [f"{hierarchy.color_bound[nodes].max():.0f}", *format_max_and_ratio(of_colors)]
        print_row(
            [
                name,
                str(level + 1),
                f"{bound:.3g}",
                colors[0],
                f"{triangles:,}",
                f"{whole:,}",
                f"{triangles / whole:.2f}",
                *format_max_and_ratio(shares),
                *colors[1:],
            ]
        )


def format_max_and_ratio(ratios: NDArray[np.float64]) -> list[str]:
    """Format the maximum, and the ratio of values of 0.8 or more."""
    return [f"{ratios.max():.3f}", f"{np.mean(ratios >= 0.8):.0%}"]


def print_clusterlod(meshes: dict[str, Mesh], hierarchies: dict[str, Hierarchy], samples: int) -> None:
    """Print cuts within an error by clusterlod (claimed) and by ours (proven)."""
    try:
        library = native.load_clusterlod()
    except native.PeerUnavailable as lacking:
        print(f"clusterlod is skipped: {lacking}.")
        return
    print_head(CLUSTERLOD_COLUMNS)
    for name, mesh in meshes.items():
        hierarchy = hierarchies[name]
        clusters = ClusterlodHierarchy(library, mesh)
        print(f"{name}: clusterlod takes {clusters.seconds:.2f} CPU s to build.", file=sys.stderr)
        for level in range(int(hierarchy.level.max()) + 1):
            at = hierarchy.shape_bound[hierarchy.level == level].max(initial=0.0)
            if at == 0.0:
                continue
            claimed, ours = clusters.cut(at), hierarchy.cut(max_shape=at).mesh
            far = [
                max(sample_max_deviation(m, mesh, samples)[0], sample_max_deviation(mesh, m, samples)[0]) / at
                for m in (claimed, ours)
            ]
            counts = [len(m.triangles) for m in (claimed, ours)]
            ratio = f"{counts[1] / counts[0]:.2f}"
            print_row(
                [
                    name,
                    f"{at:.3g}",
                    f"{counts[0]:,}",
                    f"{far[0]:.2f}",
                    f"{counts[1]:,}",
                    f"{far[1]:.2f}",
                    ratio,
                ]
            )


class ClusterlodHierarchy:
    """clusterlod hierarchy of a mesh's shape, in clusters of 128 triangles."""

    def __init__(self, library: ctypes.CDLL, mesh: Mesh) -> None:
        self.library, self.mesh = library, mesh
        points, corners = mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32)
        before = time.process_time()
        self.handle = ctypes.c_void_p(
            library.build(
                points.ctypes.data_as(ctypes.c_void_p),
                ctypes.c_size_t(len(points)),
                corners.ctypes.data_as(ctypes.c_void_p),
                ctypes.c_size_t(corners.size),
                ctypes.c_size_t(128),
            )
        )
        self.seconds = time.process_time() - before

    def cut(self, error: float) -> Mesh:
        """Cut the hierarchy at an error in metres."""
        allowed = ctypes.c_float(error)
        corners = np.empty(self.library.cut(self.handle, allowed, None), np.uint32)
        self.library.cut(self.handle, allowed, corners.ctypes.data_as(ctypes.c_void_p))
        return Mesh(self.mesh.vertices, corners.reshape(-1, 3).astype(np.int32))


def sample_node_deviation(hierarchy: Hierarchy, node: int, samples: int) -> tuple[float, float]:
    """Sample the largest deviation between a node's coarse mesh and its input.

    Returns the two-sided distance in metres and the colour difference in levels.
    """
    leaves = [leaf for leaf in range(hierarchy.nodes) if is_descendant(hierarchy, leaf, node)]
    leaves = [leaf for leaf in leaves if not len(hierarchy.children[leaf])]
    base = hierarchy.mesh(leaves, hierarchy.splits[leaves])
    coarse = hierarchy.mesh([node], [0])
    there, back = sample_max_deviation(coarse, base, samples), sample_max_deviation(base, coarse, samples)
    return max(there[0], back[0]), max(there[1], back[1])


def is_descendant(hierarchy: Hierarchy, node: int, ancestor: int) -> bool:
    """Check if a node equals another or is its descendant."""
    while node > ancestor:
        node = int(hierarchy.parent[node])
    return node == ancestor


def sample_max_deviation(mesh: Mesh, other: Mesh, samples: int) -> tuple[float, float]:
    """Sample the largest distance and colour difference from `mesh` to `other`.

    Samples are the vertices, the centroids and random points of the triangles. The distance is in metres, the
    colour difference at nearest points in 8-bit levels, 0 without colours.
    """
    random = np.random.default_rng(0)
    corners = mesh.vertices[mesh.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    every = np.arange(len(corners))
    chosen = np.concatenate([np.tile(every, 4), random.choice(every, samples, p=areas / areas.sum())])
    fixed = np.repeat(np.vstack([np.eye(3), np.full((1, 3), 1 / 3)]), len(every), axis=0)
    weights = np.concatenate([fixed, random.dirichlet(np.ones(3), samples)])
    points = np.einsum("ij,ijk->ik", weights, corners[chosen])
    scene = import_open3d().t.geometry.RaycastingScene()
    scene.add_triangles(other.vertices.astype(np.float32), other.triangles.astype(np.uint32))
    found = scene.compute_closest_points(points.astype(np.float32))
    nearest = found["points"].numpy().astype(np.float64)
    distance = float(np.linalg.norm(points - nearest, axis=1).max())
    if mesh.colors is None or other.colors is None:
        return distance, 0.0
    there = other.triangles[found["primitive_ids"].numpy().astype(np.int64)]
    at = points_to_barycentric(other.vertices[there], nearest).clip(0, 1)
    shown = [
        np.einsum("ij,ijk->ik", w, colors[of].astype(np.float64))
        for w, colors, of in ((weights, mesh.colors, mesh.triangles[chosen]), (at, other.colors, there))
    ]
    return distance, float(np.linalg.norm(shown[0] - shown[1], axis=1).max())


def print_fronts(name: str, hierarchy: Hierarchy, count: int) -> None:
    """Print a row of the table of fronts."""
    random = np.random.default_rng(0)
    base = topology(hierarchy.cut(max_shape=0.0).mesh)
    crossed = bordered = 0
    for _ in range(count):
        nodes, todo, depth = [], [0], random.random()
        while todo:
            node = todo.pop()
            if len(hierarchy.children[node]) and random.random() < depth:
                todo += [int(child) for child in hierarchy.children[node]]
            else:
                nodes.append(node)
        found = topology(
            hierarchy.mesh(nodes, [int(random.integers(hierarchy.splits[n] + 1)) for n in nodes])
        )
        crossed += found.nonmanifold_edges > base.nonmanifold_edges
        same = (found.boundary_loops, found.components) == (base.boundary_loops, base.components)
        bordered += not same
    print_row([name, f"{count:,}", str(crossed), str(bordered)])


if __name__ == "__main__":
    main()

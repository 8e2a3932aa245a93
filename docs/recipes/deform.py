"""Deform a marked part of a mesh, refined where it bends; explained in docs/recipes/deform.md.

    python docs/recipes/deform.py OUT [--mesh FILE --center X Y Z --radius M --reach M --move X Y Z ...]

Without a mesh, a bar with grooves is generated. OUT gets front.ply, deformed.ply, adjusted.ply,
repaired.ply and deform.png, a picture of the four.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from scanloom.stages import Camera, Mesh, Sphere, Viewpoint, check, lod, read_mesh, render, repair, write_mesh
from scanloom.stages._open3d import import_open3d
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.rendering.render import write_png

Floats = NDArray[np.float64]

# Degrees. The front is too coarse if neighbouring triangles turn by more than this.
MAX_BEND_DEG = 6.0
# Degrees. Triangles with a smaller angle are repaired.
MIN_ANGLE_DEG = 3.0
# Maximum number of triangles of a front.
MAX_TRIANGLES = 20_000
ITERATIONS = 40


@dataclass(frozen=True)
class Handle:
    """Handle of a deformation: a sphere that moves rigidly; vertices beyond `reach` stay.

    Attributes
    ----------
    center : (x, y, z), metres.
    radius : of the sphere, metres.
    reach : points farther than this from the centre stay, metres.
    move : (x, y, z), metres.
    turn : degrees about `axis` through the centre.
    """

    center: tuple[float, float, float]
    radius: float
    reach: float
    move: tuple[float, float, float]
    turn: float
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @property
    def region(self) -> Sphere:
        """Marked region, which moves rigidly."""
        return Sphere(center=self.center, radius=self.radius, lock=True)

    def mark_fixed(self, points: Floats) -> NDArray[np.bool_]:
        """Select the points (n, 3) that stay."""
        return np.asarray(np.linalg.norm(points - self.center, axis=1) > self.reach)

    def move_points(self, points: Floats) -> Floats:
        """Move points (n, 3) with the handle."""
        turn = Rotation.from_rotvec(np.radians(self.turn) * np.array(self.axis))
        return np.asarray(turn.apply(points - self.center) + self.center + self.move)


@dataclass(frozen=True)
class BentRegion:
    """Region of the undeformed mesh that bends."""

    tree: cKDTree
    is_bent: NDArray[np.bool_]

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Select the points (n, 3) whose nearest vertex of the front is bent."""
        _, nearest = self.tree.query(points)
        return np.asarray(self.is_bent[nearest])


@dataclass(frozen=True)
class DeformationResult:
    """Meshes and metrics of each step.

    Attributes
    ----------
    front : undeformed mesh, refined in the marked region.
    deformed : deformed front.
    adjusted : deformed mesh, refined where it bends.
    repaired : the adjusted mesh after repairs.
    bends : maximum change of the angle between neighbouring triangles, degrees, of deformed and adjusted.
    irregular : number of caps, needles, folds and spikes, of adjusted and repaired.
    repair_bound_m : proven bound on the motion of the surface by repairs.
    """

    front: Mesh
    deformed: Mesh
    adjusted: Mesh
    repaired: Mesh
    bends: tuple[float, float]
    irregular: tuple[int, int]
    repair_bound_m: float


def deform(mesh: Mesh, handle: Handle, *, cell_triangles: int = 2000) -> DeformationResult:
    """Refine the marked part, deform, refine the bends, deform again, and repair."""
    hierarchy = lod.build(mesh, cell_triangles=cell_triangles, root_triangles=cell_triangles // 4)
    view = make_view(mesh)
    marked = lod.evaluate(hierarchy, view, handle.region, silhouette=False)
    front = lod.adjust(hierarchy.front(), marked, MAX_TRIANGLES)
    before = front.cut().mesh
    deformed = deform_as_rigid_as_possible(before, handle)

    bend = measure_bends(before, deformed)
    bent = BentRegion(cKDTree(before.vertices), bend > MAX_BEND_DEG)
    bends = lod.evaluate(hierarchy, view, constraints=bent, silhouette=False)
    lod.adjust(front, bends, MAX_TRIANGLES)
    finer = front.cut().mesh
    adjusted = deform_as_rigid_as_possible(finer, handle)

    edge = np.linalg.norm(np.diff(finer.vertices[finer.triangles[:, :2]], axis=1), axis=2)
    repaired = repair(adjusted, corner_angle=MIN_ANGLE_DEG, max_shape=0.25 * float(np.median(edge)))
    return DeformationResult(
        before,
        deformed,
        adjusted,
        repaired.mesh,
        (float(bend.max()), float(measure_bends(finer, adjusted).max())),
        (count_irregular(adjusted), count_irregular(repaired.mesh)),
        repaired.bound_m,
    )


def deform_as_rigid_as_possible(mesh: Mesh, handle: Handle) -> Mesh:
    """Deform a mesh by moving its handle.

    Sorkine and Alexa, "As-rigid-as-possible surface modeling" (2007).

    Raises
    ------
    UsageError
        If no vertex is in the handle, or no vertex stays.
    """
    points = mesh.vertices
    is_handle, is_fixed = handle.region.contains(points), handle.mark_fixed(points)
    if not is_handle.any() or not is_fixed.any():
        raise UsageError(
            MACHINE_BUG,
            "no vertex is within the radius of the handle, or none is beyond its reach. "
            "Change --center, --radius or --reach.",
        )
    constrained = np.flatnonzero(is_handle | is_fixed)
    goals = np.where(is_handle[:, None], handle.move_points(points), points)[constrained]
    o3d: Any = import_open3d()
    given = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(points), o3d.utility.Vector3iVector(mesh.triangles)
    )
    places = o3d.utility.IntVector(constrained.astype(np.int32))
    goal = o3d.utility.Vector3dVector(goals)
    found = given.deform_as_rigid_as_possible(places, goal, max_iter=ITERATIONS)
    return mesh.with_(vertices=np.asarray(found.vertices).copy())


def measure_bends(before: Mesh, after: Mesh) -> Floats:
    """Compute the maximum change of the angle between triangles at each vertex (n,), degrees."""
    sides = np.concatenate([before.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    triangle = np.tile(np.arange(len(before.triangles)), 3)
    order = np.lexsort(np.sort(sides, axis=1).T)
    same = (np.sort(sides, axis=1)[order][1:] == np.sort(sides, axis=1)[order][:-1]).all(axis=1)
    first, second = order[:-1][same], order[1:][same]
    turned = np.abs(
        compute_normal_angles(after, triangle[first], triangle[second])
        - compute_normal_angles(before, triangle[first], triangle[second])
    )
    max_bend = np.zeros(len(before.vertices))
    for corner in range(2):
        np.maximum.at(max_bend, sides[first, corner], turned)
    return max_bend


def compute_normal_angles(mesh: Mesh, first: NDArray[np.int64], second: NDArray[np.int64]) -> Floats:
    """Compute angles (k,) between the normals of triangle pairs, degrees."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    cosine = np.einsum("ij,ij->i", normals[first], normals[second])
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def count_irregular(mesh: Mesh) -> int:
    """Count the defects that repairs can remove: caps, needles, folds, spikes and the like."""
    found = check(mesh, corner_angle=MIN_ANGLE_DEG).to_dict()["classes"]
    return sum(one["count"] for one in found.values() if one["treatment"] == "marking")


def make_view(mesh: Mesh) -> lod.View:
    """Return a small view of the whole mesh from the front, for low detail outside the region."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    eye = middle - np.array((0.0, 1.4 * size, 0.0))
    return lod.View(tuple(eye), tuple(middle), (0.0, 0.0, 1.0), 150, 150)


def make_bar(around: int = 48, along: int = 90) -> Mesh:
    """Make a grooved bar along z, 2 m long."""
    angle, height = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.linspace(0, 2, along))
    radius = 0.25 * (1 + 0.06 * np.sin(8 * angle + 3 * height) + 0.02 * np.sin(20 * height))
    rings = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=2).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(along - 1), np.arange(around), indexing="ij")
    a, b = row * around + column, row * around + (column + 1) % around
    sides = np.stack([a, b, b + around, a, b + around, a + around], axis=2).reshape(-1, 3)
    ring, bottom = np.arange(around), len(rings)
    following = (ring + 1) % around
    last = (along - 1) * around
    caps = [
        np.stack([following, ring, np.full(around, bottom)], axis=1),
        np.stack([last + ring, last + following, np.full(around, bottom + 1)], axis=1),
    ]
    vertices = np.concatenate([rings, [(0, 0, 0), (0, 0, 2)]])
    return Mesh(vertices, np.concatenate([sides, *caps]).astype(np.int32))


def render_steps(found: DeformationResult, along: str) -> NDArray[np.uint8]:
    """Render the four meshes side by side, with their triangles, along x or y, z up."""
    steps = (found.front, found.deformed, found.adjusted, found.repaired)
    points = np.concatenate([mesh.vertices for mesh in steps])
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max())
    ahead = np.eye(3)["xyz".index(along)]
    down = np.array((0.0, 0.0, -1.0))
    across = float(np.ptp(points, axis=0)["xyz".index("y" if along == "x" else "x")])
    width = round(240 * min(max(across / size, 0.2) + 0.05, 1.0))
    camera = Camera(width, 240, 360.0, 360.0, 0.5 * width - 0.5, 119.5)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(down, ahead), down, ahead], axis=1)
    pose[:3, 3] = 0.5 * (low + high) - 1.75 * size * ahead
    viewpoint = Viewpoint("front", camera, pose)
    return np.hstack([render(mesh, viewpoint, shading="edges") for mesh in steps])


def main(words: Sequence[str] | None = None) -> DeformationResult:
    """Deform, write meshes and picture, print a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--mesh", type=Path)
    parser.add_argument("--center", type=float, nargs=3, default=(0.0, 0.0, 2.0))
    parser.add_argument("--radius", type=float, default=0.35)
    parser.add_argument("--reach", type=float, help="default: 4 radii")
    parser.add_argument("--move", type=float, nargs=3, default=(0.75, 0.0, -0.3))
    parser.add_argument("--turn", type=float, default=70.0)
    parser.add_argument("--along", choices=("x", "y"), default="y", help="viewing direction of the picture")
    parser.add_argument("--cell-triangles", type=int, default=800)
    given = parser.parse_args(words)
    handle = Handle(
        tuple(given.center), given.radius, given.reach or 4 * given.radius, tuple(given.move), given.turn
    )
    mesh = make_bar() if given.mesh is None else read_mesh(given.mesh)
    found = deform(mesh, handle, cell_triangles=given.cell_triangles)
    given.out.mkdir(parents=True, exist_ok=True)
    for name in ("front", "deformed", "adjusted", "repaired"):
        write_mesh(given.out / f"{name}.ply", getattr(found, name))
    write_png(given.out / "deform.png", render_steps(found, given.along))
    sys.stdout.write(
        f"triangles: {len(mesh.triangles):,}; front refined in the marked region: "
        f"{len(found.front.triangles):,}; adjusted to the bend: {len(found.adjusted.triangles):,}\n"
        f"largest bend between neighbours: {found.bends[0]:.1f}° before adjusting, {found.bends[1]:.1f}° "
        "after\n"
        f"irregular triangles: {found.irregular[0]:,} before repair, {found.irregular[1]:,} after; it "
        f"moved the surface by at most {found.repair_bound_m:.2g} m\n"
    )
    return found


if __name__ == "__main__":
    main()

"""Preparation of a solid for printing: hollow with drain holes, on a base plate, split to the print bed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.check import PRINTABLE, check
from scanloom.stages.cleaning.solids.attributes import transfer_attributes
from scanloom.stages.cleaning.solids.booleans import from_manifold, require_manifold3d, to_manifold
from scanloom.stages.cleaning.solids.level_set import WindingNumbers, extract_boundary
from scanloom.stages.cleaning.solids.shell import Shell, join_shells
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.exporting.codes import EXPORT_NOT_SOLID
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Vertices
from scanloom.stages.surface.raycasting import RaycastingSurface

# Grid cells of a cavity: per wall thickness, and at most along the longest side of the object.
_CELLS_PER_WALL, _MAX_CELLS = 2.0, 192
_DEPTH_MARGIN = 0.02
# Cells are first selected in blocks of this many along each side.
_BLOCK_CELLS = 4
# Halvings of a grid edge to locate the wall of a cavity.
_HALVINGS = 6
# Vertices of the foot: those within this ratio of the height above the lowest point.
_FOOT_RATIO = 0.1
# Depth to which an object sinks into its base plate, as a ratio of the plate's thickness.
_SINK_RATIO = 0.25
# Corners of the circles of drain holes.
_CIRCLE_CORNERS = 32
# Gap between parts that are laid out next to each other, as a ratio of the largest part's width.
_GAP_RATIO = 0.1


def prepare_print(
    mesh: Mesh, *, wall: float, drain: float, plate: float, bed: tuple[float, float, float] | None
) -> Mesh:
    """Prepare a solid for printing; z is up.

    Parameters
    ----------
    mesh : solid, metres.
    wall : thickness of the wall of the hollow result, metres; 0 for none.
    drain : diameter of the drain holes of cavities, metres; 0 for none.
    plate : thickness of the base plate, metres; 0 for none.
    bed : size of the print bed; larger objects are split into parts, which are laid out side by side.

    Raises
    ------
    MeshError
        If the mesh is not solid.
    UsageError
        If `manifold3d` is not installed.
    """
    require_manifold3d()
    given = Shell(mesh.vertices, mesh.triangles, np.arange(len(mesh.triangles))).weld()
    if unmet := check(mesh).find_unmet([PRINTABLE]):
        raise MeshError(
            EXPORT_NOT_SOLID,
            "it is not solid: {reason}",
            "mesh",
            remedy="run `scanloom clean --solid` first.",
            reason=unmet[0].message.rstrip("."),
        )
    solid = to_manifold(given)
    if wall > 0:
        solid = _hollow(solid, given, wall, drain)
    if plate > 0:
        solid += _make_plate(from_manifold(solid).vertices, plate)
    parts = [solid] if bed is None else _split(solid, bed)
    shells = [from_manifold(part) for part in parts]
    joined = transfer_attributes(join_shells(*shells), mesh).mesh
    return joined if bed is None else _lay_out(joined, shells)


def _hollow(solid: Any, given: Shell, wall: float, drain: float) -> Any:
    """Subtract the space deeper than `wall`, with vertical drain holes below its lowest points."""
    extent = float(np.ptp(given.vertices, axis=0).max())
    size = max(wall / _CELLS_PER_WALL, extent / _MAX_CELLS)
    # Vertices of the cavity can be this much outside of the region.
    depth = wall + _DEPTH_MARGIN * size
    region = _DeepRegion(given.mesh, depth)
    cells = _list_depth_cells(region, given, depth, size)
    if len(cells) == 0:
        return solid
    cavity = extract_boundary(region, cells, size)
    if len(cavity.triangles) == 0:
        return solid
    space = to_manifold(Shell(cavity.vertices, cavity.triangles, np.full(len(cavity.triangles), -1)))
    # Cavities too small for a drain hole stay filled.
    spaces = [part for part in space.decompose() if part.volume() > max(drain, wall) ** 3]
    for part in spaces:
        solid -= part
        if drain > 0:
            solid -= _make_drain(part, given.mesh, drain, size)
    return solid


class _DeepRegion:
    """Points inside of a closed surface, at least a distance away from it."""

    def __init__(self, mesh: Mesh, depth: float) -> None:
        self._surface, self._winding, self._depth = RaycastingSurface(mesh), WindingNumbers(mesh), depth

    def measure_distances(self, points: Vertices) -> NDArray[np.float64]:
        return self._surface.find_closest_points(points).distances

    def is_inside(self, points: Vertices) -> NDArray[np.bool_]:
        found = self.measure_distances(points) >= self._depth
        found[found] = self._winding.is_inside(points[found])
        return found

    def find_crossings(self, inner: Vertices, outer: Vertices) -> NDArray[np.float64]:
        low, high = np.zeros(len(inner)), np.ones(len(inner))
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            deep = self.measure_distances(inner + middle[:, None] * (outer - inner)) >= self._depth
            low, high = np.where(deep, middle, low), np.where(deep, high, middle)
        return low


def _list_depth_cells(region: _DeepRegion, given: Shell, depth: float, size: float) -> Ids:
    """Return the cells at a distance from the surface, from coarse to fine."""
    low = np.floor(given.vertices.min(axis=0) / size).astype(np.int64)
    high = np.floor(given.vertices.max(axis=0) / size).astype(np.int64)
    steps = [np.arange(a - 1, b + 2, _BLOCK_CELLS) for a, b in zip(low, high, strict=True)]
    cells = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = np.stack(np.meshgrid(*3 * [np.arange(_BLOCK_CELLS)], indexing="ij"), axis=-1).reshape(-1, 3)
    for count in (_BLOCK_CELLS, 1):
        distances = region.measure_distances((cells + count / 2) * size)
        cells = cells[np.abs(distances - depth) <= (count + 0.5) * size]
        if count > 1:
            cells = (cells[:, None] + offsets).reshape(-1, 3)
    return cells


def _make_drain(cavity: Any, surface: Mesh, diameter: float, size: float) -> Any:
    """Return a vertical cylinder from the lowest point of a cavity to below the surface."""
    library = require_manifold3d()
    points = from_manifold(cavity).vertices
    start = points[points[:, 2].argmin()]
    down = np.array([[0.0, 0.0, -1.0]])
    hits = RaycastingSurface(surface).cast_rays(start[None], down)
    depth = (
        float(hits.distances[0]) if len(hits.distances) else float(start[2] - surface.vertices[:, 2].min())
    )
    # Above the lowest point, the cavity is as wide as the hole; below the surface, a slope still closes it.
    length = depth + 2 * diameter + 2 * size
    circle = library.CrossSection.circle(diameter / 2, _CIRCLE_CORNERS)
    cylinder = library.Manifold.extrude(circle, length)
    bottom = start - np.array([0, 0, depth + diameter])
    return to_manifold(_without_source(from_manifold(cylinder.translate(bottom))))


def _make_plate(points: Vertices, thickness: float) -> Any:
    """Return a plate below an object: the convex hull of the foot, with a margin of its thickness."""
    library = require_manifold3d()
    low, height = points[:, 2].min(), float(np.ptp(points[:, 2]))
    foot = points[points[:, 2] <= low + _FOOT_RATIO * height, :2]
    outline = library.CrossSection.hull_points(np.ascontiguousarray(foot)).offset(
        thickness, library.JoinType.Round, 2.0, _CIRCLE_CORNERS
    )
    plate = library.Manifold.extrude(outline, thickness)
    return to_manifold(
        _without_source(from_manifold(plate.translate((0, 0, low - (1 - _SINK_RATIO) * thickness))))
    )


def _without_source(shell: Shell) -> Shell:
    return Shell(shell.vertices, shell.triangles, np.full(len(shell.triangles), -1))


def _split(solid: Any, bed: tuple[float, float, float]) -> list[Any]:
    """Cut a solid into equal slices along each axis, so that each part fits on the bed."""
    parts = [solid]
    for axis in range(3):
        low, high = np.array(solid.bounding_box()).reshape(2, 3)[:, axis]
        count = int(np.ceil((high - low) / bed[axis] * (1 - 1e-9)))
        normal = np.eye(3)[axis]
        for cut in np.linspace(low, high, count + 1)[1:-1].tolist():
            pieces = [part.split_by_plane(normal.tolist(), cut) for part in parts]
            parts = [piece for pair in pieces for piece in pair if not piece.is_empty()]
    return parts


def _lay_out(joined: Mesh, parts: Sequence[Shell]) -> Mesh:
    """Place parts side by side along x, each on the bed, and name them."""
    gap = _GAP_RATIO * max(float(np.ptp(part.vertices[:, 0])) for part in parts)
    left, vertices = 0.0, []
    for part in parts:
        vertices.append(part.vertices - part.vertices.min(axis=0) + np.array([left, 0, 0]))
        left += float(np.ptp(part.vertices[:, 0])) + gap
    return joined.with_(
        vertices=np.concatenate(vertices),
        part_ids=np.repeat(np.arange(len(parts)), [len(part.triangles) for part in parts]).astype(np.int32),
        part_names=tuple(f"part {row}" for row in range(1, len(parts) + 1)),
    )

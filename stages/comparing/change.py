"""Change detection between two scans of one location: new and removed surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.comparison_inputs import to_measurable_mesh
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface, compute_bounding_box, iterate_chunks
from scanloom.stages.surface.topology import compute_areas

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import ChangeKeywords

# Default change distance, as ratio of the earlier mesh's bounding-box diagonal.
_CHANGE_DISTANCE_RATIO = 0.01
# Maximum number of changed regions in the JSON metrics, largest first.
_MAX_LISTED_REGIONS = 10
_UNCHANGED_COLOR, _NEW_COLOR, _GONE_COLOR = (205, 205, 205), (45, 160, 70), (200, 60, 40)


@dataclass(frozen=True, kw_only=True)
class ChangeParams:
    """Thresholds of the change detection."""

    change_distance: float | None = param(
        None,
        "Surface farther than this from the other mesh is new or gone. Not given: 1 % of the diagonal of A.",
        unit="m",
        low=0,
        low_open=True,
    )
    change_area: float = param(
        0.0, "Minimum area of a connected change; smaller changes are ignored.", unit="m²", low=0
    )

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, eq=False)
class Changes:
    """Surface that appeared or disappeared between an earlier and a later mesh.

    Attributes
    ----------
    change_distance : change threshold in metres; surface farther from the other mesh has changed.
    new_mask : (m,) bool, new triangles of the later mesh.
    gone_mask : (k,) bool, triangles of the earlier mesh that are gone or were not seen again.
    new_area, gone_area : m².
    regions : connected changed regions, largest first: `kind` ("new" or "gone"), `area_m2`, `point_m`
        (centroid).
    painted_mesh : later mesh in grey with new surface in green, plus the gone surface of the earlier mesh in
        red.
    """

    change_distance: float
    new_mask: NDArray[np.bool_]
    gone_mask: NDArray[np.bool_]
    new_area: float
    gone_area: float
    regions: tuple[dict[str, Any], ...]
    painted_mesh: Mesh

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return areas and the largest changed regions for JSON."""
        return {
            "distance_m": self.change_distance,
            "new_area_m2": self.new_area,
            "gone_area_m2": self.gone_area,
            "new_regions": sum(one["kind"] == "new" for one in self.regions),
            "gone_regions": sum(one["kind"] == "gone" for one in self.regions),
            "largest": [dict(one) for one in self.regions[:_MAX_LISTED_REGIONS]],
        }


def changes(
    earlier: MeshLike,
    later: MeshLike,
    params: ChangeParams | None = None,
    **given: Unpack[ChangeKeywords],
) -> Changes:
    """Detect surface that appeared or disappeared between two meshes.

    A triangle has changed if its centroid is farther from the other mesh than the change distance. The areas
    are therefore accurate only if triangles are small compared with the change. Surface that the later scan
    did not see counts as gone.

    Parameters
    ----------
    earlier, later : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres, in one coordinate system.
    params : ChangeParams; single fields can be given by name instead.

    Raises
    ------
    MeshError
        If a mesh has no area.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(ChangeParams, params, given)
    before, after = to_measurable_mesh(earlier, "earlier"), to_measurable_mesh(later, "later")
    distance = params.change_distance
    if distance is None:
        distance = _CHANGE_DISTANCE_RATIO * float(
            np.linalg.norm(np.diff(compute_bounding_box(before), axis=0))
        )
    box = compute_bounding_box(before, after)
    new, new_places = _find_changes(after, before, box, distance, params.change_area, "new")
    gone, gone_places = _find_changes(before, after, box, distance, params.change_area, "gone")
    regions = sorted([*new_places, *gone_places], key=lambda place: -float(place["area_m2"]))
    sizes = [
        float(compute_areas(mesh.vertices, mesh.triangles)[rows].sum())
        for mesh, rows in ((after, new), (before, gone))
    ]
    painted = _paint_changes(before, after, new, gone)
    return Changes(distance, new, gone, sizes[0], sizes[1], tuple(regions), painted)


def _find_changes(
    mesh: Mesh, other: Mesh, box: Floats, change_distance: float, min_area: float, kind: str
) -> tuple[NDArray[np.bool_], list[dict[str, Any]]]:
    """Find the triangles of a mesh that are far from another mesh.

    Returns
    -------
    A mask (m,) of the changed triangles without patches smaller than `min_area` m², and a description of each
    remaining patch.
    """
    surface = NeedleSafeSurface(RaycastingSurface(other, box), box)
    centres = mesh.vertices[mesh.triangles].mean(axis=1)
    far = np.zeros(len(centres), bool)
    for rows in iterate_chunks(len(centres)):
        far[rows] = surface.find_closest_points(centres[rows]).distances > change_distance
    found = np.flatnonzero(far)
    if len(found) == 0:
        return far, []
    patch = _label_patches(mesh, found)
    sizes = compute_areas(mesh.vertices, mesh.triangles)[found]
    total = np.bincount(patch, sizes)
    far[found[total[patch] < min_area]] = False
    middles = np.stack([np.bincount(patch, sizes * centres[found, k]) for k in range(3)], axis=1)
    kept = np.flatnonzero((total >= min_area) & (total > 0))
    return far, [
        {"kind": kind, "area_m2": float(total[k]), "point_m": (middles[k] / total[k]).tolist()} for k in kept
    ]


def _label_patches(mesh: Mesh, triangle_rows: NDArray[np.intp]) -> NDArray[np.int32]:
    """Label the connected components (common vertices) of the given triangles, (k,) int32."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corners = mesh.triangles[triangle_rows]
    ends = corners[:, [0, 1, 1, 2]].reshape(-1, 2)
    count = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), (count, count))
    _, labels = connected_components(graph, directed=False)
    _, patch = np.unique(labels[corners[:, 0]], return_inverse=True)
    return np.asarray(patch, np.int32).ravel()


def _paint_changes(
    before: Mesh, after: Mesh, new_mask: NDArray[np.bool_], gone_mask: NDArray[np.bool_]
) -> Mesh:
    """Combine both meshes into one painted mesh.

    Triangles of different colour share no vertices, so that colours do not blend.
    """
    parts = (
        (after, ~new_mask, _UNCHANGED_COLOR),
        (after, new_mask, _NEW_COLOR),
        (before, gone_mask, _GONE_COLOR),
    )
    vertices, triangles, colors, count = [], [], [], 0
    for mesh, chosen, color in parts:
        used, corners = np.unique(mesh.triangles[chosen], return_inverse=True)
        vertices.append(mesh.vertices[used])
        triangles.append(corners.reshape(-1, 3) + count)
        colors.append(np.tile(np.array(color, np.uint8), (len(used), 1)))
        count += len(used)
    return Mesh(
        np.concatenate(vertices),
        np.concatenate(triangles).astype(np.int32),
        np.concatenate(colors),
        up=after.up,
    )

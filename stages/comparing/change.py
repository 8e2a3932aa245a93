"""What is new in a scan of a place, and what is gone, since another scan of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.measurable import measurable
from scanloom.stages.comparing.needles import WithNeedles
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.surface.convert import MeshLike
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, Surface, bounding_box, chunks
from scanloom.stages.surface.topology import areas

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import ChangeKeywords

# Of the diagonal of the earlier mesh, where no distance is given.
_FAR = 0.01
# Places that are told, largest first.
_PLACES = 10
_SAME, _NEW, _GONE = (205, 205, 205), (45, 160, 70), (200, 60, 40)


@dataclass(frozen=True, kw_only=True)
class ChangeParams:
    """What counts as a change between two scans of one place."""

    change_distance: float | None = param(
        None,
        "Farther than this from the other mesh is new, or gone. Not given: 1 % of the diagonal of A.",
        unit="m",
        low=0,
        low_open=True,
    )
    change_area: float = param(
        0.0, "Connected changes of a smaller area than this are left out.", unit="m²", low=0
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, eq=False)
class Changes:
    """What is new in a later mesh, and what of an earlier one is gone.

    Attributes
    ----------
    distance : metres; what is farther from the other mesh has changed.
    new : (m,) bool, triangles of the later mesh that are new.
    gone : (k,) bool, triangles of the earlier mesh that are gone, or were not seen again.
    new_area, gone_area : m².
    places : connected changes, largest first: `kind` ("new" or "gone"), `area_m2`, `point_m` in their middle.
    painted : the later mesh in grey, what is new in green, and what is gone of the earlier one in red.
    """

    distance: float
    new: NDArray[np.bool_]
    gone: NDArray[np.bool_]
    new_area: float
    gone_area: float
    places: tuple[dict[str, Any], ...]
    painted: Mesh

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return what there is to say of them, units in the names."""
        return {
            "distance_m": self.distance,
            "new_area_m2": self.new_area,
            "gone_area_m2": self.gone_area,
            "new_places": sum(one["kind"] == "new" for one in self.places),
            "gone_places": sum(one["kind"] == "gone" for one in self.places),
            "largest": [dict(one) for one in self.places[:_PLACES]],
        }


def changes(
    earlier: MeshLike,
    later: MeshLike,
    params: ChangeParams | None = None,
    **given: Unpack[ChangeKeywords],
) -> Changes:
    """Find what is new in a later mesh of a place, and what of an earlier one is gone.

    A triangle has changed if its centre is farther from the other mesh than the distance: areas are as exact
    as triangles are small beside the change. What the later scan did not see counts as gone.

    Parameters
    ----------
    earlier, later : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres, in one place.
    params : ChangeParams; single fields can be given by name instead.

    Raises
    ------
    MeshError
        If a mesh has no area.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(ChangeParams, params, given)
    before, after = measurable(earlier, "earlier"), measurable(later, "later")
    distance = params.change_distance
    if distance is None:
        distance = _FAR * float(np.linalg.norm(np.diff(bounding_box(before), axis=0)))
    box = bounding_box(before, after)
    new, new_places = _changed(after, before, box, distance, params.change_area, "new")
    gone, gone_places = _changed(before, after, box, distance, params.change_area, "gone")
    places = sorted([*new_places, *gone_places], key=lambda place: -float(place["area_m2"]))
    sizes = [
        float(areas(mesh.vertices, mesh.triangles)[rows].sum())
        for mesh, rows in ((after, new), (before, gone))
    ]
    painted = _painted(before, after, new, gone)
    return Changes(distance, new, gone, sizes[0], sizes[1], tuple(places), painted)


def _changed(
    mesh: Mesh, other: Mesh, box: Floats, distance: float, least: float, kind: str
) -> tuple[NDArray[np.bool_], list[dict[str, Any]]]:
    """Return which triangles of a mesh are far from the other, without small patches, and these patches."""
    surface = WithNeedles(Surface(other, box), box)
    centres = mesh.vertices[mesh.triangles].mean(axis=1)
    far = np.zeros(len(centres), bool)
    for rows in chunks(len(centres)):
        far[rows] = surface.closest(centres[rows]).distances > distance
    found = np.flatnonzero(far)
    if len(found) == 0:
        return far, []
    patch = _patches(mesh, found)
    sizes = areas(mesh.vertices, mesh.triangles)[found]
    total = np.bincount(patch, sizes)
    far[found[total[patch] < least]] = False
    middles = np.stack([np.bincount(patch, sizes * centres[found, k]) for k in range(3)], axis=1)
    kept = np.flatnonzero((total >= least) & (total > 0))
    return far, [
        {"kind": kind, "area_m2": float(total[k]), "point_m": (middles[k] / total[k]).tolist()} for k in kept
    ]


def _patches(mesh: Mesh, rows: NDArray[np.intp]) -> NDArray[np.int32]:
    """Return for each of these triangles the number of its patch; those with a common vertex are in one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corners = mesh.triangles[rows]
    ends = corners[:, [0, 1, 1, 2]].reshape(-1, 2)
    count = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), (count, count))
    _, labels = connected_components(graph, directed=False)
    _, patch = np.unique(labels[corners[:, 0]], return_inverse=True)
    return np.asarray(patch, np.int32).ravel()


def _painted(before: Mesh, after: Mesh, new: NDArray[np.bool_], gone: NDArray[np.bool_]) -> Mesh:
    """Return both in one mesh; no two kinds of triangles share vertices, so colours do not run together."""
    parts = ((after, ~new, _SAME), (after, new, _NEW), (before, gone, _GONE))
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

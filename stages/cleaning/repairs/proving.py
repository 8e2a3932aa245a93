"""Which triangles of a repaired mesh are not proven near the given one, or the other way round.

A triangle that nothing has changed is at no distance from itself. So only those written are looked at, each
against what was, or is, around it: the distance to a part of a surface bounds that to all of it.
"""

from __future__ import annotations

import numpy as np

from stages.cleaning.repairs.edited import Edited
from stages.cleaning.repairs.neighbourhood import grown
from stages.comparing.certify import certify
from stages.surface.edges import Ids
from stages.surface.mesh import Mesh, Vertices

# Rings around what was written that may be nearer to it than what was in its place.
_RINGS = 1
# Pieces a triangle. With more, bounds come no closer: what they pass is what needles add to them.
_EFFORT = 1.0


def unproven(edited: Edited, limit: float, threads: int) -> tuple[Ids, float]:
    """Return the triangles whose distance is not proven to be within a limit, and what is proven of all.

    Both in metres; the proof is of both ways, and that of `certify`.
    """
    changed = edited.changed()
    if len(changed) == 0:
        return changed, 0.0
    given = edited.given_triangles()
    old = grown(given, len(edited.first), changed, _RINGS)
    new = old[edited.is_there(old)]
    proof = certify(
        _piece(edited.places, edited.triangles[new]),
        _piece(edited.mesh.vertices, given[old]),
        max_shape=limit,
        effort=_EFFORT,
        threads=threads,
    )
    far, bound = [], 0.0
    for rows, bounds in ((new, proof.shape_bound), (old, proof.original_shape_bound)):
        written = np.isin(rows, changed)
        far.append(rows[written & (bounds > limit)])
        bound = max(bound, float(bounds[written].max(initial=0.0)))
    return np.union1d(*far), bound


def _piece(vertices: Vertices, triangles: Ids) -> Mesh:
    used, index = np.unique(triangles, return_inverse=True)
    return Mesh(vertices[used], index.reshape(-1, 3).astype(np.int32))

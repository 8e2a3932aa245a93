"""Simplification that keeps colours: to a number of triangles, or within bounds on shape and colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stages import _kernels
from stages.errors import MeshError, UsageError
from stages.params import resolve
from stages.progress import Progress, silent
from stages.simplification.certified.run import simplify_certified
from stages.simplification.jia01 import run as jia01
from stages.simplification.params import SimplifyParams
from stages.simplification.planar.run import by_patches
from stages.simplification.quadric import run as quadric
from stages.simplification.regions import Region, resolve_control
from stages.simplification.result import Simplified
from stages.simplification.seams import run as seams
from stages.surface.convert import MeshLike, as_mesh
from stages.surface.mesh import Mesh

__all__ = ["RESULT_VERSION", "Simplified", "SimplifyParams", "simplify"]

RESULT_VERSION = 10


def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    lock: ArrayLike | None = None,
    importance: ArrayLike | None = None,
    regions: Sequence[Region] = (),
    record: bool = False,
    partial: bool = False,
    progress: Progress = silent,
    **changes: Any,
) -> Simplified:
    """Collapse edges until few enough triangles are left, or none may go within the bounds.

    Topology, boundary loops and orientation stay; a boundary shrinks only along itself; no triangle turns
    over. Equal input gives equal bytes, on any number of threads.

    Method `quadric`, for `triangles` or `ratio` alone: each collapse is the one that adds least to the
    squared distance from the input's triangles, in the space of position and colour, and puts the new vertex
    where that is least. At the end vertices move along their normals, and colours change, to fit the input.

    Method `certified`, for bounds: as `quadric`, as long as the vertices of the input stay within them. Then
    they are proven for every point between, and where that fails the work is done again more carefully. With
    `triangles` or `ratio` too, it ends at this number or at the bounds, whichever comes first, and
    `stopped_by` says which.

    Method `seams`, for `triangles` or `ratio` of meshes with texture, materials, parts or normals of corners:
    vertices that a file doubles along texture seams, between materials or parts are one, and move together.
    Each keeps texture coordinates, colour and normal for every chart it lies in, which are part of the error.
    Welded by position, the result has no hole, no edge of more than two triangles and no triangle upon
    another that the input has not. In the image no triangle turns over, no texture coordinate leaves its
    chart, and seams stay within `max_seam_drift`.

    Method `jia01`, for bounds on sums: long edges are split; then edges collapse in the order of what was
    summed up around them. A new vertex is the mean of the projections of the edge's midpoint on the planes of
    the triangles around, in the space of position and colour.

    Method `planar`, within bounds: near-planar patches grow over the surface (see `stages.planar_patches`),
    the borders between them are straightened, and each is triangulated anew within its border. The bounds
    hold for every point. Vertices stay where they are or vanish; triangles around locked ones stay.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres; an oriented manifold,
        but that seams and planar take any, and keep it as it is where triangles meet that cannot be joined.
        Vertices without triangles and triangles that name a vertex twice are left out.
    params : SimplifyParams; single fields can be given by name instead.
    lock : (n,) bool or vertex indices: these vertices stay to the bit, colour included (with `seams` their
        positions; copies of a locked vertex stay too). Others may collapse into them.
    importance : (n,) float above 0, factor of the squared error around each vertex; for `certified` at least
        1, and bounds there are divided by it. Not for `jia01` and `planar`.
    regions : Sphere and Box of `stages`, which lock the vertices they hold, or give them importance.
    record : keep all collapses, so that every mesh on the way can be had again. What `certified` proves, it
        proves of the last one.
    partial : Ctrl-C gives out what there is by then, instead of raising KeyboardInterrupt; `certified` then
        still proves how far that is from the input, which takes a while.
    progress : called about ten times a second with the triangles that are gone and those that have to go;
        returning False gives out what there is by then, raising stops the work.

    Returns
    -------
    Simplified
        The mesh has colours if the input has. `seams` carries texture, materials, parts and normals of
        corners, `planar` parts, and materials if there are no texture coordinates; else normals are those of
        `vertex_source` and texture is left out, and a note of the mesh says so; likewise when bounds are not
        proven.

    Raises
    ------
    MeshError
        For an edge with more than two triangles or inconsistent orientation, or a vertex where two fans
        touch; the message names them. `clean` repairs all three. Not with `seams` and `planar`, where what
        touches so stays as it is.
    UsageError
        For a parameter out of range or of another method, a bound on the colours of a mesh without, or a
        resolution so fine that splitting passes 20 million triangles.

    Notes
    -----
    With default bounds, and with a ratio of 0.1:

    ================================  =========  =======  =========  ============  ===========  =======
    mesh                              triangles  method   reduction  RMS distance  colour RMSE  PSNR
    ================================  =========  =======  =========  ============  ===========  =======
    room fused at 2 cm, 6.3 m across    144,611  jia01       68.1 %       1.1 mm   2.5 levels   40.3 dB
    room fused at 2 cm, 6.3 m across    144,611  quadric     90.0 %       1.2 mm   2.6 levels   39.8 dB
    unit sphere with a satellite map     73,728  jia01       77.6 %       0.4 mm   5.0 levels   34.2 dB
    unit sphere with a satellite map     73,728  quadric     90.0 %       0.2 mm   8.7 levels   29.4 dB
    ================================  =========  =======  =========  ============  ===========  =======

    The bounds that `certified` proves hold for positions as they are, and as 32-bit floats in a file: they
    contain 2⁻²¹ of the largest coordinate and 2⁻²⁰ of the bounding box's diagonal for that, and for searches
    in single precision. Twice as much is the least distance that can be proven, and takes the place of a
    smaller `max_shape`; half a level takes that of a smaller `max_texture`. Bounds need not be provable at
    all where sheets of different colours touch, since a point there has nearest points of both colours;
    triangles there stay as they are.

    For jia01, shape and texture changes are sums over collapses. The texture change counts contrast, not
    error, and so its default looks large.

    The paper looks at vertices only, and a long triangle can swing away between its corners; and it adds to
    each edge what happens around it, though a point may move on to another edge's triangle. Unless
    `paper_rule` is set, the shape change therefore also counts how far the surfaces are apart where old and
    new edges cross, or how far the ends move where the neighbourhood is folded; and every new edge starts
    from the largest sum around. The largest distance between input and result then stayed below `max_shape`
    wherever we measured it.

    References
    ----------
    quadric, certified: Garland and Heckbert, "Surface simplification using quadric error metrics", 1997;
    Hoppe, "New quadric metric for simplifying meshes with appearance attributes", 1999; for the fit Hoppe,
    DeRose, Duchamp, McDonald and Stuetzle, "Mesh optimization", 1993; and see the folder `certified`.

    seams: Feng, Ni and Luo, "Improved surface simplification with multi-attributes", Computer Technology and
    Development 22(4), 2012, with Hoppe's quadrics (1999) and wedges in place of the paper's.

    jia01: Jia, Liu, Pei, Zhu and Li, "Mesh simplification with texture preservation", Journal of Image and
    Graphics 6(7), 2001: shape change (1)-(2), texture change (3), placement (4)-(6), order (7).

    planar: Chen and Qin, "3-D surface reduction new algorithm"; `kernels/src/planar.rs` says why the bounds
    hold.
    """
    params = resolve(SimplifyParams, params, changes)
    mesh = as_mesh(mesh)
    method = params.chosen(in_pieces=_is_in_pieces(mesh))
    locked, factors = resolve_control(mesh, lock, importance, regions)
    if len(factors) and method == "jia01":
        raise UsageError(
            f"importance has no meaning for method {method}; give triangles or ratio, no bound, and method "
            "quadric."
        )
    if method == "planar" and (len(factors) or record):
        raise UsageError("method planar collapses no edges: it takes no importance, and there is no record.")
    if partial:
        progress = _contented(progress)
    if method == "certified":
        if params.max_texture is not None and mesh.colors is None:
            raise UsageError("max_texture is given, but the mesh has no vertex colours; leave it out.")
        return simplify_certified(
            mesh,
            max_shape=params.max_shape,
            max_color=params.max_texture,
            triangles=params.target(len(mesh.triangles)),
            fixed=locked,
            importance=factors,
            weight=params.attribute_scale,
            close=params.close_bounds,
            threads=params.threads or 0,
            record=record,
            partial=partial,
            progress=progress,
        )
    running = _kernels.Running(
        region_triangles=quadric.REGION_TRIANGLES if method == "quadric" else jia01.REGION_TRIANGLES,
        target_triangles=params.target(len(mesh.triangles)),
        threads=params.threads or 0,
        record=record,
        partial=partial,
    )
    try:
        if method == "planar":
            return by_patches(mesh, params.for_patches(), locked, partial=partial, progress=progress)
        if method == "quadric":
            return quadric.by_quadrics(mesh, params, locked, factors, running, progress)
        if method == "seams":
            return seams.by_seams(mesh, params, locked, factors, running, progress)
        return jia01.by_sums(mesh, params, locked, running, progress)
    except _kernels.InvalidMeshError as error:
        raise MeshError(f"{error}; run clean first, or take method seams or planar.", "mesh") from error


def _is_in_pieces(mesh: Mesh) -> bool:
    """Return whether the mesh has what `seams` alone carries: image, materials, parts, normals of corners."""
    texture = mesh.texture
    has_texture = texture is not None and ((texture.material_ids >= 0).any() or texture.has_uvs().any())
    has_parts = mesh.part_ids is not None and len(np.unique(mesh.part_ids)) > 1
    return bool(has_texture or has_parts or mesh.corner_normals is not None)


def _contented(progress: Progress) -> Progress:
    """Take Ctrl-C for a wish for what there is also while progress is being told."""

    def tell(done: int, total: int) -> object:
        try:
            return progress(done, total)
        except KeyboardInterrupt:
            return False

    return tell

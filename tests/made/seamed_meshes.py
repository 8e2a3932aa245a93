"""Textured meshes with known seams, and checks of their simplification."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture


def picture(width: int = 64, height: int = 32) -> Image:
    """Make an image whose colours encode the pixel position."""
    x, y = np.meshgrid(np.linspace(0, 255, width), np.linspace(0, 255, height))
    return Image("picture.png", None, np.stack([x, y, 255 - x], axis=2).astype(np.uint8))


def wrapped_ball(rings: int = 24, sectors: int = 32, bumps: float = 0.05) -> Mesh:
    """Make a sphere with an equirectangular map: one seam between the poles, one pole coordinate per sector.

    Vertices are shared; only texture coordinates differ along the seam.
    """
    polar = np.linspace(0, np.pi, rings + 1)[1:-1]
    around = np.linspace(0, 2 * np.pi, sectors, endpoint=False)
    p, a = np.meshgrid(polar, around, indexing="ij")
    radius = 1 + bumps * np.sin(5 * p) * np.cos(4 * a)
    inner = np.stack(
        [radius * np.sin(p) * np.cos(a), radius * np.sin(p) * np.sin(a), radius * np.cos(p)], axis=2
    )
    vertices = np.vstack([inner.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    north, south = len(vertices) - 2, len(vertices) - 1
    at = np.arange(len(polar) * sectors).reshape(len(polar), sectors)
    triangles, uvs = [], []
    u = np.arange(sectors + 1) / sectors
    v = 1 - np.arange(rings + 1) / rings
    for s in range(sectors):
        t = (s + 1) % sectors
        middle = 0.5 * (u[s] + u[s + 1])
        triangles.append([north, at[0, s], at[0, t]])
        uvs.append([[middle, v[0]], [u[s], v[1]], [u[s + 1], v[1]]])
        for r in range(rings - 2):
            a, b, c, d = at[r, s], at[r + 1, s], at[r + 1, t], at[r, t]
            corners = [[u[s], v[r + 1]], [u[s], v[r + 2]], [u[s + 1], v[r + 2]], [u[s + 1], v[r + 1]]]
            triangles += [[a, b, c], [a, c, d]]
            uvs += [[corners[i] for i in (0, 1, 2)], [corners[i] for i in (0, 2, 3)]]
        triangles.append([at[-1, s], south, at[-1, t]])
        uvs.append([[u[s], v[-2]], [middle, v[-1]], [u[s + 1], v[-2]]])
    ids = np.zeros(len(triangles), np.int32)
    texture = Texture(np.array(uvs, float), ids, (Material("map", picture()),))
    return Mesh(vertices, np.array(triangles, np.int32), texture=texture)


def folded_strips(columns: int = 12, rows: int = 5, height: float = 0.02) -> Mesh:
    """Make a sheet cut along its middle row: each half has a separate chart and separate vertices.

    This is figure 3a of the paper: each vertex on the cut exists twice, with two texture coordinates.
    """
    assert rows % 2 == 1
    rng = np.random.default_rng(7)
    x, y = np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float))
    z = height * rng.standard_normal(x.shape)
    middle = rows // 2
    points = np.stack([x, y, z], axis=2)
    halves = [points[: middle + 1], points[middle:]]
    vertices = np.concatenate([half.reshape(-1, 3) for half in halves])
    triangles, uvs = [], []
    offset = 0
    for number, half in enumerate(halves):
        at = offset + np.arange(half[..., 0].size).reshape(half.shape[:2])
        # The upper half is in another part of the image, turned by 90°.
        flat = half[..., :2] / (2 * columns)
        place = flat if number == 0 else np.stack([0.9 - flat[..., 1], 0.1 + flat[..., 0]], axis=2)
        for r in range(half.shape[0] - 1):
            for c in range(columns - 1):
                corners = [(r, c), (r, c + 1), (r + 1, c + 1), (r + 1, c)]
                for chosen in ((0, 1, 2), (0, 2, 3)):
                    triangles.append([at[corners[i]] for i in chosen])
                    uvs.append([place[corners[i]] for i in chosen])
        offset += half[..., 0].size
    texture = Texture(np.array(uvs), np.zeros(len(triangles), np.int32), (Material("sheet", picture()),))
    return Mesh(vertices, np.array(triangles, np.int32), texture=texture)


def two_cubes(gap: float) -> Mesh:
    """Make two untextured cubes of 768 triangles each that face each other across a gap."""
    import trimesh

    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide().subdivide()
    vertices = np.concatenate([box.vertices, box.vertices + np.array([1 + gap, 0, 0])])
    triangles = np.concatenate([box.faces, box.faces + len(box.vertices)])
    parts = np.repeat([0, 1], len(box.faces)).astype(np.int32)
    return Mesh(vertices, triangles.astype(np.int32), part_ids=parts, part_names=("left", "right"))


def touching_parts(rng: np.random.Generator, gap: float) -> Mesh:
    """Make two to five boxes, prisms and open sheets whose faces, edges or corners nearly touch."""
    import trimesh

    vertices: list[NDArray[np.float64]] = []
    triangles: list[NDArray[np.int64]] = []
    for _ in range(rng.integers(2, 6)):
        kind = rng.integers(3)
        if kind == 0:
            solid = trimesh.creation.box((1, 1, 1))
            for _ in range(rng.integers(3)):
                solid = solid.subdivide()
        elif kind == 1:
            solid = trimesh.creation.cylinder(0.5, 1, sections=int(rng.integers(4, 12)))
        else:
            solid = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
            faces = solid.faces[np.isclose(solid.triangles_center[:, rng.integers(3)], 0.5)]
            solid = trimesh.Trimesh(solid.vertices, faces)
        noise = gap * rng.integers(2) * rng.normal(size=solid.vertices.shape)
        triangles.append(solid.faces + sum(len(part) for part in vertices))
        vertices.append(solid.vertices + rng.integers(0, 2, 3) + noise)
    parts = np.repeat(np.arange(len(triangles), dtype=np.int32), [len(t) for t in triangles])
    return Mesh(
        np.concatenate(vertices),
        np.concatenate(triangles).astype(np.int32),
        part_ids=parts,
        part_names=tuple(f"part {index}" for index in range(len(triangles))),
    )


def weld_corners(mesh: Mesh) -> NDArray[np.int64]:
    """Replace the vertex indices of triangles by indices of distinct positions."""
    _, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return number.reshape(-1)[mesh.triangles]


def count_edges(triangles: NDArray[np.int64]) -> tuple[int, int]:
    """Count edges with one triangle, and edges with more than two."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    return int((counts == 1).sum()), int((counts > 2).sum())


def count_duplicates(triangles: NDArray[np.int64]) -> int:
    """Count triangles with the same corners as another triangle."""
    return len(triangles) - len(np.unique(np.sort(triangles, axis=1), axis=0))


def signed_areas(uvs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute twice the signed area of triangles (m, 3, 2) in an image."""
    u, v = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def find_charts(mesh: Mesh) -> NDArray[np.int64]:
    """Label the chart of each triangle; triangles of a chart share edges in space and in the image."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    assert mesh.texture is not None
    triangles, count = weld_corners(mesh), len(mesh.triangles)
    corner = np.concatenate([triangles[..., None], mesh.texture.uvs], axis=2)
    sides = np.stack([corner, np.roll(corner, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    swap = sides[:, 0, 0] > sides[:, 1, 0]
    sides[swap] = sides[swap][:, ::-1]
    key = np.column_stack([sides.reshape(-1, 6), np.repeat(mesh.texture.material_ids, 3)])
    same = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)
    owner = np.repeat(np.arange(count), 3)
    order = np.argsort(same, kind="stable")
    linked = same[order][1:] == same[order][:-1]
    a, b = owner[order][1:][linked], owner[order][:-1][linked]
    links = coo_array((np.ones(len(a), bool), (a, b)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def count_outside_charts(simplified: Mesh, source: NDArray[np.int32], mesh: Mesh, slack: float = 1e-9) -> int:
    """Count corners of `simplified` outside their chart in `mesh`.

    A triangle belongs to the chart of its `source` triangle. A corner is outside if no triangle of the chart
    covers its texture coordinates.
    """
    assert simplified.texture is not None
    assert mesh.texture is not None
    of = find_charts(mesh)
    outside = 0
    for chart in np.unique(of[source]):
        images = mesh.texture.uvs[of == chart]
        points = np.unique(simplified.texture.uvs[of[source] == chart].reshape(-1, 2), axis=0)
        outside += int((~_is_covered(points, images, slack)).sum())
    return outside


def _is_covered(points: NDArray[np.float64], images: NDArray[np.float64], slack: float) -> NDArray[np.bool_]:
    held = np.zeros(len(points), bool)
    low, high = images.min(axis=1) - slack, images.max(axis=1) + slack
    side = np.sign(signed_areas(images))
    for i, p in enumerate(points):
        near = np.flatnonzero(((low <= p) & (p <= high)).all(axis=1))
        t, s = images[near], side[near]
        inside = np.ones(len(near), bool)
        for k in range(3):
            a, b = t[:, k], t[:, (k + 1) % 3]
            along = b - a
            length = np.linalg.norm(along, axis=1)
            apart = along[:, 0] * (p[1] - a[:, 1]) - along[:, 1] * (p[0] - a[:, 0])
            # A triangle side of length zero gives no constraint.
            inside &= (apart * s >= -slack * length) | (length == 0)
        held[i] = inside.any()
    return held

"""Made scene that is raycast and lit: parts with procedural colours under an area light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from paints import Floats, Ints
from parts import Part

from scanloom.stages._open3d import import_open3d
from scanloom.stages.surface.mesh import Mesh


class LitScene:
    """Raycasting scene with lit colours.

    Parameters
    ----------
    parts : objects of the scene.
    lamps : (n, 3) points that approximate the area light.
    ambient : ratio of the light that reaches every point, 0..1.

    Attributes
    ----------
    mesh : the true surface, coloured by sampling the procedural colours at its vertices.
    """

    def __init__(self, parts: Sequence[Part], lamps: Floats, ambient: float) -> None:
        self._parts, self._lamps, self._ambient = list(parts), lamps, ambient
        counts = [len(part.vertices) for part in self._parts]
        offsets = np.concatenate([[0], np.cumsum(counts)[:-1]])
        vertices = np.concatenate([part.vertices for part in self._parts])
        self._normals = np.concatenate([part.normals for part in self._parts])
        triangles = [part.triangles + offset for part, offset in zip(self._parts, offsets, strict=True)]
        self._part_of = np.repeat(np.arange(len(triangles)), [len(t) for t in triangles])
        self._triangles = np.concatenate(triangles)
        core = import_open3d().core
        self._rays = import_open3d().t.geometry.RaycastingScene()
        self._rays.add_triangles(
            core.Tensor(vertices.astype(np.float32)), core.Tensor(self._triangles.astype(np.uint32))
        )
        colors = self.color(vertices, self._normals, np.repeat(np.arange(len(counts)), counts))
        self.mesh = Mesh(vertices, self._triangles.astype(np.int32), np.rint(colors * 255).astype(np.uint8))

    def cast(self, origin: Floats, directions: Floats) -> tuple[Floats, Floats, Ints]:
        """Cast rays with directions (k, 3) from an origin.

        Returns distance (k,), inf for a miss, unit normal (k, 3), and part index (k,) of the first hit.
        """
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3], rays[:, 3:] = origin, directions
        hits = self._rays.cast_rays(import_open3d().core.Tensor(rays))
        distance = hits["t_hit"].numpy().astype(np.float64)
        triangle = np.where(np.isfinite(distance), hits["primitive_ids"].numpy(), 0).astype(np.int64)
        u, v = hits["primitive_uvs"].numpy().astype(np.float64).T
        corner_normals = self._normals[self._triangles[triangle]]
        normal = np.einsum("kc,kcx->kx", np.stack([1 - u - v, u, v], axis=1), corner_normals)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return distance, normal / np.maximum(length, 1e-9), self._part_of[triangle]

    def color(self, points: Floats, normals: Floats, parts: Ints) -> Floats:
        """Compute the lit colours (n, 3) of surface points, sRGB 0..1.

        These are the colours that an ideal camera records.
        """
        albedo = np.empty((len(points), 3))
        for number, part in enumerate(self._parts):
            own = np.flatnonzero(parts == number)
            albedo[own] = part.paint(points[own])
        light = np.full(len(points), self._ambient)
        for lamp in self._lamps:
            towards = lamp - points
            towards /= np.linalg.norm(towards, axis=1, keepdims=True)
            rays = np.concatenate([points + 1e-3 * normals, towards], axis=1).astype(np.float32)
            blocked = self._rays.test_occlusions(import_open3d().core.Tensor(rays)).numpy()
            facing = np.einsum("kx,kx->k", normals, towards).clip(0, 1)
            light += np.where(blocked, 0, facing) * (1 - self._ambient) * 1.3 / len(self._lamps)
        return np.asarray((albedo**2.2 * light[:, None]).clip(0, 1) ** (1 / 2.2))

"""Angle between the shading normals of simplified meshes and their originals in renders, and bytes.

    python benches/normal_maps.py RUN... [--views 6] [--pictures FOLDER]

Each RUN is the output folder of `scanloom run`, with refined.ply, simplified.ply and textured.glb. The table
has a row for each way of shading the simplified mesh: flat triangles, normals of the file without a map, the
normal map in textured.glb, and the normal map of `scanloom mesh bake` without a byte limit. The median and
the 90th percentile are over all pixels that show both surfaces at the same depth, in views from all sides.
"MB" is the size of the GLB file.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from markdown_tables import print_head, print_row
from numpy.typing import NDArray

from scanloom.stages.rendering.render import RenderModel, Viewpoint, viewpoints, write_png
from scanloom.stages.surface.formats.gltf_materials import make_unlit_source
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.texturing.bake import bake
from scanloom.stages.texturing.shading_error import ShadingError
from scanloom.stages.texturing.shading_normals import (
    ShadingNormals,
    add_shading_normals,
    has_normal_map,
)

COLUMNS = ("run", "triangles", "shading", "median", "90 %", "MB")
# Maximum depth difference between both surfaces, as a ratio of the depth.
MAX_DEPTH_RATIO = 0.01


def cast_view(
    surface: RaycastingSurface, view: Viewpoint
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """Cast a ray per pixel; return triangles (−1 without a hit), weights and depths."""
    camera = view.camera
    v, u = np.indices((camera.height, camera.width), np.float32).reshape(2, -1)
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=1)
    hits = surface.cast_rays(view.world_from_camera[:3, 3], local @ view.world_from_camera[:3, :3].T)
    triangles, weights = np.full(len(u), -1, np.int64), np.zeros((len(u), 3), np.float32)
    depths = np.full(len(u), np.inf, np.float32)
    triangles[hits.rays], weights[hits.rays], depths[hits.rays] = hits.triangles, hits.weights, hits.distances
    return triangles, weights, depths


def remove_map(mesh: Mesh) -> Mesh:
    """Return a textured mesh without normals and normal map, as `run` writes it without one."""
    assert mesh.texture is not None
    materials = tuple(
        replace(one, kept=make_unlit_source(), image=one.image) for one in mesh.texture.materials
    )
    return mesh.with_(normals=None, corner_normals=None, texture=replace(mesh.texture, materials=materials))


def flatten(mesh: Mesh) -> Mesh:
    """Return a mesh with the normals of its triangles."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    return mesh.with_(texture=None, normals=None, corner_normals=np.repeat(normals[:, None], 3, axis=1))


def measure(mesh: Mesh, original: RaycastingSurface, views: list[Viewpoint]) -> ShadingError:
    """Compare the shading normals of two meshes over the pixels of all views."""
    surface, own, theirs = RaycastingSurface(mesh), ShadingNormals(mesh), ShadingNormals(original.mesh)
    found, expected = [], []
    for view in views:
        triangles, weights, depths = cast_view(surface, view)
        of_original, their_weights, their_depths = cast_view(original, view)
        is_shown = (triangles >= 0) & (of_original >= 0)
        is_shown[is_shown] &= (
            np.abs(depths[is_shown] - their_depths[is_shown]) < MAX_DEPTH_RATIO * depths[is_shown]
        )
        found.append(own(triangles[is_shown], weights[is_shown]))
        expected.append(theirs(of_original[is_shown], their_weights[is_shown]))
    return ShadingError.from_normals(np.concatenate(found), np.concatenate(expected))


def write_pictures(folder: Path, name: str, meshes: dict[str, Mesh], view: Viewpoint) -> None:
    """Write a row of clay renders."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [RenderModel(RaycastingSurface(mesh)).draw(view, "plain") for mesh in meshes.values()]
    write_png(folder / f"{name}.png", np.concatenate(rows, axis=1))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--pictures", type=Path, help="folder for clay renders: refined, flat, mapped")
    options = parser.parse_args()
    print_head(COLUMNS)
    for run in options.runs:
        original = read_mesh(run / "refined.ply")
        written = read_mesh(run / "textured.glb")
        surface = RaycastingSurface(original)
        views = viewpoints(original, options.views)
        baked = bake(read_mesh(run / "simplified.ply"), original, occlusion_map=False).mesh
        bare = remove_map(written)
        assert bare.texture is not None
        normals = add_shading_normals(bare, bare.texture.uvs)
        rows = {
            "flat": (flatten(bare), bare),
            "normals": (normals, normals),
            **({"textured.glb": (written, written)} if has_normal_map(written) else {}),
            "bake": (baked, baked),
        }
        with tempfile.TemporaryDirectory() as folder:
            for name, (mesh, stored) in rows.items():
                error = measure(mesh, surface, views)
                path = Path(folder) / "a.glb"
                write_mesh(path, stored)
                size = path.stat().st_size
                cells = [run.name, f"{len(mesh.triangles):,}", name]
                print_row([*cells, f"{error.median_deg:.2f}°", f"{error.p90_deg:.1f}°", f"{size / 1e6:.2f}"])
        if options.pictures:
            best = rows.get("textured.glb", rows["bake"])[0]
            shown = {"refined": original, "flat": flatten(bare), "mapped": best}
            write_pictures(options.pictures, run.name, shown, views[0])


if __name__ == "__main__":
    main()

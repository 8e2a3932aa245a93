"""Simplifiers on textured models: time, shape, colour as seen through the texture, cracks and flips.

    python benches/textured.py DATA [--ratios 0.1 0.02] [--mesh duck] [--only PyMeshLab] [--samples 200000]

DATA holds `meshes/`. It prints a Markdown table for each model and ratio. A peer that is absent is left out,
with a line that says why. All get the same mesh, cleaned, with its texture coordinates per corner; those that
take one coordinate a vertex get vertices on seams once for each side.

"CPU s" is the processor time of the call. Shape is two-sided, over the bounding box's diagonal. Colour is
sampled on both surfaces through their textures, against the nearest point of the other. "new border" is the
length of borders the original does not have, after vertices at one place became one, over the diagonal;
"UV flips" are triangles whose texture runs the other way round than next to them on the original.
"""

from __future__ import annotations

import argparse
import ctypes
import math
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markdown_tables import print_head, print_row
from peers import native
from peers.native import Missing
from peers.tools import pointer
from texture_soundness import soundness

from stages.cleaning.clean import clean
from stages.comparing.compare import compare
from stages.files.image_bytes import decoded_image
from stages.params import described
from stages.simplification.simplify import SimplifyParams, simplify
from stages.surface.color import has_color
from stages.surface.convert import as_mesh, to_open3d, to_open3d_legacy, with_vertex_colors
from stages.surface.mesh import Image, Material, Mesh
from stages.surface.mesh_files import read_mesh, write_mesh
from stages.texturing.bake import bake

Simplifier = Callable[[Mesh, int], tuple[Callable[[], Any], Callable[[Any], Mesh]]]

MODELS = {
    "spot": "meshes/spot/spot_triangulated.obj",
    "banana": "meshes/ycb_banana/*.obj",
    "bunny": "meshes/bunny10k_textured/*.obj",
    "fuze": "meshes/fuze/*.obj",
    "duck": "meshes/Duck.glb",
}
COLUMNS = (
    "tool",
    "triangles",
    "CPU s",
    "RMS ×1e-5",
    "max ×1e-5",
    "PSNR dB",
    "new border",
    "UV flips",
)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--ratios", type=float, nargs="+", default=[0.1, 0.02])
    parser.add_argument("--mesh", nargs="*", choices=MODELS, default=list(MODELS))
    parser.add_argument("--only", nargs="+", metavar="TOOL", help="tools whose names start so")
    parser.add_argument("--samples", type=int, default=200_000)
    options = parser.parse_args()
    wanted = tuple(name.lower() for name in options.only or [""])
    tools = {name: tool for name, tool in TOOLS.items() if name.lower().startswith(wanted)}
    for name in options.mesh:
        mesh = model(options.data, MODELS[name])
        for ratio in options.ratios:
            print(f"\n### {name}, {len(mesh.triangles):,} triangles to {ratio:.0%}\n")
            print_head(COLUMNS)
            for tool, prepare in tools.items():
                print_row(
                    [tool, *cells(mesh, math.floor(ratio * len(mesh.triangles)), prepare, options.samples)]
                )


def model(data: Path, pattern: str) -> Mesh:
    """Read a model, made a manifold, with one texture image."""
    path = sorted(data.glob(pattern))[0]
    mesh = clean(read_mesh(path)).mesh.with_(normals=None, corner_normals=None)
    assert mesh.texture is not None
    images = sorted(path.parent.glob("*.png"))
    if not mesh.texture.images and images:
        # No MTL file names it.
        pixels = decoded_image(images[0].read_bytes())
        materials = (Material(image=Image(given=pixels)),)
        ids = np.zeros(len(mesh.triangles), np.int32)
        mesh = mesh.with_(texture=replace(mesh.texture, materials=materials, material_ids=ids))
    return mesh


def cells(mesh: Mesh, triangles: int, prepare: Simplifier, samples: int) -> list[str]:
    """Run a tool and return its row after the name."""
    try:
        work, unpacked = prepare(mesh, triangles)
        start = time.process_time()
        raw = work()
        seconds = time.process_time() - start
        light = unpacked(raw)
    except Exception as error:  # a peer may fail in any way; the row says how
        return [f"left out: {str(error).splitlines()[0][:90]}", *[""] * (len(COLUMNS) - 2)]
    found = compare(mesh, light, samples=samples)
    damage = soundness(mesh, light)
    is_textured = has_color(light) and found.color is not None
    return [
        f"{len(light.triangles):,}",
        f"{seconds:.2f}",
        f"{1e5 * found.symmetric.rms / found.diagonal:.1f}",
        f"{1e5 * found.symmetric.maximum / found.diagonal:.0f}",
        f"{found.color.psnr:.1f}" if is_textured and found.color else "dropped",
        f"{damage.new_border:.3f}",
        f"{damage.uv_flips} of {damage.uv_triangles}" if keeps_layout(mesh, light) else "",
    ]


def keeps_layout(mesh: Mesh, light: Mesh) -> bool:
    """Return whether the image is the original's: in a new one, charts may lie either way round."""
    if mesh.texture is None or light.texture is None:
        return False
    return [id(image) for image in light.texture.images] == [id(image) for image in mesh.texture.images]


def seams(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with texture coordinates as attributes and seams kept."""
    if "seams" not in described(SimplifyParams)["method"].choices:
        raise Missing("this version has no method seams")
    return lambda: simplify(mesh, method="seams", triangles=triangles), lambda result: result.mesh


def baked(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with colours of vertices, then bake a new texture."""
    colored = with_vertex_colors(mesh)
    return lambda: bake(simplify(colored, triangles=triangles).mesh, mesh), lambda result: result.mesh


def pymeshlab(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with MeshLab's quadrics for position and texture."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    # The filter wants a mesh that has come with its image.
    with tempfile.TemporaryDirectory() as folder:
        write_mesh(Path(folder, "given.obj"), mesh)
        meshes.load_new_mesh(str(Path(folder, "given.obj")))

    def result(_: Any) -> Mesh:
        light = meshes.current_mesh()
        corners = light.wedge_tex_coord_matrix().reshape(-1, 3, 2)
        return textured(mesh, light.vertex_matrix(), light.face_matrix(), corners)

    return (
        lambda: meshes.meshing_decimation_quadric_edge_collapse_with_texture(targetfacenum=triangles),
        result,
    )


def meshoptimizer(weight: float) -> Simplifier:
    """Collapse with positions and texture coordinates updated; the library finds seams by equal positions."""

    def prepare(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
        library = native.meshoptimizer()
        rows = np.column_stack([mesh.triangles.reshape(-1), mesh.texture.uvs.reshape(-1, 2)])
        wedges, indices = np.unique(rows, axis=0, return_inverse=True)
        indices = indices.reshape(-1, 3).astype(np.uint32)
        positions = mesh.vertices[wedges[:, 0].astype(int)].astype(np.float32)
        uvs = wedges[:, 1:].astype(np.float32)
        weights = np.full(2, weight, np.float32)

        def call() -> int:
            return library.simplify(
                pointer(indices),
                ctypes.c_size_t(len(indices)),
                pointer(positions),
                pointer(uvs),
                ctypes.c_size_t(len(positions)),
                pointer(weights),
                ctypes.c_size_t(2),
                ctypes.c_size_t(triangles),
            )

        return call, lambda left: textured(mesh, positions, indices[:left], uvs[indices[:left]])

    return prepare


def open3d_legacy(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse by plain quadrics."""
    given = to_open3d_legacy(mesh)
    return lambda: given.simplify_quadric_decimation(triangles), as_mesh


def open3d_tensor(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with VTK inside."""
    given = to_open3d(mesh)
    reduction = 1 - triangles / len(mesh.triangles)
    return lambda: given.simplify_quadric_decimation(reduction), as_mesh


def textured(mesh: Mesh, vertices: np.ndarray, triangles: np.ndarray, uvs: np.ndarray) -> Mesh:
    """Return a result with the materials of the mesh it was made from, whose image is one."""
    ids = np.full(len(triangles), mesh.texture.material_ids.max(), np.int32)
    texture = replace(mesh.texture, uvs=uvs.astype(np.float64), material_ids=ids)
    return Mesh(vertices.astype(np.float64), triangles.astype(np.int32), texture=texture)


TOOLS: Mapping[str, Simplifier] = {
    "scanloom seams": seams,
    "scanloom, baked": baked,
    "PyMeshLab, with texture": pymeshlab,
    "meshoptimizer, weight 0.1": meshoptimizer(0.1),
    "meshoptimizer, weight 1": meshoptimizer(1.0),
    "Open3D legacy": open3d_legacy,
    "Open3D tensor": open3d_tensor,
}


if __name__ == "__main__":
    main()

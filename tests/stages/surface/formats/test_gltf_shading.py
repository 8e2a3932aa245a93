"""Shading of glTF files: colours in other programs, and what scanloom reads back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from browsers import PAGE, launch_browser
from coloured_sheet import UP, ball, sheet, textured_sheet

from scanloom import Image, Mesh, Texture, bake, read_mesh, write_mesh
from scanloom.stages._open3d import import_open3d
from scanloom.stages.surface.formats.color_conversion import convert_srgb_to_linear
from scanloom.stages.surface.formats.gltf_container import read_container
from scanloom.stages.surface.formats.gltf_materials import UNLIT, is_unlit, make_unlit_source
from scanloom.stages.surface.formats.gltf_packing import COMPRESSIONS, SHADINGS
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.texture import Material


def read_tree(path: Path):
    return read_container(path).tree


def list_primitives(path: Path):
    return [one for mesh in read_tree(path)["meshes"] for one in mesh["primitives"]]


def convert_to_linear(mesh: Mesh) -> np.ndarray:
    return np.rint(255 * convert_srgb_to_linear(mesh.colors / 255))


def make_unlit_sheet() -> Mesh:
    """Make a textured sheet with the materials that `texture` writes."""
    mesh = textured_sheet()
    materials = tuple(Material(m.name, m.image, kept=make_unlit_source()) for m in mesh.texture.materials)
    return mesh.with_(texture=Texture(mesh.texture.uvs, mesh.texture.material_ids, materials))


def test_trimesh_reads_vertex_colours_with_every_loader(tmp_path):
    mesh = sheet().with_(up=UP)
    write_mesh(tmp_path / "a.glb", mesh)
    for seen in (
        trimesh.load(tmp_path / "a.glb", force="mesh"),
        trimesh.load_mesh(tmp_path / "a.glb", process=False),
        next(iter(trimesh.load(tmp_path / "a.glb", process=False).geometry.values())),
    ):
        assert seen.visual.kind == "vertex"
        np.testing.assert_array_equal(seen.visual.vertex_colors[:, :3], convert_to_linear(mesh))


def test_trimesh_drops_vertex_colours_of_meshes_with_a_material(tmp_path):
    """The reason for shading `bare`. If this fails, `bare` is not needed.

    See `TextureVisuals.copy` in trimesh 5.2.
    """
    write_gltf(tmp_path / "a.glb", sheet(), shading="keep")
    scene = trimesh.load(tmp_path / "a.glb")
    assert "color" in next(iter(scene.geometry.values())).visual.vertex_attributes
    assert "color" not in scene.to_mesh().visual.vertex_attributes


def test_trimesh_reads_the_image(tmp_path):
    for number, mesh in enumerate((textured_sheet(), make_unlit_sheet())):
        write_mesh(tmp_path / f"{number}.glb", mesh.with_(up=UP))
        seen = next(iter(trimesh.load(tmp_path / f"{number}.glb").geometry.values()))
        assert seen.visual.material.baseColorTexture.size == (64, 48)
        assert seen.visual.to_color().vertex_colors[:, :3].std() > 20


@pytest.mark.parametrize("shading", SHADINGS)
def test_open3d_reads_the_colours(tmp_path, shading):
    mesh = sheet().with_(up=UP)
    write_gltf(tmp_path / "a.glb", mesh, shading=shading)
    seen = import_open3d().io.read_triangle_mesh(str(tmp_path / "a.glb"))
    found = np.rint(255 * np.asarray(seen.vertex_colors))
    assert {tuple(row) for row in found} == {tuple(row) for row in convert_to_linear(mesh)}
    heights = np.sort(np.asarray(seen.vertices)[:, 1])
    np.testing.assert_allclose(heights, np.sort(-mesh.vertices[:, 1]), atol=1e-6)


@pytest.mark.parametrize("way", COMPRESSIONS)
@pytest.mark.parametrize("shading", SHADINGS)
def test_only_bare_files_have_vertex_colours_without_a_material(tmp_path, shading, way):
    write_gltf(tmp_path / "a.glb", sheet(), shading=shading, compress=way)
    has_none = shading == "bare" and way == "none"
    assert all(("material" not in one) == has_none for one in list_primitives(tmp_path / "a.glb"))
    assert ("materials" in read_tree(tmp_path / "a.glb")) != has_none
    assert (UNLIT in read_tree(tmp_path / "a.glb").get("extensionsUsed", ())) == (shading == "unlit")
    back = read_mesh(tmp_path / "a.glb")
    assert back.texture is None
    assert {tuple(c) for c in back.colors.tolist()} == {tuple(c) for c in sheet().colors.tolist()}


@pytest.mark.parametrize("shading", SHADINGS)
def test_a_mesh_without_colours_is_lit(tmp_path, shading):
    write_gltf(tmp_path / "a.glb", ball(), shading=shading)
    assert all("material" in one for one in list_primitives(tmp_path / "a.glb"))
    assert "extensionsUsed" not in read_tree(tmp_path / "a.glb")


@pytest.mark.parametrize("shading", SHADINGS)
def test_a_scan_stays_unlit_unless_it_is_exported_as_lit(tmp_path, shading):
    write_gltf(tmp_path / "a.glb", make_unlit_sheet())
    assert read_tree(tmp_path / "a.glb")["extensionsUsed"] == [UNLIT]
    scan = read_mesh(tmp_path / "a.glb")
    assert all(map(is_unlit, scan.texture.materials))
    write_gltf(tmp_path / "b.glb", scan, shading=shading)
    back = read_mesh(tmp_path / "b.glb")
    assert all(is_unlit(m) != (shading == "lit") for m in back.texture.materials)
    assert (UNLIT in read_tree(tmp_path / "b.glb").get("extensionsUsed", ())) == (shading != "lit")
    assert back.texture.images[0].file_bytes == scan.texture.images[0].file_bytes


def test_a_texture_baked_from_a_scan_is_unlit():
    light = sheet().with_(colors=None)
    for original, unlit in ((make_unlit_sheet(), True), (textured_sheet(), False), (sheet(), False)):
        (material,) = bake(light, original, texel_size=0.2).mesh.texture.materials
        assert is_unlit(material) is unlit


PROGRAM = """
import { AmbientLight, GLTFLoader, MeshoptDecoder, PerspectiveCamera } from "./library.js";
import { Scene, WebGLRenderer } from "./library.js";
const renderer = new WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setSize(64, 64);
const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
window.seen = async (bytes, light) => {
  const { scene } = await loader.parseAsync(new Uint8Array(bytes).buffer, "");
  const all = new Scene();
  all.add(scene, new AmbientLight(0xffffff, light));
  const camera = new PerspectiveCamera(1, 1, 1, 1000);
  camera.position.set(0, 0, 60);
  renderer.render(all, camera);
  const gl = renderer.getContext();
  const pixel = new Uint8Array(4);
  gl.readPixels(32, 32, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  const found = [];
  scene.traverse(({ material }) => {
    if (material) found.push([material.type, material.vertexColors, Boolean(material.map)]);
  });
  return { pixel: Array.from(pixel), found };
};
"""


def make_colored_square(color: tuple[int, int, int], textured: bool) -> Mesh:
    """Make a square of 2 m around the origin, with its front towards +z."""
    vertices = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
    mesh = Mesh(vertices, np.array([(0, 1, 2), (0, 2, 3)], np.int32), np.tile(np.uint8(color), (4, 1)))
    if not textured:
        return mesh
    image = Image(given=np.full((8, 8, 3), color, np.uint8))
    uvs = (mesh.vertices[mesh.triangles][:, :, :2] + 1) / 2
    return mesh.with_(colors=None, texture=Texture(uvs, np.zeros(2, np.int32), (Material("m", image),)))


@pytest.mark.slow
def test_three_js_shows_the_colours(tmp_path):
    """Unlit materials need no light; metallic materials are dark under ambient light."""
    color = (200, 120, 40)
    page = f"<script type=module>{PROGRAM}</script>"
    with launch_browser() as started:
        opened = started.new_page()
        opened.route("http://page/", lambda route: route.fulfill(body=page, content_type="text/html"))
        library = (PAGE / "library.js").read_text("utf-8")
        opened.route(
            "http://page/library.js",
            lambda route: route.fulfill(body=library, content_type="text/javascript"),
        )
        opened.goto("http://page/")
        opened.wait_for_function("() => Boolean(window.seen)")

        def show_in_browser(textured: bool, light: float, **words):
            write_gltf(tmp_path / "a.glb", make_colored_square(color, textured), **words)
            result = opened.evaluate(f"seen({json.dumps(list((tmp_path / 'a.glb').read_bytes()))}, {light})")
            ((kind, of_vertices, of_image),) = result["found"]
            assert (of_vertices, of_image) == (not textured, textured)
            return kind, np.array(result["pixel"][:3], int)

        for textured in (False, True):
            for way, steps in (("none", 0), ("quantize", 0), ("meshopt", 2)):
                kind, pixel = show_in_browser(textured, 0, compress=way, shading="unlit", texel_steps=steps)
                assert kind == "MeshBasicMaterial"
                np.testing.assert_allclose(pixel, color, atol=4)
            kind, pixel = show_in_browser(textured, np.pi, shading="keep")
            assert kind == "MeshStandardMaterial"
            np.testing.assert_allclose(pixel, color, atol=8)
        # Reason for the non-metallic material of vertex colours in files for viewers.
        kind, pixel = show_in_browser(False, np.pi, shading="bare")
        assert kind == "MeshStandardMaterial"
        assert pixel.max() < 10

"""glTF files with KTX2 images: kinds and sizes of images, other programs, and what is read back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from browsers import PAGE, launch_browser, require_ktx2_packages, run_node
from coloured_sheet import UP, ball, textured_sheet

from scanloom import Image, Material, Mesh, Texture, export, preset, read_mesh
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError, MeshError, UsageError
from scanloom.stages.exporting import image_conversion
from scanloom.stages.exporting.image_conversion import make_ktx2_encoder
from scanloom.stages.surface.formats.gltf_container import read_container
from scanloom.stages.surface.formats.gltf_materials import GltfMaterialSource

MADE = Path(__file__).resolve().parents[2] / "made"
VALIDATE, DESCRIBE = MADE / "validate_glb.cjs", MADE / "describe_ktx2.mjs"
# The validator does not know KHR_texture_basisu.
UNKNOWN_TO_VALIDATOR = {"VALUE_NOT_IN_LIST", "IMAGE_UNRECOGNIZED_FORMAT"}
ETC1S, UASTC = 163, 166
COLOR, NORMAL = (200, 120, 40), (128, 128, 255)


@pytest.fixture
def encoder(monkeypatch):
    require_ktx2_packages(monkeypatch)


def make_square(width: int = 50, height: int = 30) -> Mesh:
    """Make a lit square of 2 m with a colour image, a normal map and an occlusion map."""
    images = [
        Image(f"{name}.png", given=np.full((height, width, 3), value, np.uint8))
        for name, value in (("color", COLOR), ("normal", NORMAL), ("occlusion", (255, 255, 255)))
    ]
    tree = {
        "pbrMetallicRoughness": {
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
            "baseColorTexture": {"index": 0},
        },
        "normalTexture": {"index": 1},
        "occlusionTexture": {"index": 2},
    }
    kept = GltfMaterialSource(tree, {k: (image, {}) for k, image in enumerate(images)}, None, images[0])
    vertices = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
    mesh = Mesh(vertices, np.array([(0, 1, 2), (0, 2, 3)], np.int32), up=(0.0, 1.0, 0.0))
    uvs = (mesh.vertices[mesh.triangles][:, :, :2] + 1) / 2
    return mesh.with_(
        normals=np.tile((0.0, 0.0, 1.0), (4, 1)),
        texture=Texture(uvs, np.zeros(2, np.int32), (Material("m", images[0], kept=kept),)),
    )


def describe_images(path: Path, folder: Path):
    """Return the headers of the images of a GLB file by name."""
    folder.mkdir()
    gltf = read_container(path)
    for one in gltf.tree["images"]:
        assert one["mimeType"] == "image/ktx2"
        (folder / one["name"]).write_bytes(bytes(gltf.read_view(one["bufferView"])))
    return run_node(DESCRIBE, PAGE / "node_modules", folder)


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_colours_become_etc1s_and_other_maps_uastc(tmp_path):
    export(make_square(), tmp_path / "a.glb", images="ktx2")
    tree = read_container(tmp_path / "a.glb").tree
    assert tree["extensionsRequired"] == tree["extensionsUsed"] == ["KHR_texture_basisu"]
    assert all(list(texture) == ["extensions"] for texture in tree["textures"])
    said = describe_images(tmp_path / "a.glb", tmp_path / "images")
    models = {name: header["colorModel"] for name, header in said.items()}
    assert models == {"color.ktx2": ETC1S, "normal.ktx2": UASTC, "occlusion.ktx2": UASTC}
    # KHR_texture_basisu requires sides that are multiples of four.
    assert all(header["size"] == [48, 28] for header in said.values())
    for name, value in (("color", COLOR), ("normal", NORMAL), ("occlusion", (255, 255, 255))):
        np.testing.assert_allclose(said[f"{name}.ktx2"]["means"][0][:3], value, atol=4)


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_the_web_preset_drops_maps_that_unlit_files_do_not_show(tmp_path):
    export(make_square(), tmp_path / "a.glb", preset("web"), images="ktx2", image_size=20)
    (header,) = describe_images(tmp_path / "a.glb", tmp_path / "images").values()
    assert (header["colorModel"], header["size"]) == (ETC1S, [20, 12])
    # Texture coordinates are quantized by the size of the written image.
    assert "KHR_texture_transform" in read_container(tmp_path / "a.glb").tree["extensionsRequired"]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.usefixtures("encoder")
def test_images_are_read_back_and_copied(tmp_path, suffix):
    given = textured_sheet()
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    export(given, tmp_path / "a" / f"a{suffix}", images="ktx2", quality=100)
    export(given, tmp_path / "b" / f"a{suffix}", images="ktx2", quality=100)
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()
    back = read_mesh(tmp_path / "a" / f"a{suffix}")
    (image,) = back.texture.images
    assert (image.mime, image.size, image.pixels.shape) == ("image/ktx2", (64, 48), (48, 64, 3))
    copied = export(back, tmp_path / f"b{suffix}", images="ktx2")
    assert copied.diagnostics == ()
    assert read_mesh(tmp_path / f"b{suffix}").texture.images[0].file_bytes == image.file_bytes
    # Programs that read other formats do not know KTX2.
    export(back, tmp_path / "c.obj")
    (converted,) = read_mesh(tmp_path / "c.obj").texture.images
    assert converted.mime == "image/png"
    np.testing.assert_array_equal(converted.pixels, image.pixels)
    export(back, tmp_path / "d.glb", images="jpeg")
    assert read_mesh(tmp_path / "d.glb").texture.images[0].mime == "image/jpeg"


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_without_the_encoder_images_are_copied_with_a_warning(monkeypatch, tmp_path):
    export(textured_sheet(), tmp_path / "a.glb", images="ktx2")
    data = read_mesh(tmp_path / "a.glb").texture.images[0].file_bytes
    monkeypatch.setenv("PATH", "")
    export(textured_sheet(), tmp_path / "plain.glb")
    back = read_mesh(tmp_path / "a.glb")
    with pytest.raises(MeshError, match="npm install --global ktx2-encoder"):
        _ = back.texture.images[0].pixels
    written = export(back, tmp_path / "b.glb", images="webp")
    assert ["npm install --global ktx2-encoder" in str(one) for one in written.diagnostics] == [True]
    assert read_container(tmp_path / "b.glb").tree["images"][0]["mimeType"] == "image/ktx2"
    assert data in (tmp_path / "b.glb").read_bytes()
    with pytest.raises(InputError, match="npm install --global ktx2-encoder"):
        export(textured_sheet(), tmp_path / "c.glb", images="ktx2")
    assert not (tmp_path / "c.glb").exists()


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".usdz", ".3mf"])
def test_only_gltf_has_ktx2_images(tmp_path, suffix):
    with pytest.raises(UsageError, match="only to glTF"):
        export(ball(), tmp_path / f"a{suffix}", images="ktx2")


def test_images_too_large_for_the_encoder_are_reduced_with_a_warning(monkeypatch):
    sizes = []

    def note_size(pixels, kind, quality):
        sizes.append((pixels.shape[:2], kind, quality))
        return b""

    monkeypatch.setattr(image_conversion, "encode_ktx2", note_size)
    encode = make_ktx2_encoder(75, 8192)
    for height, width in ((3072, 4096), (4096, 4096), (1, 2), (16, 8200)):
        with collecting() as diagnostics:
            encode(Image(given=np.zeros((height, width, 3), np.uint8)), "color")
        assert len(diagnostics) == (height == width)
    assert [size for size, _, _ in sizes] == [(3072, 4096), (3544, 3544), (4, 4), (12, 8192)]
    assert all(size[0] * size[1] <= 12 << 20 for size, _, _ in sizes)


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_the_validator_finds_nothing_else(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    export(make_square(), folder / "lit.glb", images="ktx2")
    export(textured_sheet().with_(up=UP), folder / "web.glb", preset("web"), images="ktx2")
    said = run_node(VALIDATE, PAGE, folder)
    assert len(said) == 2
    for found in said.values():
        worse = {one["code"] for one in found if one["severity"] < 2}
        # The square states no tangents, as every file of scanloom.
        assert worse - {"MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"} == UNKNOWN_TO_VALIDATOR


PROGRAM = """
import { AmbientLight, PerspectiveCamera, Scene, WebGLRenderer } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { KTX2Loader } from "three/addons/loaders/KTX2Loader.js";
import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";
const renderer = new WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setSize(64, 64);
const images = new KTX2Loader().setTranscoderPath("/three/examples/jsm/libs/basis/").detectSupport(renderer);
const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).setKTX2Loader(images);
window.seen = async (bytes, light) => {
  const { scene } = await loader.parseAsync(new Uint8Array(bytes).buffer, "");
  const all = new Scene();
  all.add(scene, new AmbientLight(0xffffff, light));
  const camera = new PerspectiveCamera(90, 1, 0.1, 10);
  camera.position.set(0, 0, 0.9);
  renderer.render(all, camera);
  const gl = renderer.getContext();
  const pixel = new Uint8Array(4);
  gl.readPixels(32, 32, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  const found = {};
  scene.traverse(({ material }) => {
    for (const key of ["map", "normalMap", "aoMap"]) {
      const map = material?.[key];
      if (map) found[key] = [map.isCompressedTexture === true, map.colorSpace, map.mipmaps.length];
    }
  });
  return { pixel: Array.from(pixel), found, error: gl.getError() };
};
"""
IMPORTS = {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_three_js_shows_the_images(tmp_path):
    """`KTX2Loader` transcodes all levels, with the colour space of the use."""
    page = (
        f'<script type="importmap">{json.dumps({"imports": IMPORTS})}</script>'
        f"<script type=module>{PROGRAM}</script>"
    )
    export(make_square(64, 32), tmp_path / "lit.glb", images="ktx2")
    export(make_square(64, 32), tmp_path / "web.glb", preset("web"), images="ktx2")
    types = {".js": "text/javascript", ".wasm": "application/wasm"}

    def answer(route):
        name = route.request.url.partition("://page/")[2]
        if not name:
            route.fulfill(body=page, content_type="text/html")
            return
        file = PAGE / "node_modules" / name
        route.fulfill(body=file.read_bytes(), content_type=types[file.suffix])

    with launch_browser() as started:
        opened = started.new_page()
        messages: list[str] = []
        opened.on("console", lambda message: messages.append(message.text))
        opened.on("pageerror", lambda error: messages.append(str(error)))
        opened.route("http://page/**", answer)
        opened.goto("http://page/")
        opened.wait_for_function("() => Boolean(window.seen)")
        for name, light in (("web", 0.0), ("lit", np.pi)):
            data = json.dumps(list((tmp_path / f"{name}.glb").read_bytes()))
            seen = opened.evaluate(f"seen({data}, {light})")
            assert seen["error"] == 0
            np.testing.assert_allclose(seen["pixel"][:3], COLOR, atol=8)
            maps = seen["found"]
            assert set(maps) == ({"map"} if name == "web" else {"map", "normalMap", "aoMap"})
            assert all(levels == 7 for _, _, levels in maps.values())
            assert maps["map"][1] == "srgb"
            assert all(maps[key][1] == "" for key in maps if key != "map")
        assert not [text for text in messages if "KTX2" in text or "rror" in text], messages

"""Compressed glTF files: quantization, encoded buffers, and what is read back."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from coloured_sheet import sheet
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages import Image, Material, Mesh, Texture, _kernels, read_mesh
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface.formats.gltf_container import read_container
from scanloom.stages.surface.formats.gltf_packing import COMPRESSIONS, make_quantization_grid
from scanloom.stages.surface.formats.gltf_writer import write_gltf

SMALL = [way for way in COMPRESSIONS if way != "none"]


def make_textured_sheet() -> Mesh:
    """Make a sheet with an image and a UV seam."""
    mesh = sheet()
    flat = mesh.vertices[mesh.triangles][:, :, :2] - (1, 2)
    uvs = flat * (0.45, 0.9) + 0.02
    uvs[len(uvs) // 2 :, :, 0] += 0.5
    image = Image(given=np.random.default_rng(3).integers(0, 256, (32, 32, 3)).astype(np.uint8))
    ids = np.zeros(len(uvs), np.int32)
    return mesh.with_(colors=None, texture=Texture(uvs, ids, (Material("m", image),)))


def make_two_parts() -> Mesh:
    """Make two sheets as two parts, with vertex normals."""
    one = sheet()
    count = len(one.vertices)
    up = np.tile((0.0, 0.0, 1.0), (2 * count, 1))
    return Mesh(
        np.concatenate([one.vertices, one.vertices + np.array((3, 0, 0))]),
        np.concatenate([one.triangles, one.triangles + count]).astype(np.int32),
        normals=up,
        part_ids=np.repeat([0, 1], len(one.triangles)).astype(np.int32),
        part_names=("one", "two"),
    )


def sort_corners(mesh: Mesh) -> np.ndarray:
    """Return the corner positions of all triangles in an order that does not depend on the file."""
    corners = mesh.vertices[mesh.triangles]
    first = np.lexsort(corners.transpose(2, 0, 1).reshape(3, len(corners), 3)[::-1].max(axis=0).T)
    rolled = np.stack([np.roll(c, -int(np.lexsort(c.T)[0]), axis=0) for c in corners[first]])
    return rolled[np.lexsort(rolled.reshape(len(rolled), 9).T)]


@pytest.mark.parametrize("way", SMALL)
@pytest.mark.parametrize("made", [sheet, make_textured_sheet, make_two_parts])
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_quantized_values_are_within_half_a_step(tmp_path, way, made, suffix):
    mesh = made().with_(up=(0.0, -1.0, 0.0))
    path = tmp_path / f"a{suffix}"
    write_gltf(path, mesh, compress=way)
    back = read_mesh(path)
    lattice = make_quantization_grid(mesh.vertices)
    kept = replace(mesh, vertices=lattice.origin + lattice.quantize(mesh.vertices)[:, :3] * lattice.step)
    assert np.abs(kept.vertices - mesh.vertices).max() <= lattice.step / 2 * (1 + 1e-9)
    np.testing.assert_allclose(sort_corners(back), sort_corners(kept), atol=1e-9)
    assert back.part_names == mesh.part_names
    assert back.up == pytest.approx((0, -1, 0))
    if mesh.colors is not None:

        def list_colored_points(one):
            found = zip(one.vertices.round(6).tolist(), one.colors.tolist(), strict=True)
            return sorted((*p, *c) for p, c in found)

        np.testing.assert_allclose(list_colored_points(back), list_colored_points(kept))
    if mesh.texture is not None:
        assert back.texture.images[0].file_bytes == mesh.texture.images[0].file_bytes

        def sort_corner_rows(one):
            rows = np.concatenate([one.vertices[one.triangles], one.texture.uvs], axis=2).reshape(-1, 5)
            return rows[np.lexsort(rows.round(4).T)]

        np.testing.assert_allclose(sort_corner_rows(back), sort_corner_rows(kept), atol=1e-4)
    if mesh.normals is not None:
        np.testing.assert_allclose(back.normals, np.tile((0, 0, 1), (len(back.vertices), 1)), atol=0.01)


def test_each_compression_is_smaller_than_the_previous_one(tmp_path):
    sizes = []
    for way in COMPRESSIONS:
        write_gltf(tmp_path / "a.glb", sheet(60), compress=way)
        sizes.append((tmp_path / "a.glb").stat().st_size)
    assert sizes[1] < 0.9 * sizes[0]
    assert sizes[2] < 0.8 * sizes[1]


def test_texture_coordinates_beyond_the_image_are_kept(tmp_path):
    mesh = make_textured_sheet()
    texture = replace(mesh.texture, uvs=mesh.texture.uvs * 7 - 3)
    write_gltf(tmp_path / "a.glb", mesh.with_(texture=texture), compress="meshopt")
    back = read_mesh(tmp_path / "a.glb").texture.uvs
    np.testing.assert_allclose([back.min(), back.max()], [texture.uvs.min(), texture.uvs.max()], atol=1e-6)


@pytest.mark.parametrize("steps", [1, 2, 8])
@pytest.mark.parametrize("way", SMALL)
def test_texture_coordinates_can_be_quantized_to_texel_fractions(tmp_path, way, steps):
    mesh = make_textured_sheet()
    write_gltf(tmp_path / "a.glb", mesh, compress=way, texel_steps=steps)
    tree = read_container(tmp_path / "a.glb").tree
    assert "KHR_texture_transform" in tree["extensionsRequired"]
    given = tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"]
    # The image has 32 × 32 texels.
    assert given["KHR_texture_transform"]["scale"] == [1 / (32 * steps)] * 2
    back = read_mesh(tmp_path / "a.glb")
    assert back.diagnostics == ()

    def sort_corner_rows(one):
        rows = np.concatenate([one.vertices[one.triangles], one.texture.uvs], axis=2).reshape(-1, 5)
        return rows[np.lexsort(rows[:, :2].round(3).T)]

    off = np.abs(sort_corner_rows(back)[:, 3:] - sort_corner_rows(mesh)[:, 3:]).max()
    assert 0 < off <= 0.5 / (32 * steps) + 1e-9
    # A second round trip loses nothing, and does not scale twice.
    write_gltf(tmp_path / "b.glb", back, compress=way, texel_steps=steps)
    np.testing.assert_allclose(
        sort_corner_rows(read_mesh(tmp_path / "b.glb"))[:, 3:], sort_corner_rows(back)[:, 3:], atol=1e-9
    )


def test_texel_fractions_beyond_16_bits_are_not_used(tmp_path):
    mesh = make_textured_sheet()
    write_gltf(tmp_path / "a.glb", mesh, compress="quantize", texel_steps=4096)
    assert "KHR_texture_transform" not in (tmp_path / "a.glb").read_bytes().decode("latin-1")
    beyond = mesh.with_(texture=replace(mesh.texture, uvs=mesh.texture.uvs * 7 - 3))
    write_gltf(tmp_path / "b.glb", beyond, compress="quantize", texel_steps=2)
    assert "KHR_texture_transform" not in (tmp_path / "b.glb").read_bytes().decode("latin-1")
    back = read_mesh(tmp_path / "b.glb").texture.uvs
    np.testing.assert_allclose([back.min(), back.max()], [beyond.texture.uvs.min(), beyond.texture.uvs.max()])


@pytest.mark.parametrize("bits", [8, 12, 14, 16])
def test_fewer_bits_give_a_larger_quantization_error(tmp_path, bits):
    mesh = sheet()
    write_gltf(tmp_path / "a.glb", mesh, compress="meshopt", position_bits=bits)
    back = read_mesh(tmp_path / "a.glb")
    lattice = make_quantization_grid(mesh.vertices, bits)
    # The step is a power of two, such that the longest side (1 m) fits into the bits.
    assert lattice.step == 2.0 ** (1 - bits)
    off = np.abs(np.sort(back.vertices, axis=0) - np.sort(mesh.vertices, axis=0)).max()
    assert lattice.step / 8 < off <= lattice.step / 2 + 1e-9


def test_unlit_files_have_no_normals_and_keep_colours(tmp_path):
    write_gltf(
        tmp_path / "a.glb",
        make_textured_sheet().with_(normals=np.tile((0.0, 0, 1), (144, 1))),
        shading="unlit",
    )
    tree = read_container(tmp_path / "a.glb").tree
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    assert all("KHR_materials_unlit" in material["extensions"] for material in tree["materials"])
    assert "NORMAL" not in tree["meshes"][0]["primitives"][0]["attributes"]
    back = read_mesh(tmp_path / "a.glb")
    assert back.texture.materials[0].name == "m"
    # A mesh without colours is only visible with lighting.
    write_gltf(tmp_path / "b.glb", sheet().with_(colors=None), shading="unlit")
    assert "extensionsUsed" not in read_container(tmp_path / "b.glb").tree
    # Vertex colours alone are not read as a material.
    write_gltf(tmp_path / "c.glb", sheet(), shading="unlit")
    assert read_mesh(tmp_path / "c.glb").texture is None


def test_unlit_excludes_the_extensions_of_lit_materials(tmp_path):
    """Specular and ior must not occur next to KHR_materials_unlit, by their specifications."""
    write_gltf(tmp_path / "a.gltf", make_textured_sheet())
    tree = json.loads((tmp_path / "a.gltf").read_text())
    tree["images"].append(dict(tree["images"][0]))
    tree["textures"].append({"source": 1})
    tree["materials"][0]["extensions"] = {
        "KHR_materials_specular": {"specularFactor": 0.2, "specularTexture": {"index": 1}},
        "KHR_materials_ior": {"ior": 1.4},
        "EXT_other": {"kept": True},
    }
    tree["extensionsUsed"] = ["KHR_materials_specular", "KHR_materials_ior", "EXT_other"]
    (tmp_path / "b.gltf").write_text(json.dumps(tree))
    lit = read_mesh(tmp_path / "b.gltf")
    for shading, extensions in (
        ("unlit", {"EXT_other": {"kept": True}, "KHR_materials_unlit": {}}),
        ("keep", tree["materials"][0]["extensions"]),
    ):
        write_gltf(tmp_path / "c.glb", lit, shading=shading)
        written = read_container(tmp_path / "c.glb").tree
        assert written["materials"][0]["extensions"] == extensions
        assert set(written["extensionsUsed"]) == set(extensions)
        assert len(written["images"]) == (1 if shading == "unlit" else 2)
    # A second round trip changes nothing: an unlit material stays unlit.
    write_gltf(tmp_path / "c.glb", lit, shading="unlit")
    write_gltf(tmp_path / "d.glb", read_mesh(tmp_path / "c.glb"), shading="keep")
    assert (
        read_container(tmp_path / "d.glb").tree["materials"]
        == (read_container(tmp_path / "c.glb").tree["materials"])
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 300), st.integers(1, 16), st.integers(0, 2**32 - 1), st.booleans())
def test_encoded_rows_are_decoded_exactly(count, quarter, seed, smooth):
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, 256, (count, 4 * quarter)).astype(np.uint8)
    if smooth:
        rows[:] = rows[0]
    packed = _kernels.encode_rows(rows)
    assert _kernels.decode_rows(packed, count, 4 * quarter, "NONE") == rows.tobytes()
    for cut in (packed[:-1], packed[: len(packed) // 2], b""):
        with pytest.raises(ValueError, match="damaged"):
            _kernels.decode_rows(cut, count, 4 * quarter, "NONE")


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=400), st.integers(0, 2**40), st.sampled_from([4, 8, 12, 256]))
def test_arbitrary_bytes_are_decoded_or_refused(data, count, size):
    for of_mode in ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"):
        try:
            found = _kernels.decode_rows(b"\xa0" + data, count, size, of_mode)
        except ValueError:
            continue
        assert len(found) == count * size
    for mode, head in (("TRIANGLES", b"\xe0"), ("TRIANGLES", b"\xe1"), ("INDICES", b"\xd1")):
        try:
            found = _kernels.decode_indices(head + data, count, 4, mode)
        except ValueError:
            continue
        assert len(found) == count * 4


MAY_DO = ({"count": 143}, {"filter": "OCTAHEDRAL", "byteStride": 12})


def test_changed_properties_of_an_encoded_view_are_damage(tmp_path):
    write_gltf(tmp_path / "a.gltf", sheet(), compress="meshopt")
    whole = (tmp_path / "a.gltf").read_text()
    for change in (
        {"byteLength": 7},
        {"count": 10**9},
        {"count": 143},
        {"byteStride": 5},
        {"mode": "SPELLS"},
        {"filter": "OCTAHEDRAL", "byteStride": 12},
        {"byteOffset": 10**9},
    ):
        for number in range(3):
            tree = json.loads(whole)
            tree["bufferViews"][number]["extensions"]["EXT_meshopt_compression"] |= change
            (tmp_path / "a.gltf").write_text(json.dumps(tree))
            # A smaller count or another filter may still give a mesh.
            how = suppress(InputError) if change in MAY_DO else pytest.raises(InputError)
            with how:
                read_mesh(tmp_path / "a.gltf")

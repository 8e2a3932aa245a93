from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from textured_models import (
    bumpy_plane,
    encode_jpeg,
    encode_png,
    gltf_material,
    replace_materials,
    sample_points,
    textured_ball,
    waves,
)

from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.formats.gltf_materials import GltfMaterialSource
from scanloom.stages.surface.mesh import Image, Material, Mesh
from scanloom.stages.surface.mesh_files import write_mesh
from scanloom.stages.surface.surface_color import compute_surface_colors, sample_bilinear
from scanloom.stages.texturing.image_format import estimate_jpeg_quality


def get_texture_image(mesh: Mesh, name: str, material: int = 0) -> Image:
    """Get the image of an additional texture of a material."""
    assert mesh.texture is not None
    kept = mesh.texture.materials[material].kept
    assert isinstance(kept, GltfMaterialSource)
    return kept.textures[kept.tree[name]["index"]][0]


def measure_color_difference(mesh: Mesh, original: Mesh) -> float:
    """Compute the RMS colour difference in levels."""
    from scanloom import stages

    return stages.compare(original, mesh, samples=5000).color_a_to_b.rmse


@pytest.mark.parametrize("quality", [60, 92])
def test_jpeg_keeps_its_quality_and_does_not_grow(tmp_path: Path, quality: int) -> None:
    mesh = textured_ball(encode_jpeg(waves(), quality))
    found = simplify(mesh, ratio=0.2, bake=True)
    assert found.baked is not None
    assert found.mesh.texture is not None
    (image,) = found.mesh.texture.images
    assert image.mime == "image/jpeg"
    estimated, is_subsampled = estimate_jpeg_quality(image.file_bytes)
    assert abs(estimated - quality) <= 1
    assert is_subsampled
    for path, one in ((tmp_path / "in.glb", mesh), (tmp_path / "out.glb", found.mesh)):
        write_mesh(path, one)
    assert (tmp_path / "out.glb").stat().st_size < (tmp_path / "in.glb").stat().st_size
    (size,) = found.baked.sizes
    assert size[0] * size[1] <= 512 * 256
    assert found.baked.color.rmse < 4
    assert measure_color_difference(found.mesh, mesh) < 4


def test_png_stays_png() -> None:
    found = simplify(textured_ball(encode_png(waves())), ratio=0.2)
    assert [image.mime for image in found.mesh.texture.images] == ["image/png"]
    assert found.baked.quality is None
    assert found.baked.color.rmse < 3


def test_a_noise_image_does_not_grow() -> None:
    """An image that is hard to compress loses resolution or quality."""
    flat = waves()
    flat[:] = 90
    # The source file is small, because most of it is constant; the visible part is noise.
    rng = np.random.default_rng(0)
    flat[64:192] = rng.integers(0, 255, flat[64:192].shape)
    source = encode_jpeg(flat, 90)
    mesh = textured_ball(source, rings=10, sectors=12)
    found = simplify(mesh, ratio=1.0, bake=True)
    assert found.baked.image_bytes <= len(source.file_bytes)


def test_alpha_is_baked_if_the_material_uses_it() -> None:
    pixels = np.dstack([waves(), np.tile(np.linspace(0, 255, 256)[:, None], (1, 512)).astype(np.uint8)])
    mesh = textured_ball(encode_png(pixels))
    for mode, channels in (("BLEND", 4), ("OPAQUE", 3)):
        material = gltf_material("glass", encode_png(pixels), alphaMode=mode)
        original = replace_materials(mesh, (material,), mesh.texture.material_ids)
        found = simplify(original, ratio=0.3)
        (image,) = found.mesh.texture.images
        assert image.pixels.shape[2] == channels
        assert found.mesh.texture.materials[0].kept.tree["alphaMode"] == mode
        if channels == 4:
            at, weights, places = sample_points(found.mesh)
            uvs = np.einsum("kc,kcx->kx", weights, found.mesh.texture.uvs[at])
            alpha = sample_bilinear(image.pixels[..., [3, 3, 3]], uvs, ("clamp", "clamp"))[:, 0]
            polar = np.arccos(places[:, 2] / np.linalg.norm(places, axis=1))
            # The image covers the sphere from pole to pole.
            assert np.abs(alpha - 255 * polar / np.pi).mean() < 4


def test_material_classes_have_separate_atlases() -> None:
    red, blue = waves(), waves()
    red[..., 2], blue[..., 0] = 0, 0
    mesh = textured_ball(Image(given=red))
    south = (mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] < 0).astype(np.int32)
    materials = (
        gltf_material("north", encode_png(red)),
        gltf_material("south", encode_png(blue), doubleSided=True),
    )
    found = simplify(replace_materials(mesh, materials, south), ratio=0.3)
    texture = found.mesh.texture
    assert [material.name for material in texture.materials] == ["north", "south"]
    assert [material.kept.tree.get("doubleSided") for material in texture.materials] == [None, True]
    at, weights, places = sample_points(found.mesh)
    colors = compute_surface_colors(found.mesh, at, weights)
    ids = texture.material_ids[at]
    # The border between materials is unchanged, and neither shows the colours of the other.
    assert (ids[places[:, 2] < -0.1] == 1).all()
    assert (ids[places[:, 2] > 0.1] == 0).all()
    assert colors[ids == 0, 2].max() < 10
    assert colors[ids == 1, 0].max() < 10


def test_materials_that_differ_in_factors_share_an_atlas() -> None:
    image = encode_png(waves())
    mesh = textured_ball(image)
    ids = (mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] < 0).astype(np.int32)
    half = (0.5, 0.5, 0.5, 1.0)
    plain = gltf_material("one", image)
    dark = Material(
        "two", image, half, kept=GltfMaterialSource(plain.kept.tree, plain.kept.textures, half, image)
    )
    original = replace_materials(mesh, (plain, dark), ids)
    found = simplify(original, ratio=0.3, bake=True)
    (material,) = found.mesh.texture.materials
    assert material.base_color is None
    assert measure_color_difference(found.mesh, original) < 5


def test_a_common_factor_is_not_baked_twice() -> None:
    image, factor = encode_png(waves()), (0.5, 0.25, 1.0, 1.0)
    plain = gltf_material("one", image)
    tinted = Material(
        "one", image, factor, kept=GltfMaterialSource(plain.kept.tree, plain.kept.textures, factor, image)
    )
    mesh = textured_ball(image)
    original = replace_materials(mesh, (tinted,), mesh.texture.material_ids)
    found = simplify(original, ratio=0.3)
    assert found.mesh.texture.materials[0].base_color == factor
    assert measure_color_difference(found.mesh, original) < 4


def test_vertex_colours_multiplied_with_an_image_are_baked() -> None:
    image = encode_png(waves())
    plain = gltf_material("one", image)
    kept = GltfMaterialSource(
        plain.kept.tree, plain.kept.textures, None, image, multiplies_vertex_colors=True
    )
    mesh = textured_ball(image)
    grey = np.rint(255 * (0.6 + 0.4 * mesh.vertices[:, 2:])).clip(0, 255).astype(np.uint8)
    original = replace_materials(mesh, (Material("one", image, kept=kept),), mesh.texture.material_ids)
    original = original.with_(colors=np.repeat(grey, 3, axis=1))
    found = simplify(original, ratio=0.3)
    assert found.mesh.colors is None
    assert not found.mesh.texture.materials[0].kept.multiplies_vertex_colors
    assert measure_color_difference(found.mesh, original) < 4


def test_a_repeating_image_is_baked_across_its_border() -> None:
    mesh = textured_ball(encode_png(waves()))
    moved = mesh.texture.uvs + np.array([0.37, -2.0])
    original = mesh.with_(
        texture=type(mesh.texture)(moved, mesh.texture.material_ids, mesh.texture.materials)
    )
    assert measure_color_difference(simplify(original, ratio=0.3).mesh, original) < 4


def test_normal_maps_keep_world_space_normals() -> None:
    mesh, normals_at = bumpy_plane()
    found = simplify(mesh, ratio=0.05).mesh
    assert len(found.triangles) < len(mesh.triangles) / 10
    at, weights, places = sample_points(found)
    image = get_texture_image(found, "normalTexture")
    uvs = found.texture.uvs
    texels = sample_bilinear(image.pixels, np.einsum("kc,kcx->kx", weights, uvs[at]), ("clamp", "clamp"))
    local = texels / 127.5 - 1
    # Tangent frame of each triangle from its edges; the plane has a single normal.
    corners = found.vertices[found.triangles]
    edges, steps = corners[:, 1:] - corners[:, :1], uvs[:, 1:] - uvs[:, :1]
    frame = np.linalg.solve(steps, edges)
    frame /= np.linalg.norm(frame, axis=2, keepdims=True)
    tangent, bitangent = frame[at, 0], frame[at, 1]
    world = local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * [0.0, 0.0, 1.0]
    world /= np.linalg.norm(world, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.einsum("kx,kx->k", world, normals_at(places)).clip(-1, 1)))
    assert angle.mean() < 1.5
    assert np.percentile(angle, 99) < 6


def test_other_maps_keep_their_values() -> None:
    occlusion = waves()
    occlusion[..., 1:] = 40
    image = encode_png(waves())
    material = gltf_material(
        "map", image, {"occlusionTexture": encode_png(occlusion), "emissiveTexture": image}
    )
    mesh = textured_ball(image)
    found = simplify(replace_materials(mesh, (material,), mesh.texture.material_ids), ratio=0.3).mesh
    pixels = get_texture_image(found, "occlusionTexture").pixels
    assert np.abs(pixels[..., 1:].astype(int) - 40).max() <= 1
    as_mesh = mesh.with_(
        texture=replace_materials(
            mesh, (Material("o", encode_png(occlusion)),), mesh.texture.material_ids
        ).texture
    )
    shown = replace_materials(
        found, (Material("o", Image(given=pixels), wrap=("clamp", "clamp")),), found.texture.material_ids
    )
    assert measure_color_difference(shown, as_mesh) < 4
    # An image that two textures share becomes one image for each.
    assert get_texture_image(found, "emissiveTexture").pixels.shape == found.texture.images[0].pixels.shape


def test_equal_input_gives_equal_bytes() -> None:
    mesh = textured_ball(encode_jpeg(waves()))
    one, other = (simplify(mesh, ratio=0.2, threads=threads).mesh.texture for threads in (1, 2))
    assert one.images[0].file_bytes == other.images[0].file_bytes
    assert np.array_equal(one.uvs, other.uvs)

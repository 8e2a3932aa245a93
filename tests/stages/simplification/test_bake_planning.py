from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from seamed_meshes import wrapped_ball
from textured_models import encode_jpeg, encode_png, gltf_material, replace_materials, textured_ball, waves

from scanloom import stages
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.simplification import bake_planning
from scanloom.stages.simplification.bake_planning import derive_max_shape, is_better_baked
from scanloom.stages.simplification.requirements import report_unmet_requirements
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.simplify import SimplifyParams, simplify
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture


def compute_diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def test_a_textured_model_is_simplified_freely_and_baked() -> None:
    mesh = textured_ball(encode_jpeg(waves()), bumps=0.05)
    found = simplify(mesh, ratio=0.1, bake=True)
    assert found.method == "quadric"
    assert found.to_dict()["baked"]["color"]["rmse_levels"] == found.baked.color.rmse
    kept = simplify(mesh, ratio=0.1, keep_uv=True)
    assert kept.method == "seams"
    assert kept.baked is None
    assert "baked" not in kept.to_dict()
    error, error_of_kept = (stages.compare(mesh, one.mesh, samples=20_000) for one in (found, kept))
    assert error.symmetric.rms <= error_of_kept.symmetric.rms
    # If baking loses much detail, the default keeps the images.
    chosen = stages.compare(mesh, simplify(mesh, ratio=0.1).mesh, samples=20_000)
    smaller = min(error.color_a_to_b.rmse, error_of_kept.color_a_to_b.rmse)
    assert chosen.color_a_to_b.rmse <= max(3.0, smaller / 0.35)


def test_without_options_the_bound_follows_from_the_size() -> None:
    mesh = textured_ball(encode_jpeg(waves()))
    found = simplify(mesh)
    assert found.method == "certified"
    assert found.default_max_shape == pytest.approx(derive_max_shape(mesh))
    assert found.to_dict()["default_max_shape_m"] == found.default_max_shape
    assert found.details.proven
    assert found.details.shape_bound_m <= found.default_max_shape
    assert found.baked is not None
    kept = simplify(mesh, keep_uv=True)
    assert kept.method == "certified"
    assert kept.default_max_shape == found.default_max_shape
    # Meshes without images have another default.
    assert simplify(mesh.with_(texture=None)).method == "jia01"
    assert simplify(mesh.with_(texture=None)).default_max_shape is None


def test_an_unproven_default_bound_is_not_an_unmet_requirement() -> None:
    details = {"proven": False, "shape_bound_m": 0.2, "color_bound_levels": None}
    metrics = {"details": details, "triangles_before": 10, "triangles": 5, "stopped_by": "unproven"}
    with collecting() as diagnostics:
        report_unmet_requirements(SimplifyParams(), {**metrics, "default_max_shape_m": 0.1})
    assert diagnostics == []
    with collecting() as diagnostics:
        report_unmet_requirements(SimplifyParams(max_shape=0.1), metrics)
    assert [str(one) for one in diagnostics] == [
        "the requested bounds are not proven; 0.2 m are proven instead."
    ]
    assert diagnostics[0].severity == Severity.UNMET


def test_a_stray_triangle_does_not_change_the_default_bound() -> None:
    mesh = wrapped_ball(bumps=0.0)
    assert derive_max_shape(mesh) == pytest.approx(compute_diagonal(mesh) / 1000, rel=0.05)
    stray = np.array([[500, 0, 0], [500.001, 0, 0], [500, 0.001, 0]])
    triangles = np.vstack([mesh.triangles, len(mesh.vertices) + np.arange(3)]).astype(np.int32)
    far = Mesh(np.vstack([mesh.vertices, stray]), triangles)
    assert derive_max_shape(far) == pytest.approx(derive_max_shape(mesh), rel=0.01)


def test_with_a_bound_the_distance_is_proven_and_the_image_baked() -> None:
    mesh = textured_ball(encode_jpeg(waves()), bumps=0.05)
    bound = 0.01 * compute_diagonal(mesh)
    found = simplify(mesh, max_shape=bound)
    assert found.method == "certified"
    assert found.details.proven
    assert found.details.color_measured_levels is None
    assert "colours differ" not in found.details.describe()
    certificate = stages.certify(found.mesh.with_(texture=None), mesh.with_(texture=None), max_shape=bound)
    assert certificate.within_limits
    assert found.baked.color.rmse < 5
    # A colour bound keeps the image.
    assert simplify(mesh, max_shape=bound, max_color=60.0).baked is None


def test_keep_uv_keeps_the_image_and_coordinates_stay_in_their_charts() -> None:
    mesh = textured_ball(encode_jpeg(waves()), bumps=0.05)
    for how in ({"ratio": 0.2}, {"max_shape": 0.01 * compute_diagonal(mesh)}):
        found = simplify(mesh, keep_uv=True, **how).mesh
        assert found.texture.images[0] is mesh.texture.images[0]
        assert found.texture.uvs.min() >= 0
        assert found.texture.uvs.max() <= 1


def test_without_baking_the_texture_is_dropped_with_a_diagnostic() -> None:
    mesh = textured_ball(encode_jpeg(waves()))
    found = simplify(mesh, ratio=0.2, bake=False)
    assert found.method == "quadric"
    assert found.mesh.texture is None
    assert any("discards the texture" in str(one) for one in found.diagnostics)


@pytest.mark.parametrize("method", ["quadric", "jia01", "planar"])
def test_methods_that_drop_images_bake_a_new_one(method: str) -> None:
    mesh = textured_ball(encode_png(waves()))
    how = {"ratio": 0.3} if method == "quadric" else {}
    found = simplify(mesh, method=method, **how)
    assert found.baked is not None
    assert not any("discards the texture" in str(one) for one in found.diagnostics)


def test_a_named_method_that_keeps_images_bakes_only_on_request() -> None:
    mesh = textured_ball(encode_png(waves()))
    assert simplify(mesh, method="seams", ratio=0.3).baked is None
    assert simplify(mesh, method="seams", ratio=0.3, bake=True).baked is not None
    assert simplify(mesh, method="certified", max_shape=0.05).baked is None


def test_parts_are_kept_and_share_an_image() -> None:
    one = textured_ball(encode_png(waves()), rings=12, sectors=16)
    vertices = np.vstack([one.vertices, one.vertices + np.array([3, 0, 0])])
    triangles = np.vstack([one.triangles, one.triangles + len(one.vertices)]).astype(np.int32)
    uvs, ids = np.tile(one.texture.uvs, (2, 1, 1)), np.zeros(len(triangles), np.int32)
    mesh = Mesh(
        vertices,
        triangles,
        texture=Texture(uvs, ids, one.texture.materials),
        part_ids=np.repeat([0, 1], len(one.triangles)).astype(np.int32),
        part_names=("left", "right"),
    )
    found = simplify(mesh, ratio=0.3)
    assert found.method == "seams"
    assert found.mesh.part_names == ("left", "right")
    middles = found.mesh.vertices[found.mesh.triangles].mean(axis=1)[:, 0]
    np.testing.assert_array_equal(found.mesh.part_ids, (middles > 1.5).astype(np.int32))
    assert len(found.mesh.texture.images) == 1
    only = mesh.with_(part_ids=np.zeros(len(triangles), np.int32), part_names=("both",))
    found = simplify(only, ratio=0.3)
    assert found.method == "quadric"
    assert found.mesh.part_names == ("both",)


def test_vertex_copies_that_differ_by_rounding_are_joined() -> None:
    mesh = textured_ball(encode_png(waves()), rings=12, sectors=16)
    flat = mesh.triangles.reshape(-1)
    rng = np.random.default_rng(0)
    shaken = mesh.vertices[flat] + rng.uniform(-1, 1, (len(flat), 3)) * 1e-8
    loose = mesh.with_(vertices=shaken, triangles=np.arange(len(flat), dtype=np.int32).reshape(-1, 3))
    found = simplify(loose, ratio=0.3)
    assert len(found.mesh.triangles) < 0.35 * len(mesh.triangles)
    edges = np.sort(found.mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


@pytest.mark.parametrize("how", ["repeats", "palette"])
def test_images_that_do_not_fit_an_atlas_are_kept(how: str) -> None:
    mesh = textured_ball(encode_png(waves()))
    uvs = mesh.texture.uvs * 5 if how == "repeats" else np.full_like(mesh.texture.uvs, 0.3)
    original = mesh.with_(texture=Texture(uvs, mesh.texture.material_ids, mesh.texture.materials))
    found = simplify(original, ratio=0.3)
    assert found.baked is None
    assert found.method == "seams"
    assert any("texture coordinates and images are kept" in str(one) for one in found.diagnostics)
    assert found.mesh.texture.images[0] is mesh.texture.images[0]


def test_images_are_kept_if_the_atlas_layout_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def raise_layout_error(*_: object, **__: object) -> None:
        raise MeshError(MACHINE_BUG, "falls into too many charts for an image of so few texels.", "mesh")

    monkeypatch.setattr(bake_planning, "bake_materials", raise_layout_error)
    mesh = textured_ball(encode_png(waves()), rings=12, sectors=16)
    found = simplify(mesh, ratio=0.3)
    assert found.method == "seams"
    assert found.mesh.texture.images[0] is mesh.texture.images[0]
    assert any("kept with their seams" in str(one) for one in found.diagnostics)
    with pytest.raises(MeshError, match="too many charts"):
        simplify(mesh, ratio=0.3, bake=True)
    assert simplify(mesh, method="quadric", ratio=0.3).mesh.texture is None


def test_vertex_colours_are_baked_on_request() -> None:
    mesh = textured_ball(Image(given=waves())).with_(texture=None)
    colors = np.rint(127.5 * (mesh.vertices + 1)).clip(0, 255).astype(np.uint8)
    found = simplify(mesh.with_(colors=colors), ratio=0.2, bake=True)
    assert found.baked.vertex_color is not None
    assert found.mesh.colors is None
    assert simplify(mesh.with_(colors=colors), ratio=0.2).baked is None


def test_a_material_without_an_image_is_kept() -> None:
    mesh = textured_ball(encode_png(waves()))
    ids = (mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] < 0).astype(np.int32)
    glass = Material("glass", base_color=(0.1, 0.2, 0.9, 0.5))
    model = replace_materials(mesh, (gltf_material("map", encode_png(waves())), glass), ids)
    found = simplify(model, ratio=0.3, bake=True)
    assert found.method == "seams"
    assert found.mesh.texture.materials[1] is glass
    assert not found.mesh.texture.has_uvs()[found.mesh.texture.material_ids == 1].any()
    assert len(found.mesh.texture.images) == 1


def test_keep_uv_with_bake_is_refused() -> None:
    with pytest.raises(UsageError, match="keep_uv and bake are both given"):
        simplify(wrapped_ball(), ratio=0.5, keep_uv=True, bake=True)


def test_fine_detail_in_an_image_keeps_its_texels() -> None:
    """Noise cannot be resampled without loss, and the seams of a ball can be kept."""
    noise = np.random.default_rng(0).integers(0, 2, (128, 128, 1), np.uint8) * np.full(3, 255, np.uint8)
    mesh = textured_ball(Image(given=noise), bumps=0.0)
    found = simplify(mesh, ratio=0.3)
    assert found.method == "seams"
    assert found.baked is None
    assert found.kept_images is not None
    assert found.kept_images.rmse_levels < found.kept_images.baked_rmse_levels
    assert simplify(mesh, ratio=0.3, bake=True).baked is not None


@pytest.mark.parametrize("is_better", [True, False])
def test_repeated_images_are_baked_if_their_seams_keep_too_many_triangles(
    monkeypatch: pytest.MonkeyPatch, is_better: bool
) -> None:
    asked: list[tuple[int, int]] = []

    def record_comparison(
        _mesh: Mesh, baked: SimplificationResult[Any], kept: SimplificationResult[Any]
    ) -> bool:
        asked.append((len(baked.mesh.triangles), len(kept.mesh.triangles)))
        return is_better

    monkeypatch.setattr("scanloom.stages.simplification.simplify.is_better_baked", record_comparison)
    mesh = textured_ball(encode_png(waves(64, 32)))
    rng = np.random.default_rng(3)
    # Each triangle is a separate chart.
    texture = replace(mesh.texture, uvs=rng.random(mesh.texture.uvs.shape))
    found = simplify(mesh.with_(texture=texture), ratio=0.1)
    ((baked_count, kept_count),) = asked
    assert baked_count <= len(mesh.triangles) // 10 < kept_count
    assert len(found.mesh.triangles) == (baked_count if is_better else kept_count)
    assert (found.baked is not None) == is_better
    assert any("new images are baked" in str(one) for one in found.diagnostics) == is_better
    # Explicit requests are not compared.
    simplify(mesh.with_(texture=texture), ratio=0.1, keep_uv=True)
    assert len(asked) == 1


def test_a_baked_mesh_is_better_only_with_smaller_errors() -> None:
    mesh = textured_ball(encode_png(waves(64, 32)))
    coarse = simplify(mesh, ratio=0.03, bake=True)
    fine = simplify(mesh, ratio=0.3, keep_uv=True)
    assert not is_better_baked(mesh, coarse, fine)
    assert not is_better_baked(mesh, fine, coarse)
    spoiled = replace(fine, mesh=fine.mesh.with_(vertices=fine.mesh.vertices * 1.5))
    black = replace(spoiled.mesh.texture, uvs=np.full_like(spoiled.mesh.texture.uvs, 0.9))
    spoiled = replace(spoiled, mesh=spoiled.mesh.with_(texture=black))
    assert is_better_baked(mesh, coarse, spoiled)
